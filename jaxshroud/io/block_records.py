"""The records of a store that grows: which lanes are finished, with a checksum of their values.

The group `resume` has the records. Its attributes identify the sweep, and name the arrays. The record of a block has
the finished lanes of the block, and what the lanes after them need. Each file appears completely or not at all.
"""

import hashlib
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.files import write
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import zarr


RESUME, DESCRIPTION_FILE = "resume", "zarr.json"
SWEEP, BLOCKED, OTHERS, CHECKSUM = "sweep", "arrays of blocks", "other arrays", "checksum"  # attributes of `resume`
Lanes = tuple[slice, ...]  # along each dimension of a grid of lanes, which are the first dimensions of arrays of blocks
ChatterReport = list[Any]  # the place of the first lane whose events alternate, and a text


class BlockRecord(NamedTuple):
    """The finished part of a block."""

    at: Lanes
    report: ChatterReport | None
    handover: Sequence[np.ndarray]  # to the lanes that continue from these


def record_path(store: Path, block: Lanes) -> Path:
    """The file of a block's record."""
    return store / RESUME / f"{'-'.join(str(lanes.start) for lanes in block)}.npz"


def write_record(path: Path, record: BlockRecord, arrays: "Mapping[str, zarr.Array]") -> None:
    """Write a record, with the checksum of the values that the store has now.

    Raises:
        WriteError: The file cannot be written.
    """
    about = {
        "at": [[lanes.start, lanes.stop] for lanes in record.at],
        "report": record.report,
        CHECKSUM: _values_checksum(path, record.at, arrays),
    }
    content = io.BytesIO()
    np.savez(content, *record.handover, about=json.dumps(about))
    write(path, content.getbuffer(), is_result=False)


def read_record(path: Path, arrays: "Mapping[str, zarr.Array]") -> BlockRecord | None:
    """A record; None if there is none, or if the store has other values."""
    try:
        with open_regular(path) as file, np.load(file) as entries:
            text, *handover = entries.values()
        about = json.loads(str(text))
        at = tuple(slice(*ends) for ends in about["at"])
        agrees = about[CHECKSUM] == _values_checksum(path, at, arrays)
        return BlockRecord(at, about["report"], handover) if agrees else None
    except Exception:  # of any type: it depends on where the record or an array is damaged
        return None


def _values_checksum(path: Path, at: Lanes, arrays: "Mapping[str, zarr.Array]") -> str:
    total = hashlib.sha256(path.stem.encode())
    for array in arrays.values():
        total.update(np.asarray(array[at]).tobytes())
    return total.hexdigest()


def sweep_arrays(store: Path) -> "dict[str, zarr.Array]":
    """The arrays of blocks, the statuses last; none where a description or another array is not as it was written."""
    stored = group_attributes(store / RESUME)
    try:
        return _opened(store, stored[BLOCKED]) if stored[CHECKSUM] == arrays_checksum(store, stored) else {}
    except Exception:  # of any type, as above
        return {}


def arrays_checksum(store: Path, names: Mapping[str, Any]) -> str:
    """The checksum of the descriptions of all arrays, and of the values of those that are not made of blocks."""
    total = hashlib.sha256()
    for name in (*names[BLOCKED], *names[OTHERS]):
        total.update(_content(store / name / DESCRIPTION_FILE))
    for array in _opened(store, names[OTHERS]).values():
        total.update(repr(np.asarray(array[...]).tolist()).encode())
    return total.hexdigest()


def _opened(store: Path, names: Iterable[str]) -> "dict[str, zarr.Array]":
    import zarr

    with zarr.config.set({"array.write_empty_chunks": True}):  # else the sign of zeros is lost with their chunk
        return {
            name: zarr.open_array(store / name, mode="r+", zarr_format=3) for name in sorted(names, key="status".__eq__)
        }


def store_damage(store: Path) -> str:
    """A description of the damage to a store; empty if there is none. Every chunk is read."""
    arrays = sweep_arrays(store)
    if not arrays:
        return "a description, a coordinate or the list of them is missing or has another checksum"
    missing = arrays["status"].size if group_attributes(store).get("complete") else 0
    for path in sorted((store / RESUME).glob("*.npz")):
        record = read_record(path, arrays)
        if record is None:
            return f"the block of {path.relative_to(store)} or this record is missing or has another checksum"
        missing -= math.prod(lanes.stop - lanes.start for lanes in record.at)
    return "the record of a block is missing" if missing > 0 else ""


def group_attributes(group: Path) -> dict[str, Any]:
    """The attributes of a Zarr group; empty if there is no such group."""
    try:
        return dict(json.loads(_content(group / DESCRIPTION_FILE))["attributes"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _content(path: Path) -> bytes:
    with open_regular(path) as file:
        return file.read()
