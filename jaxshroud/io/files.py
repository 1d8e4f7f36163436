"""Results and other files: each appears completely or not at all, the results of a command together."""

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from threading import RLock

from jaxshroud.scene.checks import MachineError, WriteError
from jaxshroud.whole_file import WholeFile, remove_leftovers, unfinished, write_whole

MACHINE_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}  # the path is valid, the machine fails
SECONDS_TO_PLACE = 1.0  # that a process which ends at once waits for files that are being put in place

written_files: dict[Path, Path] = {}  # results of the command: where each was to be -> where it is
kept_files: list[Path] = []  # that have appeared while the command ran, where its results were to be
_free_names: set[Path] = set()  # that the command has found free
_folders: set[Path] = set()  # for results of the command, which are made with the first of them
_waiting: list[WholeFile] | None = None  # complete results of the command that runs
_placing = RLock()


@contextmanager
def results_together() -> Iterator[None]:
    """Within, a command runs: its results wait for each other until `put_in_place`, at the latest until the end.

    Raises:
        WriteError: A result cannot be put in its place.
    """
    global _waiting
    for names in (written_files, kept_files, _free_names, _folders):
        names.clear()
    _waiting = []
    try:
        yield
    finally:
        try:
            put_in_place()
        finally:
            _waiting = None


def expect_free(path: Path) -> None:
    """Note that a result is to be where nothing is yet; what appears there meanwhile is kept, see `put_in_place`."""
    _free_names.add(path)


def expect_folder(path: Path) -> None:
    """Note that results are to be in a folder, which is made with the first of them."""
    _folders.add(path)


def write(path: Path, content: bytes | memoryview, *, is_result: bool = True) -> None:
    """Write a file. What killed runs have left of it is removed first.

    Args:
        path: The path of the file; what a command has written there before is replaced.
        content: The whole content.
        is_result: Whether the file is a result, which a command puts in place with its others.

    Raises:
        WriteError: The path cannot be written; then no part of the file exists.
    """
    if not path.name or "\0" in str(path):
        fault = "holds a NUL byte" if path.name else "is a folder"
        raise WriteError(f"{path}: {fault}; give the name of a file")
    try:
        if path.parent in _folders:
            path.parent.mkdir(parents=True, exist_ok=True)
        if is_result and _waiting is not None:
            remove_leftovers(path)
            for earlier in [file for file in _waiting if file.path == path]:
                _waiting.remove(earlier)
                earlier.close()
            _waiting.append(WholeFile(path, content))
        else:
            write_whole(path, content)
    except OSError as error:
        raise write_error(path, error) from None


def put_in_place() -> None:
    """Put the results that wait in their places, or all of them beside: as NAME-1.SUFFIX, where a name is taken.

    A name is taken where the command has found it free and something has appeared since; other files are replaced.

    Raises:
        WriteError: A result cannot be put in its place.
    """
    with _placing:
        waiting = _waiting or []
        try:
            for number in count():
                taken = _taken_name(waiting, number)
                if taken is None:
                    break
                kept_files.extend([taken] if number == 0 else [])
        except WriteError:
            for file in waiting:
                file.close()
            waiting.clear()
            raise
        for file in waiting:
            written_files[file.path] = file.name or file.path
            file.close()
        waiting.clear()


def place_of(path: Path) -> Path:
    """Where the result is that was to be at `path`; all that wait are put in place."""
    put_in_place()
    return written_files.get(path, path)


def _taken_name(waiting: Sequence[WholeFile], number: int) -> Path | None:
    """Put results where they were to be, or beside with a number; the first name that is taken, if one is."""
    for file in waiting:
        path = file.path
        target = path.with_name(f"{path.stem}-{number}{path.suffix}") if number else path
        try:
            file.place(target, replace=not number and path not in _free_names)
        except FileExistsError:
            return target
        except OSError as error:
            raise write_error(target, error) from None
    return None


def leave_files() -> None:
    """As the process ends at once: put in place what is complete, and remove what is not."""
    if _placing.acquire(timeout=SECONDS_TO_PLACE):
        with suppress(WriteError):
            put_in_place()
    for file in [*unfinished]:
        file.close()


def write_error(path: Path, error: OSError) -> WriteError:
    """The error for a failure to write, with a message of one line."""
    message = f"{path}: cannot be written ({error.strerror or error}); "
    if error.errno in MACHINE_ERRORS:
        return MachineError(message + "make room and run again")
    return WriteError(message + "choose another --out")
