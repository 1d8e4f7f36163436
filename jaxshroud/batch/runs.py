"""Many lanes over many periods, in chunks on one thread per core."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.closed_form import free_runs
from jaxshroud.batch.march_programs import PAIR_MARCHES, RunLog, march_programs, run_log
from jaxshroud.batch.pace import CallPace
from jaxshroud.batch.periods import (
    LANES_PER_CALL,
    PERIODS_PER_CALL,
    CallLimits,
    Clock,
    Interim,
    Sample,
    at_start_of_period,
    first_passes,
    lanes_per_call,
)
from jaxshroud.batch.threads import Check, Interrupted, concatenated_lanes, in_chunks
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import require_contact
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.programs.kept import is_traced
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import Tree

Tick = Callable[[float], None]  # called with the number of lane-periods done, which need not be whole
Progress = Callable[[float, int], None]  # called with the lane-periods done, to two decimals, and in all; 0: not known


def initial_states(scenes: Scene) -> State:
    """The initial state of each scene (leading axis), which lets nothing be compiled."""
    like = jnp if is_traced(scenes) else np
    motion, one = scenes.initial, scenes.friction.mu  # at each interface
    nothing = like.zeros_like(one, np.int32)
    return State(motion, like.zeros_like(one, motion.x.dtype), nothing, nothing)


@dataclass(frozen=True)
class Plan:
    """The length of a run, its time grid and its method."""

    transient: int
    kept: int
    steps_per_period: int
    phase: float
    method: Choices

    @property
    def clock(self) -> Clock:
        """The grid of whole periods from the sampling phase."""
        n = self.steps_per_period
        return Clock(jnp.asarray(self.phase / (2 * np.pi)), jnp.int32(n), jnp.asarray(float(n)))

    @property
    def lead_in(self) -> Clock | None:
        """The grid from phase 0 to the sampling phase, with steps no longer than the others; None at phase 0."""
        turns = self.phase / (2 * np.pi)
        steps = int(np.ceil(turns * self.steps_per_period))
        return Clock(jnp.asarray(0.0), jnp.int32(steps), jnp.asarray(steps / turns)) if steps else None


def stepping_method(scene: Scene, method: Choices) -> Tableau | TaylorOptions | None:
    """The method that steps through a scene; None where there is a closed form.

    Raises:
        InputError: The contact is smooth or has user laws, which power series cannot march.
    """
    require_contact(scene.parts.contact, method)
    return None if scene.parts.contact == "none" else method.tableau


class Ticker:
    """Sums up the lane-periods done and reports them."""

    def __init__(self, total: int, report: Progress | None):
        self.total, self.done, self.report = total, 0, report

    def __call__(self, lane_periods: int | float) -> None:
        """Report `lane_periods` more as done."""
        self.done += lane_periods
        if self.report is not None:
            done = round(self.done, 2)
            self.report(int(done) if done == int(done) else done, self.total)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Runs:
    """The results of a batch of lanes."""

    samples: Any  # Sample of arrays (lanes, kept), with a last axis of blades or of interfaces
    before: RunLog  # at the start of the kept periods
    log: RunLog  # at the end
    last: Any  # the lanes at the end, as compiled loops carry them


def run_lanes(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray | None = None) -> Runs:
    """Run all lanes (leading axis), in chunks that share one compiled function, one thread per core.

    Args:
        scenes: The scenes.
        states: Their states at drive phase 0.
        plan: The plan of the run.
        ticker: Called after every block with the number of its lane-periods.
        arrived: Which lanes start at the phase of the plan instead (lanes,); by default none.

    Raises:
        Interrupted: On Ctrl-C; `done` has the lanes that had ended, and the others with status NOT_RUN.
    """
    lanes, scenes = len(scenes.drive.omega), without_given(scenes)
    arrived = np.zeros(lanes, bool) if arrived is None else arrived
    if scenes.parts.contact == "none":
        begin = np.where(arrived, plan.phase, 0.0)
        samples, last = free_runs(scenes, states, plan.transient, plan.kept, plan.phase, plan.method, begin)
        ticker(lanes * (plan.transient + plan.kept))
        log = run_log(last)
        return Runs(PAIR_MARCHES.sample(samples), jax.tree.map(np.zeros_like, log), log, last)
    try:
        width = lanes_per_call(scenes.layout)
        pace = CallPace(first_passes(width, scenes.layout))
        run = lambda chunk, tick: _run_chunk(chunk, plan, pace, tick)
        return chunk_by_chunk(run, (scenes, states, arrived), ticker, width)
    except Interrupted as stopped:
        raise Interrupted(completed_runs(stopped.done, lambda runs: concatenated_lanes(runs, lanes))) from None


def chunk_by_chunk(run: Callable[[Any, Tick], Tree], lanes: Any, ticker: Tick, width: int = LANES_PER_CALL) -> Tree:
    """The results of `run(lanes, tick)` for one chunk of lanes after another, concatenated.

    Args:
        run: A function of a chunk and of a callback that reports progress; it is compiled for one lane alone, or for
            `width`.
        lanes: A tree of arrays with a leading axis.
        ticker: Called with the progress, summed over the lanes.
        width: Lanes of a chunk, see `lanes_per_call`.

    Raises:
        Interrupted: As in `in_chunks`.
    """
    count = len(jax.tree.leaves(lanes)[0])
    width = 1 if count == 1 else width

    def one(check: Check, at: np.ndarray) -> Tree:
        n = min(width, count - int(at[0]))

        def tick(done: int | float) -> None:
            ticker(done * n)
            check()

        return run(jax.tree.map(lambda a: np.asarray(a)[at], lanes), tick)

    return in_chunks(one, count, width)


def completed_runs(runs: list[Runs | None], concatenate: Callable[[list[Runs]], Runs]) -> Runs | None:
    """All runs, with status NOT_RUN for missing ones; None if all are missing."""
    finished = next((run for run in runs if run is not None), None)
    return (
        None if finished is None else concatenate([_unfinished_like(finished) if run is None else run for run in runs])
    )


def _unfinished_like(like: Runs) -> Runs:
    """As many lanes, none of which has been run."""
    fill = lambda a: np.full_like(a, np.nan if np.issubdtype(a.dtype, np.floating) else 0)
    empty = jax.tree.map(fill, like)
    status = np.full_like(like.last.status, Status.NOT_RUN)
    return replace(empty, last=eqx.tree_at(lambda lane: lane.status, empty.last, status))


def _run_chunk(chunk: tuple[Scene, State, np.ndarray], plan: Plan, pace: CallPace, tick: Tick) -> Runs:
    scenes, states, arrived = chunk
    lanes = march_programs(scenes.layout).begin(scenes, states, plan.method)
    if plan.lead_in is not None and not arrived.all():
        led_in, _ = run_periods(scenes, lanes, plan.lead_in, 1, plan.method, pace, lambda _: tick(0), keep=False)
        lanes = select_lanes(arrived, lanes, led_in)
    run = partial(run_periods, clock=plan.clock, method=plan.method, pace=pace, tick=tick)
    lanes, _ = run(scenes, lanes, n=plan.transient, keep=False)
    before = run_log(lanes)
    lanes, samples = run(scenes, lanes, n=plan.kept)
    return jax.tree.map(np.asarray, Runs(samples, before, run_log(lanes), lanes))


def select_lanes(which: np.ndarray, a: Tree, b: Tree) -> Tree:
    """Trees of arrays with a leading axis: `a` where `which`, else `b`."""
    return jax.tree.map(lambda a, b: np.where(which.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), a, b)


def run_periods(
    scenes: Scene, lanes: Any, clock: Clock, n: int, method: Choices, pace: CallPace, tick: Tick, keep: bool = True
) -> tuple[Any, Sample | None]:
    """Run `n` periods of lanes (leading axis), in calls to the device that are short.

    Args:
        scenes: The scenes.
        lanes: The lanes, or rows, at the start of a period.
        clock: The time grid.
        n: Periods.
        method: The options of the march.
        pace: How much a call does.
        tick: Called after every call with the number of periods that it made, parts of one included.
        keep: Whether samples are returned.

    Returns:
        The lanes at the end, and their samples, see `Runs`.
    """
    programs = march_programs(scenes.layout)
    blocks: list[Sample] = []
    interim, done, told = at_start_of_period(lanes), 0, 0.0
    while done < n:

        def call(passes: np.int32, left: int = n - done, interim: Interim = interim) -> tuple[Interim, int, Any]:
            limits = CallLimits(jnp.int32(min(left, PERIODS_PER_CALL)), jnp.asarray(passes))
            options = method, PERIODS_PER_CALL, best_mapping()
            end, ended, samples = programs.block(scenes, interim, clock, limits, *options)
            return end, int(ended), samples

        interim, ended, samples = pace.timed(call, lambda result: result[0].inside)
        if keep and ended:
            blocks.append(jax.tree.map(lambda a, n=ended: in_float64(a)[:n].swapaxes(0, 1), programs.sample(samples)))
        done += ended
        now = done + (_part_of_period(interim.lanes, clock) if interim.inside else 0.0)
        tick(now - told)
        told = now
    return interim.lanes, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks) if blocks else None


def _part_of_period(lanes: Any, clock: Clock) -> float:
    """The part of a period that lanes have marched, on average; those that have stopped need no more."""
    part = np.where(np.asarray(lanes.status) == Status.OK, np.asarray(lanes.step) / int(clock.steps), 1.0)
    return float(np.mean(part))


def in_float64(a) -> np.ndarray:
    """An array, in float64 if its numbers are real."""
    return np.asarray(a, float) if np.issubdtype(np.asarray(a).dtype, np.floating) else np.asarray(a)
