"""Valleys of a fit to a time history, found by a record that is lengthened from its beginning.

Over a whole record with contact chi^2 has many valleys, each narrower than a thousandth of the range. Over its
beginning, which holds few events, it has few and wide ones. Many points therefore descend at once over the beginning;
the best of them stay, the others are drawn anew within what the data have left open, and all descend over a part that
is a third longer.
"""

import numpy as np

from jaxshroud.motion.descents import Points, descend_together
from jaxshroud.motion.misfit import Misfit

PARTS = 8  # of the record, each longer than the one before it by the same factor
SHORTEST_PART = 1 / 12  # of the record
FEWEST_OF_PART = 8  # samples
STEPS, LAST_STEPS = 3, 10  # down chi^2, over a part and over the whole record
LEAST_GAIN_OF_PART = 1e-3  # of chi^2 over that of one residual, below which a point rests
KEPT = 0.25  # share of the points that stay
SPREAD_OF_DRAWS = 2.0  # standard deviations of what the data leave open within which others are drawn
PRIOR = 12.0  # inverse square of a standard deviation: that of a number which is anywhere in its range


def evaluations_of_search(points: int) -> int:
    """The evaluations of the model in one search, those of points at rest included."""
    return points * (PARTS + (PARTS - 1) * STEPS + LAST_STEPS)


def lengthened(misfit: Misfit, u: np.ndarray, rng: np.random.Generator) -> Points:
    """The points (points, keys) after a search, those with the least chi^2 of the whole record first."""
    *parts, whole = parts_of_record(misfit.samples)
    for samples in parts:
        points = _descended(misfit, u, samples, STEPS)
        u = _drawn_anew(points, samples * misfit.channels, rng)
    return _descended(misfit, u, whole, LAST_STEPS)


def _descended(misfit: Misfit, u: np.ndarray, samples: int, steps: int) -> Points:
    """The points after some steps down chi^2 of a part of the record, the best first."""
    rows, points = samples * misfit.channels, Points.at(misfit, u, samples)
    least_gain = LEAST_GAIN_OF_PART * float(np.min(points.chi2(rows))) / rows
    points = descend_together(misfit, points, samples, steps, least_gain)
    return points.take(np.argsort(points.chi2(rows), kind="stable"))


def parts_of_record(samples: int) -> list[int]:
    """The samples in each part of a record of so many, the shortest first and the whole record last."""
    shortest = min(max(FEWEST_OF_PART, round(SHORTEST_PART * samples)), samples)
    return np.unique(np.round(np.geomspace(shortest, samples, PARTS)).astype(int)).tolist()


def _drawn_anew(points: Points, rows: int, rng: np.random.Generator) -> np.ndarray:
    """The best of the points, and in place of the others places near these, within what the data have left open."""
    count, keys = points.u.shape
    best = points.take(slice(0, max(round(KEPT * count), 1)))
    noise = max(best.chi2(rows)[0] / max(rows - keys, 1), np.finfo(float).tiny)
    slopes = best.residuals.jacobian[:, :rows]
    known = np.einsum("pik,pil->pkl", slopes, slopes) / noise + PRIOR * np.eye(keys)
    spread = np.linalg.cholesky(np.linalg.inv(known))
    parents = np.arange(count - len(best.u)) % len(best.u)
    away = np.einsum("pkl,pl->pk", spread[parents], rng.standard_normal((len(parents), keys)))
    return np.concatenate([best.u, _reflected(best.u[parents] + SPREAD_OF_DRAWS * away)])


def _reflected(u: np.ndarray) -> np.ndarray:
    """Places reflected into the unit cube at its faces."""
    within = np.abs(u) % 2.0
    return np.minimum(within, 2.0 - within)
