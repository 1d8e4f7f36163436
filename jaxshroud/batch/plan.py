"""What a run of many lanes is to do, its progress, and what it returns."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.periods import Clock
from jaxshroud.march.accumulator import Counters
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.row import at_only_interface

Tick = Callable[[float], None]  # called with the number of lane-periods done, which need not be whole
Progress = Callable[[float, int], None]  # called with the lane-periods done, to two decimals, and in all; 0: not known


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
        start = self.phase / (2 * np.pi)
        return Clock.of_steps(self.steps_per_period, start=start, flat_return=self.method.flat_return)

    @property
    def lead_in(self) -> Clock | None:
        """The grid from phase 0 to the sampling phase, with steps no longer than the others; None at phase 0."""
        turns = self.phase / (2 * np.pi)
        steps = int(np.ceil(turns * self.steps_per_period))
        if not steps:
            return None
        return Clock.of_steps(steps, per_period=steps / turns, flat_return=self.method.flat_return)


def both(one: Tick, other: Tick) -> Tick:
    """A callback that calls two."""

    def tick(lane_periods: int | float) -> None:
        one(lane_periods)
        other(lane_periods)

    return tick


class Ticker:
    """Sums up the lane-periods done and reports them; sent to another process, it reports nothing there."""

    def __init__(self, total: int, report: Progress | None):
        self.total = total
        self.done = 0
        self.report = report

    def __call__(self, lane_periods: int | float) -> None:
        """Report `lane_periods` more as done."""
        self.done += lane_periods
        if self.report is not None:
            done = round(self.done, 2)
            self.report(int(done) if done == int(done) else done, self.total)

    def __reduce__(self) -> tuple[type["Ticker"], tuple[int, None]]:
        return Ticker, (self.total, None)


class RunLog(NamedTuple):
    """What lanes (leading axis) have logged so far."""

    v_max: np.ndarray  # largest penetration at each interface [m], (lanes, interfaces), as all that follows
    counters: Counters
    within: Any  # `StepExtrema`; None unless they were requested


def run_log(lanes: Any) -> RunLog:
    """The log of lanes (leading axis), which counts no events that cannot happen."""
    log = at_only_interface(lanes.accumulator.log)
    count = len(lanes.status)
    counters = filled(log.counters, np.zeros(np.shape(log.v_max), np.int32))
    kept = log.v_max, counters, log.within
    return RunLog._make(jax.tree.map(lambda a: np.reshape(a, (count, -1)), kept))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Runs:
    """The results of a batch of lanes."""

    samples: Any  # Sample of arrays (lanes, kept), with a last axis of blades or of interfaces
    before: RunLog  # at the start of the kept periods
    log: RunLog  # at the end
    last: Any  # the lanes at the end, as compiled loops carry them


def completed_runs(runs: list[Runs | None], concatenate: Callable[[list[Runs]], Runs]) -> Runs | None:
    """All runs, with status NOT_RUN for missing ones; None if all are missing."""
    finished = next((run for run in runs if run is not None), None)
    return (
        None if finished is None else concatenate([_unfinished_like(finished) if run is None else run for run in runs])
    )


def _unfinished_like(like: Runs) -> Runs:
    """As many lanes, none of which has been run."""

    def fill(a):
        return np.full_like(a, np.nan if np.issubdtype(a.dtype, np.floating) else 0)

    empty = jax.tree.map(fill, like)
    status = np.full_like(like.last.status, Status.NOT_RUN)
    return replace(empty, last=eqx.tree_at(lambda lane: lane.status, empty.last, status))
