"""The peaks of an amplitude over a number of a scene whose contact stays in one state, by its closed form."""

from collections.abc import Callable

import numpy as np

from jaxshroud.orbits.peaks import Peak
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.quantities import counted_amplitude
from jaxshroud.signals.waves import HALF_POWER

PEAK_ZOOMS, PEAK_VALUES = (
    6,
    33,
)  # closer looks at a peak, or at where its amplitude has fallen to half power, and their values

AmplitudesAt = Callable[[np.ndarray], np.ndarray]  # values (n,) -> those of all blades (n, blades)


def linear_peaks(amplitudes: AmplitudesAt, values: np.ndarray, layout: Layout) -> list[Peak]:
    """The peaks between the ends of values.

    Args:
        amplitudes: The amplitudes at any values of the number.
        values: The values (n,), in order.
        layout: The layout of the blades.
    """
    here = counted_amplitude(amplitudes(values), layout)
    inner = np.flatnonzero((here[1:-1] > here[:-2]) & (here[1:-1] >= here[2:])) + 1
    return [_linear_peak(amplitudes, layout, values, here, int(i)) for i in inner]


def _linear_peak(amplitudes: AmplitudesAt, layout: Layout, values: np.ndarray, here: np.ndarray, i: int) -> Peak:
    def level(at):
        return counted_amplitude(amplitudes(at), layout)

    fine = values[i - 1 : i + 2]
    of_blades, place = amplitudes(fine), 1
    for _ in range(PEAK_ZOOMS):
        fine = np.linspace(fine[max(place - 1, 0)], fine[min(place + 1, len(fine) - 1)], PEAK_VALUES)
        of_blades = amplitudes(fine)
        place = int(np.nanargmax(counted_amplitude(of_blades, layout)))
    top, blades = float(fine[place]), of_blades[place]
    size = float(counted_amplitude(of_blades[place : place + 1], layout)[0])
    ends, reasons = zip(*(_half_power_end(level, values, here, i, top, size, side) for side in (-1, 1)), strict=True)
    reason = next(filter(None, reasons), "")
    first, last = (np.nan, np.nan) if reason else ends
    return Peak(0, top, size, 1, True, first, last, reason, blades)


def _half_power_end(
    level: AmplitudesAt, values: np.ndarray, here: np.ndarray, i: int, top: float, size: float, side: int
) -> tuple[float, str]:
    """Where the amplitude has fallen to half power on a side of a peak; or why there is no such place."""
    beyond = range(i + side, -1 if side < 0 else len(values), side)
    end = next((k for k in beyond if not here[k] > size * HALF_POWER), None)
    if end is None:
        return np.nan, "it does not fall to half power within the range"
    if not np.isfinite(here[end]):
        return np.nan, "contact leaves its state before half power"
    near, far = (top, float(values[end])) if end == i + side else (float(values[end - side]), float(values[end]))
    for _ in range(PEAK_ZOOMS):
        fine = np.linspace(near, far, PEAK_VALUES)
        k = int(np.argmax(~(level(fine) > size * HALF_POWER)))
        near, far = float(fine[max(k - 1, 0)]), float(fine[k])
    return far, ""
