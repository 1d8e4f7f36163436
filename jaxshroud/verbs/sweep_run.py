"""The runs of a sweep's lanes, the numbers that its result holds, and their comparison with a finer march."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import final_states
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.plan import Plan, Runs, Ticker
from jaxshroud.batch.runs import SweepHandover, continued_runs, independent_runs, stepping_method
from jaxshroud.batch.stepped_runs import in_float64, zeno_warning
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.scene_numbers import dimension
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.accumulator import ContactTimes
from jaxshroud.march.stability import steps_for
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.lyapunov import ALIGNMENT_PERIODS, largest_exponents, with_phase_shift
from jaxshroud.results.sweep import GAP_ATTRS, SweepResult, sweep_coordinates
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import Direction
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.amplitudes import (
    amplitude_intervals,
    amplitude_values,
    counted_mean,
    counted_periods,
    load_values,
)
from jaxshroud.signals.averages import averages, contact_shares, relative_drop, relative_residual
from jaxshroud.signals.period import SETTLED
from jaxshroud.verbs.arguments import MarchPlan, ResolvedOptions
from jaxshroud.verbs.lanes import in_shape
from jaxshroud.verbs.trials import missed_lanes

MAX_LANES_AT_ONCE = 4096  # lanes whose samples are in memory at once where the result does not keep them


class Grid(NamedTuple):
    """The scenes of a sweep: those given, at every value of its axes."""

    resolved: ResolvedOptions
    lanes: Scene  # one leading axis: the axes of the scenes, then those of the sweep, the last fastest
    axes: dict[str, np.ndarray]  # key -> values
    precise: Scene | None = None  # the lanes in float64, for Lyapunov exponents
    numbers: np.ndarray | None = None  # of the lanes, counted in the whole sweep

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the lanes' axes."""
        return (*self.resolved.shape, *(len(values) for values in self.axes.values()))

    @property
    def dims(self) -> tuple[str, ...]:
        """The names of the lanes' axes."""
        return (*self.resolved.dims, *(dimension(key, self.lanes.layout.names) for key in self.axes))


class SweepSettings(NamedTuple):
    """How the lanes of a sweep are run, and which of their numbers are kept."""

    plan: Plan
    march: MarchPlan
    period_tol: float
    ticker: Ticker
    keep_samples: bool = True
    is_part: bool = False  # the lanes are one block of a larger sweep
    confirm: bool = False  # run again, with a finer march
    confirms: bool = False  # it is that finer march, of which exponents do not count


def lane_periods(plan: Plan, lyapunov: bool) -> int:
    """The number of drive periods for which each lane is run."""
    return plan.transient + plan.kept + (ALIGNMENT_PERIODS + plan.kept if lyapunov else 0)


def run_sweep(
    grid: Grid,
    states: State | None,
    direction: Direction,
    settings: SweepSettings,
    handover: SweepHandover | None = None,
) -> SweepResult:
    """The result of all lanes in one direction; `handover` is the `relay` of `continued_runs`.

    Raises:
        Interrupted: Ctrl-C; `done` has the result with the lanes that had ended, None if none had.
    """

    def result(runs: Runs, exponents: dict[str, np.ndarray]) -> SweepResult:
        chatter = zeno_warning(grid.lanes, runs, settings.plan)
        return _sweep_result(grid, _lane_numbers(grid.lanes, runs, settings) | exponents, chatter, settings)

    try:
        runs = _run_grid(grid, states, direction, settings, handover)
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result(stopped.done, {})) from None
    single = settings.is_part and math.prod(grid.shape) == 1
    if single:
        grid, runs = _duplicated(grid, runs)
    try:
        swept = result(runs, _exponents(grid, runs, settings))
    except Interrupted:
        raise Interrupted(result(runs, {})) from None
    return SweepResult(swept.data.isel({grid.dims[len(grid.resolved.dims)]: slice(1)})) if single else swept


def _duplicated(grid: Grid, runs: Runs) -> tuple[Grid, Runs]:
    """A single lane and its run, each twice: the numbers of a part of a sweep must be rounded like those of many."""

    def double(tree):
        return jax.tree.map(lambda a: np.concatenate([a, a]), tree)

    key, *others = grid.axes
    axes = {key: double(grid.axes[key]), **{other: grid.axes[other] for other in others}}
    lanes, precise, numbers = double((grid.lanes, grid.precise, grid.numbers))
    return Grid(grid.resolved, lanes, axes, precise, numbers), double(runs)


