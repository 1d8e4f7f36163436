"""The peak of an amplitude over a range of a number with contact, against the peak without contact.

At one speed a contact that only shifts the resonance away looks like one that damps it; the peaks compare resonances.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.motion.amplitudes import free_amplitudes
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.quantities import DISPLACEMENTS, counted_amplitude
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import with_numbers
from jaxshroud.verbs.sweep import sweep

FREE_VALUES, FREE_ZOOMS = 2001, 4  # values at which the free amplitude is looked at, and how often more closely
VALUES, ZOOMS, MARGIN = 61, 2, 2  # of the sweeps with contact; a closer look goes this many values beyond the largest


class PeakOfSweep(NamedTuple):
    """The largest value of an amplitude over a range of a number."""

    value: float  # of the number [SI]
    amplitude: float
    at_end: bool  # it is at an end of the range: the peak may lie beyond


class PeakRatio(NamedTuple):
    """The peaks of an amplitude with and without contact."""

    of: str
    along: str
    ends: tuple[float, float]  # of the range [SI]
    apart: float  # distance between neighbouring values of the last look
    free: PeakOfSweep
    contact: PeakOfSweep

    @property
    def words(self) -> str:
        """The peaks and their ratio in words."""
        unit, per_si = find_key(self.along)[0].shown
        ends, at, free = ([f"{per_si * v:.6g}" for v in vs] for vs in (self.ends, [self.contact[0]], [self.free[0]]))
        beyond = [
            f" The largest {kind} contact is at an end of the range: the peak may lie beyond."
            for kind, peak in (("without", self.free), ("with", self.contact))
            if peak.at_end
        ]
        share = self.contact.amplitude / self.free.amplitude
        return (
            f"Peak against peak, over {self.along} from {' to '.join(ends)} {unit}: the largest {self.of} with contact "
            f"is {self.contact.amplitude:.5g} m, at {at[0]} {unit} (upwards, downwards and from rest, every "
            f"{per_si * self.apart:.2g} {unit} there), without contact {self.free.amplitude:.5g} m, at {free[0]} "
            f"{unit}; the first is {share:.4g} of the second.{''.join(beyond)}"
        )


def peak_ratio(scene: Scene, along: str, low: float, high: float, of: str, run: Mapping[str, Any]) -> PeakRatio | None:
    """The peaks of an amplitude with and without contact; None where no run comes to its end.

    It is the largest of the blades that count.

    The sweeps go over the range, then about their largest value once more, with the same number of values.

    Args:
        scene: One scene.
        along: The number, as for `vary`.
        low: One end of its range [SI].
        high: The other end.
        of: The amplitude, e.g. "x_peak".
        run: The arguments of `sweep` that say how to run.
    """
    ends, values, apart, found = (low, high), np.linspace(low, high, VALUES), np.nan, []
    for _ in range(ZOOMS):
        swept = sweep(scene, {along: values}, direction="both", amplitudes=True, **run)
        levels = counted_amplitude(getattr(swept, of), scene.layout)
        if not np.isfinite(levels).any():
            break
        top = int(np.unravel_index(np.nanargmax(levels), levels.shape)[-1])
        found.append((float(np.nanmax(levels)), float(values[top])))
        apart = float(values[1] - values[0])
        beside = MARGIN * apart
        values = np.linspace(max(values[top] - beside, low), min(values[top] + beside, high), VALUES)
    if not found:
        return None
    level, value = max(found)
    return PeakRatio(of, along, ends, apart, free_peak(scene, along, low, high, of), _peak_in(value, level, ends))


def _peak_in(value: float, level: float, ends: tuple[float, float]) -> PeakOfSweep:
    return PeakOfSweep(value, level, value in ends)


def free_peak(scene: Scene, along: str, low: float, high: float, of: str) -> PeakOfSweep:
    """Where an amplitude without contact is largest in a range of a number, and that amplitude."""
    name, kind = of.split("_")
    row = DISPLACEMENTS.index(name)
    share = 1.0 if kind == "peak" else np.sqrt(0.5)
    numbered, values, at, level = with_numbers(scene, [along]), np.array([low, high]), low, 0.0
    for _ in range(FREE_ZOOMS):
        values = np.linspace(values[0], values[-1], FREE_VALUES)
        every = free_amplitudes(scenes_at(numbered, [along], values[:, None]))[row]
        levels = counted_amplitude(every, scene.layout)
        top = int(levels.argmax())
        at, level, values = float(values[top]), float(levels[top]), values[max(top - 1, 0) : top + 2]
    return _peak_in(at, level * share, (low, high))
