"""Vibration-power reduction P_d and its uncertainty (Sec. 3.2, Eqs. (23), (24))."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Floats = NDArray[np.float64]
BATCHES = 10
DRIFT = 0.01  # percentage points between the two halves of a run that never count as drift


class Reduction(NamedTuple):
    """Power of both blades and the reduction of the left one, for each lane."""

    P: Floats  # (..., 2) [m^4]
    P_d: Floats  # (...) [%]
    ci: Floats  # (...) half width of the 95 % interval of P_d [percentage points]
    settled: NDArray[np.bool_]  # (...) no drift between the two halves of the run
    n: NDArray[np.int64]  # (...) periods averaged over


def reduction(power: Floats, P_0: Floats, number: NDArray[np.int32]) -> Reduction:
    """P_d by the paper's rule for the number n of averaged periods.

    Args:
        power: P of each kept period, (..., n, 2) [m^4], oldest first.
        P_0: Power without contact, (..., 2) [m^4].
        number: Period number of each lane, 0 if aperiodic.

    Returns:
        Averages over the largest multiple of the period number within the kept periods, or over all of them where the
        orbit is aperiodic. The interval is by batch means: over ten batches of equal length, or over blocks of one
        orbit where that gives fewer. It is NaN below two batches. P_d is NaN where P_0 is zero (no drive).
    """
    power, P_0, number = np.asarray(power), np.asarray(P_0), np.asarray(number)
    lanes = number.shape
    flat = power.reshape(-1, *power.shape[-2:])
    base = np.broadcast_to(P_0, (*lanes, 2)).reshape(-1, 2)
    groups = [np.flatnonzero(number.ravel() == q) for q in np.unique(number)]
    parts = [_same_period(flat[at], base[at], max(int(q), 1)) for q, at in zip(np.unique(number), groups, strict=True)]
    back = np.argsort(np.concatenate(groups))
    return Reduction(*(np.concatenate(a)[back].reshape(lanes + a[0].shape[1:]) for a in zip(*parts, strict=True)))


def _same_period(power: Floats, P_0: Floats, q: int) -> Reduction:
    n = power.shape[1] // q * q
    used = power[:, power.shape[1] - n :]
    P = used.mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = 100 * (1 - used[..., 0] / P_0[:, :1])  # P_d of each period
    percent = np.where(P_0[:, :1] > 0, percent, np.nan)
    return Reduction(P, percent.mean(axis=1), interval(percent, q), _settled(percent, q), np.full(len(P), n))


def _settled(series: Floats, q: int) -> NDArray[np.bool_]:
    """Whether the halves of `series` (lanes, n) differ by no more than twice the later one's own interval."""
    half = series.shape[1] // (2 * q) * q
    if half == 0:
        return np.zeros(len(series), bool)
    early, late = series[:, :-half], series[:, -half:]
    with np.errstate(invalid="ignore"):
        drift = np.abs(late.mean(axis=1) - early.mean(axis=1))
        return drift <= np.fmax(2 * interval(late, q), DRIFT)


def interval(series: Floats, q: int = 1) -> Floats:
    """Half width of the 95 % interval of the mean of `series` (lanes, n) by batch means; batches hold whole orbits."""
    orbits = series.shape[-1] // q
    batches = min(BATCHES, orbits)
    if batches < 2:
        return np.full(series.shape[:-1], np.nan)
    length = orbits // batches * q
    batch = (
        series[..., series.shape[-1] - batches * length :].reshape(*series.shape[:-1], batches, length).mean(axis=-1)
    )
    return np.asarray(stdtrit(batches - 1, 0.975) * batch.std(axis=-1, ddof=1) / np.sqrt(batches))
