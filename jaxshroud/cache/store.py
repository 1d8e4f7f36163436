"""Files of compiled programs in a folder of the user's own, those of JAX's own cache among them.

An entry holds code, as any compiled program does. So the folder must belong to the user, who alone may enter it, and
be no link; the same goes for the files. A checksum is compared before anything of an entry is interpreted. It finds
damage, not malice: whoever can write with the user's own rights is not kept out.

JAX reads its own entries unchecked: a damaged one, or one that was exchanged with another, fails when it is run. It has
no public way to be given another cache; where the private one is not as it was, JAX keeps nothing.
"""

import hashlib
import logging
import os
import platform
import re
import stat
import zlib
from contextlib import suppress
from pathlib import Path

from jax._src import compilation_cache

from jaxshroud.cache.key import processor_features
from jaxshroud.whole_file import leftovers_in, remove_unless_locked, write_whole

MARK = b"jaxshroud program 1\n"
DIGEST_BYTES = 32
ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.program")
MAX_BYTES = 1 << 29  # of all entries

OTHER_PLACE = "set JAX_COMPILATION_CACHE_DIR to one that is"

log = logging.getLogger("jaxshroud.programs")
_reported: set[str] = set()  # faults of folders


class ProgramStore:
    """Programs by the names of what they depend on, see `entry_name`; every failure is a miss."""

    def __init__(self, folder: Path):
        self.folder = folder

    def read(self, name: str) -> bytes | None:
        """The content of the entry of a `name`; None if there is none, or it is damaged or not the user's own."""
        path = self._path(name)
        try:
            raw = _own_file(path)
        except FileNotFoundError:
            return None
        except OSError as error:
            log.warning("%s: not used (%s); it is compiled anew", path.name, error.strerror or error)
            return None
        content = _checked_content(raw, name)
        if content is None:
            log.warning("%s: not used (damaged, or of another version); it is compiled anew", path.name)
            return None
        with suppress(OSError):
            os.utime(path)  # the least recently used is removed first
        return content

    def write(self, name: str, content: bytes) -> None:
        """Keep `content` under a `name`, completely or not at all."""
        body = bytes.fromhex(name) + zlib.compress(content, 1)
        try:
            write_whole(self._path(name), MARK + hashlib.sha256(body).digest() + body, synced=False, mode=0o600)
            self._prune()
        except OSError as error:
            log.warning("a compiled program is not kept in %s (%s)", self.folder, error.strerror or error)

    def entries(self) -> list[tuple[float, int, Path]]:
        """When each entry was last used, its bytes, and its path; the least recently used first."""
        found = []
        for path in self.folder.iterdir():
            with suppress(OSError):
                state = path.lstat()
                if ENTRY_NAME.fullmatch(path.name) and stat.S_ISREG(state.st_mode) and state.st_uid == os.getuid():
                    found.append((state.st_mtime, state.st_size, path))
        return sorted(found)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.program"

    def _prune(self) -> None:
        """Remove the least recently used beyond `MAX_BYTES`, and what killed processes left."""
        entries = self.entries()
        excess = sum(size for _, size, _ in entries) - MAX_BYTES
        for _, size, path in entries:
            if excess > 0 and _has_mark(path):
                path.unlink(missing_ok=True)
                excess -= size
        for left in leftovers_in(self.folder):
            remove_unless_locked(left)


def own_folder(folder: Path) -> bool:
    """Make a folder unless it exists; whether it is the user's own alone, and nobody else can put another in its place.

    What it lacks is said once in a process, with the cure.
    """
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        fault = _fault_of(folder.lstat(), folder) or _fault_above(folder.parent.stat(), folder.parent)
    except OSError as error:
        log.info("%s: not used (%s)", folder, error.strerror or error)
        return False
    if fault and fault not in _reported:
        _reported.add(fault)
        log.warning("%s; until then programs are compiled anew in every process", fault)
    return not fault


def _fault_of(state: os.stat_result, folder: Path) -> str:
    """What is wrong with a folder of programs, and the cure; empty: nothing."""
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != os.getuid():
        return f"{folder}: not used for compiled programs: it is no folder of your own; {OTHER_PLACE}"
    if stat.S_IMODE(state.st_mode) != 0o700:
        return f"{folder}: not used for compiled programs: others may enter it; do `chmod 700 {folder}`"
    return ""


def _fault_above(state: os.stat_result, folder: Path) -> str:
    """What is wrong with the folder around it, and the cure; empty: nothing."""
    if state.st_uid not in (0, os.getuid()):
        return f"{folder}: not used for compiled programs: it belongs to another user; {OTHER_PLACE}"
    if state.st_mode & 0o022 and not state.st_mode & stat.S_ISVTX:  # in a sticky one, such as /tmp, names are safe
        return f"{folder}: not used for compiled programs: others may write it; do `chmod go-w {folder}`"
    return ""


def _own_file(path: Path) -> bytes:
    """The bytes of a file of the user's own; OSError if it is a link or of others."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(handle, "rb") as file:
        state = os.fstat(handle)
        if not stat.S_ISREG(state.st_mode) or state.st_uid != os.getuid() or state.st_mode & 0o022:
            raise OSError("not a file of your own")
        return file.read()


def _checked_content(raw: bytes, name: str) -> bytes | None:
    """The content of an entry of that `name`; None unless it is what was written."""
    start = len(MARK)
    digest, body = raw[start : start + DIGEST_BYTES], raw[start + DIGEST_BYTES :]
    if raw[:start] != MARK or hashlib.sha256(body).digest() != digest or body[:DIGEST_BYTES].hex() != name:
        return None
    return zlib.decompress(body[DIGEST_BYTES:])


def _has_mark(path: Path) -> bool:
    with suppress(OSError), path.open("rb") as file:
        return file.read(len(MARK)) == MARK
    return False


def entry_name(key: str) -> str:
    """The name of the entry of a key."""
    return hashlib.sha256(key.encode()).hexdigest()


_cache: "CheckedCache | None" = None


class CheckedCache:
    """What JAX asks for the entry of a key, and gives one to keep."""

    def __init__(self, store: ProgramStore):
        self.store = store
        self.machine = f"{platform.machine()}\n{processor_features()}"
        self._path = store.folder  # which JAX names in its log

    def get(self, key: str) -> bytes | None:
        """The entry of a key; None if there is none, or it is not as it was written, here."""
        return self.store.read(self._name(key))

    def put(self, key: str, value: bytes) -> None:
        """Keep an entry."""
        self.store.write(self._name(key), value)

    def _name(self, key: str) -> str:
        return entry_name(f"of JAX\n{key}\n{self.machine}")


def lead_jax_into(store: ProgramStore | None) -> bool:
    """Let JAX keep its entries in a store from now on; None: where its settings say. Whether that could be done."""
    global _cache
    _cache = None if store is None or not hasattr(compilation_cache, "_cache") else CheckedCache(store)
    reset_jax_cache()
    return store is None or _cache is not None


def reset_jax_cache() -> None:
    """Let JAX ask anew whether it has a cache, and where."""
    compilation_cache.reset_cache()
    if _cache is not None:
        compilation_cache._cache = _cache  # pyright: ignore[reportAttributeAccessIssue]
