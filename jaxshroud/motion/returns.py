"""The return map of stroboscopic samples: after how many periods, and how nearly, a motion repeats."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SHOWN = 3  # times that a period number must show within the samples


class Returns(NamedTuple):
    """Of each lane."""

    number: NDArray[np.int32]  # smallest number of periods after which all samples return; 0: none
    error: Floats  # largest difference at that number, or at the number where it is least; in units of what counts
    nearest: NDArray[np.int32]  # that number
    one_way: NDArray[np.bool_]  # some displacement moves one way, by more than counts, from each return to the next


def returns(samples: Floats, near: Floats, largest: int = 64) -> Returns:
    """After how many periods samples return.

    Args:
        samples: Displacements (lanes, n, k), oldest first.
        near: Differences (lanes, k) that count as none.
        largest: Most periods looked for; no more than a third of the samples.

    Returns:
        The numbers; a lane that stopped (NaN) has number 0 and error infinity.
    """
    scaled = samples / np.maximum(near, np.finfo(float).tiny)[:, None]
    most = max(min(largest, samples.shape[1] // SHOWN), 1)
    errors = np.stack([np.abs(scaled[:, q:] - scaled[:, :-q]).max(axis=(1, 2)) for q in range(1, most + 1)], axis=1)
    errors = np.where(np.isfinite(errors), errors, np.inf)
    closed = errors <= 1
    nearest = np.where(closed.any(axis=1), closed.argmax(axis=1), errors.argmin(axis=1)) + 1
    error = np.take_along_axis(errors, nearest[:, None] - 1, axis=1)[:, 0]
    number = np.where(error <= 1, nearest, 0).astype(np.int32)
    one_way = np.array([_drifts(one, int(q)) for one, q in zip(scaled, nearest, strict=True)])
    return Returns(number, error, nearest.astype(np.int32), one_way)


def _drifts(z: Floats, q: int) -> bool:
    """Whether samples (n, k) in units of what counts drift: all steps over `q` periods have one sign, and add up."""
    steps = z[q:] - z[:-q]
    one_sign = (steps > 0).all(axis=0) | (steps < 0).all(axis=0)
    return bool(np.any(one_sign & (np.abs(z[-q:].mean(axis=0) - z[:q].mean(axis=0)) > 1)))
