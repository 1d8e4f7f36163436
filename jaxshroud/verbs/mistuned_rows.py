"""How rows with patterns of mistuning respond: linear ones in closed form, others by sweeps."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.plan import Progress
from jaxshroud.batch.threads import in_chunks
from jaxshroud.model.modes import Status
from jaxshroud.model.natural_modes import NaturalContact
from jaxshroud.motion.amplification import LargestAmplitude, RowResponses, peak_between
from jaxshroud.motion.linear_response import LinearSystem, linear_amplitudes, linear_slopes, linear_systems
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.grids import grid_of_scenes, scenes_at
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray
from jaxshroud.scene.vary import vary, with_numbers
from jaxshroud.verbs.sweep import sweep
from jaxshroud.verbs.worst_pattern import PatternProblem

PEAK_ROUNDS, PEAK_ZOOM = 3, 8.0  # looks at the peak of a linear row between values, each so many times closer
DIFFERENCE = 1e-4  # of the mistuning of one blade, across which a slope is taken


class MistunedRow(NamedTuple):
    """A row, the number along which it responds, and the amplitude that counts."""

    scene: Scene  # without mistuning
    along: str
    values: FloatArray
    of: str

    @property
    def coordinate(self) -> int:
        """The place of its displacement in `DISPLACEMENTS`."""
        return DISPLACEMENTS.index(self.of.split("_")[0])

    @property
    def share(self) -> float:
        """What the amplitude of a sine counts as."""
        return 1.0 if self.of.endswith("_peak") else math.sqrt(0.5)


def linear_problem(row: MistunedRow, contact: NaturalContact) -> PatternProblem:
    """A linear row: every interface stays in one state of contact. Costs are solutions of the linear system."""
    numbered, everywhere = (
        with_numbers(row.scene, [row.along]),
        _systems(grid_of_scenes(row.scene, {row.along: row.values}), contact, row.coordinate),
    )
    at = lambda values: _systems(scenes_at(numbered, [row.along], values[:, None]), contact, row.coordinate)

    def respond(patterns: FloatArray) -> RowResponses:
        amplitude = np.stack([linear_amplitudes(everywhere, pattern) for pattern in patterns])
        value = _peak_values(row.values, amplitude, lambda values: _at_each(at, values, patterns))
        peak = linear_amplitudes(at(value), patterns)
        lanes = (len(patterns), 1, len(row.values))
        ended, settled = np.full(lanes, Status.OK, np.int32), np.ones(lanes, bool)
        return RowResponses(row.share * amplitude[:, None], ended, settled, value, row.share * peak)

    def slopes(patterns: FloatArray, top: LargestAmplitude) -> FloatArray:
        lanes = at(top.value), patterns, top.blade.astype(np.int32)
        return row.share * _chunked(linear_slopes, lanes)

    return PatternProblem(row.values, respond, slopes, len(row.values) + 3 * PEAK_ROUNDS + 1, 2)


def _systems(scenes: Scene, contact: NaturalContact, coordinate: int) -> LinearSystem:
    """The linear systems of scenes (leading axis)."""
    return _chunked(lambda some: linear_systems(some, contact, coordinate), (without_given(scenes),))


def _chunked(f: Callable[..., Any], trees: tuple[Any, ...]) -> Any:
    """`f` of trees of arrays (leading axis) by whole chunks: one program for any number of lanes."""
    some = lambda lanes: jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[lanes]), trees)
    chunk = lambda _, lanes: jax.tree.map(np.asarray, f(*some(lanes)))
    return in_chunks(chunk, len(jax.tree.leaves(trees)[0]), LANES_PER_CALL)


def _at_each(at: Callable[[FloatArray], LinearSystem], values: FloatArray, patterns: FloatArray) -> FloatArray:
    """The amplitudes (n, m, N) of n patterns at m values of their own, (n, m)."""
    every = np.repeat(patterns, values.shape[1], axis=0)
    return linear_amplitudes(at(values.ravel()), every).reshape(*values.shape, -1)


def _peak_values(values: FloatArray, amplitude: FloatArray, at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Where, about the largest amplitude (n, values, N) of each pattern, its peak lies; within the range of values.

    `at` gives the amplitudes (n, m, N) at m values for each pattern.
    """
    rows, order = np.arange(len(amplitude)), np.sort(values)
    index, blade = np.unravel_index(amplitude.reshape(len(amplitude), -1).argmax(axis=1), amplitude.shape[1:])
    centre, apart = values[index], np.max(np.diff(order), initial=0.0) / 2
    for _ in range(PEAK_ROUNDS):
        three = np.clip(np.stack([centre - apart, centre, centre + apart], axis=1), order[0], order[-1])
        centre, apart = peak_between(three, at(three)[rows, :, blade]), apart / PEAK_ZOOM
    return centre


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
) -> tuple[RowResponses, SweepResult]:
    """The response of rows with contact to patterns (n, N), by a sweep of all patterns, and that sweep.

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
    directed = (lambda a: np.moveaxis(a, 0, 1)) if direction == "both" else (lambda a: a[:, None])
    amplitude = np.asarray(getattr(swept, row.of), float)
    responses = RowResponses(*(directed(np.asarray(a)) for a in (amplitude, swept.status, swept.settled)))
    return responses, swept


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
    periods, done = run["n_periods"] + run["transient"], [spent]

    def tick(lane_periods: int | float, _: int) -> None:
        if progress is not None:
            progress(min(done[0] + lane_periods, in_all), in_all)

    def respond(patterns: FloatArray) -> RowResponses:
        responses, _ = swept_responses(row, patterns, "independent", run, progress=tick)
        done[0] += periods * len(patterns) * len(row.values)
        return responses

    def slopes(patterns: FloatArray, top: LargestAmplitude) -> FloatArray:
        n, blades = patterns.shape
        apart = DIFFERENCE * np.eye(blades)
        shifted = (patterns[:, None] + apart).reshape(-1, blades)
        at = scenes_at(with_numbers(row.scene, [row.along]), [row.along], np.repeat(top.value, blades)[:, None])
        swept = sweep(vary(at, "row.mistuning", shifted), amplitudes=True, keep_samples=False, progress=tick, **run)
        done[0] += periods * len(shifted)
        level = np.asarray(getattr(swept, row.of), float).reshape(n, blades, blades)
        rise = level[np.arange(n), :, top.blade] - top.amplitude[:, None]
        return np.where(np.isfinite(rise), rise / DIFFERENCE, 0.0)

    blades = row.scene.blades.m.shape[-1]
    return PatternProblem(row.values, respond, slopes, periods * len(row.values), periods * blades)
