"""Atomic writes: a file appears completely or not at all, even if the disk is full or the process is interrupted."""

import errno
import fcntl
import itertools
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING

from jaxshroud.scene.checks import MachineError, WriteError

if TYPE_CHECKING:
    import zarr

MACHINE_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}  # the path is valid, the machine fails

written_files: list[Path] = []  # by this process so far
_temporary_files: set[str] = set()  # in use
PARTIAL_NAME = re.compile(r"(\w+)\.[0-9a-f]{32}\.partial")  # Zarr's name of a file that it is about to rename
TEMPORARY_NAME = re.compile(r"zarr\.[0-9a-f]{32}\.partial|\.zarr-\w{8}\.json")  # of descriptions, by Zarr and `write`


def write(path: Path, content: bytes | memoryview, *, is_result: bool = True) -> None:
    """Write a file under a temporary name, then rename it. Temporary files that killed runs left are removed first.

    Args:
        path: The path of the file.
        content: The whole content.
        is_result: Whether an interrupted command lists the file among those that it has written.

    Raises:
        WriteError: The path cannot be written; then no part of the file exists.
    """
    temporary = None
    try:
        remove_leftovers(path)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        _temporary_files.add(temporary)
        with os.fdopen(handle, "wb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # so that it does not count as a leftover
            file.write(content)
            file.flush()
            os.fsync(handle)
            os.fchmod(handle, 0o666 & ~_umask())
            os.replace(temporary, path)
        if is_result:
            written_files.append(path)
    except OSError as error:
        raise write_error(path, error) from None
    finally:
        if temporary is not None:
            _remove(temporary)


def write_error(path: Path, error: OSError) -> WriteError:
    """The error for a failure to write, with a message of one line."""
    message = f"{path}: cannot be written ({error.strerror or error}); "
    if error.errno in MACHINE_ERRORS:
        return MachineError(message + "make room and run again")
    return WriteError(message + "choose another --out")


def remove_parts() -> None:
    """Remove the files that are not complete yet, as the process is about to end."""
    for temporary in list(_temporary_files):
        _remove(temporary)


def _remove(temporary: str) -> None:
    with suppress(FileNotFoundError):
        os.remove(temporary)
    _temporary_files.discard(temporary)


def remove_leftovers(path: Path) -> None:
    """Remove the temporary files of `path` on which no living process holds a lock."""
    for leftover in path.parent.glob(f".{escape(path.stem)}-????????{escape(path.suffix)}"):
        with suppress(OSError), leftover.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            leftover.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def zarr_leftovers(store: Path, arrays: "Mapping[str, zarr.Array]") -> Iterator[Path]:
    """Files that Zarr was about to rename to a chunk or a description, of one of the arrays or of the store."""
    yield from _leftovers_in(store, store.glob("zarr.*.partial"), {"zarr"})
    for name, array in arrays.items():
        chunks = itertools.product(*map(range, array.cdata_shape))
        keys = {array.metadata.encode_chunk_key(chunk) for chunk in chunks}
        yield from _leftovers_in(store / name, (store / name).rglob("*.partial"), {"zarr", *keys})


def _leftovers_in(folder: Path, candidates: Iterator[Path], files: set[str]) -> Iterator[Path]:
    """Those candidates that were to be renamed to one of the files of a folder."""
    for path in candidates:
        name = PARTIAL_NAME.fullmatch(path.name)
        target = name and path.with_name(name[1]).relative_to(folder).as_posix()
        if target in files and path.is_file() and not path.is_symlink():
            yield path
