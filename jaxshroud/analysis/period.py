"""Period number of a stroboscopic orbit (Sec. 3.1)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

LARGEST_PERIOD = 16
PERIOD_TOLERANCE = 1e-3  # of the largest displacement


class Periodicity(NamedTuple):
    """Result for each lane; both arrays have the shape of the lanes."""

    number: NDArray[np.int32]  # 1..16; 0 means aperiodic
    settled: NDArray[np.bool_]  # False: the samples still converge, the transient is not over


def periodicity(x: ArrayLike, tolerance: float = PERIOD_TOLERANCE) -> Periodicity:
    """Smallest q <= 16 whose return map closes over all kept samples.

    Args:
        x: Stroboscopic samples (..., n), one per drive period, oldest first.
        tolerance: Largest |x[n+q] - x[n]| that counts as closed, relative to the largest |x|.

    Returns:
        The period number, and whether the samples are settled: an orbit that is not closed but whose best return error
        over the second half of the samples is less than half of that over the first is still converging.
    """
    x = np.asarray(x, dtype=float)
    n = x.shape[-1]
    scale = np.max(np.abs(x), axis=-1)
    number = np.zeros(x.shape[:-1], np.int32)
    converging = np.zeros(x.shape[:-1], bool)
    with np.errstate(invalid="ignore"):  # a stopped lane is NaN, which is never closed
        for q in range(min(LARGEST_PERIOD, n - 1), 0, -1):
            error = np.abs(x[..., q:] - x[..., :-q])
            number = np.where((error.max(axis=-1) <= tolerance * scale) & np.isfinite(scale), q, number)
            half = error.shape[-1] // 2
            if half >= LARGEST_PERIOD:
                early, late = error[..., :half].max(axis=-1), error[..., half:].max(axis=-1)
                converging |= late < early / 2
    return Periodicity(number.astype(np.int32), (number > 0) | (~converging & np.isfinite(scale)))
