"""Vibration-power reduction P_d and its uncertainty (Sec. 3.2, Eqs. (23), (24))."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxshroud.model.linear import power_reduction
from jaxshroud.motion.interval import ENOUGH, correlation_times, interval
from jaxshroud.motion.settling import YES, series_settling

Floats = NDArray[np.float64]
DRIFT = 0.01  # percentage points that never count as drift


class Reduction(NamedTuple):
    """Power of both blades and the reduction of the left one, for each lane."""

    P: Floats  # (..., 2) [m^4]
    P_d: Floats  # (...) [%]
    ci: Floats  # (...) half width of the 95 % interval of P_d [percentage points]
    settled: NDArray[np.bool_]  # (...) P_d will stay what it is, on evidence
    n: NDArray[np.int64]  # (...) periods averaged over
    settling: NDArray[np.int8]  # (...) 0: P_d still drifts, 1: it does not, 2: unknown
    periods_more: Floats  # (...) of transient until it no longer does; NaN if unknown
    ci_short: NDArray[np.bool_]  # (...) too few correlation times for the interval to be trusted


def reduction(power: Floats, P_0: Floats, number: NDArray[np.int32]) -> Reduction:
    """P_d by the paper's rule for the number n of averaged periods.

    Args:
        power: P of each kept period, (..., n, 2) [m^4], oldest first.
        P_0: Power without contact, (..., 2) [m^4].
        number: Period number of each lane, 0 if aperiodic.

    Returns:
        Averages over the largest multiple of the period number within the kept periods, or over all of them where the
        orbit is aperiodic. The interval is that of `interval`, with batches of whole orbits, and short where the run
        spans fewer than 30 correlation times and P_d has not settled on an orbit. P_d is NaN where P_0 is zero (no
        drive).
    """
    power, P_0, number = np.asarray(power), np.asarray(P_0), np.asarray(number)
    lanes = number.shape
    flat = power.reshape(-1, *power.shape[-2:])
    base = np.broadcast_to(P_0, (*lanes, 2)).reshape(-1, 2)
    groups = [np.flatnonzero(number.ravel() == q) for q in np.unique(number)]
    parts = [_same_period(flat[at], base[at], int(q)) for q, at in zip(np.unique(number), groups, strict=True)]
    back = np.argsort(np.concatenate(groups))
    return Reduction(*(np.concatenate(a)[back].reshape(lanes + a[0].shape[1:]) for a in zip(*parts, strict=True)))


def _same_period(power: Floats, P_0: Floats, number: int) -> Reduction:
    q = max(number, 1)
    n = power.shape[1] // q * q
    used = power[:, power.shape[1] - n :]
    P = used.mean(axis=1)
    percent = power_reduction(used[..., 0], P_0[:, :1])  # of each period
    told, ci, times = series_settling(percent, number, DRIFT), interval(percent, q), correlation_times(percent, q)
    settled = told.verdict == YES
    short = ~(times >= ENOUGH) & ~(settled & (number > 0))
    return Reduction(P, percent.mean(axis=1), ci, settled, np.full(len(P), n), *told, short)
