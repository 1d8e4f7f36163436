"""Whether a transient is over, from the slowest decay that the kept samples show.

Samples that repeat are no evidence of it: those of a lightly damped blade differ by little from period to period long
before it has arrived. What counts is how far they still have to go, and that follows from how fast their changes
shrink: changes D_1, D_2, D_3 between four successive blocks of the samples, shrinking by r at least, sum up to
D_3 r / (1 - r) in all the blocks to come.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxshroud.motion.interval import ENOUGH, correlation_times, interval

Floats = NDArray[np.float64]
NO, YES, UNKNOWN = 0, 1, 2
LARGEST_PERIOD = 16  # that is looked for
BLOCKS = 4
FEWEST = 16  # periods; fewer have looked settled in front of an unstable orbit
FEWEST_ORBITS = 8  # for a rate of decay; with half as many the slowest counts
FEWEST_APERIODIC = 64  # periods
SLOWEST = 1000.0  # blocks that a decay takes at most: changes so much smaller than the tolerance are none
SAFETY = 3.0  # of the way still to go
MARGIN = 2.0  # around the tolerance, within which a period number is in doubt
STEADY = 0.6  # ratio of late to early return errors above which nothing converges, and below a half something does
ORDER, REGULAR = 8, 0.1  # numbers of a series from which the next one follows, but for so much of it
APART = 1.5  # half widths of their difference's interval by which halves of a stationary run may differ


class Settling(NamedTuple):
    """Result for each lane."""

    verdict: NDArray[np.int8]  # 0: no, 1: yes, 2: unknown
    periods_more: Floats  # of transient until what is kept is settled; 0 where it is, NaN if unknown


def settling(samples: Floats, near: Floats, q: int) -> Settling:
    """Whether lanes that all have the period number `q` have arrived.

    Args:
        samples: Displacements (lanes, n, k) at the strobe, oldest first.
        near: Differences (lanes, k) that do not count.
        q: The period number; 0: aperiodic.

    Returns:
        For an orbit "yes" where what it still has to go is less than `near`, and its period number not in doubt. For
        aperiodic motion "yes" where the means and mean squares of both halves agree within their intervals, over at
        least 30 correlation times, no return error shrinks, and it is not regular: what rings on for a thousand periods
        cannot be told from what does so for ever.
    """
    scaled = samples / np.maximum(near, np.finfo(float).tiny)[:, None]
    if q == 0:
        return _of_aperiodic(samples, scaled)
    changes, step = block_changes(scaled, q)
    to_go, rate = _remaining(changes, samples.shape[1] // q)
    verdict = np.where(to_go <= 1, YES, np.where(rate < 1, NO, UNKNOWN))
    doubtful = _return_errors(scaled, q).max(axis=1) * MARGIN > 1
    for p in range(1, q):
        if q % p == 0:
            doubtful |= _return_errors(scaled, p).max(axis=1) <= MARGIN
    if samples.shape[1] < FEWEST:
        doubtful[:] = True
    verdict = np.where((verdict == YES) & doubtful, UNKNOWN, verdict)
    return _with_periods(verdict, to_go, rate, step)


def series_settling(series: Floats, q: int, near: float) -> Settling:
    """Whether the mean of `series` (lanes, n) will stay within `near` of what it is; aperiodic: within its interval.

    Args:
        series: One number for each period, oldest first.
        q: The period number of the lanes; 0: aperiodic.
        near: Difference that does not count.
    """
    if q == 0:
        return _of_aperiodic(series[..., None], series[..., None] / near)
    n = series.shape[1]
    changes, step = block_changes(series[..., None], q)
    to_go, rate = _remaining(changes, n // q)
    off = np.abs(series.mean(axis=1) - series[:, n - max(step, 1) :].mean(axis=1)) + to_go
    with np.errstate(invalid="ignore"):
        verdict = np.where(off <= near, YES if n >= FEWEST else UNKNOWN, np.where(rate < 1, NO, UNKNOWN))
    return _with_periods(verdict, off / near, rate, step)


def block_changes(samples: Floats, q: int) -> tuple[Floats, int]:
    """Changes (lanes, blocks - 1) between means over successive blocks of whole orbits, and the length of a block.

    The means are taken for each of an orbit's `q` samples; a change is the largest of any of them, over all k.
    """
    lanes, n, k = samples.shape
    blocks = min(BLOCKS, n // q)
    if blocks < 2:
        return np.full((lanes, 1), np.nan), 0
    orbits = n // q // blocks
    means = samples[:, n - blocks * orbits * q :].reshape(lanes, blocks, orbits, q, k).mean(axis=2)
    return np.linalg.norm(np.diff(means, axis=1), axis=-1).max(axis=-1), orbits * q


def _remaining(changes: Floats, orbits: int) -> tuple[Floats, Floats]:
    """How far lanes still have to go beyond the last block, and by how much a change shrinks from block to block."""
    last = changes[:, -1]
    if changes.shape[1] < BLOCKS - 1:
        return np.full_like(last, np.nan), np.full_like(last, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(changes[:, :-1] > 0, changes[:, 1:] / changes[:, :-1], np.inf).max(axis=1)
        ahead = np.where(rate < 1, SAFETY * rate / (1 - rate), np.inf)
    ahead = np.minimum(ahead, SLOWEST) if orbits >= FEWEST_ORBITS else np.full_like(last, SLOWEST)
    return last * ahead, rate


def _with_periods(verdict, off: Floats, rate: Floats, step: int) -> Settling:
    """`off`: in units of what does not count. It is a block's end that is so far off: the kept ones begin earlier."""
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.ceil(step * (BLOCKS - np.log(off) / np.log(rate)))
    return _told(verdict, more)


