"""The numbers of a scene that a page has fields and sliders for."""

import math
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import ALL_KEYS, Key, key_in
from jaxshroud.scene.shown import read_shown, shown_text

# In the order of the page; of rivals a scene gives one.
FIELD_KEYS = (
    *("shroud.gap", "contact.gamma", "contact.k", "contact.width", "friction.mu", "friction.k_d"),
    *("drive.F_0", "drive.M_0", "drive.level", "drive.omega", "drive.f", "drive.speed", "drive.engine_order"),
    *("drive.F_x_mean", "drive.F_y_mean", "drive.M_mean"),
    *("shroud.alpha", "drive.beta", "blades.k_x", "blades.c_x"),
)
FIRST_FIELDS = 10  # that are open from the start
AROUND_VALUE = (
    "drive.omega",
    "drive.f",
    "drive.speed",
    "blades.k_x",
    "shroud.alpha",
)  # whose sliders do not begin at 0
SLIDER_STEPS = 200
REACH = 3.0  # of a slider, times the value
NICE_STEPS = (1.0, 2.0, 5.0, 10.0)
LEAST_SLID, MOST_SLID = 1e-100, 1e100  # values that a slider can have
DIGITS = 9  # of what a slider gives


class NumberField(NamedTuple):
    """A number of a scene on a page, in the unit that it is shown in."""

    key: Key
    value: float | None  # None: no slider, as it is one for each blade or interface, or beyond all sliders
    text: str  # the value, or all of them
    low: float
    high: float
    step: float

    @property
    def unit(self) -> str:
        """The unit that is shown."""
        return self.key.shown[0]

    @property
    def label(self) -> str:
        """What the number is, with its unit."""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.key.parts[1]}, {self.key.label}{unit}"

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the slider in SI units."""
        return in_si(self.key, self.low), in_si(self.key, self.high)

    def refusal(self, text: str) -> str | None:
        """What is wrong with a text whose number is out of the range of the key, in the unit that is shown."""
        try:
            values = np.ravel(read_shown(self.key, text))
        except ValueError:
            return None
        allowed, (unit, factor) = self.key.range, self.key.shown
        shown = allowed._replace(minimum=allowed.minimum * factor, maximum=allowed.maximum * factor)
        for value in map(float, values[~allowed.holds(values)]):
            said = f"{self.key.parts[1]} = {text.strip()} {shown.fault(value * factor)} {unit}".strip()
            return f"{said}; {self.text} is kept"
        return None


def in_si(key: Key, shown: float) -> float:
    """A number of few digits in the unit that is shown, as one would type it, in SI units."""
    return float(read_shown(key, f"{shown:.{DIGITS}g}"))


def few_digits(key: Key, value: float) -> float:
    """A value in SI units, rounded to few digits in the unit that is shown."""
    return in_si(key, value * key.shown[1])


def number_fields(file: SceneFile) -> list[NumberField]:
    """The fields of the numbers that a scene gives."""
    given = file.given_tables
    rows = [key_in(ALL_KEYS[name], file.layout) for name in FIELD_KEYS]
    return [_number_field(row, given[row.parts[0]][row.parts[1]], file) for row in rows if _gives(given, row)]


def _gives(given: dict, row: Key) -> bool:
    table, name = row.parts
    return given.get(table, {}).get(name) is not None


def _number_field(row: Key, value: Any, file: SceneFile) -> NumberField:
    text = shown_text(row, value)
    shown = math.nan if isinstance(value, list | tuple) else float(value) * row.shown[1]
    if shown and not LEAST_SLID < abs(shown) < MOST_SLID:
        return NumberField(row, None, text, 0.0, 1.0, 0.01)
    low, high = _slider_ends(row, shown, row.shown[1], file)
    step = _nice_step((high - low) / SLIDER_STEPS)
    low, high = math.floor(low / step) * step, math.ceil(high / step) * step
    low = max(low, step if row.range.open else row.range.minimum * row.shown[1])
    high = min(high, row.range.maximum * row.shown[1])
    return NumberField(row, shown, text, float(f"{low:.{DIGITS}g}"), float(f"{high:.{DIGITS}g}"), step)


def _slider_ends(row: Key, shown: float, factor: float, file: SceneFile) -> tuple[float, float]:
    """The ends of a slider: those of the scene's own sweep, or some way around the value, within the key's range."""
    axis = next((a for a in file.axes if a.key == row.name), None)
    if axis is not None:
        return float(np.min(axis.values)) * factor, float(np.max(axis.values)) * factor
    reach = REACH * abs(shown) or 1.0
    low, high = (0.5 * shown, 1.5 * shown) if row.name in AROUND_VALUE else (0.0 if shown >= 0 else -reach, reach)
    return max(low, row.range.minimum * factor), min(high, row.range.maximum * factor)


def _nice_step(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return float(f"{next(n for n in NICE_STEPS if n * power >= step * (1 - 1e-9)) * power:.6g}")
