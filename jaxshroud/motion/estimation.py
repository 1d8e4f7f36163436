"""Least squares in the unit cube of some numbers: the best fit from several starts, intervals, and what is unknown."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.scene.checks import NumericalError

Predict = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # points (P, keys) -> (P, n, c), (P, n, c, keys)
MOST_EVALUATIONS = 60  # from one start
TOLERANCE = 1e-9  # of the cost, of the step and of the slope at which a descent ends
FEWEST_NOISE = 1e-9  # least noise of a channel, over the root mean square of its values
SAME_NOISE = 0.01  # relative change of the noise at which weights are settled
MOST_REWEIGHTINGS = 5
WIDE_INTERVAL = 0.1  # half width of an interval, over the range of its number, from which it is found by profile
CONFOUNDED = 0.99  # correlation from which two numbers cannot be told from one another
NO_INFLUENCE = 1.0  # change of all data over their noise that a number makes across its range
NONLINEAR = 0.3  # relative departure from the linear model at the ends of intervals from which profiles are taken
PROFILE_TOLERANCE = 1e-3  # of the ends of profiles, over the range
APART_MINIMA = 0.02  # distance of two minima over the range
WIDEST_STEP = 0.25  # of the search for the end of a profile, over the range
LEVEL = 0.95


class Data(NamedTuple):
    """Measured values and the standard deviations of their noise."""

    values: np.ndarray  # (n, c)
    sigma: np.ndarray  # (n, c)
    sigma_is_known: bool


class Residuals(NamedTuple):
    """Residuals over the noise, of points (leading axis) or of one."""

    values: np.ndarray  # (n * c,)
    jacobian: np.ndarray  # (n * c, keys)
    known: np.ndarray  # (n * c,) whether the model says something


class Misfit:
    """The weighted residuals of one problem and their Jacobian, which are computed together.

    Where the model says nothing, the residual is the datum itself, with no slope: a descent goes elsewhere.
    """

    def __init__(self, predict: Predict, data: Data):
        self.predict, self.data, self.evaluations = predict, data, 0
        self._latest: tuple[bytes, Residuals] | None = None

    def of_points(self, points: np.ndarray) -> "Residuals":
        """The residuals of points, and their Jacobians."""
        values, slopes = self.predict(points)
        known = np.isfinite(values) & np.isfinite(slopes).all(axis=-1)
        residuals = np.where(known, values - self.data.values, self.data.values) / self.data.sigma
        slopes = np.where(known[..., None], slopes, 0.0) / self.data.sigma[..., None]
        self.evaluations += len(points)
        rows = lambda a: a.reshape(len(points), -1, *a.shape[3:])
        return Residuals(rows(residuals), rows(slopes), rows(known))

    def at(self, u: np.ndarray) -> "Residuals":
        """Those of one point."""
        if self._latest is None or self._latest[0] != u.tobytes():
            self._latest = u.tobytes(), Residuals(*(a[0] for a in self.of_points(u[None])))
        return self._latest[1]

    def with_sigma(self, sigma: np.ndarray) -> "Misfit":
        """The same with another noise."""
        changed = Misfit(self.predict, self.data._replace(sigma=sigma))
        changed.evaluations = self.evaluations
        return changed


class Minimum(NamedTuple):
    """Where a descent ended."""

    u: np.ndarray  # (keys,) in the unit cube
    chi2: float


def descend(misfit: Misfit, start: np.ndarray, free: Sequence[int], tolerance: float = TOLERANCE) -> Minimum:
    """The minimum of chi^2 from a start, in the `free` numbers, within the cube."""
    from scipy.optimize import least_squares

    free = list(free)
    if not free:
        return Minimum(start, float(np.sum(misfit.at(start).values ** 2)))

    def whole(part: np.ndarray) -> np.ndarray:
        u = np.array(start)
        u[free] = part
        return u

    found = least_squares(
        lambda part: misfit.at(whole(part)).values,
        start[free],
        lambda part: misfit.at(whole(part)).jacobian[:, free],  # pyright: ignore[reportArgumentType]
        bounds=(0.0, 1.0),
        **dict.fromkeys(("ftol", "xtol", "gtol"), tolerance),
        max_nfev=MOST_EVALUATIONS,
    )
    return Minimum(whole(found.x), 2 * float(found.cost))


class NumberInterval(NamedTuple):
    """The 95 % interval of one number, in the unit cube."""

    low: float
    high: float
    by: str  # "jacobian" or "profile"
    open: tuple[bool, bool] = (False, False)  # whether the data leave an end at the bound


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

    @property
    def covariance(self) -> np.ndarray:
        """The covariance of the fit made linear; huge along directions of which the data say nothing."""
        _, size, rows = np.linalg.svd(self.jacobian, full_matrices=False)
        size = np.maximum(size, max(1e-12 * size[0], 1e-100))
        return (rows.T / size**2) @ rows

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
    def influence(self) -> np.ndarray:
        """How much each number changes the data across its range, over their noise (keys,)."""
        return np.linalg.norm(self.jacobian, axis=0)


def estimate(predict: Predict, data: Data, points: np.ndarray, n_starts: int) -> Estimate:
    """The best fit from the best of some points (points, keys); the noise is estimated where it is not known.

    Raises:
        NumericalError: The model says nothing of the data at any of the points.
    """
    misfit = Misfit(predict, data)
    first = misfit.of_points(points)
    if not first.known.any():
        raise NumericalError("The model says nothing of the data at any start: its runs stop, or find no orbit.")
    best_first = np.argsort(np.sum(first.values**2, axis=1), kind="stable")[:n_starts]
    every = range(points.shape[1])
    minima = sorted((descend(misfit, points[i], every) for i in best_first), key=lambda found: found.chi2)
    best = minima[0]
    if not data.sigma_is_known:
        misfit, best = _reweighted(misfit, best)
        minima = [best, *(m._replace(chi2=float(np.sum(misfit.at(m.u).values ** 2))) for m in minima[1:])]
    freedom = data.values.size - len(every)
    return Estimate(best.u, best.chi2, freedom, misfit, *misfit.at(best.u), minima)


def _reweighted(misfit: Misfit, best: Minimum) -> tuple[Misfit, Minimum]:
    """The fit in which each channel has the noise that its own residuals show."""
    every, data = range(len(best.u)), misfit.data
    spared = data.values.size / (data.values.size - len(best.u))
    least = FEWEST_NOISE * np.sqrt(np.mean(data.values**2, axis=0))
    for _ in range(MOST_REWEIGHTINGS):
        residuals = misfit.at(best.u).values.reshape(data.values.shape) * misfit.data.sigma
        noise = np.maximum(np.sqrt(spared * np.mean(residuals**2, axis=0)), least)
        change = np.max(np.abs(noise / misfit.data.sigma[0] - 1))
        misfit = misfit.with_sigma(np.broadcast_to(noise, data.values.shape))
        if change > SAME_NOISE and data.values.shape[1] > 1:
            best = descend(misfit, best.u, every)
        else:
            break
    return misfit, Minimum(best.u, float(np.sum(misfit.at(best.u).values ** 2)))


def linear_departure(found: Estimate) -> float:
    """The largest relative departure of residuals from the linear model at the ends of the region's principal axes."""
    values, axes = np.linalg.eigh(found.covariance)
    steps = found.quantile * np.sqrt(np.maximum(values, 0))[:, None] * axes.T
    steps = np.stack([steps, -steps], axis=1).reshape(-1, len(values))
    points = np.clip(found.u + steps, 0, 1)
    moved = found.misfit.of_points(points).values - found.residuals
    linear = (points - found.u) @ found.jacobian.T
    size = np.maximum(np.linalg.norm(linear, axis=1), found.quantile * 1e-3)
    return float(np.max(np.linalg.norm(moved - linear, axis=1) / size))


