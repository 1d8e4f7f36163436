"""The lanes of a sweep run, and their numbers."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.continuation import Relay, continued, independent
from jaxshroud.batch.periods import CHUNK, Sample
from jaxshroud.batch.runs import Plan, Runs, Ticker, in_full, told_chatter
from jaxshroud.batch.states import by_blade, final_states
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.events import Counters
from jaxshroud.march.stability import steps_for
from jaxshroud.model.absent import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import averages, relative_drop, relative_residual
from jaxshroud.motion.largest import TURNING, largest_exponents, shifted
from jaxshroud.motion.settling import YES
from jaxshroud.results.dimension import dimension
from jaxshroud.results.sweep import GAP, SweepResult, sweep_coordinates
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import broken
from jaxshroud.verbs.door import Asked, Marched, in_shape

AT_ONCE = 4096  # lanes whose samples are held at once where they are not kept


class Grid(NamedTuple):
    """What is swept."""

    door: Asked
    lanes: Scene  # one leading axis: those of the scenes, then those of the sweep, the last fastest
    axes: dict[str, np.ndarray]
    precise: Scene | None = None  # the lanes in float64, where exponents are wanted
    numbers: np.ndarray | None = None  # of the lanes, in the whole of a sweep

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the lanes."""
        return (*self.door.shape, *(len(values) for values in self.axes.values()))

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the lanes' axes."""
        return (*self.door.dims, *map(dimension, self.axes))


class Wanted(NamedTuple):
    """What is to be known of the lanes."""

    plan: Plan
    how: Marched
    period_tol: float
    ticker: Ticker
    samples: bool = True
    of_many: bool = False  # the lanes at hand are some of more


def lane_periods(plan: Plan, lyapunov: bool) -> int:
    """Drive periods that each lane is run for."""
    return plan.transient + plan.kept + (TURNING + plan.kept if lyapunov else 0)


def swept(
    grid: Grid, states: State | None, direction: Direction, wanted: Wanted, relay: Relay | None = None
) -> SweepResult:
    """All lanes in one direction; `relay` as of `continued`."""

    def result(runs: Runs, exponents: dict[str, np.ndarray]) -> SweepResult:
        chatter = told_chatter(grid.lanes, runs, wanted.plan)
        return _result(grid, _numbers(grid.lanes, runs, wanted) | exponents, chatter, wanted)

    try:
        runs = _run(grid, states, direction, wanted, relay)
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result(stopped.done, {})) from None
    single = wanted.of_many and math.prod(grid.shape) == 1
    if single:
        grid, runs = _twice(grid, runs)
    try:
        found = result(runs, _exponents(grid, runs, wanted))
    except Interrupted:
        raise Interrupted(result(runs, {})) from None
    return SweepResult(found.data.isel({dimension(next(iter(grid.axes))): slice(1)})) if single else found


def _twice(grid: Grid, runs: Runs) -> tuple[Grid, Runs]:
    """One lane, run by a program of its own as all its neighbours, as two: its numbers are to be rounded as theirs."""
    double = lambda tree: jax.tree.map(lambda a: np.concatenate([a, a]), tree)  # noqa: E731
    key, *others = grid.axes
    axes = {key: double(grid.axes[key]), **{other: grid.axes[other] for other in others}}
    lanes, precise, numbers = double((grid.lanes, grid.precise, grid.numbers))
    return Grid(grid.door, lanes, axes, precise, numbers), double(runs)


def mapped(grid: Grid, states: State | None, direction: Direction, wanted: Wanted) -> SweepResult:
    """The same of independent lanes, some thousands at a time, without their samples."""
    if direction != "independent":
        raise InputError("Sweeps forward and backward keep their samples; leave out `samples`.")
    parts, chatter, count = [], None, math.prod(grid.shape)
    size = AT_ONCE if count % AT_ONCE != 1 else AT_ONCE + CHUNK  # a single lane would be run by another program
    for first in range(0, count, size):
        at = slice(first, first + size)
        some = (grid.lanes, grid.precise, grid.numbers, states)
        scenes, precise, lane_numbers, begin = jax.tree.map(lambda a: a[at], some)  # noqa: B023  called at once
        part = grid._replace(lanes=scenes, precise=precise, numbers=lane_numbers)
        try:
            runs = independent(scenes, (len(scenes.drive.omega),), wanted.plan, wanted.ticker, begin)
            numbers = _numbers(scenes, runs, wanted) | _exponents(part, runs, wanted)
        except Interrupted:
            raise Interrupted(None) from None
        chatter = chatter or told_chatter(scenes, runs, wanted.plan)
        parts.append({name: value for name, value in numbers.items() if name != "motion"})
    return _result(grid, jax.tree.map(lambda *a: np.concatenate(a), *parts), chatter, wanted)


