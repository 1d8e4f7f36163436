"""Whether this process compiles a program: in a file of its own, as messages ask for it before JAX is imported."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_running = 0  # compilations, of all threads


@contextmanager
def compilation(begins: bool = True) -> Iterator[None]:
    """Within, a program is being compiled, if one `begins` to be at all."""
    _count(begins)
    try:
        yield
    finally:
        _count(-begins)


def _count(more: int) -> None:
    global _running
    with _lock:
        _running += more


def is_compiling() -> bool:
    """Whether any thread of this process compiles a program."""
    return _running > 0
