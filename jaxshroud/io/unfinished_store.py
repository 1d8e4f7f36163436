"""A store of a sweep that grows block by block, and from which the sweep resumes if it is killed at any moment.

It is a Zarr store with one array for each variable and one chunk for each block. A block is finished when its record
is written, after its chunks; a block that does not agree with its record, or has none, is computed again. The group
`resume`, which has the records, also identifies the sweep. A lock on a file in that group, which ends with the process
that holds it, keeps other processes from writing.
"""

import fcntl
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from jaxshroud.io.block_records import (
    DESCRIPTION_FILE,
    DIGESTS,
    FILES,
    RESUME,
    WHOLE,
    Record,
    StoreRecord,
    arrays_in,
    changed_files,
    chunk_files,
    damaged_blocks,
    digests,
    dimension_names,
    group_attributes,
    read_record,
    read_store_record,
    record_content,
    record_file,
    write_store_record,
)
from jaxshroud.io.files import write
from jaxshroud.io.zarr_arrays import Block, LaneDimension, group_description, write_array, writing_errors
from jaxshroud.scene.checks import StoreError
from jaxshroud.whole_file import TEMPORARY_NAME, open_regular, remove_leftovers, remove_unless_locked

if TYPE_CHECKING:
    import xarray as xr

MOST_DIFFERENCES = 4  # differences shown
BEGUN = ".begun.npz"  # of the record of a block that is not finished
NUMBER = "number "  # prefix of the names of variables in a record
LOCK = f"{RESUME}/lock"
PARTIAL = ".partial"  # in place of the rest of the name of a temporary file
# The files of a store, and those that it has before it says of which sweep it is; as paths within it.
STORE_FILE = re.compile(
    r"((resume/)?zarr\.json|resume/(lock|whole\.npz|\d+(-\d+)*(\.begun)?\.npz)|[^/]+/(zarr\.json|c(/\d+)*))(\.partial)?"
)
FIRST_FILE = re.compile(r"resume/(lock|zarr\.json\.partial)")
BLOCK_NAME = "block"  # entry of the record of a block that is not finished


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
        StoreError: The path holds the store of another sweep or no store, or the store is damaged beyond repair or in
            use.
        WriteError: The path cannot be written.
    """
    if not (path / "zarr.json").exists():
        _refuse_foreign(path)
    with _locked(path):
        yield Unfinished(path, lanes, about, coords)


def _refuse_foreign(path: Path) -> None:
    """Raise StoreError if a folder holds anything that may not have been written by a sweep."""
    own = {*_own_files(path)}
    foreign = [file.relative_to(path).as_posix() for file in _files_within(path) if file not in own]
    if foreign:
        raise StoreError(
            f"{path}: holds {foreign[0]!r}, which is not of a store that a sweep has begun, and stays as it is; "
            "choose another --out"
        )


def _own_files(path: Path) -> Iterator[Path]:
    """The files in a folder that a sweep writes: without an identity, those of its first moment alone."""
    names = STORE_FILE if store_identity(path) else FIRST_FILE
    for file in _files_within(path):
        temporary = TEMPORARY_NAME.fullmatch(file.name)
        inner = (file.with_name(f"{temporary[1]}{PARTIAL}") if temporary else file).relative_to(path).as_posix()
        if names.fullmatch(inner) and stat.S_ISREG(file.lstat().st_mode):
            yield file


def _files_within(path: Path) -> list[Path]:
    """All that is no folder in a folder and in those within; links are not followed."""
    found = [Path(folder, name) for folder, folders, names in os.walk(path) for name in [*folders, *names]]
    return sorted(file for file in found if file.is_symlink() or not file.is_dir())


def _remove_files(path: Path, files: Iterable[Path]) -> None:
    """Remove files in a folder, and all folders in it that are empty then."""
    for file in files:
        file.unlink(missing_ok=True)
    for folder, _, _ in os.walk(path, topdown=False):
        with suppress(OSError):  # it is not empty
            os.rmdir(folder)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """A context in which no other process writes to the store."""
    lock_path = path / LOCK
    with writing_errors(path):
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


class Unfinished:
    """A store that this process has locked."""

    def __init__(
        self, path: Path, lanes: Mapping[str, LaneDimension], about: Mapping[str, str], coords: Mapping[str, object]
    ):
        import xarray as xr

        self.path, self.lanes = path, lanes
        self.coords = {str(name): variable for name, variable in xr.Dataset(coords=coords).variables.items()}
        self.has_arrays = False
        if store_identity(path) != about:
            self._claim(about)
        elif (record := read_store_record(path)) and group_attributes(path) and not changed_files(path, record.digests):
            self._resume(record)

    def record(self, block: Block) -> Record | None:
        """The record of a finished block; None if the block has to be computed."""
        record = read_record(self._record_path(block)) if self.has_arrays else None
        if record is None:
            return None
        self._remove_progress(block)
        return {name: value for name, value in record.items() if name not in (FILES, DIGESTS)}

    def kept(self, block: Block) -> Record | None:
        """The progress of a block that is not finished; None if none was kept."""
        record = read_record(self._progress_path(block)) or {}
        return record if record.pop(BLOCK_NAME, None) == block.name else None

    def keep(self, block: Block, record: Record) -> None:
        """Keep the progress of a block that is not finished, for another process to continue."""
        content = record_content({**record, BLOCK_NAME: np.array(block.name)})
        write(self._progress_path(block), content, is_result=False)

    def write(self, block: Block, data: "xr.Dataset", record: Record) -> None:
        """Store the values of a block, its statuses last, and then its record."""
        with writing_errors(self.path):
            self._record_path(block).unlink(missing_ok=True)
            if not self.has_arrays:
                self._create(data)
            self._discard(block.place)
            files = chunk_files(self._arrays, block.place)
            part = dict(zip(self.lanes, block.at, strict=True))
            for name in sorted(files, key="status".__eq__):
                array = self._arrays[name]
                array[tuple(part.get(dim, slice(None)) for dim in dimension_names(array))] = data[name].to_numpy()
        write(self._record_path(block), record_content(record, digests(self.path, files.values())), is_result=False)
        self._remove_progress(block)

    def finish(self, attrs: Mapping[str, object], more: "Mapping[str, xr.Variable]") -> None:
        """Write the attributes and the further variables that are known when all blocks are finished."""
        written = dict(self._whole.digests)
        with writing_errors(self.path):
            for name, variable in more.items():
                written |= write_array(self.path, name, variable)
        write_store_record(self.path, self._whole._replace(digests=written))
        write_attributes(self.path, attrs)

    def _resume(self, record: StoreRecord) -> None:
        """Open the arrays, and discard the blocks that are not as they were written."""
        arrays = arrays_in(self.path, record.names, writable=True)
        self._whole = record
        self._arrays = {name: arrays[name] for name in record.blocked}
        self.has_arrays = True
        for left in [file for file in _own_files(self.path) if TEMPORARY_NAME.fullmatch(file.name)]:
            remove_unless_locked(left)
        with writing_errors(self.path):
            for place in damaged_blocks(self.path, self._arrays):
                self._discard(place)

    def _discard(self, place: Sequence[int]) -> None:
        """Make a block one that has not run."""
        for file in (record_file(place), chunk_files(self._arrays, place)["status"]):
            (self.path / file).unlink(missing_ok=True)

    def _remove_progress(self, block: Block) -> None:
        """Remove the progress that was kept of a block, as it is finished."""
        with writing_errors(self.path):
            remove_leftovers(self._progress_path(block))
            self._progress_path(block).unlink(missing_ok=True)

    def _record_path(self, block: Block) -> Path:
        return self.path / record_file(block.place)

    def _progress_path(self, block: Block) -> Path:
        return self._record_path(block).with_suffix(BEGUN)

    def _create(self, data: "xr.Dataset") -> None:
        """Create all arrays, with values only for coordinates. The description that makes them a store comes last."""
        group = group_description({**data.attrs, "complete": 0})
        if (self.path / DESCRIPTION_FILE).exists():  # a damaged store, which is incomplete until all is written again
            write(self.path / DESCRIPTION_FILE, group, is_result=False)
        written = {}
        for name, variable in self.coords.items():
            written |= write_array(self.path, name, variable)
        for name, variable in data.data_vars.items():
            sizes = [self.lanes.get(str(dim), LaneDimension(n, n)) for dim, n in variable.sizes.items()]
            written |= write_array(self.path, str(name), variable.variable, sizes)
        record = StoreRecord(tuple(map(str, data.data_vars)), written)
        write_store_record(self.path, record)
        write(self.path / DESCRIPTION_FILE, group, is_result=False)
        self._resume(record)

    def _claim(self, about: Mapping[str, str]) -> None:
        """Remove the remains of a sweep that was killed before it stored anything, and write the new identity.

        Raises:
            StoreError: The folder holds stored blocks of another sweep.
        """
        is_store = (self.path / DESCRIPTION_FILE).exists()
        records = [file for file in (self.path / RESUME).glob("*.npz") if file != self.path / WHOLE]
        if is_store or any(not file.name.endswith(BEGUN) for file in records):
            self._refuse(about)
        with writing_errors(self.path):
            lock = self.path / LOCK
            _remove_files(self.path, [file for file in _own_files(self.path) if file != lock])
        write(self.path / RESUME / DESCRIPTION_FILE, group_description(about), is_result=False)

    def _refuse(self, about: Mapping[str, str]) -> NoReturn:
        """Raise StoreError with the differences between the stored sweep and the new one."""
        stored = store_identity(self.path)
        if not stored:
            raise StoreError(f"{self.path}: not a sweep that can be gone on with; choose another --out")
        names = dict.fromkeys([*about, *stored])
        changes = [f"{n} was {stored.get(n)}, is {about.get(n)}" for n in names if stored.get(n) != about.get(n)]
        more = f" and {len(changes) - MOST_DIFFERENCES} more" if len(changes) > MOST_DIFFERENCES else ""
        shown = "; ".join(changes[:MOST_DIFFERENCES]) + more
        raise StoreError(f"{self.path}: is of another sweep: {shown}; choose another --out, or --force to replace it")


def join_along(before: Record, data: "xr.Dataset", along: int, *, backward: bool) -> "xr.Dataset":
    """The values of some lanes joined to those that a record has of the lanes before them.

    Args:
        before: The record.
        data: The values.
        along: The dimension of the lanes along which they are joined.
        backward: Whether the lanes of the record come last.
    """
    import xarray as xr

    dim = data["status"].dims[along]

    def joined(name: str, variable: "xr.DataArray") -> "xr.Variable":
        if dim not in variable.dims:
            return variable.variable
        parts = [before[NUMBER + name], variable.to_numpy()]
        values = np.concatenate(parts[::-1] if backward else parts, axis=variable.dims.index(dim))
        return xr.Variable(variable.dims, values, variable.attrs)

    return xr.Dataset({str(name): joined(str(name), v) for name, v in data.data_vars.items()}, attrs=data.attrs)


def store_identity(path: Path) -> dict[str, str]:
    """The identity of the sweep that a store belongs to; empty if there is no store."""
    return {str(name): str(value) for name, value in group_attributes(path / RESUME).items()}


def write_attributes(path: Path, attrs: Mapping[str, object]) -> None:
    """Change attributes of the dataset in a store.

    Raises:
        WriteError: The file cannot be written.
    """
    write(path / DESCRIPTION_FILE, group_description({**group_attributes(path), **attrs}), is_result=False)


def remove_store(path: Path) -> None:
    """Remove a store, if there is one.

    Raises:
        StoreError: Another process is writing to it, or it holds files of another origin.
        WriteError: It cannot be removed.
    """
    if path.exists():
        _refuse_foreign(path)
        with _locked(path), writing_errors(path):
            _remove_files(path, [*_own_files(path)])
