"""The best fit to a time history: independent searches along the record, until two end alike, as noise allows.

Valleys of a fit to a time history, found by a record that is lengthened from its beginning.

Over a whole record with contact chi^2 has many valleys, each narrower than a thousandth of the range. Over its
beginning, which holds few events, it has few and wide ones. Many points therefore descend at once over the beginning;
the best of them stay, the others are drawn anew within what the data have left open, and all descend over a part that
is a third longer.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from jaxshroud.fitting.least_squares import (
    FEWEST_NOISE,
    Estimate,
    Minimum,
    Misfit,
    Points,
    check_says_something,
    descend_together,
    estimate_at,
)
from jaxshroud.fitting.noise import is_contradicted, noise_of_neighbours

PARTS = 8  # of the record, each longer than the one before it by the same factor
SHORTEST_PART = 1 / 12  # of the record
FEWEST_OF_PART = 8  # samples
STEPS, LAST_STEPS = 3, 10  # down chi^2, over a part and over the whole record
LEAST_GAIN_OF_PART = 1e-3  # of chi^2 over that of one residual, below which a point rests
KEPT = 0.25  # share of the points that stay
SPREAD_OF_DRAWS = 2.0  # standard deviations of what the data leave open within which others are drawn
PRIOR = 12.0  # inverse square of a standard deviation: that of a number which is anywhere in its range


def evaluations_of_search(points: int) -> int:
    """The evaluations of the model in one search at most, those of points at rest included."""
    return points * (PARTS * (1 + STEPS) + LAST_STEPS - STEPS)


def lengthened(misfit: Misfit, u: np.ndarray, rng: np.random.Generator) -> Points:
    """The points (points, keys) after a search, those with the least chi^2 of the whole record first."""
    parts = parts_of_record(misfit.samples)
    count = len(u)
    for samples, longer in pairwise(parts):
        points = _descended(misfit, u, samples, STEPS)
        u = _drawn_anew(points, samples * misfit.channels, math.ceil(count * math.sqrt(parts[0] / longer)), rng)
    return _descended(misfit, u, parts[-1], LAST_STEPS)


def _descended(misfit: Misfit, u: np.ndarray, samples: int, steps: int) -> Points:
    """The points after some steps down chi^2 of a part of the record, the best first."""
    rows = samples * misfit.channels
    points = Points.at(misfit, u, samples)
    least_gain = LEAST_GAIN_OF_PART * float(np.min(points.chi2(rows))) / rows
    points = descend_together(misfit, points, samples, steps, least_gain)
    return points.take(np.argsort(points.chi2(rows), kind="stable"))


def parts_of_record(samples: int) -> list[int]:
    """The samples in each part of a record of so many, the shortest first and the whole record last."""
    shortest = min(max(FEWEST_OF_PART, round(SHORTEST_PART * samples)), samples)
    return np.unique(np.round(np.geomspace(shortest, samples, PARTS)).astype(int)).tolist()


def _drawn_anew(points: Points, rows: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """So many points: the best valleys, and others drawn near these, within what the data leave open.

    Of many points in one valley one is kept: else the widest valley of a part crowds out all others, among them that
    which a longer part shows to be the right one.
    """
    keys = points.u.shape[1]
    best = _distinct(points, rows).take(slice(0, max(round(KEPT * count), 1)))
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


MOST_SEARCHES = 4
MOST_STEPS = 30  # down chi^2 from the ends of searches
LEAST_GAIN_AT_MINIMA = 1e-6  # of chi^2 over that of one degree of freedom, at which these end
APART_PLACES = 0.02  # of a number over its range, from which places differ
ALIKE_PREDICTIONS = 0.1  # square of their distance, over the noise of one datum, below which they are one


def estimate_of_history(
    misfit: Misfit,
    at: np.ndarray,
    draws: Sequence[np.ndarray],
    candidates: int,
    rng: np.random.Generator,
    may_err: Callable[[Estimate], bool] = lambda _: False,
) -> Estimate:
    """The best fit to a time history, with every other minimum at which a search ended.

    Searches end once two of them have found it, unless the noise contradicts it.

    Args:
        misfit: Of the whole record.
        at: The times of its samples.
        draws: The points (points, keys) in which each search begins.
        candidates: The distinct ends of a search that are followed to their minima, at most.
        rng: Of the searches.
        may_err: Whether the error of the model's march may be why the noise contradicts a fit; no search helps there.

    Raises:
        NumericalError: The model says nothing of the data at any of the points.
    """
    ends = []
    best = []
    alike = 0
    for points in draws:
        found = lengthened(misfit, points, rng)
        check_says_something(found)
        found = _distinct(found).take(slice(0, candidates))
        misfit = _with_noise(misfit, found, at)
        found = _at_minima(misfit, found.u)
        ends.append(found.u)
        best.append(found.u[0])
        reached = Points.at(misfit, np.array(best))
        alike = _count_alike(reached)
        if alike > 1 and not _must_go_on(misfit, reached, may_err):
            break
    misfit = _with_noise(misfit, _at_minima(misfit, np.concatenate(ends)), at)
    return estimate_at(misfit, _minima(misfit, np.concatenate(ends)), alike, len(best))


def _must_go_on(misfit: Misfit, reached: Points, may_err: Callable[[Estimate], bool]) -> bool:
    """Whether the noise contradicts the best of these points, and the march is not to blame for it."""
    chi2 = reached.chi2(misfit.size)
    best = int(np.argmin(chi2))
    found = estimate_at(misfit, [Minimum(reached.u[best], float(chi2[best]))])
    return is_contradicted(found.chi2, found.freedom) and not may_err(found)


def remarched(found: Estimate, at: np.ndarray) -> Estimate:
    """The estimate of a record whose model has changed to a finer march, from the minima that are known."""
    u = np.array([minimum.u for minimum in found.minima])
    misfit = _with_noise(found.misfit.anew(), _at_minima(found.misfit.anew(), u), at)
    return estimate_at(misfit, _minima(misfit, u), found.alike, found.searches)


def descended(misfit: Misfit, found: Estimate, u: np.ndarray) -> Estimate:
    """The estimate from a place with less chi^2 than that of the fit."""
    minima = _minima(misfit, np.array([u, *(minimum.u for minimum in found.minima)]))
    is_same = _count_alike(Points.at(misfit, np.array([minima[0].u, found.u]))) > 1
    return estimate_at(misfit, minima, found.alike if is_same else 1, found.searches + (not is_same))


def _minima(misfit: Misfit, u: np.ndarray) -> list[Minimum]:
    """These minima with their chi^2."""
    found = _at_minima(misfit, u)
    return [Minimum(place, float(chi2)) for place, chi2 in zip(found.u, found.chi2(misfit.size), strict=True)]


def _with_noise(misfit: Misfit, ends: Points, at: np.ndarray) -> Misfit:
    """The misfit with the noise of each channel by the residuals of the best point, where the noise is not known.

    It is that of neighbours, of few samples the root mean square.
    """
    data = misfit.data
    if data.sigma_is_known:
        return misfit
    left = ends.residuals.values[0].reshape(data.values.shape) * data.sigma
    noise = noise_of_neighbours(left, at) if len(at) > 2 else np.sqrt(np.mean(left**2, axis=0))
    return misfit.with_sigma(np.maximum(noise, FEWEST_NOISE * np.sqrt(np.mean(data.values**2, axis=0))))


def _at_minima(misfit: Misfit, u: np.ndarray) -> Points:
    """The distinct points at the minima below some places, the least first."""
    points = Points.at(misfit, u)
    gain = LEAST_GAIN_AT_MINIMA * np.min(points.chi2(misfit.size)) / misfit.size
    points = descend_together(misfit, points, misfit.samples, MOST_STEPS, gain)
    return _distinct(points.take(np.argsort(points.chi2(misfit.size), kind="stable")))


def _distinct(points: Points, rows: int | None = None) -> Points:
    """The points that differ in place or in what they predict of the first residuals, the first of each kind."""
    kept: list[int] = []
    for i in range(len(points.u)):
        near = [j for j in kept if np.max(np.abs(points.u[i] - points.u[j])) < APART_PLACES]
        if not any(_are_alike(points, j, i, rows) for j in near):
            kept.append(i)
    return points.take(kept)


def _count_alike(points: Points) -> int:
    """How many of the points predict what the best of them does."""
    best = int(np.argmin(np.sum(points.residuals.values**2, axis=1)))
    return sum(_are_alike(points, best, i) for i in range(len(points.u)))


def _are_alike(points: Points, i: int, j: int, rows: int | None = None) -> bool:
    """Whether two points predict the same except for a small part of the noise."""
    one, other = points.residuals.values[i, :rows], points.residuals.values[j, :rows]
    return float(np.sum((one - other) ** 2)) <= ALIKE_PREDICTIONS * float(np.mean(one**2))
