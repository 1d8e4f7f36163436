"""Parts of a grid of lanes that are computed and stored one at a time."""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple


class Block(NamedTuple):
    """A part of a grid."""

    place: tuple[int, ...]  # its number along each dimension
    at: tuple[slice, ...]

    @property
    def lanes(self) -> int:
        """How many it has."""
        return math.prod(part.stop - part.start for part in self.at)

    @property
    def name(self) -> str:
        """Of its files."""
        return "-".join(map(str, self.place))

    def within(self, number: int) -> "Block":
        """The block in a grid with one more dimension in front, in a row of its own there."""
        return Block((number, *self.place), (slice(number, number + 1), *self.at))


def spread(shape: Sequence[int], lanes: int) -> tuple[int, ...]:
    """Sizes of blocks of about so many lanes, which hold as much as they can of the last dimensions."""
    sizes = []
    for n in reversed(shape):
        size = min(n, max(lanes, 1))
        sizes.append(size)
        lanes //= size
    return tuple(reversed(sizes))


def chains(
    shape: Sequence[int], sizes: Sequence[int], along: int = 0, *, backward: bool = False
) -> Iterator[list[Block]]:
    """All blocks of a grid; together those that differ along one dimension only.

    Args:
        shape: Of the grid.
        sizes: Of the blocks; the last of a dimension may be smaller.
        along: That dimension.
        backward: From its end.
    """
    numbers = [range(-(-n // size)) for n, size in zip(shape, sizes, strict=True)]
    inner = numbers.pop(along)
    for others in product(*numbers):
        places = [(*others[:along], i, *others[along:]) for i in (reversed(inner) if backward else inner)]
        yield [_block(shape, sizes, place) for place in places]


def _block(shape: Sequence[int], sizes: Sequence[int], place: tuple[int, ...]) -> Block:
    at = (slice(p * size, min((p + 1) * size, n)) for p, size, n in zip(place, sizes, shape, strict=True))
    return Block(place, tuple(at))
