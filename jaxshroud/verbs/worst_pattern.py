"""The search for the worst pattern of mistuning by gradient ascent, and random search at equal cost.

Patterns are those whose root mean square deviation is at most sigma. A path climbs the amplitude of the blade, at the
value and in the direction, where its row's is largest: the largest of maxima is the maximum of the largest.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.amplification import LargestAmplitude, RowResponses, largest_amplitudes
from jaxshroud.scene.mistuning import random_patterns
from jaxshroud.scene.typed import FloatArray

PATTERN_STEP = 0.5  # of a path, in units of the radius of the ball of patterns
STEP_GAIN, STEP_LOSS = 1.5, 0.3  # of the step after an update that raises the amplitude, and after one that does not


class PatternProblem(NamedTuple):
    """What a search asks of rows; how they are run and how derivatives are found is not its concern."""

    values: FloatArray  # of the number along which the response is taken
    respond: Callable[[FloatArray], RowResponses]  # to patterns (n, N)
    slopes: Callable[[FloatArray, LargestAmplitude], FloatArray]  # of the largest amplitudes, (n, N)
    cost: int  # of the response to one pattern: lane-periods, or solutions of the linear system
    slope_cost: int  # of the derivatives of one pattern

    @property
    def relative_cost(self) -> float:
        """The cost of an update of one path, in responses to one pattern."""
        return 1 + self.slope_cost / self.cost

    def largest(self, patterns: FloatArray) -> LargestAmplitude:
        """The largest amplitude of each pattern; -inf where a lane stopped."""
        found = largest_amplitudes(self.respond(patterns), self.values)
        return found._replace(amplitude=np.where(found.whole, found.amplitude, -np.inf))


class SearchSize(NamedTuple):
    """How long a search is."""

    scan: int  # random patterns that are tried first
    starts: int  # the best of them, from which paths begin
    updates: int  # steps of each path

    def most_patterns(self, relative_cost: float) -> float:
        """The responses that both searches together cost at most, one update costing `relative_cost` of them."""
        return 2 * (self.scan + self.starts * (self.updates + 1) * relative_cost)


class PatternSearch(NamedTuple):
    """The best pattern found by gradient, and what random search finds at the same cost."""

    mistuning: FloatArray  # (N,)
    responses: RowResponses  # of this pattern alone
    cost: FloatArray  # (updates + 1,) spent after the scan, and after each update
    by_gradient: FloatArray  # (updates + 1,) largest amplitude found so far
    by_chance: FloatArray  # (updates + 1,) largest amplitude of as many random patterns as that costs


def within_ball(patterns: FloatArray, sigma: float) -> FloatArray:
    """Patterns (n, N), shortened where their root mean square is above sigma."""
    size = np.sqrt(np.mean(patterns**2, axis=1, keepdims=True))
    return patterns * np.minimum(sigma / np.where(size > 0, size, 1.0), 1.0)


def on_sphere(patterns: FloatArray, sigma: float) -> FloatArray:
    """Patterns (n, N) with a root mean square of sigma."""
    return patterns * sigma / np.sqrt(np.mean(patterns**2, axis=1, keepdims=True))


def search_worst_pattern(
    problem: PatternProblem, blades: int, sigma: float, size: SearchSize, seed: int
) -> PatternSearch:
    """Climb from the best of some random patterns, and draw as many further ones as that has cost.

    Args:
        problem: The rows.
        blades: Their number of blades.
        sigma: The largest root mean square deviation.
        size: How long to search.
        seed: Of the random patterns.
    """
    scanned = on_sphere(random_patterns(size.scan, blades, seed), sigma)
    levels = problem.largest(scanned).amplitude
    best = np.argsort(-levels, kind="stable")[: size.starts]
    patterns, cost, found = _climb(problem, scanned[best], sigma, size)
    top = int(np.nanargmax(found[-1]))
    by_gradient = np.maximum.accumulate(np.max(found, axis=1))
    count = math.ceil(cost[-1] / problem.cost)
    further = on_sphere(random_patterns(count, blades, seed)[size.scan :], sigma)
    if len(further):
        levels = np.concatenate([levels, problem.largest(further).amplitude])
    so_far = np.maximum.accumulate(levels)
    affordable = np.ceil(cost / problem.cost).astype(int)
    chosen = patterns[top]
    return PatternSearch(chosen, problem.respond(chosen[None]), cost, by_gradient, so_far[affordable - 1])


def _climb(
    problem: PatternProblem, patterns: FloatArray, sigma: float, size: SearchSize
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The ends of paths (starts, N), the cost after each update, and the amplitudes of the paths (updates + 1, starts).

    Updates that do not raise the amplitude are undone, and the next step of that path is shorter.
    """
    top = problem.largest(patterns)
    level, slope = top.amplitude, problem.slopes(patterns, top)
    spent = size.scan * problem.cost + len(patterns) * problem.slope_cost
    radius, step = sigma * math.sqrt(patterns.shape[1]), np.full((len(patterns), 1), PATTERN_STEP)
    cost, levels = [spent], [level]
    for _ in range(size.updates):
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        trial = within_ball(patterns + step * radius * slope / np.where(length > 0, length, 1.0), sigma)
        tried = problem.largest(trial)
        better = tried.amplitude > level
        patterns, level = np.where(better[:, None], trial, patterns), np.where(better, tried.amplitude, level)
        step *= np.where(better[:, None], STEP_GAIN, STEP_LOSS)
        spent += len(patterns) * problem.cost
        if better.any():
            taken = LargestAmplitude(*(np.asarray(a)[better] for a in tried))
            slope = slope.copy()
            slope[better] = problem.slopes(patterns[better], taken)
            spent += int(better.sum()) * problem.slope_cost
        cost.append(spent)
        levels.append(level)
    return patterns, np.array(cost, float), np.array(levels)
