"""A store of a sweep that grows part by part, and from which the sweep resumes if it is killed at any moment.

It is a Zarr store with one array for each variable and one chunk for each block of lanes. Part of a block is finished
when the record of the block says so, which is written after the values. A lock on a file, which ends with the process
that holds it, keeps other processes from writing.
"""

import fcntl
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

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
LEFT, ZARR_LEFT = r"\.jaxshroud-[0-9a-f]{32}\.partial", r"\.[0-9a-f]{32}\.partial"  # ends of names of temporary files
# The files of a store, and those that it has before it says of which sweep it is; as paths within it.
STORE_FILE = re.compile(
    rf"(resume/)?\.?zarr\.json({LEFT})?|resume/(lock|\.?\d+(-\d+)*\.npz({LEFT})?)"
    rf"|[^/]+/(zarr(\.json|{ZARR_LEFT})|c(/\d+)*({ZARR_LEFT})?)"
)
FIRST_FILE = re.compile(rf"resume/(lock|\.zarr\.json{LEFT})")


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
    if not store_identity(path):
        _refuse_foreign(path)
    with _locked(path):
        _refuse_other(path, about)
        for file in _own_files(path):
            if file.suffix == ".partial":
                file.unlink()
        yield Unfinished(path, about, known, shape, block)


def _refuse_foreign(path: Path) -> None:
    """Raise StoreError if a folder holds anything that may not have been written by a sweep."""
    foreign = {part for part in path.rglob("*") if part.is_symlink() or not part.is_dir()}.difference(_own_files(path))
    if foreign:
        raise StoreError(
            f"{path}: holds {min(foreign).relative_to(path).as_posix()!r}, which is not of a store that a sweep has "
            "begun, and stays as it is; choose another --out"
        )


def _own_files(path: Path) -> list[Path]:
    """The files in a folder that a sweep writes: without an identity, those of its first moment alone."""
    names = STORE_FILE if store_identity(path) else FIRST_FILE
    return [
        file
        for file in path.rglob("*")
        if names.fullmatch(file.relative_to(path).as_posix()) and file.is_file() and not file.is_symlink()
    ]


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
            is_removed = not os.path.samestat(os.fstat(lock.fileno()), lock_path.stat())
        except (BlockingIOError, FileNotFoundError):
            is_removed = True
        if is_removed:
            raise StoreError(f"{path}: another process is writing to it; wait, or choose another --out")
        yield


def _refuse_other(path: Path, about: Mapping[str, str]) -> None:
    """Raise StoreError with the differences between the sweep that a store is of, if any, and a new one."""
    stored = store_identity(path) or about
    changes = [
        f"{name} was {stored.get(name)}, is {about.get(name)}"
        for name in {**about, **stored}
        if stored.get(name) != about.get(name)
    ]
    if changes:
        more = f" and {len(changes) - MOST_DIFFERENCES} more" if len(changes) > MOST_DIFFERENCES else ""
        shown = "; ".join(changes[:MOST_DIFFERENCES]) + more
        raise StoreError(f"{path}: is of another sweep: {shown}; choose another --out, or --force to replace it")


class Unfinished:
    """A store that this process has locked."""

    def __init__(
        self, path: Path, about: Mapping[str, str], known: "xr.Dataset", shape: tuple[int, ...], block: tuple[int, ...]
    ):
        self.path, self.about, self.known, self.shape = path, about, known, shape
        self.arrays = sweep_arrays(path) if group_attributes(path) else {}
        self.block = self.arrays["status"].chunks if self.arrays else block
        if not store_identity(path):
            self._describe([], [])

    def begun(self, block: Lanes) -> BlockRecord | None:
        """The record of the finished part of a block; None if there is none, and no lane of the block counts as run."""
        path = record_path(self.path, block)
        record = read_record(path, self.arrays)
        if record is None:
            with _writing_errors(self.path):
                path.unlink(missing_ok=True)
                for array in reversed(self.arrays.values()):
                    array[block] = array.fill_value
        return record

    def write(self, block: Lanes, at: Lanes, data: "xr.Dataset", record: BlockRecord) -> None:
        """Store the values of some lanes of a block, and then its record."""
        with _writing_errors(self.path):
            if not self.arrays:
                self._create(data.drop_vars([*self.known.variables], errors="ignore"))
                self.begun(block)
            for name, array in self.arrays.items():
                array[at] = data[name].to_numpy()
            write_record(record_path(self.path, block), record, self.arrays)

    def finish(self, attrs: Mapping[str, object], more: "Mapping[str, xr.Variable]") -> None:
        """Write the attributes and the further variables that are known when all blocks are finished."""
        with _writing_errors(self.path):
            for name, variable in more.items():
                self._write_array(name, variable)
        self._describe(self.arrays, [*self.known.variables, *more])
        write_attributes(self.path, attrs)

    def _create(self, data: "xr.Dataset") -> None:
        """Create all arrays, with what is known alone. The description that makes them a store comes last."""
        for name, variable in self.known.variables.items():
            self._write_array(str(name), variable)
        for name, variable in data.variables.items():
            self._write_array(str(name), variable, self.shape, self.block)
        self._describe(data.variables, self.known.variables)
        _write_group(self.path, {**data.attrs, **self.known.attrs, "complete": 0})
        self.arrays = sweep_arrays(self.path)

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
            attributes=json_values(variable.attrs),
            zarr_format=3,
        )
        if not lanes:
            array[...] = variable.to_numpy()

    def _describe(self, blocked: Iterable[object], others: Iterable[object]) -> None:
        """Write what identifies the sweep, and which arrays there are."""
        about = {SWEEP: self.about, BLOCKED: [*blocked], OTHERS: [*others]}
        _write_group(self.path / RESUME, {**about, CHECKSUM: arrays_checksum(self.path, about)})


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
    group = {"zarr_format": 3, "node_type": "group", "attributes": json_values(attrs)}
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
        raise error if isinstance(error, StoreError) else write_error(path, error) from None
