"""A store of a sweep that grows part by part, and from which the sweep resumes if it is killed at any moment.

It is a Zarr store with one array for each variable and one chunk for each block of lanes. Its group `resume` has the
identity of the sweep and the names of the arrays as attributes, and a record of each block: which of its lanes are
finished, with a checksum of their values, and what the lanes after them need. The record is written after the values.
A lock on a file, which ends with the process that holds it, keeps other processes from writing. Each file appears
completely or not at all.
"""

import fcntl
import hashlib
import io
import json
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.files import write, write_error
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StoreError
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import xarray as xr
    import zarr

RESUME, DESCRIPTION_FILE = "resume", "zarr.json"
SWEEP, BLOCKED, OTHERS, CHECKSUM = "sweep", "arrays of blocks", "other arrays", "checksum"  # attributes of `resume`
MOST_DIFFERENCES = 4  # differences shown
LEFT, ZARR_LEFT = r"\.jaxshroud-[0-9a-f]{32}\.partial", r"\.[0-9a-f]{32}\.partial"  # ends of names of temporary files
# The files of a store, and those that it has before it says of which sweep it is; as paths within it.
STORE_FILE = re.compile(
    rf"(resume/)?\.?zarr\.json({LEFT})?|resume/(lock|\.?\d+(-\d+)*\.npz({LEFT})?)"
    rf"|[^/]+/(zarr(\.json|{ZARR_LEFT})|c(/\d+)*({ZARR_LEFT})?)"
)
FIRST_FILE = re.compile(rf"resume/(lock|\.zarr\.json{LEFT})")
Lanes = tuple[slice, ...]  # along each dimension of a grid of lanes, which are the first dimensions of arrays of blocks
ChatterReport = list[Any]  # the place of the first lane whose events alternate, and a text


class BlockRecord(NamedTuple):
    """The finished part of a block."""

    at: Lanes
    reports: Sequence[ChatterReport]  # at most one
    handover: Sequence[np.ndarray]  # to the lanes that continue from these


@contextmanager
def open_unfinished(
    path: Path, about: Mapping[str, str], known: "xr.Dataset", shape: tuple[int, ...], block: tuple[int, ...]
) -> Iterator["Unfinished"]:
    """A store that is continued, or a new one, to which no other process writes meanwhile.

    Args:
        path: The folder of the store.
        about: The identity of the sweep, name -> value; a store of another sweep is refused.
        known: The attributes, coordinates and variables that are known before any lane has run.
        shape: The numbers of lanes along all dimensions of the lanes.
        block: The same of a block, unless the store has blocks already.

    Raises:
        StoreError: The path holds the store of another sweep or no store, or is in use.
        WriteError: The path cannot be written.
    """
    _own_files(path, alone=not _identity(path))
    with _locked(path):
        stored = _identity(path)
        _refuse_other(path, stored or about, about)
        for file in _own_files(path):
            if file.suffix == ".partial":
                file.unlink()
        arrays = _sweep_arrays(path) if group_attributes(path) else {}
        store = Unfinished(
            path=path,
            about=about,
            known=known,
            shape=shape,
            block=arrays["status"].chunks if arrays else block,
            arrays=arrays,
        )
        if not stored:
            store.describe([], [])
        yield store


def _identity(path: Path) -> dict[str, str]:
    """The identity of the sweep that a store belongs to; empty if there is no store."""
    return group_attributes(path / RESUME).get(SWEEP, {})