def run_map(grid: Grid, states: State | None, direction: Direction, settings: SweepSettings) -> SweepResult:
    """The result of independent lanes without their samples, run some thousands at a time.

    Raises:
        InputError: The direction is not "independent".
        Interrupted: Ctrl-C.
    """
    if direction != "independent":
        raise InputError("Sweeps forward and backward keep their samples; leave out `keep_samples`.")
    parts = []
    chatter = None
    count = math.prod(grid.shape)
    # A last part of a single lane would be run by another program.
    size = MAX_LANES_AT_ONCE if count % MAX_LANES_AT_ONCE != 1 else MAX_LANES_AT_ONCE + LANES_PER_CALL
    for first in range(0, count, size):
        at = slice(first, first + size)
        some = (grid.lanes, grid.precise, grid.numbers, states)
        scenes, precise, lane_numbers, starts = jax.tree.map(lambda a: a[at], some)  # noqa: B023  called at once
        part = grid._replace(lanes=scenes, precise=precise, numbers=lane_numbers)
        try:
            runs = independent_runs(scenes, (len(scenes.drive.omega),), settings.plan, settings.ticker, starts)
            numbers = _lane_numbers(scenes, runs, settings) | _exponents(part, runs, settings)
        except Interrupted:
            raise Interrupted(None) from None
        chatter = chatter or zeno_warning(scenes, runs, settings.plan)
        parts.append({name: value for name, value in numbers.items() if name != "motion"})
    return _sweep_result(grid, jax.tree.map(lambda *a: np.concatenate(a), *parts), chatter, settings)


def _run_grid(
    grid: Grid, states: State | None, direction: Direction, settings: SweepSettings, handover: SweepHandover | None
) -> Runs:
    """The runs of all lanes (leading axis) in one direction."""
    run_for = settings.plan, settings.ticker
    if direction == "independent" or is_linear(grid.lanes):  # a settled motion does not depend on where it starts
        return independent_runs(grid.lanes, (math.prod(grid.shape),), *run_for, states)
    shape = (
        math.prod(grid.resolved.shape),
        *grid.shape[len(grid.resolved.shape) :],
    )  # scenes, then the axes of the sweep
    swapped = (shape[1], shape[0], *shape[2:])

    def to_front(tree):
        return jax.tree.map(lambda a: np.moveaxis(np.asarray(a).reshape(*shape, *a.shape[1:]), 1, 0), tree)

    def back(tree):
        return jax.tree.map(lambda a: np.moveaxis(a, 0, 1).reshape(-1, *a.shape[len(shape) :]), tree)

    try:
        runs = continued_runs(
            to_front(grid.lanes), swapped, *run_for, to_front(states), direction=direction, relay=handover
        )
        return back(runs)
    except Interrupted as stopped:
        raise Interrupted(stopped.done and back(stopped.done)) from None


def known_values(grid: Grid, plan: Plan) -> dict[str, Any]:
    """What a result has before any lane has run: `coords`, `attrs` and `more` of `Result.from_values`."""
    periods = np.arange(plan.transient + 1, plan.transient + plan.kept + 1)
    attributes, differing = grid.resolved.provenance(plan.steps_per_period)
    more: dict[str, Any] = {name: variable for name, variable in differing.items() if name not in grid.dims}
    if "gap" not in grid.dims and (grid.axes or "gap" not in more):
        gap = np.asarray(grid.lanes.running_shroud.gap)
        more["gap"] = (
            (*grid.dims, "interface")[: len(grid.shape) + gap.ndim - 1],
            gap.reshape(*grid.shape, *gap.shape[1:]),
            GAP_ATTRS,
        )
    coords = sweep_coordinates(grid.axes, periods, grid.lanes.layout)
    return {"coords": coords, "attrs": {**attributes, "axes": ",".join(grid.dims)}, "more": more}


def _sweep_result(grid: Grid, numbers: dict[str, object], chatter: str | None, settings: SweepSettings) -> SweepResult:
    """The result from the numbers of all lanes (leading axis)."""
    plan, march = settings.plan, settings.march
    common = {"phase": plan.phase, "period_tol": settings.period_tol, "chatter": chatter, **march.attributes}
    if march.tried is not None:
        numbers = numbers | {"inaccurate": missed_lanes(grid.lanes, march.tried, settings.ticker.report)}
    known = known_values(grid, plan)
    known["attrs"]["complete"] = int(not np.any(numbers["status"] == Status.NOT_RUN))
    values = {**in_shape(numbers, grid.shape), **common}
    return SweepResult.from_values(values, lanes=grid.dims, layout=grid.lanes.layout, **known)


