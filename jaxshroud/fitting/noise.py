"""What residuals say of the noise, and whether they are noise at all."""

import math

import numpy as np

UNLIKELY = 0.01  # probability of a chi^2 as large, below which the noise contradicts a fit
CONTRAST = 1e-4  # probability with which the halves of white noise differ as much


def is_contradicted(chi2: float, freedom: int) -> bool:
    """Whether noise has such a chi^2, or a larger one, less than once in a hundred times.

    That holds of long records with the noise of neighbours too: it varies with the residuals, and over it chi^2 spreads
    0.97 times as much as over noise that is known, by their covariances. Few rows in many channels are contradicted
    more often, as the mean of a quotient is above the quotient of means: then less is claimed than could be.
    """
    from scipy.stats import chi2 as distribution

    return float(distribution.sf(chi2, freedom)) < UNLIKELY


def noise_of_neighbours(residuals: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The noise of each channel (channels,) by how far residuals depart from the line through both neighbours.

    What the model misses is smooth from sample to sample, and hardly counts: this is the noise of the data even where
    the fit is bad.

    Args:
        residuals: Of the channels, (n, channels), n > 2.
        at: Where they were measured, growing, (n,).
    """
    before, after = np.diff(at)[:-1, None], np.diff(at)[1:, None]
    share = after / (before + after)  # of the sample before
    away = residuals[1:-1] - share * residuals[:-2] - (1 - share) * residuals[2:]
    return np.sqrt(np.mean(away**2 / (1 + share**2 + (1 - share) ** 2), axis=0))


def halves_differ(residuals: np.ndarray) -> bool:
    """Whether the residuals (n, channels) of one half are larger by more than noise is, by the F test."""
    from scipy.stats import f

    first, second = (part.ravel() for part in np.array_split(residuals, 2))
    squares = [float(np.mean(part**2)) for part in (first, second)]
    limit = float(f(first.size, second.size).isf(CONTRAST / 2))
    return min(squares) > 0 and max(squares) / min(squares) > limit


def lag_correlation(residuals: np.ndarray) -> float:
    """The correlation of each residual with the next of its channel, (n, c); 0 of white noise."""
    power = float(np.sum(residuals**2))
    return float(np.sum(residuals[1:] * residuals[:-1])) / power if power > 0 else 0.0


def random_limit(count: int) -> float:
    """The correlation of neighbours that white noise exceeds once in some hundred times."""
    return 2.6 / math.sqrt(count)
