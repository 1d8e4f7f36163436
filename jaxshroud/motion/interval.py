"""The interval of a mean of correlated samples, and how many correlation times they span."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BATCHES = (6, 12, 24)  # numbers of batches tried: the widest interval counts
ENOUGH = 30  # correlation times; with fewer, batches are too much alike for an interval to be trusted


def interval(series: Floats, q: int = 1) -> Floats:
    """Half width of the 95 % interval of the mean of `series` (lanes, n) by batch means; batches hold whole orbits.

    Few batches are long enough to be independent, many tell their own spread well: the widest of three intervals is
    taken. On AR(1) series of more than 25 correlation times it covers the mean in 95 to 98 of 100, and is 1.2 to 1.3
    times as wide as one that knows the spectrum. NaN below two orbits.
    """
    widths = [quantile(m - 1) * error for m, error in _errors(series, q)]
    return np.asarray(np.max(widths, axis=0)) if widths else np.full(series.shape[:-1], np.nan)


def quantile(degrees: int) -> float:
    """Student's t of so many degrees of freedom that 97.5 % stay below."""
    from scipy.special import stdtrit

    return stdtrit(degrees, 0.975)


def correlation_times(series: Floats, q: int = 1) -> Floats:
    """How many correlation times `series` (lanes, n) spans: independent samples that would say as much of its mean.

    Infinite where the orbits' means are all alike, NaN below two orbits. A series that does not know its mean yet gives
    too many: three where it spans less than one.
    """
    errors = [error for _, error in _errors(series, q)]
    if not errors:
        return np.full(series.shape[:-1], np.nan)
    spread = orbit_means(series, q).std(axis=-1, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0, (spread / np.max(errors, axis=0)) ** 2, np.where(spread == 0, np.inf, np.nan))


def orbit_means(series: Floats, q: int) -> Floats:
    """Means over the latest whole orbits of `q` samples, (lanes, n // q)."""
    orbits = series.shape[-1] // q
    return series[..., series.shape[-1] - orbits * q :].reshape(*series.shape[:-1], orbits, q).mean(axis=-1)


def _errors(series: Floats, q: int) -> list[tuple[int, Floats]]:
    """Numbers of batches, and the standard error of the mean (lanes,) that each gives."""
    orbits, found = series.shape[-1] // q, []
    for length in sorted({orbits // min(m, max(orbits, 1)) for m in BATCHES} - {0}):
        means = orbit_means(series, length * q)
        batches = means.shape[-1]
        if batches > 1:
            found.append((batches, np.asarray(means.std(axis=-1, ddof=1) / np.sqrt(batches))))
    return found
