"""A store of a sweep that grows part by part, and from which the sweep resumes if it is killed at any moment.

It is a Zarr store with one array for each variable and one chunk for each block of lanes. Part of a block is finished
when the record of the block says so, which is written after the values. A lock on a file, which ends with the process
that holds it, keeps other processes from writing.
"""

import fcntl
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.block_records import (
    BLOCKED,
    CHECKSUM,
    DESCRIPTION_FILE,
    OTHERS,
    RESUME,
    SWEEP,
    BlockRecord,
    Lanes,
    arrays_checksum,
    group_attributes,
    parts_of_arrays,
    read_record,
    record_path,
    sweep_arrays,
    write_record,
)
from jaxshroud.io.files import write, write_error
from jaxshroud.io.store import json_values
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StoreError
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import xarray as xr

MOST_DIFFERENCES = 4  # differences shown
LOCK = f"{RESUME}/lock"
LEFT, ZARR_LEFT = r"\.jaxshroud-[0-9a-f]{32}\.partial", r"\.[0-9a-f]{32}\.partial"  # ends of names of temporary files
# The files of a store, and those that it has before it says of which sweep it is; as paths within it.
STORE_FILE = re.compile(
    rf"(resume/)?\.?zarr\.json({LEFT})?|resume/(lock|\.?\d+(-\d+)*\.npz({LEFT})?)"
    rf"|[^/]+/(zarr(\.json|{ZARR_LEFT})|c(/\d+)*({ZARR_LEFT})?)"
)
FIRST_FILE = re.compile(rf"resume/(lock|\.zarr\.json{LEFT})")


class LaneDimension(NamedTuple):
    """The number of lanes along a dimension of the grid, and of a block."""

    whole: int
    block: int


@contextmanager
def open_unfinished(
    path: Path, lanes: Mapping[str, LaneDimension], about: Mapping[str, str], coords: Mapping[str, object]
) -> Iterator["Unfinished"]:
    """A store that is continued, or a new one, to which no other process writes meanwhile.

    Args:
        path: The folder of the store.
        lanes: The dimensions of the lanes.
        about: The identity of the sweep, name -> value; a store of another sweep is refused.
        coords: The coordinates of the dataset, as xarray takes them.

    Raises:
        StoreError: The path holds the store of another sweep or no store, or is in use.
        WriteError: The path cannot be written.
    """
    if not store_identity(path):
        _refuse_foreign(path)
    with _locked(path):
        _refuse_other(path, about)
        for file in _own_files(path):
            if file.name.endswith(".partial"):
                file.unlink()
        yield Unfinished(path, lanes, about, coords)


def _refuse_foreign(path: Path) -> None:
    """Raise StoreError if a folder holds anything that may not have been written by a sweep."""
    foreign = sorted({*_files_within(path)} - {*_own_files(path)})
    if foreign:
        name = foreign[0].relative_to(path).as_posix()
        raise StoreError(
            f"{path}: holds {name!r}, which is not of a store that a sweep has begun, "
            "and stays as it is; choose another --out"
        )


def _own_files(path: Path) -> list[Path]:
    """The files in a folder that a sweep writes: without an identity, those of its first moment alone."""
    names = STORE_FILE if store_identity(path) else FIRST_FILE
    return [
        file
        for file in _files_within(path)
        if names.fullmatch(file.relative_to(path).as_posix()) and stat.S_ISREG(file.lstat().st_mode)
    ]