def _run(grid: Grid, states: State | None, direction: Direction, wanted: Wanted, relay: Relay | None) -> Runs:
    """All lanes (leading axis)."""
    to = wanted.plan, wanted.ticker
    if direction == "independent":
        return independent(grid.lanes, (math.prod(grid.shape),), *to, states)
    shape = (math.prod(grid.door.shape), *grid.shape[len(grid.door.shape) :])  # scenes, then the axes of the sweep
    swapped = (shape[1], shape[0], *shape[2:])
    first = lambda tree: jax.tree.map(lambda a: np.moveaxis(np.asarray(a).reshape(*shape, *a.shape[1:]), 1, 0), tree)  # noqa: E731
    back = lambda tree: jax.tree.map(lambda a: np.moveaxis(a, 0, 1).reshape(-1, *a.shape[len(shape) :]), tree)  # noqa: E731
    try:
        return back(continued(first(grid.lanes), swapped, *to, first(states), direction=direction, relay=relay))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and back(stopped.done)) from None


def _result(grid: Grid, numbers: dict[str, Any], chatter: str | None, wanted: Wanted) -> SweepResult:
    """The result from the numbers of all lanes (leading axis)."""
    plan, how = wanted.plan, wanted.how
    common = {"phase": plan.phase, "period_tol": wanted.period_tol, "chatter": chatter, **how.told}
    if how.choice is not None:
        numbers["inaccurate"] = broken(grid.lanes, how.choice)
    coords = sweep_coordinates(grid.axes, np.arange(plan.transient + 1, plan.transient + plan.kept + 1))
    told, differing = grid.door.about(plan.transient, plan.steps_per_period)
    more = {name: variable for name, variable in differing.items() if name not in grid.dims}
    if "gap" not in grid.dims and (grid.axes or "gap" not in more):
        more["gap"] = (grid.dims, in_shape(grid.lanes.shroud.gap, grid.shape), GAP)
    told |= {"axes": ",".join(grid.dims), "complete": int(not np.any(numbers["status"] == Status.NOT_RUN))}
    values = {**in_shape(numbers, grid.shape), **common}
    return SweepResult.from_values(values, lanes=grid.dims, coords=coords, attrs=told, more=more)


def _exponents(grid: Grid, runs: Runs, wanted: Wanted) -> dict[str, np.ndarray]:
    """The largest exponent of each lane (leading axis) that has not stopped, and its interval, if wanted."""
    scenes = grid.precise
    if scenes is None:
        return {}
    plan, fine = wanted.plan, np.flatnonzero(runs.last.status == Status.OK)
    exponent, ci = np.full((2, len(runs.last.status)), np.nan)
    if len(fine):
        states = jax.tree.map(in_full, final_states(runs.last.state))
        lanes, states = jax.tree.map(lambda a: np.asarray(a)[fine], (shifted(scenes, plan.phase), states))
        steps = plan.steps_per_period
        if scenes.parts.contact == "none":  # tangents are marched there too
            steps = steps_for(lanes, 1, "auto", plan.method.tableau)
        method = plan.method._replace(precision="float64")
        numbers = None if grid.numbers is None else grid.numbers[fine]
        found = largest_exponents(lanes, states, plan.kept, steps, method, wanted.ticker, numbers)
        exponent[fine], ci[fine] = found.exponent, found.ci
    return {"lyapunov": exponent, "lyapunov_ci": ci}


def _numbers(scenes: Scene, runs: Runs, wanted: Wanted) -> dict[str, Any]:
    """Numbers of lanes (leading axis)."""
    runs = jax.tree.map(in_full, runs)
    motion = by_blade(runs.samples.motion)
    (number, told), power, P_0 = averages(scenes, runs.samples, wanted.period_tol)
    log, before = runs.last.tally.log, runs.before.log
    spent = [getattr(log, n) - getattr(before, n) for n in ("time_apart", "time_stick", "time_slip")]
    whole = sum(spent)
    with np.errstate(invalid="ignore", divide="ignore"):
        times = [t / whole for t in spent]
        residual = relative_residual(runs.samples) if wanted.plan.method.ledger else None
        dropped = relative_drop(runs.samples) if wanted.plan.method.ledger else None
    counts = [filled(of.counters, runs.last.status) for of in (log, before)]
    counters = {n: np.asarray(getattr(counts[0], n) - getattr(counts[1], n)) for n in Counters.__annotations__}
    return {
        "motion": motion,
        "P": power.P,
        "P_0": P_0,
        "P_d": power.P_d,
        "P_d_ci": power.ci,
        "P_d_ci_short": power.ci_short,
        "P_d_settled": power.settled,
        "P_d_settling": power.settling,
        "P_d_periods_more": power.periods_more,
        "period_number": number,
        "settled": told.verdict == YES,
        "settling": told.verdict,
        "periods_more": told.periods_more,
        "status": runs.last.status,
        "v_max": log.v_max,
        **dict(zip(("time_apart", "time_stick", "time_slip"), times, strict=True)),
        **({} if residual is None else {"energy_residual": residual, "energy_dropped": dropped}),
        "counters": counters,
        **({} if runs.samples.forces is None else _forces(runs.samples)),
    }


def _forces(samples: Sample) -> dict[str, np.ndarray]:
    """The largest forces of the kept periods, and the mean work of friction in one, (lanes,)."""
    N_max, F_max = (a.max(axis=-1) for a in samples.forces)
    return {"N_max": N_max, "F_max": F_max, "friction_work": samples.friction.mean(axis=-1)}
