"""Least squares in the unit cube of some numbers: the best fit from several starts, with its uncertainty."""

import math
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.descents import Points
from jaxshroud.motion.misfit import FEWEST_NOISE, Misfit
from jaxshroud.scene.checks import NumericalError

MOST_EVALUATIONS = 60  # from one start
TOLERANCE = 1e-9  # of the cost, of the step and of the slope at which a descent ends
SAME_NOISE = 0.01  # relative change of the noise at which weights are settled
MOST_REWEIGHTINGS = 5
LEVEL = 0.95


class Minimum(NamedTuple):
    """Where a descent ended."""

    u: np.ndarray  # (keys,) in the unit cube
    chi2: float


def descend(misfit: Misfit, start: np.ndarray) -> Minimum:
    """The minimum of chi^2 from a start, within the cube."""
    from scipy.optimize import least_squares

    found = least_squares(
        lambda u: misfit.at(u).values,
        start,
        lambda u: misfit.at(u).jacobian,  # pyright: ignore[reportArgumentType]
        bounds=(0.0, 1.0),
        **dict.fromkeys(("ftol", "xtol", "gtol"), TOLERANCE),
        max_nfev=MOST_EVALUATIONS,
    )
    return Minimum(found.x, 2 * float(found.cost))


class Estimate(NamedTuple):
    """The best fit with its uncertainty, in the unit cube."""

    u: np.ndarray  # (keys,)
    chi2: float
    freedom: int
    misfit: Misfit
    residuals: np.ndarray  # (n * c,) over the noise
    jacobian: np.ndarray  # (n * c, keys)
    known: np.ndarray  # (n * c,) whether the fitted model says something
    minima: list[Minimum]  # of all starts, that of the fit first
    alike: int = 1  # how many searches have found the fit
    searches: int = 1

    @property
    def variance(self) -> float:
        """The square of residuals over their noise as it is taken in intervals: 1 where the noise is known."""
        return 1.0 if self.misfit.data.sigma_is_known else max(self.chi2 / self.freedom, np.finfo(float).tiny)

    @property
    def covariance(self) -> np.ndarray:
        """The covariance of the fit made linear; huge along directions of which the data say nothing."""
        _, size, rows = np.linalg.svd(self.jacobian, full_matrices=False)
        size = np.maximum(size, max(1e-12 * size[0], 1e-100))
        return self.variance * (rows.T / size**2) @ rows

    @property
    def correlation(self) -> np.ndarray:
        """The correlation of the numbers."""
        covariance = self.covariance
        scale = np.sqrt(np.diag(covariance))
        return covariance / np.outer(scale, scale)

    @property
    def quantile(self) -> float:
        """The half width of a 95 % interval in standard deviations: of Student's t where the noise is estimated."""
        from scipy.stats import norm, t

        known = self.misfit.data.sigma_is_known
        return float((norm if known else t(self.freedom)).ppf((1 + LEVEL) / 2))

    @property
    def limit(self) -> float:
        """The rise of chi^2 at the ends of a 95 % interval."""
        return self.quantile**2 * self.variance

    @property
    def half_widths(self) -> np.ndarray:
        """Those of the intervals of the fit made linear (keys,)."""
        return self.quantile * np.sqrt(np.diag(self.covariance))

    @property
    def influence(self) -> np.ndarray:
        """How much each number changes the data across its range, over their noise (keys,)."""
        return np.linalg.norm(self.jacobian, axis=0) / math.sqrt(self.variance)


def estimate(misfit: Misfit, points: np.ndarray, n_starts: int) -> Estimate:
    """The best fit from the best of some points (points, keys); the noise is estimated where it is not known.

    Raises:
        NumericalError: The model says nothing of the data at any of the points.
    """
    first = Points.at(misfit, points)
    check_says_something(first)
    best_first = np.argsort(first.chi2(misfit.data.values.size), kind="stable")[:n_starts]
    minima = sorted((descend(misfit, points[i]) for i in best_first), key=lambda found: found.chi2)
    best = minima[0]
    if not misfit.data.sigma_is_known:
        misfit, best = _reweighted(misfit, best)
        minima = [best, *(m._replace(chi2=misfit.chi2(m.u)) for m in minima[1:])]
    return estimate_at(misfit, minima)


def check_says_something(points: Points) -> None:
    """Raise NumericalError if the model says nothing of the data at any point."""
    if not points.residuals.known.any():
        raise NumericalError("The model says nothing of the data at any start: its runs stop, or find no orbit.")


def estimate_at(misfit: Misfit, minima: list[Minimum], alike: int = 1, searches: int = 1) -> Estimate:
    """The estimate at the first of some minima."""
    u, chi2 = minima[0]
    return Estimate(u, chi2, misfit.data.values.size - len(u), misfit, *misfit.at(u), minima, alike, searches)


def _reweighted(misfit: Misfit, best: Minimum) -> tuple[Misfit, Minimum]:
    """The fit in which each channel has the noise that its own residuals show."""
    data = misfit.data
    spared = data.values.size / (data.values.size - len(best.u))
    least = FEWEST_NOISE * np.sqrt(np.mean(data.values**2, axis=0))
    for _ in range(MOST_REWEIGHTINGS):
        residuals = misfit.at(best.u).values.reshape(data.values.shape) * misfit.data.sigma
        noise = np.maximum(np.sqrt(spared * np.mean(residuals**2, axis=0)), least)
        change = np.max(np.abs(noise / misfit.data.sigma[0] - 1))
        misfit = misfit.with_sigma(noise)
        if change > SAME_NOISE and data.values.shape[1] > 1:
            best = descend(misfit, best.u)
        else:
            break
    return misfit, Minimum(best.u, misfit.chi2(best.u))
