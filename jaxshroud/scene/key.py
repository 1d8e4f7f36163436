"""One number of a scene: its unit, range, symbol and words, and the usual ranges."""

import math
from types import EllipsisType
from typing import Any, NamedTuple

LARGEST_NUMBER = 1e30  # of a number in SI units, in magnitude: products do not overflow
SMALLEST_POSITIVE = 1e-30  # of a number that must be positive


class Range(NamedTuple):
    """The range of a number."""

    words: str
    minimum: float = -math.inf
    open: bool = False  # whether the minimum itself is excluded
    maximum: float = math.inf
    whole: bool = False  # whether only whole numbers are in the range

    def holds(self, value):
        """Whether a number, or each of an array, is in the range."""
        above = value - self.minimum >= SMALLEST_POSITIVE if self.open else value >= self.minimum
        inside = (abs(value) <= LARGEST_NUMBER) & above & (value <= self.maximum)
        return inside & _is_whole(value) if self.whole else inside

    def fault(self, value: float) -> str:
        """The message for a number outside the range."""
        if not abs(value) < math.inf:
            return "must be a finite number"
        if abs(value) > LARGEST_NUMBER:
            return f"must be at most {LARGEST_NUMBER:g} in magnitude"
        if self.whole and not _is_whole(value):
            return "must be a whole number"
        if value > self.maximum:
            return f"must be less than or equal to {self.maximum}"
        if self.open and value > self.minimum:
            return f"must be at least {SMALLEST_POSITIVE:g}"
        return f"must be greater than {'' if self.open else 'or equal to '}{self.minimum:g}"


def _is_whole(value):
    """Whether a number, or each of an array, is whole."""
    return value.round() == value if hasattr(value, "round") else float(value).is_integer()


class Key(NamedTuple):
    """One number of a scene."""

    name: str  # table.key
    unit: str  # SI unit in messages
    pair: bool  # one value per blade
    range: Range
    symbol: str  # LaTeX
    label: str  # of an axis
    example: str | float | list[str]  # a value as in a file
    about: str  # meaning
    default: float | EllipsisType | None  # value if a file leaves it out; None: no value; ...: required
    per_interface: bool = False  # one value per interface of a row; one of the pair

    @property
    def parts(self) -> tuple[str, str]:
        """Table and key."""
        table, _, key = self.name.partition(".")
        return table, key

    @property
    def netcdf(self) -> str:
        """The SI unit as NetCDF files write it: "N m rad-1" for "N m/rad"."""
        above, _, below = self.unit.replace("^", "").partition("/")
        return f"{above} {below}-1" if below else above or "1"

    @property
    def shown(self) -> tuple[str, float]:
        """The unit in pictures, and its number per SI unit."""
        return DISPLAY_UNITS.get(self.name) or DISPLAY_UNITS.get(self.unit, (self.unit, 1.0))


ANY, POSITIVE, FROM_0 = Range("any"), Range("> 0", 0.0, open=True), Range(">= 0", 0.0)
ANY_WHOLE = Range("whole", whole=True)
UP_TO_1 = Range(">= 0, <= 1", 0.0, maximum=1.0)
FACE = Range("> 0, <= pi/2", 0.0, open=True, maximum=math.pi / 2)
DISPLAY_UNITS = {  # SI unit, or key -> unit in pictures, and its number per SI unit
    "rad": ("°", 180 / math.pi),
    "m": ("mm", 1e3),
    "kg": ("g", 1e3),
    "kg m^2": ("g m²", 1e3),
    "N/m": ("kN/m", 1e-3),
    "drive.speed": ("rpm", 30 / math.pi),
    "shroud.gap_at_speed": ("rpm", 30 / math.pi),
    **{f"blades.zeta_{name}": ("%", 100.0) for name in ("x", "y", "T")},
}


def scene_key(
    name: str,
    unit: str,
    allowed: Range,
    symbol: str,
    label: str,
    example: str | float | list[str],
    about: str = "",
    default: float | EllipsisType | None = ...,
) -> Key:
    """The key of a number of the whole scene."""
    return Key(name, unit, False, allowed, symbol, label, example, about or label, default)


def blade_key(*row: Any, **options: Any) -> Key:
    """The key of a number per blade; the arguments are those of `scene_key`."""
    return scene_key(*row, **options)._replace(pair=True)


def interface_key(*row: Any, **options: Any) -> Key:
    """The key of a number per interface of a row; the arguments are those of `scene_key`."""
    return scene_key(*row, **options)._replace(per_interface=True)
