"""Least squares in the unit cube of some numbers: the best fit from several starts, with its uncertainty.

Residuals are over their noise and come with their slopes; steps are damped Gauss-Newton steps from many points at once,
over a part of the record.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import NumericalError

# points (P, keys) and rows -> (P, n, c), (P, n, c, keys), of which only the first rows are needed; None: all
Predict = Callable[[np.ndarray, int | None], tuple[np.ndarray, np.ndarray]]
FEWEST_NOISE = 1e-9  # least noise of a channel, over the root mean square of its values


class Data(NamedTuple):
    """Measured values and the standard deviations of their noise."""

    values: np.ndarray  # (n, c)
    sigma: np.ndarray  # (n, c)
    sigma_is_known: bool


class Residuals(NamedTuple):
    """Residuals over the noise, of points (leading axis) or of one; the channels of a row follow each other."""

    values: np.ndarray  # (n * c,)
    jacobian: np.ndarray  # (n * c, keys)
    known: np.ndarray  # (n * c,) whether the model says something


class Misfit:
    """The weighted residuals of one problem and their Jacobian, which are computed together.

    Where the model says nothing, the residual is the datum itself, with no slope: a descent goes elsewhere.
    """

    def __init__(self, predict: Predict, data: Data, skip: Callable[[int], None] = lambda _: None):
        """The misfit of a model.

        Args:
            predict: Values and slopes at points.
            data: What was measured.
            skip: Called with a number of evaluations that were counted on and are not needed.
        """
        self.predict = predict
        self.data = data
        self.skip = skip
        self.evaluations = 0
        self._latest: tuple[bytes, Residuals] | None = None

    @property
    def channels(self) -> int:
        """The number of channels."""
        return self.data.values.shape[1]

    @property
    def samples(self) -> int:
        """The number of samples."""
        return len(self.data.values)

    @property
    def size(self) -> int:
        """The number of residuals."""
        return self.data.values.size

    def of_points(self, points: np.ndarray, rows: int | None = None) -> Residuals:
        """The residuals of points, and their Jacobians; only those of the first `rows` mean anything."""
        values, slopes = self.predict(points, rows)
        known = np.isfinite(values) & np.isfinite(slopes).all(axis=-1)
        residuals = np.where(known, values - self.data.values, self.data.values) / self.data.sigma
        slopes = np.where(known[..., None], slopes, 0.0) / self.data.sigma[..., None]
        self.evaluations += len(points)

        def flat(a):
            return a.reshape(len(points), -1, *a.shape[3:])

        return Residuals(flat(residuals), flat(slopes), flat(known))

    def at(self, u: np.ndarray) -> Residuals:
        """Those of one point."""
        if self._latest is None or self._latest[0] != u.tobytes():
            self._latest = u.tobytes(), Residuals(*(a[0] for a in self.of_points(u[None])))
        return self._latest[1]

    def chi2(self, u: np.ndarray) -> float:
        """chi^2 of one point."""
        return float(np.sum(self.at(u).values ** 2))

    def with_sigma(self, sigma: np.ndarray) -> "Misfit":
        """The same with another noise of each channel (channels,)."""
        sigma = np.broadcast_to(sigma, self.data.values.shape)
        changed = self.anew()
        changed.data = self.data._replace(sigma=sigma)
        return changed

    def anew(self) -> "Misfit":
        """The same of a model that has changed."""
        changed = Misfit(self.predict, self.data, self.skip)
        changed.evaluations = self.evaluations
        return changed


FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-7, 1e6  # over the squares of the slopes
EASED, RAISED = 0.2, 5.0  # factors of the damping after a step that succeeds, and after one that fails
LONGEST_STEP = 0.2  # of any number, over its range


class Points(NamedTuple):
    """Points of the unit cube (leading axis), with their residuals, of which the first ones count."""

    u: np.ndarray  # (points, keys)
    residuals: Residuals  # fields with the same leading axis

    @classmethod
    def at(cls, misfit: Misfit, u: np.ndarray, samples: int | None = None) -> "Points":
        """The points of these places, with residuals of so many samples; None: of all."""
        return cls(u, misfit.of_points(u, samples))

    def chi2(self, residuals: int) -> np.ndarray:
        """chi^2 of each point over the first residuals."""
        return np.sum(self.residuals.values[:, :residuals] ** 2, axis=1)

    def take(self, which: Any) -> "Points":
        """Some of the points."""
        return Points(self.u[which], Residuals(*(a[which] for a in self.residuals)))

    def put(self, which: np.ndarray, others: "Points") -> "Points":
        """The points with others in some places."""

        def placed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            changed = a.copy()
            changed[which] = b
            return changed

        pairs = zip(self.residuals, others.residuals, strict=True)
        return Points(placed(self.u, others.u), Residuals(*(placed(a, b) for a, b in pairs)))


def descend_together(
    misfit: Misfit, points: Points, samples: int, steps: int, least_gain: float, free: np.ndarray | None = None
) -> Points:
    """The points after at most so many steps down chi^2 over the first samples of the record.

    Args:
        misfit: Evaluated at all points that still move, as one batch.
        points: Where to begin.
        samples: Those that count.
        steps: At most.
        least_gain: Decrease of chi^2 in a step below which a point rests.
        free: Whether each number of each point may move, (points, keys); None: all.

    Source:
        The method of Levenberg and Marquardt: a step solves (J^T J + damping diag(J^T J)) d = -J^T r. Numbers at a
        bound that chi^2 pushes beyond it rest.
    """
    free = np.ones(points.u.shape, bool) if free is None else free
    rows = samples * misfit.channels
    damping = np.full(len(points.u), FIRST_DAMPING)
    moving = np.ones(len(points.u), bool)
    for _ in range(steps):
        at = np.flatnonzero(moving)
        if not at.size:
            break
        here = points.take(at)
        there = Points.at(misfit, _stepped(here, rows, damping[at], free[at]), samples)
        gain = here.chi2(rows) - there.chi2(rows)
        points = points.put(at[gain > 0], there.take(gain > 0))
        factor = np.where(gain > 0, EASED, RAISED)
        damping[at] = np.maximum(damping[at] * factor, LEAST_DAMPING)
        moving[at] = np.where(gain > 0, gain > least_gain, damping[at] < MOST_DAMPING)
        misfit.skip(len(points.u) - len(at))
    return points


def _stepped(points: Points, rows: int, damping: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The places after one step."""
    residuals, slopes = points.residuals.values[:, :rows], points.residuals.jacobian[:, :rows]
    downhill = -np.einsum("pik,pi->pk", slopes, residuals)
    outward = ((points.u <= 0) & (downhill < 0)) | ((points.u >= 1) & (downhill > 0))
    moves = free & ~outward
    square = np.einsum("pik,pil->pkl", slopes, slopes)
    size = np.einsum("pkk->pk", square)
    floor = 1e-12 * size.max(axis=1, keepdims=True) + np.finfo(float).tiny
    own = damping[:, None] * size + np.where(moves, floor, 1.0)
    both = moves[:, :, None] & moves[:, None, :]
    system = np.where(both, square, 0.0) + own[:, :, None] * np.eye(size.shape[1])
    step = np.linalg.solve(system, np.where(moves, downhill, 0.0)[..., None])[..., 0]
    return np.clip(points.u + np.clip(step, -LONGEST_STEP, LONGEST_STEP), 0.0, 1.0)


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

    def moved_by(self, others: Residuals) -> float:
        """How far other residuals at the fit move a number, at most, over the half width of its interval."""
        change = np.where(others.known, others.values - self.residuals, np.inf)
        shift = self.covariance / self.variance @ (self.jacobian.T @ change)
        return float(np.max(np.abs(shift) / self.half_widths))

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
    there = misfit.at(u)
    return Estimate(
        u=u,
        chi2=chi2,
        freedom=misfit.data.values.size - len(u),
        misfit=misfit,
        residuals=there.values,
        jacobian=there.jacobian,
        known=there.known,
        minima=minima,
        alike=alike,
        searches=searches,
    )


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
