"""Whether a transient is over, and the period number of the orbit that is left (Sec. 3.1)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from jaxshroud.scene.checks import tolerance_argument
from jaxshroud.scene.typed import FloatArray, series_argument, typed
from jaxshroud.signals.statistics import MIN_CORRELATION_TIMES, confidence_interval, correlation_times

NOT_SETTLED, SETTLED, UNKNOWN_IF_SETTLED = 0, 1, 2
LARGEST_PERIOD = 16  # that is recognised in any run that is longer
LARGEST_LONG_PERIOD = 64  # that is recognised where it occurs three times
MEAN_BLOCKS = 4
MIN_PERIODS = 16  # with fewer, motions near an unstable orbit have seemed settled
MIN_ORBITS = 8  # for an estimate of the decay; with fewer the slowest decay is assumed
MIN_APERIODIC_PERIODS = 64  # periods
MAX_DECAY_BLOCKS = 1000.0  # longest decay in blocks: changes smaller than the tolerance over this are none
REMAINING_FACTOR = 3.0  # on the remaining change
TOLERANCE_MARGIN = 2.0  # around the tolerance, within which a period number is in doubt
STEADY_RATIO = 0.6  # ratio of late to early return errors: above it nothing converges, below a half something does
# order and largest relative error of a linear prediction of a regular series
PREDICTION_ORDER, PREDICTION_ERROR = 8, 0.1
# A motion passes by what is no orbit where each return is further on by so much of the mean step, and in all, in
# tolerances, by more than rounding, while the steps shrink more slowly than any decay that is waited for.
STEADY_SHARE = 0.8
NEGLIGIBLE_MOVE = 1e-9
SLOWEST_DECAY = 1 - REMAINING_FACTOR / MAX_DECAY_BLOCKS
MAX_MEAN_SHIFT = 1.5  # largest difference of the halves of a stationary run, in half widths of its interval


class Settling(NamedTuple):
    """The settling of each lane."""

    verdict: NDArray[np.int8]  # 0: no, 1: yes, 2: unknown
    periods_more: FloatArray  # further transient until the kept periods are settled; 0 if they are, NaN if unknown
    to_keep: FloatArray  # periods to keep until an aperiodic motion can be judged; 0: enough, NaN if unknown


def settling(samples: FloatArray, near: FloatArray, q: int) -> Settling:
    """Whether lanes that all have the period number `q` have settled.

    Args:
        samples: Displacements (lanes, n, k) at the strobe, oldest first.
        near: Differences (lanes, k) that count as zero.
        q: The period number; 0: aperiodic.

    Returns:
        For an orbit "yes" where its remaining change is less than `near`, its period number is certain, and it does not
        move on steadily, as near a fold, where motions pass by what is no orbit, as slowly as one likes. For
        aperiodic motion "yes" where the means and mean squares of both halves agree within their intervals, over at
        least 30 correlation times, no return error shrinks, and the motion is not regular: a vibration that decays over
        thousands of periods cannot be distinguished from one that lasts.
    """
    scaled = samples / np.maximum(near, np.finfo(float).tiny)[:, None]
    if q == 0:
        return _aperiodic_settling(samples, scaled)
    changes, step = block_changes(scaled, q)
    to_go, rate = _remaining_change(changes, samples.shape[1] // q)
    verdict = np.where(to_go <= 1, SETTLED, np.where(rate < 1, NOT_SETTLED, UNKNOWN_IF_SETTLED))
    doubtful = _passes_by(scaled, q, rate) | (_return_errors(scaled, q).max(axis=1) * TOLERANCE_MARGIN > 1)
    for p in range(1, q):
        if q % p == 0:
            doubtful |= _return_errors(scaled, p).max(axis=1) <= TOLERANCE_MARGIN
    if samples.shape[1] < MIN_PERIODS:
        doubtful[:] = True
    verdict = np.where((verdict == SETTLED) & doubtful, UNKNOWN_IF_SETTLED, verdict)
    return _settling_from_decay(verdict, to_go, rate, step)


def series_settling(series: FloatArray, q: int, near: float) -> Settling:
    """Whether the mean of `series` (lanes, n) will change by less than `near`; aperiodic: by less than its interval.

    Args:
        series: One number for each period, oldest first.
        q: The period number of the lanes; 0: aperiodic.
        near: A difference that counts as zero.
    """
    if q == 0:
        return _aperiodic_settling(series[..., None], series[..., None] / near)
    n = series.shape[1]
    changes, step = block_changes(series[..., None], q)
    to_go, rate = _remaining_change(changes, n // q)
    offset = np.abs(series.mean(axis=1) - series[:, n - max(step, 1) :].mean(axis=1)) + to_go
    certain = (n >= MIN_PERIODS) & ~_passes_by(series[..., None] / near, q, rate)
    with np.errstate(invalid="ignore"):
        verdict = np.where(
            offset <= near,
            np.where(certain, SETTLED, UNKNOWN_IF_SETTLED),
            np.where(rate < 1, NOT_SETTLED, UNKNOWN_IF_SETTLED),
        )
    return _settling_from_decay(verdict, offset / near, rate, step)


def block_changes(samples: FloatArray, q: int) -> tuple[FloatArray, int]:
    """The changes (lanes, blocks - 1) between the means of consecutive blocks of whole orbits, and a block's length.

    The means are taken for each of an orbit's `q` samples; a change is the largest of any of them, over all k.
    """
    lanes, n, k = samples.shape
    blocks = min(MEAN_BLOCKS, n // q)
    if blocks < 2:
        return np.full((lanes, 1), np.nan), 0
    orbits = n // q // blocks
    means = samples[:, n - blocks * orbits * q :].reshape(lanes, blocks, orbits, q, k).mean(axis=2)
    return np.linalg.norm(np.diff(means, axis=1), axis=-1).max(axis=-1), orbits * q


def _passes_by(scaled: FloatArray, q: int, rate: FloatArray) -> NDArray[np.bool_]:
    """Whether lanes seem to pass by an orbit: samples (lanes, n, k), in tolerances, move on in one direction.

    The steps shrink by `rate` from block to block.
    """
    orbits = scaled.shape[1] // q
    if orbits < 2:
        return np.zeros(len(scaled), bool)
    points = scaled[:, scaled.shape[1] - orbits * q :].reshape(len(scaled), orbits, -1)
    whole = points[:, -1] - points[:, 0]
    steps = np.einsum("loi,li->lo", np.diff(points, axis=1), whole)
    length = np.linalg.norm(whole, axis=-1)
    is_steady = (length > NEGLIGIBLE_MOVE) & (steps.min(axis=1) >= STEADY_SHARE * steps.mean(axis=1))
    return is_steady & (rate > SLOWEST_DECAY)


def _remaining_change(changes: FloatArray, orbits: int) -> tuple[FloatArray, FloatArray]:
    """The remaining change of lanes after the last block, and the ratio by which changes shrink from block to block."""
    last = changes[:, -1]
    if changes.shape[1] < MEAN_BLOCKS - 1:
        return np.full_like(last, np.nan), np.full_like(last, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(changes[:, :-1] > 0, changes[:, 1:] / changes[:, :-1], np.inf).max(axis=1)
        ahead = np.where(rate < 1, REMAINING_FACTOR * rate / (1 - rate), np.inf)
    ahead = np.minimum(ahead, MAX_DECAY_BLOCKS) if orbits >= MIN_ORBITS else np.full_like(last, MAX_DECAY_BLOCKS)
    return last * ahead, rate


def _settling_from_decay(verdict, offset: FloatArray, rate: FloatArray, step: int) -> Settling:
    """The settling from the `offset` of the last block, in tolerances, and its decay from block to block."""
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.ceil(step * (MEAN_BLOCKS - np.log(offset) / np.log(rate)))
    return _settling_with_periods(verdict, more)


def _settling_with_periods(verdict, more: FloatArray) -> Settling:
    periods = np.where((verdict == NOT_SETTLED) & np.isfinite(more), np.maximum(more, 1.0), np.nan)
    return Settling(verdict.astype(np.int8), np.where(verdict == SETTLED, 0.0, periods), np.zeros(len(periods)))


def _return_errors(scaled: FloatArray, q: int) -> FloatArray:
    """The largest difference from the sample `q` periods before, (lanes, n - q)."""
    return np.abs(scaled[:, q:] - scaled[:, :-q]).max(axis=-1)


def _aperiodic_settling(samples: FloatArray, scaled: FloatArray) -> Settling:
    n = samples.shape[1]
    shrinks = np.full(len(samples), np.inf)
    early = np.full(len(samples), np.nan)
    half = 0
    for p in range(1, LARGEST_PERIOD + 1):
        if n - p < MIN_PERIODS // 2:
            break
        errors = _return_errors(scaled, p)
        half = errors.shape[1] // 2
        first, second = (np.sqrt((part**2).mean(axis=1)) for part in (errors[:, :half], errors[:, half:]))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = second / first
        better = ratio < shrinks
        shrinks, early = np.where(better, ratio, shrinks), np.where(better, first, early)
    verdict = np.where(shrinks < 0.5, NOT_SETTLED, UNKNOWN_IF_SETTLED)
    spans = np.full(len(samples), np.nan) if n < MIN_PERIODS else _correlation_times_of_stationary(samples)
    if n >= MIN_APERIODIC_PERIODS:
        verdict = np.where((shrinks > STEADY_RATIO) & (spans >= MIN_CORRELATION_TIMES), SETTLED, verdict)
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.ceil(half * np.log(TOLERANCE_MARGIN * early) / -np.log(shrinks))
        needed = np.fmax(np.ceil(n * MIN_CORRELATION_TIMES / spans), MIN_APERIODIC_PERIODS)
    to_keep = np.where(verdict != UNKNOWN_IF_SETTLED, 0.0, np.where(needed > n, needed, np.nan))
    return _settling_with_periods(verdict, more)._replace(to_keep=to_keep)


def _correlation_times_of_stationary(samples: FloatArray) -> FloatArray:
    """How many correlation times (lanes,) samples and their squares span; NaN where they drift or are regular."""
    spans = np.where(np.isfinite(samples).all(axis=(1, 2)), np.inf, np.nan)
    squares = (samples - samples.mean(axis=1, keepdims=True)) ** 2
    for series in (*np.moveaxis(samples, -1, 0), *np.moveaxis(squares, -1, 0)):
        lanes = np.flatnonzero(np.isfinite(series).all(axis=1) & (series.std(axis=1) > 0))
        varying = series[lanes]
        stationary = (_mean_shift(varying) <= MAX_MEAN_SHIFT) & ~_is_predictable(varying)
        spans[lanes] = np.minimum(spans[lanes], np.where(stationary, correlation_times(varying), np.nan))
    return spans


def _is_predictable(series: FloatArray) -> NDArray[np.bool_]:
    """Whether each number of `series` (lanes, n) is a linear function of the previous eight, as in free vibration."""
    centred = series - series.mean(axis=1, keepdims=True)
    windows = np.lib.stride_tricks.sliding_window_view(centred, PREDICTION_ORDER + 1, axis=1)
    products = np.einsum("lni,lnj->lij", windows, windows)
    size = products[:, PREDICTION_ORDER, PREDICTION_ORDER]
    normal = products[:, :PREDICTION_ORDER, :PREDICTION_ORDER] + 1e-12 * size[:, None, None] * np.eye(PREDICTION_ORDER)
    mixed = products[:, :PREDICTION_ORDER, PREDICTION_ORDER]
    residual = size - np.einsum("li,li->l", mixed, np.linalg.solve(normal, mixed[..., None])[..., 0])
    return residual < PREDICTION_ERROR**2 * size


def _mean_shift(series: FloatArray) -> FloatArray:
    """The difference of the means of the halves of `series` (lanes, n), in half widths of its 95 % interval."""
    half = series.shape[1] // 2
    early, late = series[:, :half], series[:, half:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(late.mean(axis=1) - early.mean(axis=1)) / np.hypot(
            confidence_interval(early), confidence_interval(late)
        )


PERIOD_TOLERANCE = 1e-3  # of the largest displacement
MIN_RELATIVE_SIZE = 1e-6  # smallest size of a displacement that counts, over the largest of the motion
CLOSING_ROUNDINGS = 100  # rounding units of the largest displacement that count as zero
MIN_REPEATS = 3  # times that a period must occur within the samples


class Periodicity(NamedTuple):
    """The period numbers of lanes; both arrays have the shape of the lanes."""

    number: NDArray[np.int32]  # see `periodicity`; 0 means aperiodic
    settled: NDArray[np.bool_]  # whether the transient is known to be over, see `settling`


class Repetition(NamedTuple):
    """The period number and the settling of lanes, from all their displacements."""

    number: NDArray[np.int32]  # see `periodicity`; 0 means aperiodic
    settling: Settling


@typed
def periodicity(x: ArrayLike, period_tol: float = PERIOD_TOLERANCE) -> Periodicity:
    """The smallest q for which the return map of one displacement closes over all kept samples.

    Numbers up to 16 are found in every run that is longer, and numbers up to 64 where they are kept three times.

    Args:
        x: Stroboscopic samples (..., n), one per drive period, oldest first.
        period_tol: The largest |x[n+q] - x[n]| that counts as closed, relative to the largest |x|.

    Returns:
        The period number, and whether the samples show that the transient is over.

    Raises:
        InputError: There is no sample, or `period_tol` is out of range.
    """
    tolerance_argument("period_tol", period_tol)
    x = series_argument("x", x)
    number, settling_result = _repetition_of(x[..., None], period_tol * np.max(np.abs(x), axis=-1, keepdims=True))
    return Periodicity(number, settling_result.verdict == SETTLED)


def repetition(
    samples: FloatArray, sizes: FloatArray, lever: FloatArray, tolerance: float, precision: DTypeLike
) -> Repetition:
    """The smallest q for which the return map of every displacement closes over all kept samples, as `periodicity`.

    Args:
        samples: x, y [m] and theta [rad] of the blades at the strobe, (..., n, 3 blades), oldest first.
        sizes: The largest magnitude of each in the kept periods, (..., 3 blades); 0 where the model leaves it out.
        lever: Half the diagonal of a block (...) [m], which converts angles to displacements.
        tolerance: Largest difference that counts as closed, see `closing_tolerances`.
        precision: The floating-point type of the march.

    Returns:
        The period numbers, and whether the transient is over.
    """
    return _repetition_of(samples, closing_tolerances(sizes, lever, tolerance, precision))


def _repetition_of(samples: FloatArray, near: FloatArray) -> Repetition:
    lanes, (n, k) = samples.shape[:-2], samples.shape[-2:]
    flat = samples.reshape(-1, n, k)
    close = near.reshape(-1, 1, k)
    number = np.zeros(len(flat), np.int32)
    still_open = np.flatnonzero(np.isfinite(flat).all(axis=(1, 2)))  # a stopped lane has NaN
    for q in range(1, _largest_period(n) + 1):
        z, near_zero = flat[still_open], close[still_open]
        closed = (np.abs(z[:, q:] - z[:, :-q]) <= near_zero).all(axis=(1, 2))
        number[still_open[closed]] = q
        still_open = still_open[~closed]
    verdict = np.full(len(flat), UNKNOWN_IF_SETTLED, np.int8)
    more, to_keep = np.full((2, len(flat)), np.nan)
    for q in np.unique(number):
        lanes_with_q = np.flatnonzero((number == q) & np.isfinite(flat).all(axis=(1, 2)))
        if len(lanes_with_q):
            found = settling(flat[lanes_with_q], close[lanes_with_q, 0], int(q))
            verdict[lanes_with_q], more[lanes_with_q] = found.verdict, found.periods_more
            to_keep[lanes_with_q] = found.to_keep
    settled = Settling(verdict=verdict.reshape(lanes), periods_more=more.reshape(lanes), to_keep=to_keep.reshape(lanes))
    return Repetition(number.astype(np.int32).reshape(lanes), settled)


def _largest_period(n: int) -> int:
    """The largest period number that `n` samples can show."""
    return max(min(LARGEST_PERIOD, n - 1), min(LARGEST_LONG_PERIOD, n // MIN_REPEATS))


def closing_tolerances(sizes: FloatArray, lever: FloatArray, tolerance: float, precision: DTypeLike) -> FloatArray:
    """The differences of displacements that count as zero, (..., 3 blades); the arguments are those of `repetition`.

    They are `tolerance` times the size of each displacement, or times a millionth of the largest where that is more,
    and at least 100 rounding units of the largest, from which the others are computed.
    """
    per_metre = np.ones((*np.shape(lever), np.shape(sizes)[-1]))
    per_metre[..., np.shape(sizes)[-1] * 2 // 3 :] = 1 / np.asarray(lever)[..., None]
    largest = (sizes / per_metre).max(axis=-1, keepdims=True) * per_metre
    return np.maximum(
        tolerance * np.maximum(sizes, MIN_RELATIVE_SIZE * largest),
        CLOSING_ROUNDINGS * np.finfo(precision).eps * largest,
    )


class Recurrence(NamedTuple):
    """The returns of the samples of each lane."""

    number: NDArray[np.int32]  # smallest number of periods after which all samples return; 0: none
    error: FloatArray  # largest difference at that number, or at the nearest one, in tolerances
    nearest: NDArray[np.int32]  # the number at which the difference is least
    one_way: NDArray[np.bool_]  # some displacement drifts one way from each return to the next


def recurrence(samples: FloatArray, near: FloatArray, largest: int = 64) -> Recurrence:
    """The number of periods after which samples return.

    Args:
        samples: Displacements (lanes, n, k), oldest first.
        near: Differences (lanes, k) that count as zero.
        largest: The largest number of periods tried; at most a third of the samples.

    Returns:
        The numbers; a lane that stopped (NaN) has number 0 and error infinity.
    """
    scaled = samples / np.maximum(near, np.finfo(float).tiny)[:, None]
    largest_tried = max(min(largest, samples.shape[1] // MIN_REPEATS), 1)
    errors = np.stack(
        [np.abs(scaled[:, q:] - scaled[:, :-q]).max(axis=(1, 2)) for q in range(1, largest_tried + 1)], axis=1
    )
    errors = np.where(np.isfinite(errors), errors, np.inf)
    closed = errors <= 1
    nearest = np.where(closed.any(axis=1), closed.argmax(axis=1), errors.argmin(axis=1)) + 1
    error = np.take_along_axis(errors, nearest[:, None] - 1, axis=1)[:, 0]
    number = np.where(error <= 1, nearest, 0).astype(np.int32)
    one_way = np.array([_drifts(samples_of_lane, int(q)) for samples_of_lane, q in zip(scaled, nearest, strict=True)])
    return Recurrence(number, error, nearest.astype(np.int32), one_way)


def _drifts(z: FloatArray, q: int) -> bool:
    """Whether samples (n, k), in tolerances, drift: all steps over `q` periods have one sign and a sum above 1."""
    steps = z[q:] - z[:-q]
    one_sign = (steps > 0).all(axis=0) | (steps < 0).all(axis=0)
    return bool(np.any(one_sign & (np.abs(z[-q:].mean(axis=0) - z[:q].mean(axis=0)) > 1)))
