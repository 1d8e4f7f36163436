"""What this process is doing, for its progress reports: compiling programs, and pieces of work that are counted.

It imports nothing, as messages ask for it before JAX is imported.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Count = Callable[[float], None]  # called with how much more is done


class Piece:
    """A piece of work."""

    def __init__(self, name: str, total: float):
        self.name = name
        self.total = total
        self.done = 0.0

    def __str__(self) -> str:
        return f"{self.name}: {self.done:.4g} of {self.total:.6g}"


_lock = threading.Lock()
_pieces: list[Piece] = []  # that are being done, the innermost last
_compilations = 0  # that run, of all threads
_began = 0.0  # the first of these [s]
_compiled = 0.0  # seconds of those before


@contextmanager
def compilation(begins: bool = True) -> Iterator[None]:
    """Within, a program is being compiled, if one `begins` to be at all."""
    _count_compilations(begins)
    try:
        yield
    finally:
        _count_compilations(-begins)


def _count_compilations(more: int) -> None:
    global _compilations, _began, _compiled
    with _lock:
        before = _compilations
        now = time.monotonic()
        _compilations += more
        if not before:
            _began = now
        elif not _compilations:
            _compiled += now - _began


def is_compiling() -> bool:
    """Whether any thread of this process compiles a program."""
    return _compilations > 0


def seconds_compiling() -> float:
    """The time in which programs were being compiled so far [s]."""
    with _lock:
        return _compiled + (time.monotonic() - _began if _compilations else 0.0)


@contextmanager
def counted(name: str, total: float) -> Iterator[Count]:
    """Within, a piece of work of so many units is done, of which the function that is yielded counts what is done."""
    piece = Piece(name, total)

    def count(more: float) -> None:
        piece.done += more

    _pieces.append(piece)
    try:
        yield count
    finally:
        _pieces.remove(piece)


def innermost_piece() -> Piece | None:
    """The piece of work that was begun last and has not ended."""
    return _pieces[-1] if _pieces else None
