"""How rows with patterns of mistuning respond, and the search for the worst pattern.

Linear rows respond in closed form, others by sweeps. The worst pattern is searched by gradient ascent, beside a random
search at equal cost, among those whose root mean square deviation is at most sigma. A path ascends the amplitude of the
blade, at the value and in the direction, where its row's is largest: the largest of maxima is the maximum of the
largest.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.plan import Progress
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.layout import Direction
from jaxshroud.scene.mistuning import random_patterns
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray
from jaxshroud.scene.vary import vary, with_numbers
from jaxshroud.signals.waves import LargestAmplitude, RowResponses, largest_amplitudes
from jaxshroud.verbs.sweep import sweep

PATTERN_STEP = 0.5  # of a path, in units of the radius of the ball of patterns
STEP_GAIN, STEP_LOSS = 1.5, 0.3  # of the step after an update that raises the amplitude, and after one that does not


class PatternSlopes(NamedTuple):
    """The derivatives of the largest amplitudes of n patterns by the mistuning of each blade."""

    by_mistuning: FloatArray  # (n, N)
    ties: int = 0  # of how many patterns another blade, or another instant, is as large and moves differently


class PatternProblem(NamedTuple):
    """What a search asks of rows; how they are run and how derivatives are found is not its concern."""

    values: FloatArray  # of the number along which the response is taken
    respond: Callable[[FloatArray], RowResponses]  # to patterns (n, N)
    slopes: Callable[[FloatArray, LargestAmplitude], PatternSlopes]  # of the largest amplitudes
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
    ties: int  # slopes that were taken where another blade or instant is as large


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
    """Ascend from the best of some random patterns, and draw as many further ones as that has cost.

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
    patterns, cost, found, ties = _ascend(problem, scanned[best], sigma, size)
    top = int(np.nanargmax(found[-1]))
    by_gradient = np.maximum.accumulate(np.max(found, axis=1))
    count = math.ceil(cost[-1] / problem.cost)
    further = on_sphere(random_patterns(count, blades, seed)[size.scan :], sigma)
    if len(further):
        levels = np.concatenate([levels, problem.largest(further).amplitude])
    so_far = np.maximum.accumulate(levels)
    affordable = np.ceil(cost / problem.cost).astype(int)
    chosen = patterns[top]
    return PatternSearch(
        mistuning=chosen,
        responses=problem.respond(chosen[None]),
        cost=cost,
        by_gradient=by_gradient,
        by_chance=so_far[affordable - 1],
        ties=ties,
    )


def _ascend(
    problem: PatternProblem, patterns: FloatArray, sigma: float, size: SearchSize
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """The ends of paths (starts, N), the cost after each update, the amplitudes (updates + 1, starts), and the ties.

    Updates that do not raise the amplitude are undone, and the next step of that path is shorter.
    """
    top = problem.largest(patterns)
    level = top.amplitude
    slope, ties = problem.slopes(patterns, top)
    spent = size.scan * problem.cost + len(patterns) * problem.slope_cost
    radius = sigma * math.sqrt(patterns.shape[1])
    step = np.full((len(patterns), 1), PATTERN_STEP)
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
            taken = LargestAmplitude._make(np.asarray(a)[better] for a in tried)
            found = problem.slopes(patterns[better], taken)
            slope = slope.copy()
            slope[better] = found.by_mistuning
            ties += found.ties
            spent += int(better.sum()) * problem.slope_cost
        cost.append(spent)
        levels.append(level)
    return patterns, np.array(cost, float), np.array(levels), ties


DIFFERENCE = 1e-4  # of the mistuning of one blade, across which a slope is taken


class MistunedRow(NamedTuple):
    """A row, the number along which it responds, and the amplitude that counts."""

    scene: Scene  # without mistuning, marched whole
    along: str
    values: FloatArray
    of: str
    by_sector: Scene | None = None  # the same, marched by its sector; None where that is not requested


def with_patterns(scene: Scene, patterns: FloatArray) -> Scene:
    """A row with each pattern of mistuning (n, N), as scenes with a leading axis."""
    alike = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a), (len(patterns), *np.shape(a))), scene)
    return vary(jax.tree.map(jnp.asarray, alike), "row.mistuning", patterns)


