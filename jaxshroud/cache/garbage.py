"""Times in which no garbage is collected.

Tracing makes many objects that stay, and each collection looks at all there are. And a collection calls JAX, which lets
other threads run: within the import of an extension module, whose loader is locked meanwhile, a thread that waits for
this lock then holds Python's, and neither ever goes on.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_changing = Lock()
_holders: list[bool] = []  # those that hold collections back now; the first knows whether there were any


@contextmanager
def no_garbage_collected() -> Iterator[None]:
    """Leave garbage for later, in all threads."""
    with _changing:
        _holders.append(gc.isenabled())
        gc.disable()
    try:
        yield
    finally:
        with _changing:
            collected = _holders[0]
            _holders.pop()
            if collected and not _holders:
                gc.enable()