def intervals(found: Estimate, departure: float) -> list[NumberInterval]:
    """The 95 % intervals: of the linear model, or by profile where that is wide, confounded or has a `departure`."""
    half = found.quantile * np.sqrt(np.diag(found.covariance))
    others = np.abs(found.correlation - np.eye(len(half)))
    at_bound = (found.u <= PROFILE_TOLERANCE) | (found.u >= 1 - PROFILE_TOLERANCE)
    profiled = (departure > NONLINEAR) | (half > WIDE_INTERVAL) | (others.max(axis=1) > CONFOUNDED) | at_bound
    return [
        _profile(found, i, float(half[i]))
        if profiled[i]
        else NumberInterval(float(found.u[i] - half[i]), float(found.u[i] + half[i]), "jacobian")
        for i in range(len(half))
    ]


def _profile(found: Estimate, i: int, half: float) -> NumberInterval:
    """The values of a number for which chi^2, the others fitted anew, stays below that of 95 %."""
    (low, low_open), (high, high_open) = (_profile_end(found, i, side * min(half, WIDEST_STEP)) for side in (-1, 1))
    return NumberInterval(low, high, "profile", (low_open, high_open))


def _profile_end(found: Estimate, i: int, step: float) -> tuple[float, bool]:
    """One end of a profile, and whether it is the bound of the number; `step` is the first that is tried."""
    from scipy.optimize import brentq

    excess, inside = _ProfileExcess(found, i), float(found.u[i])
    tolerance = min(PROFILE_TOLERANCE, abs(step) / 50)
    while True:
        outside = min(max(inside + step, 0.0), 1.0)
        if excess(outside) > 0:
            return brentq(excess, *sorted((inside, outside)), xtol=tolerance), False  # type: ignore[return-value]
        if outside in (0.0, 1.0):
            return outside, True
        inside, step = outside, 2 * step


class _ProfileExcess:
    """How far chi^2 with one number held, the others fitted anew, is above the limit of 95 %."""

    def __init__(self, found: Estimate, i: int):
        self.found, self.i, self.best = found, i, {float(found.u[i]): Minimum(found.u, found.chi2)}
        # A thousandth of the limit is enough of chi^2.
        self.tolerance = float(np.clip(1e-3 * found.quantile**2 / max(found.chi2, 1.0), TOLERANCE, 1e-4))

    def __call__(self, value: float) -> float:
        if value not in self.best:
            others = [j for j in range(len(self.found.u)) if j != self.i]
            start = np.array(self.best[min(self.best, key=lambda known: abs(known - value))].u)
            start[self.i] = value
            self.best[value] = descend(self.found.misfit, start, others, self.tolerance)
        return self.best[value].chi2 - self.found.chi2 - self.found.quantile**2


def lag_correlation(residuals: np.ndarray) -> float:
    """The correlation of each residual with the next of its channel, (n, c); 0 of white noise."""
    power = float(np.sum(residuals**2))
    return float(np.sum(residuals[1:] * residuals[:-1])) / power if power > 0 else 0.0


def random_limit(count: int) -> float:
    """The correlation of neighbours that white noise exceeds once in some hundred times."""
    return 2.6 / math.sqrt(count)
