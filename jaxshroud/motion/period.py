"""Period number of a stroboscopic orbit (Sec. 3.1)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxshroud.motion.settling import LARGEST_PERIOD, UNKNOWN, YES, Settling, settling

Floats = NDArray[np.float64]
PERIOD_TOLERANCE = 1e-3  # of the largest displacement
SMALLEST = 1e-6  # size of a displacement that still counts, over the motion's largest
ROUNDING = 100  # units of the last place of the motion's largest that never count


class Periodicity(NamedTuple):
    """Result for each lane; both arrays have the shape of the lanes."""

    number: NDArray[np.int32]  # 1..16; 0 means aperiodic
    settled: NDArray[np.bool_]  # True: on evidence, see `settling`; False: the transient is not over, or who knows


class Repetition(NamedTuple):
    """Of a motion with all its displacements, for each lane."""

    number: NDArray[np.int32]  # 1..16; 0 means aperiodic
    settling: Settling


def periodicity(x: ArrayLike, tolerance: float = PERIOD_TOLERANCE) -> Periodicity:
    """Smallest q <= 16 whose return map closes over all kept samples, of one displacement.

    Args:
        x: Stroboscopic samples (..., n), one per drive period, oldest first.
        tolerance: Largest |x[n+q] - x[n]| that counts as closed, relative to the largest |x|.

    Returns:
        The period number, and whether the samples show that the transient is over.
    """
    x = np.asarray(x, dtype=float)
    number, told = _judged(x[..., None], tolerance * np.max(np.abs(x), axis=-1, keepdims=True))
    return Periodicity(number, told.verdict == YES)


def repetition(samples: Floats, sizes: Floats, lever: Floats, tolerance: float, precision: Any) -> Repetition:
    """Smallest q <= 16 whose return map closes over all kept samples, in every displacement.

    Args:
        samples: x, y [m] and theta [rad] of both blades at the strobe, (..., n, 6), oldest first.
        sizes: Largest magnitude of each in the kept periods, (..., 6); 0 for what the model leaves out.
        lever: Half the diagonal of a block (...) [m], by which angles are compared with displacements.
        tolerance: Largest difference that counts as closed, see `nearness`.
        precision: Type of the numbers that the motion was computed with.

    Returns:
        The period numbers, and whether the transient is over.
    """
    return _judged(samples, nearness(sizes, lever, tolerance, precision))


def _judged(samples: Floats, near: Floats) -> Repetition:
    lanes, (n, k) = samples.shape[:-2], samples.shape[-2:]
    flat, close = samples.reshape(-1, n, k), near.reshape(-1, 1, k)
    number = np.zeros(len(flat), np.int32)
    with np.errstate(invalid="ignore"):  # a stopped lane is NaN, which is never closed
        for q in range(min(LARGEST_PERIOD, n - 1), 0, -1):
            closed = (np.abs(flat[:, q:] - flat[:, :-q]) <= close).all(axis=(1, 2))
            number = np.where(closed & np.isfinite(flat).all(axis=(1, 2)), q, number)
    verdict, more = np.full(len(flat), UNKNOWN, np.int8), np.full(len(flat), np.nan)
    for q in np.unique(number):
        at = np.flatnonzero((number == q) & np.isfinite(flat).all(axis=(1, 2)))
        if len(at):
            verdict[at], more[at] = settling(flat[at], close[at, 0], int(q))
    return Repetition(number.astype(np.int32).reshape(lanes), Settling(verdict.reshape(lanes), more.reshape(lanes)))


def nearness(sizes: Floats, lever: Floats, tolerance: float, precision: Any) -> Floats:
    """Differences of displacements that count as none, (..., 6); the arguments are those of `repetition`.

    They are `tolerance` of each displacement's own size, or of a millionth of the motion's largest where that is more,
    and at least 100 rounding units of the largest, from which the others are computed.
    """
    per_metre = np.ones((*np.shape(lever), 6))
    per_metre[..., 4:] = 1 / np.asarray(lever)[..., None]
    largest = (sizes / per_metre).max(axis=-1, keepdims=True) * per_metre
    return np.maximum(tolerance * np.maximum(sizes, SMALLEST * largest), ROUNDING * np.finfo(precision).eps * largest)
