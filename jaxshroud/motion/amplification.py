"""The amplification of mistuned rows: their largest amplitude over that of the tuned row, by one rule for both.

The rule: the largest over all blades, over all values of the number along which the row is driven through its
resonances, and over all directions in which these are taken. Whitehead's factor (1 + sqrt(N)) / 2 bounds it for a
linear row with one mode per blade.
"""

import math
from typing import NamedTuple

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.motion.waves import participation_ratio
from jaxshroud.scene.typed import FloatArray

HALF_POWER = math.sqrt(0.5)  # of a peak's amplitude, where its width is taken


class RowResponses(NamedTuple):
    """The amplitudes of rows with n patterns of mistuning."""

    amplitude: FloatArray  # (n, directions, values, N); NaN where a lane stopped
    status: np.ndarray  # (n, directions, values)
    settled: np.ndarray  # (n, directions, values) whether the transient was over
    peak_value: FloatArray | None = None  # (n,) where, between the values, a linear row has its peak
    peak: FloatArray | None = None  # (n, N) the amplitudes there


class LargestAmplitude(NamedTuple):
    """The largest amplitude of each pattern, and where it is."""

    amplitude: FloatArray  # (n,); NaN where no lane came to its end
    direction: np.ndarray  # (n,) its index
    nearest: np.ndarray  # (n,) index of the value, or of the one beside it
    value: FloatArray  # (n,)
    blade: np.ndarray  # (n,)
    participation_ratio: FloatArray  # (n,) of the amplitudes of all blades there
    whole: np.ndarray  # (n,) whether all lanes came to their ends
    at_end: np.ndarray  # (n,) whether it is at an end of the range of values: the peak may lie beyond
    coarse: np.ndarray  # (n,) whether the amplitudes at both values beside it are below half power


def largest_amplitudes(found: RowResponses, values: FloatArray) -> LargestAmplitude:
    """The largest amplitude over blades, `values` and directions of each pattern; of a linear row, between them too."""
    amplitude = np.where(np.isfinite(found.amplitude), found.amplitude, -np.inf)
    n, rows = len(amplitude), np.arange(len(amplitude))
    flat = amplitude.reshape(n, -1)
    direction, index, blade = (np.asarray(i) for i in np.unravel_index(flat.argmax(axis=1), amplitude.shape[1:]))
    top, value, of_blades = flat.max(axis=1), values[index], found.amplitude[rows, direction, index]
    beside = _beside(amplitude[rows, direction, :, blade], index)
    if found.peak is not None and found.peak_value is not None:
        higher = found.peak.max(axis=1) >= top
        top, value = np.maximum(top, found.peak.max(axis=1)), np.where(higher, found.peak_value, value)
        blade = np.where(higher, found.peak.argmax(axis=1), blade)
        of_blades = np.where(higher[:, None], found.peak, of_blades)
    return LargestAmplitude(
        amplitude=np.where(np.isfinite(top), top, np.nan),
        direction=direction,
        nearest=index,
        value=value,
        blade=blade,
        participation_ratio=participation_ratio(of_blades),
        whole=(found.status == Status.OK).all(axis=(1, 2)),
        at_end=(index == 0) | (index == len(values) - 1),
        coarse=beside < HALF_POWER * flat.max(axis=1),
    )


def _beside(of_blade: FloatArray, index: np.ndarray) -> FloatArray:
    """The larger of the amplitudes (n, values) at both neighbours of each index."""
    padded, rows = np.pad(of_blade, ((0, 0), (1, 1)), constant_values=-np.inf), np.arange(len(index))
    return np.maximum(padded[rows, index], padded[rows, index + 2])


def peak_between(values: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Where each of n peaks lies, from three values (n, 3) about it and the amplitudes there; within these values.

    Source:
        About a lightly damped resonance 1 / amplitude^2 is a parabola of the frequency.
    """
    (a, b, c), (f, g, h) = values.T, 1 / amplitude.T**2
    with np.errstate(divide="ignore", invalid="ignore"):  # of values that are one, at an end of a range
        first, second = (g - f) / (b - a), (h - g) / (c - b)
        curvature = (second - first) / (c - a)
        vertex = (a + b) / 2 - first / (2 * curvature)
    return np.clip(np.where(curvature > 0, vertex, b), a, c)


def whitehead_factor(blades: int) -> float:
    """Whitehead's factor (1 + sqrt(N)) / 2: the bound of the amplification of a linear row with one mode per blade."""
    return (1 + math.sqrt(blades)) / 2
