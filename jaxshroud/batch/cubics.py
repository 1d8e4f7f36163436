"""The cubics through samples and their rates: means over time, largest values, and the amplitudes of long runs."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import DISPLACEMENTS


def cubic_mean(q: Any, rate: Any, h: Any) -> Any:
    """The mean over time of the cubics through samples (lanes, n, ...) and their rates at intervals `h`."""
    intervals = q.shape[1] - 1
    trapezoid = q.mean(axis=1) * (intervals + 1) - (q[:, 0] + q[:, -1]) / 2
    return (trapezoid + h[:, 0] / 12 * (rate[:, 0] - rate[:, -1])) / intervals


def hermite_coefficients(g_0: Any, g_1: Any, m_0: Any, m_1: Any) -> tuple[Any, Any]:
    """The coefficients of s^2 and s^3 of cubics on [0, 1] with values `g` and slopes `m` at the ends."""
    return 3 * (g_1 - g_0) - 2 * m_0 - m_1, m_0 + m_1 - 2 * (g_1 - g_0)


def hermite_largest(q: Any, slope: Any) -> Any:
    """The largest value of the cubics through samples (lanes, n, columns) with these slopes per interval."""
    like: Any = np if isinstance(q, np.ndarray) else jnp
    (g_0, g_1), (m_0, m_1) = ((a[:, :-1], a[:, 1:]) for a in (q, slope))
    b, c = hermite_coefficients(g_0, g_1, m_0, m_1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        s = m_0 / (like.sqrt(b * b - 3 * m_0 * c) - b)
    top = g_0 + s * (m_0 + s * (b + s * c))
    return like.maximum(q.max(axis=1), like.where((s > 0) & (s < 1), top, -np.inf).max(axis=1))


SAMPLES_AT_ONCE = 1 << 12  # of each lane, in NumPy's temporary arrays


class SampledAmplitudes(NamedTuple):
    """Where displacements of runs lie, fields (lanes, blades, 3): x, y [m] and theta [rad]."""

    mean: np.ndarray
    rms: np.ndarray  # about the mean
    peak: np.ndarray  # largest distance from the mean


class RunningAmplitudes:
    """The amplitudes of displacements from samples that come in parts, none of which is kept.

    Sums are those of distances from the first sample: of a motion that hardly moves they keep their digits.
    """

    def __init__(self, first: Motion, interval: np.ndarray):
        """`first` is the sample that the next ones follow at `interval` [s], (lanes,); fields (lanes, blades)."""
        self._h = interval[:, None, None, None]
        q, rate = _displacements(Motion(*(a[:, None] for a in first)))
        self._origin, self._last = q[:, 0], (q, rate)
        self._count, self._sum, self._squares = 0, np.zeros_like(q[:, 0]), np.zeros_like(q[:, 0])
        self._highest, self._lowest = np.full_like(q[:, 0], -np.inf), np.full_like(q[:, 0], np.inf)

    def add(self, motion: Motion) -> None:
        """Count the next samples, fields (lanes, n, blades)."""
        for begin in range(0, motion.x.shape[1], SAMPLES_AT_ONCE):
            self._add(Motion(*(a[:, begin : begin + SAMPLES_AT_ONCE] for a in motion)))

    def _add(self, motion: Motion) -> None:
        n = motion.x.shape[1]
        q, rate = (np.concatenate(pair, axis=1) for pair in zip(self._last, _displacements(motion), strict=True))

        def columns(a):
            return a.reshape(*a.shape[:2], -1)

        with np.errstate(invalid="ignore", over="ignore"):  # of a motion that has overflowed
            away, slope = q - self._origin[:, None], rate * self._h
            self._sum += n * cubic_mean(away, rate, self._h)
            self._squares += n * cubic_mean(away**2, 2 * away * rate, self._h)
            top = hermite_largest(columns(away), columns(slope)).reshape(self._sum.shape)
            bottom = -hermite_largest(columns(-away), columns(-slope)).reshape(self._sum.shape)
        self._highest, self._lowest = np.maximum(self._highest, top), np.minimum(self._lowest, bottom)
        self._last, self._count = (q[:, -1:], rate[:, -1:]), self._count + n

    @property
    def amplitudes(self) -> SampledAmplitudes:
        """The amplitudes over all samples so far."""
        mean = self._sum / self._count
        with np.errstate(invalid="ignore", over="ignore"):  # of a motion that has overflowed
            square = self._squares / self._count - mean**2
            peak = np.maximum(self._highest - mean, mean - self._lowest)
            return SampledAmplitudes(self._origin + mean, np.sqrt(np.maximum(square, 0.0)), peak)


def _displacements(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The displacements and their rates, (lanes, n, blades, 3) each."""

    def stacked(prefix):
        return np.stack([np.asarray(getattr(motion, prefix + n), float) for n in DISPLACEMENTS], axis=-1)

    return stacked(""), stacked("v_")
