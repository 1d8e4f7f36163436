"""What a scatter of numbers does to an output: shares of its variance (Sobol indices).

Rows of A and B are independent draws; in A_B[i] number i is that of B and all others are those of A. The estimators are
those that `scipy.stats.sobol_indices` calls saltelli_2010; there resampling has no seed, and one number alone fails.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

RESAMPLES = 999
ENDS = (0.025, 0.975)


class Indices(NamedTuple):
    """Of each number, (keys,): its share of the variance alone and with all that it takes part in; 95 % intervals."""

    first: np.ndarray
    first_low: np.ndarray
    first_high: np.ndarray
    total: np.ndarray
    total_low: np.ndarray
    total_high: np.ndarray


def draws(n: int, ends: np.ndarray, seed: int) -> np.ndarray:
    """Rows of A, of B and of each A_B, (2 + keys, n, keys): uniform between `ends` (keys, 2), quasi-random.

    `n` is a power of 2.
    """
    size = len(ends)
    A, B = np.split(qmc.Sobol(2 * size, rng=np.random.default_rng(seed), bits=64).random(n), 2, axis=1)
    mixed = [np.where(np.arange(size) == i, B, A) for i in range(size)]
    low, high = ends.T
    return low + (high - low) * np.stack([A, B, *mixed])


def indices(values: np.ndarray, seed: int) -> Indices:
    """Indices from what the rows of `draws` came to, (2 + keys, n), all finite; intervals by resampling rows."""
    again = np.random.default_rng(seed).integers(values.shape[1], size=(RESAMPLES, values.shape[1]))
    first, total = _estimates(values[:, None])
    resampled = _estimates(values[:, again])
    (first_low, first_high), (total_low, total_high) = (np.quantile(a, ENDS, axis=-1) for a in resampled)
    return Indices(first[:, 0], first_low, first_high, total[:, 0], total_low, total_high)


def _estimates(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and total indices (keys, resamples) from values (2 + keys, resamples, n); 0 where nothing varies."""
    A, B, mixed = values[0], values[1], values[2:]
    both = np.concatenate([A, B], axis=-1)
    middle, variance = both.mean(axis=-1, keepdims=True), both.var(axis=-1)
    variance = np.where(variance > 0, variance, np.inf)
    first = np.mean((B - middle) * (mixed - A), axis=-1) / variance
    return first, np.mean((A - mixed) ** 2, axis=-1) / (2 * variance)
