"""How much each number of a scene matters: derivatives per 1 % of a number, side by side."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from jaxshroud.scene.keys import found


class Effect(NamedTuple):
    """Of one number of a scene, on P_d [percentage points] or on P [m^4]."""

    key: str
    number: float  # [SI]
    per: str  # the change that it is the effect of
    change: float
    ci: float  # half width of the 95 % interval

    @property
    def cells(self) -> list[str]:
        """A row of a table: key, value in SI units, what it is changed by, what that changes, half width."""
        return [self.key, f"{self.number:.6g}", self.per, f"{self.change:.4g}", f"{self.ci:.2g}"]


def step_of(key: str, number: float) -> tuple[float, str]:
    """The change of a number that effects are told for, in SI units and in words.

    It is 1 % of the number; of angles 1 degree, and of a number that is 0 one unit, as pictures write it.
    """
    row, _ = found(key)
    unit, per_si = row.shown
    if row.unit == "rad":
        return math.pi / 180, "1°"
    if number == 0:
        return 1 / per_si, f"1 {unit}".strip()
    return abs(number) / 100, "1 %"


def effects(value: Mapping[str, float], ci: Mapping[str, float], number: Mapping[str, float]) -> list[Effect]:
    """Effects of numbers from derivatives in SI units, the largest first; those that are NaN last."""
    told = []
    for key, at in number.items():
        step, words = step_of(key, at)
        told.append(Effect(key, at, words, value[key] * step, ci[key] * step))
    return sorted(told, key=lambda e: -abs(e.change) if math.isfinite(e.change) else math.inf)