def swept_responses(
    row: MistunedRow,
    patterns: FloatArray,
    direction: Direction,
    run: Mapping[str, Any],
    *,
    store: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> tuple[RowResponses, str | None]:
    """The response of rows with contact to patterns (n, N), by a sweep of all patterns, and what it shows of chatter.

    Args:
        row: The row.
        patterns: The patterns.
        direction: Whether lanes are independent, or each starts from where its neighbour in value ended.
        run: The arguments of `sweep` that say how to run.
        store: The folder of a store.
        resume: Continue the store.
        progress: Called with lane-periods.
    """
    swept = sweep(
        with_patterns(row.scene, patterns),
        {row.along: row.values},
        direction=direction,
        amplitudes=True,
        keep_samples=store is None and direction != "independent",
        store=store,
        resume=resume,
        progress=progress,
        dims=("pattern",),
        **run,
    )

    def directed(a):
        a = np.asarray(a)
        return np.moveaxis(a, 0, 1) if direction == "both" else a[:, None]

    responses = RowResponses(
        amplitude=directed(np.asarray(getattr(swept, row.of), float)),
        status=directed(swept.status),
        settled=directed(swept.settled),
        to_keep=directed(np.where(swept.unjudged, swept.periods_to_keep, 0.0)),
    )
    return responses, swept.chatter


def tuned_and_mistuned_responses(
    row: MistunedRow,
    patterns: FloatArray,
    direction: Direction,
    run: Mapping[str, Any],
    *,
    store: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> tuple[RowResponses, str | None]:
    """`swept_responses` to patterns (n, N) whose first is none: by the sector where that of the tuned row is requested.

    The sector has a store of its own beside that of the patterns.
    """
    if row.by_sector is None:
        return swept_responses(row, patterns, direction, run, store=store, resume=resume, progress=progress)
    done = 0

    def tick(lane_periods: int | float, _: int) -> None:
        if progress is not None:
            progress(done + lane_periods, done)

    how = {"direction": direction, "run": run, "resume": resume, "progress": tick}
    mistuned, chatter = swept_responses(row, patterns[1:], store=store, **how)
    done = (run["n_periods"] + run["transient"]) * mistuned.status.size
    beside = None if store is None else tuned_store(store)
    tuned, other = swept_responses(row._replace(scene=row.by_sector), patterns[:1], store=beside, **how)
    return jax.tree.map(lambda *a: np.concatenate(a), tuned, mistuned), other or chatter


def tuned_store(store: Path) -> Path:
    """The store of the tuned row by its sector, beside that of the patterns."""
    return store.with_name(f"{store.stem}_tuned{store.suffix}")


def marched_problem(
    row: MistunedRow, run: Mapping[str, Any], progress: Progress | None, spent: int, in_all: int
) -> PatternProblem:
    """A row with contact, from rest at each value. Costs are lane-periods; slopes are differences.

    Args:
        row: The row.
        run: The arguments of `sweep` that say how to run.
        progress: Called with (lane-periods done, lane-periods in all).
        spent: Lane-periods done before.
        in_all: Lane-periods in all.
    """
    periods = run["n_periods"] + run["transient"]
    done = [spent]

    def tick(lane_periods: int | float, _: int) -> None:
        if progress is not None:
            progress(min(done[0] + lane_periods, in_all), in_all)

    def respond(patterns: FloatArray) -> RowResponses:
        responses, _ = swept_responses(row, patterns, "independent", run, progress=tick)
        done[0] += periods * len(patterns) * len(row.values)
        return responses

    def slopes(patterns: FloatArray, top: LargestAmplitude) -> PatternSlopes:
        n, blades = patterns.shape
        apart = DIFFERENCE * np.eye(blades)
        shifted = (patterns[:, None] + apart).reshape(-1, blades)
        at = scenes_at(with_numbers(row.scene, [row.along]), [row.along], np.repeat(top.value, blades)[:, None])
        swept = sweep(vary(at, "row.mistuning", shifted), amplitudes=True, keep_samples=False, progress=tick, **run)
        done[0] += periods * len(shifted)
        level = np.asarray(getattr(swept, row.of), float).reshape(n, blades, blades)
        rise = level[np.arange(n), :, top.blade] - top.amplitude[:, None]
        return PatternSlopes(np.where(np.isfinite(rise), rise / DIFFERENCE, 0.0))

    blades = row.scene.layout.blades
    return PatternProblem(row.values, respond, slopes, periods * len(row.values), periods * blades)
