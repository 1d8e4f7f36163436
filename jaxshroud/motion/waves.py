"""Waves around a row of blades: harmonics in time by nodal diameters around the row.

A travelling wave of harmonic n and nodal diameter h is Re a exp(i (n omega t + 2 pi h i / N)) at blade i: it travels
forward, from blade to blade in the order of time, for h < 0 and backward for h > 0. A drive of engine order EO, whose
phase at blade i is 2 pi EO i / N, alone excites the harmonics n at h = n EO modulo N.
"""

from typing import NamedTuple

import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.typed import FloatArray


class BladeSpectrum(NamedTuple):
    """Amplitudes of waves, (..., harmonics, N): |a| by harmonic 0, 1, ... of the drive and by nodal diameter."""

    amplitude: FloatArray  # [m] or [rad]; of all blades alike
    diameters: np.ndarray  # (N,) from -N/2 to N/2


def blade_spectrum(q: FloatArray, per_period: float, periods: int) -> BladeSpectrum:
    """The waves of a displacement over its last drive periods.

    Args:
        q: Samples (..., time, N), the last one at the end of a period.
        per_period: Samples in a drive period.
        periods: Drive periods.

    Raises:
        ValueError: The samples do not divide the period, or there are too few.
    """
    count = round(per_period)
    if abs(count - per_period) > 1e-9 * per_period or count < 4:
        raise InputError(f"{per_period:g} samples in a drive period: waves need a whole number, at least 4.")
    if q.shape[-2] <= count * periods:
        raise InputError(f"The run has fewer than {periods} drive periods of samples.")
    last = np.asarray(q, float)[..., -count * periods :, :]
    blades = q.shape[-1]
    both = np.fft.fft2(last, axes=(-2, -1)) / (count * periods * blades)
    harmonics = both[..., : count * periods // 2 : periods, :]
    twice = np.where(np.arange(harmonics.shape[-2]) > 0, 2.0, 1.0)[:, None]  # positive and negative frequencies
    diameters = np.fft.fftfreq(blades, 1 / blades).round().astype(int)
    order = np.argsort(diameters, kind="stable")
    return BladeSpectrum((twice * np.abs(harmonics))[..., order], diameters[order])


def wave_distance(spectrum: BladeSpectrum) -> FloatArray:
    """The share of the motion's square that lies outside the largest nodal diameter of each harmonic >= 1, (...).

    A travelling wave has one nodal diameter for each harmonic: 0, to rounding. It is NaN without motion.
    """
    square = spectrum.amplitude[..., 1:, :] ** 2
    total = square.sum(axis=(-2, -1))
    outside = total - square.max(axis=-1).sum(axis=-1)
    return np.where(total > 0, outside / np.where(total > 0, total, 1.0), np.nan)


def participation_ratio(amplitude: FloatArray) -> FloatArray:
    """How many of the blades take part, of all: (sum a^2)^2 / (N sum a^4), 1 if all alike and 1/N if one alone."""
    square = np.asarray(amplitude, float) ** 2
    whole = square.shape[-1] * np.sum(square**2, axis=-1)
    return np.where(whole > 0, np.sum(square, axis=-1) ** 2 / np.where(whole > 0, whole, 1.0), np.nan)
