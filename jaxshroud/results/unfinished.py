"""A sweep on disk that grows block by block: killed at any moment, it goes on where it was.

It is a Zarr store of one array for each number, a chunk for each block, each with its checksum. What finishes a block
is its record in the group `resume`, written after its chunks; a block whose record or chunks are missing or damaged is
computed again. The group also says of which sweep the store is. A lock on a file in there, which ends with its process,
keeps others from writing.
"""

import fcntl
import io
import json
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.results.blocks import Block
from jaxshroud.results.files import refusal, write
from jaxshroud.results.store import plain
from jaxshroud.scene.errors import StoreError

if TYPE_CHECKING:
    import xarray as xr
    import zarr

Record = dict[str, np.ndarray]
MOST = 4  # differences shown
BEGUN = ".begun.npz"
NUMBER = "number "  # before the names of numbers in a record


class Lanes(NamedTuple):
    """How many there are along a dimension, of the whole and of a block."""

    whole: int
    block: int


@contextmanager
def unfinished(
    path: Path, lanes: Mapping[str, Lanes], about: Mapping[str, str], coords: Mapping[str, Any]
) -> Iterator["Unfinished"]:
    """A store to go on with, or a new one, while no other process writes to it.

    Args:
        path: Where it is to be, or is.
        lanes: Dimensions of the lanes.
        about: What it is of, in words by names: another one is refused.
        coords: Coordinates of the whole, as xarray takes them.

    Raises:
        StoreError: It is of another sweep, none, damaged beyond repair or in use.
        WriteError: The place cannot be written.
    """
    if not (path / "zarr.json").exists():
        _refuse_foreign(path)
    with _locked(path):
        yield Unfinished(path, lanes, about, coords)


def _refuse_foreign(path: Path) -> None:
    """Raise StoreError if a folder holds anything that is not known to have been written here."""
    if not path.is_dir():
        return
    ours = bool(told_in(path))
    known = lambda part: part.name == "resume" or (ours and _of_a_store(part))  # noqa: E731
    strange = [part.name for part in sorted(path.iterdir()) if not known(part)]
    if not ours and (path / "resume").is_dir():
        strange += [f"resume/{part.name}" for part in sorted((path / "resume").iterdir()) if part.name != "lock"]
    if strange:
        raise StoreError(
            f"{path}: holds {strange[0]!r}, which is not of a store that a sweep has begun, and stays as it is; "
            "choose another --out"
        )