def _exponents(grid: Grid, runs: Runs, settings: SweepSettings) -> dict[str, np.ndarray]:
    """The largest exponent of each lane (leading axis) and its interval, NaN where it stopped; {} if not requested."""
    scenes = grid.precise
    if scenes is None or settings.confirms:
        return {}
    plan = settings.plan
    running = np.flatnonzero(runs.last.status == Status.OK)
    exponent, ci = np.full((2, len(runs.last.status)), np.nan)
    if len(running):
        states = jax.tree.map(in_float64, final_states(runs.last.state))
        lanes, states = jax.tree.map(lambda a: np.asarray(a)[running], (with_phase_shift(scenes, plan.phase), states))
        steps = plan.steps_per_period
        if stepping_method(scenes, plan.method) is None:  # tangents are marched step by step
            steps = steps_for(lanes, 1, "auto", plan.method.tableau)
        method = plan.method._replace(precision="float64")
        numbers = None if grid.numbers is None else grid.numbers[running]
        largest = largest_exponents(lanes, states, plan.kept, steps, method, settings.ticker, numbers)
        exponent[running], ci[running] = largest.exponent, largest.ci
    return {"lyapunov": exponent, "lyapunov_ci": ci}


def _row_numbers(runs: Runs, reductions: np.ndarray) -> dict[str, np.ndarray]:
    """The variables that only rows have, from the power reduction of each blade (lanes, blades)."""
    return {"P_d_worst": reductions.min(axis=-1), "interface_v_max": runs.log.v_max}


def _lane_numbers(scenes: Scene, runs: Runs, settings: SweepSettings) -> dict[str, object]:
    """The variables of the result for lanes (leading axis), without exponents."""
    runs = jax.tree.map(in_float64, runs)
    (number, settling), power, P_0 = averages(scenes, runs.samples, settings.period_tol)
    counted = counted_periods(runs.samples, number)
    times = ContactTimes._make(counted_mean(t.sum(axis=-1), counted) for t in runs.samples.times)
    with np.errstate(invalid="ignore", divide="ignore"):
        residual = relative_residual(runs.samples) if settings.plan.method.ledger else None
        dropped = relative_drop(runs.samples) if settings.plan.method.ledger else None

    def gained(end, start):
        return (end - start).sum(axis=-1, dtype=np.int32)  # of all interfaces

    events = jax.tree.map(gained, runs.log.counters, runs.before.counters)
    return {
        "motion": runs.samples.motion,
        "P": power.P,
        "P_0": P_0,
        "P_d": power.P_d,
        "P_d_ci": power.ci,
        "P_d_vibration": power.P_d_vibration,
        "P_d_vibration_ci": power.vibration_ci,
        "P_d_ci_short": power.ci_short,
        "P_d_settled": power.settled,
        "P_d_settling": power.settling,
        "P_d_periods_more": power.periods_more,
        "period_number": number,
        "settled": settling.verdict == SETTLED,
        "settling": settling.verdict,
        "periods_more": settling.periods_more,
        "periods_to_keep": settling.to_keep,
        "status": runs.last.status,
        "v_max": runs.log.v_max.max(axis=-1),
        **contact_shares(times),
        **({} if residual is None else {"energy_residual": residual, "energy_dropped": dropped}),
        "counters": vars(events),
        **({} if scenes.row is None else _row_numbers(runs, power_reduction(power.P, P_0))),
        **load_values(scenes, runs.samples, number),
        **amplitude_values(scenes, runs.samples, number),
        **amplitude_intervals(scenes, runs.samples, number),
    }


SAME_P_D = 1e-3  # percentage points beside both intervals: more than the rounding of a settled orbit makes


def confirmed_run(run: Callable[[SweepSettings], SweepResult], settings: SweepSettings) -> SweepResult:
    """A sweep, with `unconfirmed` where it is to be confirmed: run again with half the step of the finer method.

    Raises:
        Interrupted: Ctrl-C; `done` is without `unconfirmed` where the sweep itself had ended.
    """
    result = run(settings)
    if not settings.confirm:
        return result
    try:
        finer = run(_finer_settings(settings))
    except Interrupted:
        raise Interrupted(result) from None
    variable = SweepResult.variables["unconfirmed"]
    entries = variable.entries(_ends_elsewhere(result, finer), result.dims)
    return SweepResult(result.data.assign(dict(entries)))


def _finer_settings(settings: SweepSettings) -> SweepSettings:
    plan = settings.plan
    finer = replace(plan, steps_per_period=2 * plan.steps_per_period, method=plan.method.finer())
    return settings._replace(plan=finer, march=settings.march.untried, confirms=True)


def _ends_elsewhere(result: SweepResult, finer: SweepResult) -> np.ndarray:
    """Whether lanes whose P_d has settled have another period number or P_d by the finer march."""
    both_ran = (result.status == Status.OK) & (finer.status == Status.OK)
    apart = np.abs(result.P_d - finer.P_d) > SAME_P_D + result.P_d_ci + finer.P_d_ci
    return both_ran & result.P_d_settled & (apart | (result.period_number != finer.period_number))