def _told(verdict, more: Floats) -> Settling:
    known = np.where((verdict == NO) & np.isfinite(more), np.maximum(more, 1.0), np.nan)
    return Settling(verdict.astype(np.int8), np.where(verdict == YES, 0.0, known))


def _return_errors(scaled: Floats, q: int) -> Floats:
    """Largest difference to the sample `q` periods before, (lanes, n - q)."""
    return np.abs(scaled[:, q:] - scaled[:, :-q]).max(axis=-1)


def _of_aperiodic(samples: Floats, scaled: Floats) -> Settling:
    n = samples.shape[1]
    shrinks, early, half = np.full(len(samples), np.inf), np.full(len(samples), np.nan), 0
    for p in range(1, LARGEST_PERIOD + 1):
        if n - p < FEWEST // 2:
            break
        errors = _return_errors(scaled, p)
        half = errors.shape[1] // 2
        first, second = (np.sqrt((part**2).mean(axis=1)) for part in (errors[:, :half], errors[:, half:]))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = second / first
        better = ratio < shrinks
        shrinks, early = np.where(better, ratio, shrinks), np.where(better, first, early)
    verdict = np.where(shrinks < 0.5, NO, UNKNOWN)
    if n >= FEWEST_APERIODIC:
        verdict = np.where((shrinks > STEADY) & _stationary(samples), YES, verdict)
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.ceil(half * np.log(MARGIN * early) / -np.log(shrinks))
    return _told(verdict, more)


def _stationary(samples: Floats) -> NDArray[np.bool_]:
    fine = np.asarray(np.isfinite(samples).all(axis=(1, 2)))
    squares = (samples - samples.mean(axis=1, keepdims=True)) ** 2
    for series in (*np.moveaxis(samples, -1, 0), *np.moveaxis(squares, -1, 0)):
        at = np.flatnonzero(fine & (series.std(axis=1) > 0))
        moving = series[at]
        fine[at] = (_halves_apart(moving) <= APART) & (correlation_times(moving) >= ENOUGH) & ~_regular(moving)
    return fine


def _regular(series: Floats) -> NDArray[np.bool_]:
    """Whether each number of `series` (lanes, n) follows linearly from the eight before, as in free vibration."""
    about = series - series.mean(axis=1, keepdims=True)
    windows = np.lib.stride_tricks.sliding_window_view(about, ORDER + 1, axis=1)
    products = np.einsum("lni,lnj->lij", windows, windows)
    size = products[:, ORDER, ORDER]
    normal = products[:, :ORDER, :ORDER] + 1e-12 * size[:, None, None] * np.eye(ORDER)
    mixed = products[:, :ORDER, ORDER]
    left = size - np.einsum("li,li->l", mixed, np.linalg.solve(normal, mixed[..., None])[..., 0])
    return left < REGULAR**2 * size


def _halves_apart(series: Floats) -> Floats:
    """Difference of the means of the halves of `series` (lanes, n), in half widths of its 95 % interval."""
    half = series.shape[1] // 2
    early, late = series[:, :half], series[:, half:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(late.mean(axis=1) - early.mean(axis=1)) / np.hypot(interval(early), interval(late))
