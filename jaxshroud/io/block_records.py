"""The records of a store: a digest of each of its files, which reveals files that are lost, damaged or exchanged.

The records are in the group `resume` of the store. The record of the whole store has the names of the arrays that are
made of blocks, and the digests of all descriptions and of the other arrays. Each finished block has a record with the
digests of its chunks. Each file appears completely or not at all.
"""

import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.files import write
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import zarr


Record = dict[str, np.ndarray]
Digests = dict[str, bytes]  # file, as a path within the store -> digest
RESUME, DESCRIPTION_FILE = "resume", "zarr.json"
WHOLE = f"{RESUME}/whole.npz"
FILES, DIGESTS, BLOCKED = "files", "digests", "arrays"  # entries of records


class StoreRecord(NamedTuple):
    """The record of a whole store."""

    blocked: tuple[str, ...]  # names of the arrays that are made of blocks
    digests: Digests

    @property
    def names(self) -> set[str]:
        """The names of all arrays."""
        return {file.partition("/")[0] for file in self.digests}


def read_store_record(store: Path) -> StoreRecord | None:
    """The record of a whole store; None if there is no complete one."""
    arrays = read_record(store / WHOLE)
    if arrays is None or not arrays.keys() >= {BLOCKED, FILES, DIGESTS}:
        return None
    record = StoreRecord(tuple(map(str, arrays[BLOCKED])), digests_in(arrays))
    return record if "status" in record.blocked and f"status/{DESCRIPTION_FILE}" in record.digests else None


def write_store_record(store: Path, record: StoreRecord) -> None:
    """Write the record of a whole store.

    Raises:
        WriteError: The file cannot be written.
    """
    write(store / WHOLE, record_content({BLOCKED: np.array(record.blocked)}, record.digests), is_result=False)


def record_file(place: Sequence[int]) -> str:
    """The file of a block's record, as a path within the store."""
    return f"{RESUME}/{'-'.join(map(str, place))}.npz"


def record_content(record: Mapping[str, Any], expected: Digests | None = None) -> memoryview:
    """The content of a record's file, with the expected digests of other files."""
    content = io.BytesIO()
    entries = dict(record)
    if expected is not None:
        entries |= {FILES: np.array([*expected]), DIGESTS: np.array([*map(list, expected.values())], np.uint8)}
    np.savez(content, allow_pickle=False, **entries)
    return content.getbuffer()


def read_record(path: Path) -> Record | None:
    """A record; None if there is no complete one."""
    try:
        with open_regular(path) as file, np.load(io.BytesIO(file.read())) as arrays:
            return dict(arrays)
    except Exception:  # of any type: it depends on where it is damaged
        return None


def digests_in(record: Record) -> Digests:
    """The digests that a record holds."""
    if not record.keys() >= {FILES, DIGESTS}:
        return {}
    return {str(file): bytes(digest) for file, digest in zip(record[FILES], record[DIGESTS], strict=False)}


def digest(content: bytes) -> bytes:
    """The digest of a file's content."""
    return hashlib.sha256(content).digest()


def digests(store: Path, files: Iterable[str]) -> Digests:
    """The digests of files as they are now, without those of files that cannot be read."""
    files = [*files]
    with ThreadPoolExecutor() as pool:
        values = pool.map(lambda file: _digest(store / file), files)
        return {file: value for file, value in zip(files, values, strict=True) if value is not None}


def _digest(path: Path) -> bytes | None:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError:
        return None


def changed_files(store: Path, expected: Digests) -> list[str]:
    """The files whose digest is not the expected one."""
    actual = digests(store, expected)
    return [file for file, value in expected.items() if actual.get(file) != value]


def arrays_in(store: Path, names: Iterable[str], *, writable: bool = False) -> "dict[str, zarr.Array]":
    """The arrays of a store, by their names."""
    import zarr

    from jaxshroud.io.chunk_store import ChunkStore

    def opened(name):
        return zarr.open_array(
            ChunkStore(store / name, read_only=not writable), mode="r+" if writable else "r", zarr_format=3
        )

    with zarr.config.set({"array.write_empty_chunks": True}):  # so that a missing chunk is damage
        return {name: opened(name) for name in names}


def dimension_names(array: "zarr.Array") -> tuple[str, ...]:
    """The names of the dimensions of an array."""
    return tuple(map(str, getattr(array.metadata, "dimension_names", None) or ()))  # a Zarr v2 array has none


def chunk_files(arrays: "Mapping[str, zarr.Array]", place: Sequence[int]) -> dict[str, str]:
    """The chunk file of each array that a block writes.

    An array that lacks a dimension of the lanes has a chunk for several blocks, which only the first of them writes.
    """
    index = dict(zip(dimension_names(arrays["status"]), place, strict=True))

    def is_first(array):
        return not any(n for dim, n in index.items() if dim not in dimension_names(array))

    def chunk(array):
        return array.metadata.encode_chunk_key(tuple(index.get(dim, 0) for dim in dimension_names(array)))

    return {name: f"{name}/{chunk(array)}" for name, array in arrays.items() if is_first(array)}


def block_places(arrays: "Mapping[str, zarr.Array]") -> Iterator[tuple[int, ...]]:
    """The places of all blocks."""
    return np.ndindex(*arrays["status"].cdata_shape)


def damaged_blocks(store: Path, arrays: "Mapping[str, zarr.Array]") -> dict[tuple[int, ...], str]:
    """The places of the blocks that do not agree with their record, each with its first damaged file.

    Blocks without a record are not finished and do not count. Every chunk is read once.
    """
    damaged = {}
    for place in block_places(arrays):
        if not (store / record_file(place)).exists():
            continue
        expected = digests_in(read_record(store / record_file(place)) or {})
        if not expected.keys() >= {*chunk_files(arrays, place).values()}:
            damaged[place] = record_file(place)
        elif files := changed_files(store, expected):
            damaged[place] = files[0]
    return damaged


def store_damage(store: Path) -> str:
    """A description of the damage to a store; empty if there is none."""
    record = read_store_record(store)
    if record is None:
        return f"{WHOLE} is missing or holds nothing"
    damaged = changed_files(store, record.digests)
    if not damaged:
        arrays = arrays_in(store, record.blocked)
        damaged = [*damaged_blocks(store, arrays).values()]
        if group_attributes(store).get("complete"):
            records = [record_file(place) for place in block_places(arrays)]
            damaged += [file for file in records if not (store / file).exists()]
    more = f", and {len(damaged) - 1} more" if len(damaged) > 1 else ""
    return f"{damaged[0]} is missing or has another checksum{more}" if damaged else ""


def group_attributes(group: Path) -> dict[str, object]:
    """The attributes of a Zarr group; empty if there is no such group."""
    try:
        with open_regular(group / DESCRIPTION_FILE) as file:
            return dict(json.loads(file.read().decode("utf-8"))["attributes"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}
