"""Files that appear whole or not at all.

A file is written without a name (Linux's `O_TMPFILE`), and linked to its name when it is complete: a process that is
killed leaves nothing. Where the system has no such files, and for the moment before another file is replaced, its name
is `.NAME.jaxshroud-<32 hexadecimal digits>.partial`, and it is locked. A leftover is an unlocked regular file of the
same user with such a name, and nothing else.
"""

import errno
import fcntl
import os
import re
import stat
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path

TEMPORARY_NAME = re.compile(r"\.(.+)\.jaxshroud-[0-9a-f]{32}\.partial", re.DOTALL)
MOST_BYTES = 190  # of a name within that of its temporary file: names have at most 255
COPIED_AT_ONCE = 1 << 20  # bytes

NO_REGULAR_FILE = "is no regular file"

unfinished: "set[WholeFile]" = set()  # files of this process whose handles are open


class WholeFile:
    """A file with its whole content that gets its place later."""

    def __init__(self, path: Path, content: bytes | memoryview, *, synced: bool = True, mode: int = 0o666):
        """Write the content.

        Args:
            path: Where the file is meant to be; its folder exists.
            content: The whole content.
            synced: Whether to wait until the disk has it.
            mode: Who may do what with the file, less what the user's mask forbids.

        Raises:
            OSError: The folder or the disk takes no such file; then nothing of it is left.
        """
        self.path, self.mode = path, mode
        self.name: Path | None = None
        handle = _open_unnamed(path.parent, mode)
        if handle is None:
            self.name = _temporary_path(path)
            handle = _open_new(self.name, mode)
        self.handle = handle
        unfinished.add(self)
        try:
            _lock_file(self.handle)
            with open(self.handle, "wb", closefd=False) as file:
                file.write(content)
                file.flush()
                if synced:
                    os.fsync(self.handle)
        except BaseException:
            self.close()
            raise

    def place(self, target: Path, *, replace: bool = False) -> None:
        """Give the file the name `target` in place of the one that it has.

        Raises:
            FileExistsError: The name is taken, and not to be replaced.
            OSError: The folder does not take it.
        """
        if replace:
            os.replace(self.name or self._take_temporary_name(), target)
        else:
            self._link_or_rename(target)
        self.name = target

    def close(self) -> None:
        """Let go of the file; without a place, it is gone."""
        if self not in unfinished:
            return
        if self.name is not None and TEMPORARY_NAME.fullmatch(self.name.name):
            self._unlink(self.name)
        unfinished.discard(self)
        os.close(self.handle)

    def _link_or_rename(self, target: Path) -> None:
        """Name the file `target`, which nothing may be called yet; FileExistsError if something is."""
        before = self.name
        try:
            self._link(target)
        except FileExistsError:
            if not self._is_at(target):
                raise
        except OSError:  # the filesystem has no hard links: an empty file claims the name
            os.close(_open_new(target, self.mode))
            try:
                os.replace(before or self._take_temporary_name(), target)
            except BaseException:
                os.unlink(target)
                raise
        if before is not None and before != target:
            self._unlink(before)

    def _link(self, target: Path) -> None:
        if self.name is None:
            os.link(f"/proc/self/fd/{self.handle}", target, src_dir_fd=self.handle)  # with which the link is followed
        else:
            os.link(self.name, target)

    def _take_temporary_name(self) -> Path:
        """Name a file that has no name yet; where that cannot be, its copy takes its place."""
        name = _temporary_path(self.path)
        try:
            self._link(name)
        except OSError:
            handle = _open_new(name, self.mode)
            _lock_file(handle)
            with open(self.handle, "rb", closefd=False) as source, open(handle, "wb", closefd=False) as copy:
                source.seek(0)
                while part := source.read(COPIED_AT_ONCE):
                    copy.write(part)
            os.dup2(handle, self.handle, inheritable=False)
            os.close(handle)
        self.name = name
        return name

    def _is_at(self, path: Path) -> bool:
        """Whether a path is a name of this very file."""
        try:
            return os.path.samestat(os.fstat(self.handle), path.lstat())
        except FileNotFoundError:
            return False

    def _unlink(self, path: Path) -> None:
        if self._is_at(path):
            with suppress(FileNotFoundError):
                os.unlink(path)


def write_whole(path: Path, content: bytes | memoryview, *, synced: bool = True, mode: int = 0o666) -> None:
    """Write a file, in place of any of its name; its leftovers are removed first.

    Raises:
        OSError: The folder or the disk does not take it; then the old file is as it was.
    """
    remove_leftovers(path)
    file = WholeFile(path, content, synced=synced, mode=mode)
    try:
        file.place(path, replace=True)
    finally:
        file.close()


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes left of a file that was to be at `path`."""
    start = f"{_temporary_stem(path)}.jaxshroud-"
    for left in leftovers_in(path.parent):
        if left.name.startswith(start):
            remove_unless_locked(left)


def leftovers_in(folder: Path) -> list[Path]:
    """All in a folder that is named like a leftover."""
    with suppress(OSError):
        return [folder / name for name in os.listdir(folder) if TEMPORARY_NAME.fullmatch(name)]
    return []


def remove_unless_locked(leftover: Path) -> None:
    """Remove a regular file of this package that no living process has locked."""
    with suppress(OSError):
        if not _is_own_file(leftover.lstat()):  # others are not even opened
            return
        handle = os.open(leftover, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_own_file(os.fstat(handle)):
                os.unlink(leftover)
        finally:
            os.close(handle)


def open_regular(path: Path, flags: int = os.O_RDONLY) -> BufferedIOBase:
    """Open a regular file; of any other kind, which might be waited for or never end, nothing is read.

    Raises:
        OSError: The path cannot be opened, or is no regular file.
    """
    handle = os.open(path, flags | os.O_NONBLOCK, 0o666)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, NO_REGULAR_FILE)
    except OSError:
        os.close(handle)
        raise
    return open(handle, "rb") if flags == os.O_RDONLY else open(handle, "rb+")


def _is_own_file(state: os.stat_result) -> bool:
    return stat.S_ISREG(state.st_mode) and state.st_uid == os.getuid()


def _lock_file(handle: int) -> None:
    with suppress(OSError):  # a filesystem without locks, on which nothing counts as a leftover
        fcntl.flock(handle, fcntl.LOCK_EX)


def _open_unnamed(folder: Path, mode: int) -> int | None:
    """A new file without a name, open for reading and writing; None where there are no such files."""
    if not hasattr(os, "O_TMPFILE"):
        return None
    with suppress(OSError):  # of a folder that takes no file at all, opening one by its name says so
        return os.open(folder, os.O_TMPFILE | os.O_RDWR, mode)
    return None


def _open_new(path: Path, mode: int) -> int:
    """A new file of that name, open for reading and writing; FileExistsError if there is one."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)


def _temporary_path(path: Path) -> Path:
    return path.with_name(f"{_temporary_stem(path)}.jaxshroud-{os.urandom(16).hex()}.partial")


def _temporary_stem(path: Path) -> str:
    return "." + os.fsdecode(os.fsencode(path.name)[:MOST_BYTES])
