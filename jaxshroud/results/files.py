"""Files that appear whole or not at all, whatever the disk or the keyboard does meanwhile."""

import errno
import fcntl
import os
import tempfile
from contextlib import suppress
from glob import escape
from pathlib import Path

from jaxshroud.scene.errors import MachineError, WriteError

MACHINE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}  # the place was right, the machine failed

written: list[Path] = []  # by this process so far
_parts: set[str] = set()  # temporary names in use


def write(path: Path, content: bytes | memoryview, *, told: bool = True) -> None:
    """Write a file under a temporary name, then rename it; what killed runs have left of it is removed first.

    Args:
        path: Its place.
        content: All of it.
        told: It is one of the results, whose names an interrupted command tells.

    Raises:
        WriteError: The place cannot be written. Nothing of the file is there then.
    """
    part = None
    try:
        _remove_leftovers(path)
        handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        _parts.add(part)
        with os.fdopen(handle, "wb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # it is no leftover
            file.write(content)
            file.flush()
            os.fsync(handle)
            os.fchmod(handle, 0o666 & ~_umask())
            os.replace(part, path)
        if told:
            written.append(path)
    except OSError as error:
        raise refusal(path, error) from None
    finally:
        if part is not None:
            _remove(part)


def refusal(path: Path, error: OSError) -> WriteError:
    """What a failure to write means, in one line."""
    told = f"{path}: cannot be written ({error.strerror or error}); "
    if error.errno in MACHINE:
        return MachineError(told + "make room and run again")
    return WriteError(told + "choose another --out")


def remove_parts() -> None:
    """Remove the files that are not whole yet: the process is about to end."""
    for part in list(_parts):
        _remove(part)


def _remove(part: str) -> None:
    with suppress(FileNotFoundError):
        os.remove(part)
    _parts.discard(part)


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files of `path` that no living process holds the lock of."""
    for part in path.parent.glob(f".{escape(path.stem)}-????????{escape(path.suffix)}"):
        with suppress(OSError), part.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            part.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