def _own_files(path: Path, *, alone: bool = False) -> list[Path]:
    """The files in a folder that a sweep writes: without an identity, those of its first moment alone.

    Raises:
        StoreError: They are to be `alone`, and the folder holds anything else.
    """
    names = STORE_FILE if _identity(path) else FIRST_FILE
    own = []
    for part in sorted(path.rglob("*")):
        name = part.relative_to(path).as_posix()
        is_link = part.is_symlink()
        if names.fullmatch(name) and part.is_file() and not is_link:
            own.append(part)
        elif alone and (is_link or not part.is_dir()):
            raise StoreError(
                f"{path}: holds {name!r}, which is not of a store that a sweep has begun, and stays as it is; choose "
                "another --out"
            )
    return own


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """A context in which no other process writes to the store."""
    lock_path = path / RESUME / "lock"
    with _writing_errors(path):
        lock_path.parent.mkdir(parents=True, exist_ok=True)
        lock = open_regular(lock_path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_locked = os.path.samestat(os.fstat(lock.fileno()), lock_path.stat())  # not a file removed meanwhile
        except (BlockingIOError, FileNotFoundError):
            is_locked = False
        if not is_locked:
            raise StoreError(f"{path}: another process is writing to it; wait, or choose another --out")
        yield


def _refuse_other(path: Path, stored: Mapping[str, str], about: Mapping[str, str]) -> None:
    """Raise StoreError with the differences between the stored identity of a sweep and that of a new one, if any."""
    changes = [
        f"{name} was {stored.get(name)}, is {about.get(name)}"
        for name in {**about, **stored}
        if stored.get(name) != about.get(name)
    ]
    if changes:
        shown = "; ".join(changes[:MOST_DIFFERENCES]) + " and more" * (len(changes) > MOST_DIFFERENCES)
        raise StoreError(f"{path}: is of another sweep: {shown}; choose another --out, or --force to replace it")


@dataclass
class Unfinished:
    """A store that this process has locked."""

    path: Path
    about: Mapping[str, str]
    known: "xr.Dataset"
    shape: tuple[int, ...]
    block: tuple[int, ...]
    arrays: "dict[str, zarr.Array]"

    def begun(self, block: Lanes) -> BlockRecord | None:
        """The record of the finished part of a block; None if there is none, and no lane of the block counts as run."""
        path = self._record_path(block)
        record = _read_record(path, self.arrays)
        if record is None:
            with _writing_errors(self.path):
                path.unlink(missing_ok=True)
                for name in sorted(self.arrays, key="status".__ne__):  # the statuses first
                    self.arrays[name][block] = self.arrays[name].fill_value
        return record

    def write(self, block: Lanes, at: Lanes, data: "xr.Dataset", record: BlockRecord) -> None:
        """Store the values of some lanes of a block, and then its record."""
        with _writing_errors(self.path):
            if not self.arrays:
                self._create(data.drop_vars([*self.known.variables], errors="ignore"))
                self.begun(block)
            for name in sorted(self.arrays, key="status".__eq__):  # the statuses last
                self.arrays[name][at] = data[name].to_numpy()
            path = self._record_path(block)
            about = {
                "at": [[lanes.start, lanes.stop] for lanes in record.at],
                "reports": record.reports,
                CHECKSUM: _checksum(path.stem.encode(), self.arrays, record.at),
            }
            content = io.BytesIO()
            np.savez(content, *record.handover, about=json.dumps(about))
            write(path, content.getbuffer(), is_result=False)

    def finish(self, attrs: Mapping[str, object], more: "Mapping[str, xr.Variable]") -> None:
        """Write the attributes and the further variables that are known when all blocks are finished."""
        with _writing_errors(self.path):
            for name, variable in more.items():
                self._write_array(name, variable)
        self.describe(self.arrays, [*self.known.variables, *more])
        write_attributes(self.path, attrs)

    def describe(self, blocked: Iterable[object], others: Iterable[object]) -> None:
        """Write what identifies the sweep, and which arrays there are."""
        about = {SWEEP: self.about, BLOCKED: [*blocked], OTHERS: [*others]}
        write_attributes(self.path / RESUME, {**about, CHECKSUM: _arrays_checksum(self.path, about)})

    def _record_path(self, block: Lanes) -> Path:
        return self.path / RESUME / f"{'-'.join(str(lanes.start) for lanes in block)}.npz"

    def _create(self, data: "xr.Dataset") -> None:
        """Create all arrays, with what is known alone. The description that makes them a store comes last."""
        for name, variable in self.known.variables.items():
            self._write_array(str(name), variable)
        for name, variable in data.variables.items():
            self._write_array(str(name), variable, self.shape, self.block)
        self.describe(data.variables, self.known.variables)
        write_attributes(self.path, {**data.attrs, **self.known.attrs, "complete": 0})
        self.arrays = _sweep_arrays(self.path)

    def _write_array(
        self, name: str, variable: "xr.Variable", lanes: tuple[int, ...] = (), block: tuple[int, ...] = ()
    ) -> None:
        """Write an array, or one of so many lanes in blocks, of which none has run."""
        import zarr

        (self.path / name / DESCRIPTION_FILE).unlink(missing_ok=True)
        kind = variable.dtype.kind
        others = variable.shape[len(lanes) :]
        array = zarr.create_array(
            store=self.path / name,
            shape=(*lanes, *others),
            chunks=(*block, *others),
            dtype=str if kind == "U" else variable.dtype,
            fill_value=Status.NOT_RUN if name == "status" else np.nan if kind == "f" else None,
            dimension_names=[*map(str, variable.dims)],
            attributes=variable.to_dict(data=False)["attrs"],
            zarr_format=3,
        )
        if not lanes:
            array[...] = variable.to_numpy()


def write_attributes(group: Path, attrs: Mapping[str, object]) -> None:
    """Add or change attributes of a Zarr group, such as the dataset of a store; a group that is missing is begun.

    Raises:
        WriteError: The file cannot be written.
    """
    about = {"zarr_format": 3, "node_type": "group", "attributes": {**group_attributes(group), **attrs}}
    text = json.dumps(about, indent=1, default=lambda value: value.tolist())
    write(group / DESCRIPTION_FILE, text.encode(), is_result=False)


def group_attributes(group: Path) -> dict[str, Any]:
    """The attributes of a Zarr group; empty if there is no such group."""
    try:
        return dict(json.loads(_content(group / DESCRIPTION_FILE))["attributes"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _content(path: Path) -> bytes:
    with open_regular(path) as file:
        return file.read()


def _read_record(path: Path, arrays: "Mapping[str, zarr.Array]") -> BlockRecord | None:
    """A record; None if there is none, or if the store has other values."""
    try:
        with open_regular(path) as file, np.load(file) as entries:
            text, *handover = entries.values()
        about = json.loads(str(text))
        at = tuple(slice(*ends) for ends in about["at"])
        agrees = about[CHECKSUM] == _checksum(path.stem.encode(), arrays, at)
        return BlockRecord(at, about["reports"], handover) if agrees else None
    except Exception:  # of any type: it depends on where the record or an array is damaged
        return None


def _checksum(named: bytes, arrays: "Mapping[str, zarr.Array]", at: Any = ...) -> str:
    """The checksum of what names or describes some arrays, and of their values."""
    total = hashlib.sha256(named)
    for array in arrays.values():
        values = np.asarray(array[at])
        total.update(repr(values.tolist()).encode() if values.dtype.kind == "T" else values.tobytes())
    return total.hexdigest()


def _sweep_arrays(store: Path) -> "dict[str, zarr.Array]":
    """The arrays of blocks; none where a description or another array is not as it was written."""
    stored = group_attributes(store / RESUME)
    try:
        return _opened(store, stored[BLOCKED]) if stored[CHECKSUM] == _arrays_checksum(store, stored) else {}
    except Exception:  # of any type, as above
        return {}


def _arrays_checksum(store: Path, names: Mapping[str, Any]) -> str:
    """The checksum of the descriptions of all arrays, and of the values of those that are not made of blocks."""
    descriptions = [_content(store / name / DESCRIPTION_FILE) for name in (*names[BLOCKED], *names[OTHERS])]
    return _checksum(b"".join(descriptions), _opened(store, names[OTHERS]))


def _opened(store: Path, names: Iterable[str]) -> "dict[str, zarr.Array]":
    import zarr

    with zarr.config.set({"array.write_empty_chunks": True}):  # else the sign of zeros is lost with their chunk
        return {name: zarr.open_array(store / name, mode="r+", zarr_format=3) for name in names}


def store_damage(store: Path) -> str:
    """A description of the damage to a store; empty if there is none. Every chunk is read."""
    arrays = _sweep_arrays(store)
    if not arrays:
        return "a description, a coordinate or the list of them is missing or has another checksum"
    missing = arrays["status"].size if group_attributes(store).get("complete") else 0
    for path in sorted((store / RESUME).glob("*.npz")):
        record = _read_record(path, arrays)
        if record is None:
            return f"the block of {path.relative_to(store)} or this record is missing or has another checksum"
        missing -= math.prod(lanes.stop - lanes.start for lanes in record.at)
    return "the record of a block is missing" if missing > 0 else ""


def remove_store(path: Path) -> None:
    """Remove a store, if there is one.

    Raises:
        StoreError: Another process is writing to it, or it holds files of another origin.
        WriteError: It cannot be removed.
    """
    if path.exists():
        _own_files(path, alone=True)
        with _locked(path), _writing_errors(path):
            for file in _own_files(path):
                file.unlink()
            for folder, _, _ in os.walk(path, topdown=False):
                with suppress(OSError):  # it is not empty
                    os.rmdir(folder)


@contextmanager
def _writing_errors(path: Path) -> Iterator[None]:
    """A context in which an error of the operating system becomes a WriteError with a message of one line."""
    try:
        yield
    except OSError as error:
        raise error if isinstance(error, StoreError) else write_error(path, error) from None