def _files_within(path: Path) -> list[Path]:
    """All that is no folder in a folder and in those within; links are not followed."""
    found = [Path(folder, name) for folder, folders, names in os.walk(path) for name in [*folders, *names]]
    return [file for file in found if file.is_symlink() or not file.is_dir()]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """A context in which no other process writes to the store."""
    lock_path = path / LOCK
    with _writing_errors(path):
        lock_path.parent.mkdir(parents=True, exist_ok=True)
        lock = open_regular(lock_path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            has_lock = os.path.samestat(os.fstat(lock.fileno()), lock_path.stat())  # not of a file removed meanwhile
        except (BlockingIOError, FileNotFoundError):
            has_lock = False
        if not has_lock:
            raise StoreError(f"{path}: another process is writing to it; wait, or choose another --out")
        yield


def _refuse_other(path: Path, about: Mapping[str, str]) -> None:
    """Raise StoreError with the differences between the sweep that a store is of, if any, and a new one."""
    stored = store_identity(path)
    names = dict.fromkeys([*about, *stored]) if stored else ()
    changes = [f"{n} was {stored.get(n)}, is {about.get(n)}" for n in names if stored.get(n) != about.get(n)]
    if changes:
        more = f" and {len(changes) - MOST_DIFFERENCES} more" if len(changes) > MOST_DIFFERENCES else ""
        shown = "; ".join(changes[:MOST_DIFFERENCES]) + more
        raise StoreError(f"{path}: is of another sweep: {shown}; choose another --out, or --force to replace it")


class Unfinished:
    """A store that this process has locked."""

    def __init__(
        self, path: Path, lanes: Mapping[str, LaneDimension], about: Mapping[str, str], coords: Mapping[str, object]
    ):
        import xarray as xr

        self.path, self.lanes, self.about = path, lanes, about
        self.coords = {str(name): variable for name, variable in xr.Dataset(coords=coords).variables.items()}
        self.arrays = sweep_arrays(path) if group_attributes(path) else {}
        if not store_identity(path):
            self._describe(())

    def begun(self, block: Lanes) -> BlockRecord | None:
        """The record of the finished part of a block; None if there is none, and no lane of the block counts as run."""
        path = record_path(self.path, block)
        record = read_record(path, self.arrays)
        if record is None and self.arrays:
            with _writing_errors(self.path):
                path.unlink(missing_ok=True)
                for name, part in reversed([*parts_of_arrays(self.arrays, block)]):
                    self.arrays[name][part] = self.arrays[name].fill_value
        return record

    def write(self, block: Lanes, at: Lanes, data: "xr.Dataset", record: BlockRecord) -> None:
        """Store the values of some lanes of a block, and then its record."""
        with _writing_errors(self.path):
            if not self.arrays:
                self._create(data)
                self.begun(block)
            for name, part in parts_of_arrays(self.arrays, at):
                self.arrays[name][part] = data[name].to_numpy()
            write_record(record_path(self.path, block), record, self.arrays)

    def finish(self, attrs: Mapping[str, object], more: "Mapping[str, xr.Variable]") -> None:
        """Write the attributes and the further variables that are known when all blocks are finished."""
        with _writing_errors(self.path):
            for name, variable in more.items():
                self._write_array(name, variable)
        self._describe(self.arrays, more)
        write_attributes(self.path, attrs)

    def _create(self, data: "xr.Dataset") -> None:
        """Create all arrays, with values only for coordinates. The description that makes them a store comes last."""
        for name, variable in self.coords.items():
            self._write_array(name, variable)
        for name, variable in data.data_vars.items():
            sizes = [self.lanes.get(str(dim), LaneDimension(n, n)) for dim, n in variable.sizes.items()]
            self._write_array(str(name), variable.variable, sizes)
        self._describe([*map(str, data.data_vars)])
        _write_group(self.path, {**data.attrs, "complete": 0})
        self.arrays = sweep_arrays(self.path)

    def _write_array(self, name: str, variable: "xr.Variable", sizes: Sequence[LaneDimension] = ()) -> None:
        """Write an array, without values if it is made of blocks, of which `sizes` are given: no lane of it has run."""
        import zarr

        (self.path / name / DESCRIPTION_FILE).unlink(missing_ok=True)
        kind = variable.dtype.kind
        array = zarr.create_array(
            store=self.path / name,
            shape=tuple(n for n, _ in sizes) or variable.shape,
            chunks=tuple(block for _, block in sizes) or variable.shape,
            dtype=str if kind == "U" else variable.dtype,
            fill_value=Status.NOT_RUN if name == "status" else {"f": np.nan, "U": ""}.get(kind, 0),
            dimension_names=[*map(str, variable.dims)],
            attributes=json_values(variable.attrs),
            zarr_format=3,
        )
        if not sizes:
            array[...] = variable.to_numpy().astype(object) if kind == "U" else variable.to_numpy()

    def _describe(self, blocked: Iterable[str], more: Iterable[str] = ()) -> None:
        """Write what identifies the sweep, and which arrays there are."""
        about: dict[str, Any] = {SWEEP: self.about, BLOCKED: [*blocked], OTHERS: [*self.coords, *more]}
        if about[BLOCKED]:
            about[CHECKSUM] = arrays_checksum(self.path, about)
        _write_group(self.path / RESUME, about)


def store_identity(path: Path) -> dict[str, str]:
    """The identity of the sweep that a store belongs to; empty if there is no store."""
    return group_attributes(path / RESUME).get(SWEEP, {})


def write_attributes(path: Path, attrs: Mapping[str, object]) -> None:
    """Change attributes of the dataset in a store.

    Raises:
        WriteError: The file cannot be written.
    """
    _write_group(path, {**group_attributes(path), **attrs})


def _write_group(path: Path, attrs: Mapping[str, object]) -> None:
    """Write the description of a Zarr group."""
    group = {"zarr_format": 3, "node_type": "group", "attributes": json_values(dict(attrs))}
    write(path / DESCRIPTION_FILE, json.dumps(group, indent=1).encode(), is_result=False)


def remove_store(path: Path) -> None:
    """Remove a store, if there is one.

    Raises:
        StoreError: Another process is writing to it, or it holds files of another origin.
        WriteError: It cannot be removed.
    """
    if path.exists():
        _refuse_foreign(path)
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
        if isinstance(error, StoreError):
            raise
        raise write_error(path, error) from None
