"""The amplitude spectrum over whole drive periods, and labels for its lines (Figs. 10, 12 and 14)."""

from fractions import Fraction
from math import isqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.typed import FloatArray, series_argument, typed

NEIGHBOUR_BINS = 8  # bins on either side, with which a line is compared
PROMINENCE = 5.0  # over their median; broadband (Rayleigh) noise exceeds this in 1 bin of 30,000
MIN_LABELLED_PERIODS = 9  # below this, thirds of f_e are not resolved and only harmonics are labelled


@typed
def amplitude_spectrum(
    signal: ArrayLike, samples_per_period: int | Fraction, window: str = "rectangular"
) -> tuple[FloatArray, FloatArray]:
    """The one-sided amplitudes of `signal` over the last whole number n of drive periods.

    A sin(k tau) gives the amplitude A at frequency k where n k is an integer: the line falls on a bin.
    Any other line leaks. With the rectangular window its peak is up to 36 % low (1 - 2/pi) and its tails
    fall as 1/distance; with "hann" the peak is up to 15 % low (1 - 8/(3 pi)), a line is four bins wide and
    its tails fall as 1/distance^3. So: rectangular over a multiple of the period number, Hann without one.
    The mean is removed before windowing; its magnitude stands at frequency 0.

    Args:
        signal: Equidistant samples (m,); of a run that stores both ends, the first is dropped.
        samples_per_period: Samples in one drive period, at least 2; a Fraction where not every period ends at a
            sample.
        window: "rectangular" or "hann".

    Returns:
        Frequency in units of f_e and amplitude in the signal's unit, both (n samples_per_period // 2 + 1,).
        One NaN in the signal makes every amplitude NaN.

    Raises:
        ValueError: The signal is shorter than one drive period, or an argument is out of range.
    """
    x = _as_series(series_argument("signal", signal))
    rate = _sampling_rate(samples_per_period)
    n_periods = whole_periods(x.size, rate)
    if n_periods < 1:
        need = int(rate * rate.denominator)
        raise InputError(f"Argument `signal` must have {need} samples (whole drive periods), but has {x.size}.")
    x = x[x.size - int(n_periods * rate) :]
    mean = x.mean()
    weight = _weights(window, x.size)
    amplitude = 2 * np.abs(np.fft.rfft((x - mean) * weight)) / weight.sum()
    if x.size % 2 == 0:
        amplitude[-1] /= 2  # the highest frequency has no mirror image
    amplitude[0] = abs(mean)
    return np.arange(amplitude.size) / n_periods, amplitude


def whole_periods(n_samples: int, samples_per_period: int | Fraction) -> int:
    """The largest number of drive periods within `n_samples` that is a whole number of samples."""
    rate = _sampling_rate(samples_per_period)
    return int(n_samples / rate) // rate.denominator * rate.denominator


def repeats_after(
    signal: ArrayLike, samples_per_period: int | Fraction, *, tolerance: float = 1e-3, largest: int = 16
) -> int:
    """The smallest number of drive periods after which the whole signal repeats itself.

    This chooses the length of a spectrum without leakage. Unlike a period number it compares all samples,
    not only those at the ends of periods, and requires two repeats within the signal.

    Args:
        signal: Equidistant samples (m,).
        samples_per_period: Samples in one drive period.
        tolerance: Largest difference that counts as equal, relative to the largest magnitude.
        largest: The largest number tried.

    Returns:
        1 to `largest`, or 0 where the signal does not repeat (or has a NaN).
    """
    x = _as_series(signal)
    rate = _sampling_rate(samples_per_period)
    if x.size == 0:
        return 0
    largest_difference = tolerance * np.abs(x).max()
    for q in range(rate.denominator, largest + 1, rate.denominator):
        shift = int(q * rate)
        if 2 * shift <= x.size and np.abs(x[shift:] - x[:-shift]).max() <= largest_difference:
            return q
    return 0


def label_lines(
    frequency: ArrayLike,
    amplitude: ArrayLike,
    period_number: int = 0,
    *,
    max_denominator: int = 16,
    threshold: float = 1e-3,
) -> list[tuple[float, str]]:
    """The labels of the visible lines: harmonics `f_e`, `2f_e` and fractions `f_e/2`, `3f_e/2`.

    Args:
        frequency: In units of f_e, equidistant from 0 (m,).
        amplitude: One per frequency (m,).
        period_number: q where the motion is known to repeat after q periods: every multiple of f_e/q above
            the threshold is named. The spectrum should cover a multiple of q periods.
            0 (unknown or aperiodic): peaks that stand out from the bins around them are named, if they lie
            within half a bin of a fraction that the resolution can separate from the next one:
            denominator^2 <= n periods; and below 9 periods harmonics only.
        max_denominator: The largest denominator for period number 0.
        threshold: Smallest amplitude of a named line, relative to the largest; the mean does not count.

    Returns:
        (frequency in units of f_e, label), by rising frequency.
    """
    f, a = _as_series(frequency), _as_series(amplitude)
    if f.size < 2:
        return []
    n_periods = round(1 / (f[1] - f[0]))
    visible = (a > threshold * a[1:].max()) & (f > 0)
    if period_number == 0 and n_periods >= MIN_LABELLED_PERIODS:
        lines = _prominent_lines(f, a, visible, min(max_denominator, isqrt(n_periods)))
    else:
        q = max(period_number, 1)
        multiples = [Fraction(p, q) for p in range(1, int(f[-1] * q + 1e-9) + 1)]
        lines = [line for line in multiples if visible[round(line * n_periods)]]
    return [(float(line), line_label(line)) for line in lines]


def line_label(line: Fraction) -> str:
    """`f_e`, `2f_e`, `f_e/2`, `3f_e/2`, ... for a frequency in units of f_e."""
    times = "" if line.numerator == 1 else str(line.numerator)
    denominator = "" if line.denominator == 1 else f"/{line.denominator}"
    return f"{times}f_e{denominator}"


def _prominent_lines(f: FloatArray, a: FloatArray, visible: NDArray[np.bool_], max_denominator: int) -> list[Fraction]:
    padded = np.pad(a, NEIGHBOUR_BINS, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOUR_BINS + 1)
    left, right = windows[:, NEIGHBOUR_BINS - 1], windows[:, NEIGHBOUR_BINS + 1]
    peaks = visible & (a >= left) & (a >= right) & (a > PROMINENCE * np.median(windows, axis=1))
    candidates = [(peak, Fraction(peak).limit_denominator(max_denominator)) for peak in f[peaks]]
    half_bin = (f[1] - f[0]) / 2
    return sorted({line for peak, line in candidates if line > 0 and abs(peak - line) <= half_bin * (1 + 1e-9)})


def _weights(window: str, n: int) -> FloatArray:
    if window == "rectangular":
        return np.ones(n)
    if window == "hann":
        return np.sin(np.pi * np.arange(n) / n) ** 2  # periodic form: exact for lines on a bin
    raise InputError(f"Argument `window` must be 'rectangular' or 'hann', but is {window!r}.")


def _as_series(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.ndim != 1:
        raise InputError(f"A signal or spectrum must have one dimension, but has shape {array.shape}.")
    return array


def _sampling_rate(samples_per_period: int | Fraction) -> Fraction:
    if not samples_per_period >= 2:
        raise InputError(f"Argument `samples_per_period` must be at least 2, but is {samples_per_period}.")
    return Fraction(samples_per_period)
