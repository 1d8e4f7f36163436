"""The layout of a scene: its blades, how they touch, what they are called and which of them count."""

from functools import lru_cache
from typing import Any, NamedTuple


class Layout(NamedTuple):
    """The blades of a scene and the interfaces between them; interface j is between blades j and j + 1.

    A row is an open chain, or a ring, whose last blade touches the first. The pair is a chain of two with names of its
    own: its left blade alone counts, and its only interface has no axis where users see it.
    """

    blades: int
    closed: bool
    names: tuple[str, ...]  # of the blades
    counted: int  # of the blades, from the first on: those whose vibration counts
    indices: tuple[str, ...]  # of the blades, in symbols such as x_1
    interface_shape: tuple[int, ...]  # the shape of a number of each interface
    text: str

    @property
    def interfaces(self) -> int:
        """The number of interfaces."""
        return self.blades if self.closed else self.blades - 1

    @property
    def counting(self) -> slice:
        """The blades whose vibration counts: the left one of the pair, all of a row."""
        return slice(self.counted)

    def at_interfaces(self, a: Any) -> Any:
        """Numbers (..., interfaces) as users see them: those of the pair's only interface without an axis."""
        return a if self.interface_shape else a[..., 0]

    def dims(self, dims: tuple[str, ...]) -> tuple[str, ...]:
        """Dimensions as users see them: those of the pair without `interface`."""
        return dims if self.interface_shape else tuple(dim for dim in dims if dim != "interface")

    @property
    def coords(self) -> dict[str, range]:
        """The numbers of the blades and, where users see an axis of them, of the interfaces."""
        sizes = self.blades, *self.interface_shape
        return {name: range(n) for name, n in zip(("blade", "interface"), sizes, strict=False)}

    @property
    def state_size(self) -> int:
        """How many numbers a state has: six of each blade, and a slider at each interface."""
        return 6 * self.blades + self.interfaces

    @property
    def number_words(self) -> str:
        """How many blades there are, in words for all of them."""
        return "both blades" if self.blades == 2 else "all blades"


PAIR = Layout(2, False, ("left", "right"), 1, ("1", "2"), (), "a pair")


def layout_with(row: Any) -> Layout:
    """The layout of scenes with a row of blades, or of pairs without one."""
    return PAIR if row is None else row.layout


@lru_cache(maxsize=64)
def row_layout(blades: int, closed: bool) -> Layout:
    """The layout of a row, all of whose blades count; they are called by their numbers."""
    size = blades if closed else blades - 1
    text, numbers = f"{'a ring' if closed else 'an open chain'} of {blades}", tuple(map(str, range(blades)))
    return Layout(blades, closed, numbers, blades, numbers, (size,), text)
