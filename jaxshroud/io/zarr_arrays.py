"""The blocks of a grid of lanes, and the arrays of a Zarr store, created before their values are known."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.block_records import Digests, digest
from jaxshroud.io.files import write, write_error
from jaxshroud.io.store import json_values
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StoreError

if TYPE_CHECKING:
    import xarray as xr
    import zarr
    from zarr.storage import MemoryStore


class Block(NamedTuple):
    """A block of lanes of a grid."""

    place: tuple[int, ...]  # the index of the block along each dimension
    at: tuple[slice, ...]  # the lanes along each dimension

    @property
    def lanes(self) -> int:
        """The number of lanes."""
        return math.prod(part.stop - part.start for part in self.at)

    @property
    def name(self) -> str:
        """The name of its files."""
        return "-".join(map(str, self.place))

    def within(self, number: int) -> "Block":
        """The block as a part of row `number` of a grid with one more dimension in front."""
        return Block((number, *self.place), (slice(number, number + 1), *self.at))


def block_shape(shape: Sequence[int], lanes: int) -> tuple[int, ...]:
    """The sizes of blocks of at most `lanes` lanes, which extend as far as possible along the last dimensions."""
    sizes = []
    for n in reversed(shape):
        size = min(n, max(lanes, 1))
        sizes.append(size)
        lanes //= size
    return tuple(reversed(sizes))


def block_chains(
    shape: Sequence[int], sizes: Sequence[int], along: int = 0, *, backward: bool = False
) -> Iterator[list[Block]]:
    """All blocks of a grid, in chains of blocks that differ only in their place along one dimension.

    Args:
        shape: The shape of the grid.
        sizes: The sizes of the blocks; the last block of a dimension may be smaller.
        along: The dimension of the chains.
        backward: Whether chains begin at the end of that dimension.
    """
    numbers = [range(-(-n // size)) for n, size in zip(shape, sizes, strict=True)]
    inner = numbers.pop(along)
    for others in product(*numbers):
        places = [(*others[:along], i, *others[along:]) for i in (reversed(inner) if backward else inner)]
        yield [_block_at(shape, sizes, place) for place in places]


def _block_at(shape: Sequence[int], sizes: Sequence[int], place: tuple[int, ...]) -> Block:
    slices = (slice(p * size, min((p + 1) * size, n)) for p, size, n in zip(place, sizes, shape, strict=True))
    return Block(place, tuple(slices))


class LaneDimension(NamedTuple):
    """The number of lanes along a dimension of the grid, and of a block."""

    whole: int
    block: int


def group_description(attrs: Mapping[str, object]) -> bytes:
    """The description of a Zarr group."""
    return json.dumps(
        {"zarr_format": 3, "node_type": "group", "attributes": json_values(dict(attrs))}, indent=1
    ).encode()


def write_array(
    path: Path, name: str, variable: "xr.Variable", sizes: Sequence[LaneDimension] | None = None
) -> Digests:
    """Write the description of an array; its values too, unless it is made of blocks, of which `sizes` are given."""
    from zarr.storage import MemoryStore

    buffers: dict[str, Any] = {}
    array = _create_array(MemoryStore(buffers), name, variable, sizes or [LaneDimension(n, n) for n in variable.shape])
    if sizes is None:
        values = variable.to_numpy()
        array[...] = values.astype(object) if _is_text(values) else values
    contents = {f"{name}/{file}": buffer.to_bytes() for file, buffer in buffers.items()}
    for file, content in contents.items():
        (path / file).parent.mkdir(parents=True, exist_ok=True)
        write(path / file, content, is_result=False)
    return {file: digest(content) for file, content in contents.items()}


def _create_array(
    store: "MemoryStore", name: str, variable: "xr.Variable", sizes: Sequence[LaneDimension]
) -> "zarr.Array":
    """An array like a variable but with other sizes, filled with values of lanes that have not run."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    is_text = _is_text(variable)
    fill = "" if is_text else np.nan if variable.dtype.kind == "f" else Status.NOT_RUN if name == "status" else 0
    return zarr.create_array(
        store=store,
        shape=tuple(n for n, _ in sizes),
        chunks=tuple(block for _, block in sizes),
        dtype=str if is_text else variable.dtype,
        fill_value=fill,
        dimension_names=[str(dim) for dim in variable.dims],
        attributes=json_values(variable.attrs),
        compressors=[ZstdCodec(), Crc32cCodec()],
        config={"write_empty_chunks": True},
        zarr_format=3,
    )


def _is_text(values: "xr.Variable | np.ndarray") -> bool:
    return values.dtype.kind == "U"


@contextmanager
def writing_errors(path: Path) -> Iterator[None]:
    """A context in which an error of the operating system becomes a WriteError with a message of one line."""
    try:
        yield
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise write_error(path, error) from None