def _of_a_store(part: Path) -> bool:
    """Whether a store of this kind has such a part: its description, an array of Zarr's version 3, what a kill left."""
    if part.name == "zarr.json" or part.name.endswith(".partial"):
        return part.is_file()
    return part.is_dir() and ((part / "zarr.json").is_file() or not any(part.iterdir()))


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Within, no other process writes to the store."""
    with _writing(path):
        (path / "resume").mkdir(parents=True, exist_ok=True)
        lock = (path / "resume" / "lock").open("w")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{path}: another process is writing to it; wait, or choose another --out") from None
        yield


class Unfinished:
    """A store that is held by this process."""

    def __init__(self, path: Path, lanes: Mapping[str, Lanes], about: Mapping[str, str], coords: Mapping[str, Any]):
        import xarray as xr

        self.path, self.lanes = path, lanes
        self.coords = {str(name): variable for name, variable in xr.Dataset(coords=coords).variables.items()}
        if (path / "zarr.json").exists():
            self._same(about)
            self._write_coords()
        else:
            self._make_room(about)

    @property
    def begun(self) -> bool:
        """Whether anything is stored."""
        return (self.path / "zarr.json").exists()

    def record(self, block: Block) -> Record | None:
        """What was kept beside the numbers of a block; None if it has to be computed."""
        if not self.begun:
            return None
        record = _loaded(self._record(block))
        if record is None:
            return None
        names = set(record.pop("names", np.array([])).tolist())
        if missing := names - set(self._arrays):
            raise StoreError(f"{self.path}: lacks {', '.join(sorted(missing))}; begin anew with --force")
        if not all(self._whole(array, block) for name, array in self._own(block).items() if name in names):
            return None
        with _writing(self.path):
            self._begun(block).unlink(missing_ok=True)
        return record

    def kept(self, block: Block) -> Record | None:
        """What was kept of a block that is not finished."""
        return _loaded(self._begun(block))

    def keep(self, block: Block, record: Record) -> None:
        """Keep what is known of a block that is not finished, for another process to go on with."""
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **record)
        write(self._begun(block), content.getbuffer(), told=False)

    def write(self, block: Block, data: "xr.Dataset", record: Record) -> None:
        """Store the numbers of a block, then its record."""
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, names=np.array([*map(str, data.data_vars)]), **record)
        with _writing(self.path):
            self._record(block).unlink(missing_ok=True)
            if not self.begun:
                self._create(data)
            for name, array in self._own(block).items():
                if name not in data:
                    continue
                part = dict(zip(self.lanes, block.at, strict=True))
                array[tuple(part.get(dim, slice(None)) for dim in _dims(array))] = data[name].to_numpy()
        write(self._record(block), content.getbuffer(), told=False)
        self._begun(block).unlink(missing_ok=True)

    def finish(self, attrs: Mapping[str, Any], more: "Mapping[str, xr.Variable]") -> None:
        """Say of the whole what is known at its end, and store what is."""
        with _writing(self.path):
            for name, variable in more.items():
                _array(self.path / name, variable, [Lanes(n, n) for n in variable.shape])[...] = variable.to_numpy()
            self._group.attrs.update(plain(dict(attrs)))

    @cached_property
    def _group(self) -> "zarr.Group":
        import zarr

        return zarr.open_group(self.path, mode="r+", zarr_format=3)

    @cached_property
    def _arrays(self) -> "dict[str, zarr.Array]":
        """Those that are made of blocks."""
        import zarr

        try:
            with zarr.config.set({"array.write_empty_chunks": True}):  # a chunk that is not there is damage
                return {name: array for name, array in self._group.arrays() if name not in self.coords}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{self.path}: its description is damaged ({error}); begin anew with --force") from None

    def _own(self, block: Block) -> "dict[str, zarr.Array]":
        """What a block writes: of arrays that several would, as they lack a dimension of the lanes, the first does."""
        number = dict(zip(self.lanes, block.place, strict=True))
        beyond = lambda array: any(n for dim, n in number.items() if dim not in _dims(array))  # noqa: E731
        return {name: array for name, array in self._arrays.items() if not beyond(array)}

    def _record(self, block: Block) -> Path:
        return self._resume / f"{block.name}.npz"

    def _begun(self, block: Block) -> Path:
        return self._resume / f"{block.name}{BEGUN}"

    @property
    def _resume(self) -> Path:
        return self.path / "resume"

    def _whole(self, array: "zarr.Array", block: Block) -> bool:
        """Whether the chunk of a block is there, and as it was written."""
        number = dict(zip(self.lanes, block.place, strict=True))
        place = tuple(number.get(dim, 0) for dim in _dims(array))
        if not (self.path / array.path / array.metadata.encode_chunk_key(place)).exists():
            return False
        try:
            array.get_block_selection(place)
        except (OSError, ValueError, RuntimeError):
            return False
        return True

    def _create(self, data: "xr.Dataset") -> None:
        """All arrays, without numbers; what makes them a store comes last."""
        import zarr

        self._write_coords()
        for name, variable in data.data_vars.items():
            sizes = [self.lanes.get(str(dim), Lanes(n, n)) for dim, n in variable.sizes.items()]
            _array(self.path / str(name), variable.variable, sizes)
        zarr.create_group(self.path, attributes=plain({**data.attrs, "complete": 0}), zarr_format=3)

    def _write_coords(self) -> None:
        with _writing(self.path):
            for name, variable in self.coords.items():
                sizes = [Lanes(n, n) for n in variable.shape]
                values = variable.to_numpy()
                _array(self.path / name, variable, sizes)[...] = values.astype(object) if _words(values) else values

    def _same(self, about: Mapping[str, str]) -> None:
        """Raise StoreError if the store is of something else."""
        then = told_in(self.path)
        if not then:
            raise StoreError(f"{self.path}: not a sweep that can be gone on with; choose another --out")
        names = dict.fromkeys([*about, *then])
        told = [f"{n} was {then.get(n)}, is {about.get(n)}" for n in names if then.get(n) != about.get(n)]
        if told:
            more = f" and {len(told) - MOST} more" if len(told) > MOST else ""
            what = "; ".join(told[:MOST]) + more
            raise StoreError(
                f"{self.path}: is of another sweep: {what}; choose another --out, or --force to replace it"
            )

    def _make_room(self, about: Mapping[str, str]) -> None:
        """Remove what is left of a store that was killed before it was one, and say what the new one is of.

        What the same sweep had begun is kept.
        """
        begun = set(self._resume.glob(f"*{BEGUN}") if told_in(self.path) == about else [])
        with _writing(self.path):
            for old in self.path.iterdir():
                if old.is_file():
                    old.unlink()
                elif old.name != "resume":
                    shutil.rmtree(old)
            for old in set(self._resume.glob("*.npz")) - begun:
                old.unlink()
        group = {"zarr_format": 3, "node_type": "group", "attributes": dict(about)}
        write(self._resume / "zarr.json", json.dumps(group, indent=1).encode(), told=False)


def joined(before: Record, data: "xr.Dataset", along: int, *, backward: bool) -> "xr.Dataset":
    """The numbers of some values after those that a record has of the values before them.

    Args:
        before: The record.
        data: The numbers.
        along: Which dimension of the lanes is that of the values.
        backward: The values before are the later ones.
    """
    import xarray as xr

    dim = data["status"].dims[along]

    def whole(name: str, variable: "xr.DataArray") -> "xr.Variable":
        if dim not in variable.dims:
            return variable.variable
        parts = [before[NUMBER + name], variable.to_numpy()]
        values = np.concatenate(parts[::-1] if backward else parts, axis=variable.dims.index(dim))
        return xr.Variable(variable.dims, values, variable.attrs)

    return xr.Dataset({str(name): whole(str(name), v) for name, v in data.data_vars.items()}, attrs=data.attrs)


def _loaded(path: Path) -> Record | None:
    """A record; None if there is none that is whole."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as kept:
            return dict(kept)
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def told_in(path: Path) -> dict[str, str]:
    """What a store says that it is of; nothing where there is none."""
    try:
        told = json.loads((path / "resume" / "zarr.json").read_text("utf-8"))["attributes"]
        return {str(name): str(value) for name, value in told.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def relabel(path: Path, attrs: Mapping[str, Any]) -> None:
    """Change what a finished store says of the whole.

    Raises:
        WriteError: It cannot be written.
    """
    import zarr

    with _writing(path):
        zarr.open_group(path, mode="r+", zarr_format=3).attrs.update(plain(dict(attrs)))


def remove(path: Path) -> None:
    """Make an end of a store, if it is there.

    Raises:
        StoreError: Another process is writing to it, or it holds what was not written here.
        WriteError: It cannot be removed.
    """
    if path.exists():
        _refuse_foreign(path)
        with _locked(path), _writing(path):
            shutil.rmtree(path)


def _dims(array: "zarr.Array") -> tuple[str, ...]:
    return array.metadata.dimension_names  # type: ignore[return-value]


def _array(path: Path, variable: "xr.Variable", sizes: Sequence[Lanes]) -> "zarr.Array":
    """An array for more of a variable, of what is not there yet: NaN, lanes that have not run, nought."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    words = _words(variable)
    fill = "" if words else np.nan if variable.dtype.kind == "f" else Status.NOT_RUN if path.name == "status" else 0
    return zarr.create_array(
        store=str(path),
        shape=tuple(n for n, _ in sizes),
        chunks=tuple(block for _, block in sizes),
        dtype=str if words else variable.dtype,
        fill_value=fill,
        dimension_names=[str(dim) for dim in variable.dims],
        attributes=plain(variable.attrs),
        compressors=[ZstdCodec(), Crc32cCodec()],
        config={"write_empty_chunks": True},
        zarr_format=3,
        overwrite=True,
    )


def _words(values: "xr.Variable | np.ndarray") -> bool:
    return values.dtype.kind == "U"


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Within, what cannot be written is told in one line."""
    try:
        yield
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise refusal(path, error) from None
