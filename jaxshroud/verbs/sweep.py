"""Many scenes at once: bifurcation diagrams and power curves over any number of a scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.continuation import continued, independent
from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress, Runs, Ticker, in_full, told_chatter
from jaxshroud.batch.states import by_blade
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.events import Counters
from jaxshroud.march.method import FAST, Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.absent import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import averages, relative_drop, relative_residual
from jaxshroud.motion.period import PERIOD_TOLERANCE
from jaxshroud.motion.settling import YES
from jaxshroud.results.dimension import dimension
from jaxshroud.results.directions import overlaid
from jaxshroud.results.status import tell_failures
from jaxshroud.results.sweep import GAP, SweepResult, sweep_coordinates
from jaxshroud.scene.checks import tolerance_argument, word_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.parts import WAYS, Direction
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import broken
from jaxshroud.verbs.door import Asked, Marched, asked, in_line, in_shape, marched


def sweep(
    scene: Scene | SceneFile,
    along: Mapping[str, ArrayLike | Sequence[float]] | None = None,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    direction: Direction | None = None,
    phase: float = 0.0,
    period_tol: float = PERIOD_TOLERANCE,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    ledger: bool = False,
    samples: bool = True,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> SweepResult:
    """Simulate scenes for every value (or pair of values) of one or two of their numbers, or as they are.

    Args:
        scene: What all lanes have in common; or many scenes, with leading axes, which come first in all results; or a
            scene file, whose [run] and [sweep] count where an argument is not given.
        along: One or two keys as for `vary`, each with its values (n,) in SI units; two make a grid. None: those of the
            file, or the scenes as they are.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded before these; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        direction: "independent" (the default): every lane starts from `scene.initial`. "forward" or "backward": along
            the first key each value starts from its neighbour's final state, slider and mode included. "both": these
            two and from rest, in a leading dimension `direction`; over one key the result tells where the motion jumps
            (`jump`) and where the directions come to different motions (`coexisting`).
        phase: Drive phase omega t at which samples are taken, 0 <= phase < 2 pi [rad].
        period_tol: Tolerance of the period number, see `periodicity`.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, see `choose`.
        state: Where to start, at drive phase 0: one state, or one for each of the scenes.
        ledger: Keep every lane's energy balance.
        samples: Keep the samples of each lane. Without them memory is bounded: for maps of many lanes.
        progress: Called with (lane-periods done, lane-periods in all) after every block.
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        Samples and statistics of every lane. A lane that failed has a status and NaN; the others are not affected.

    Raises:
        ValueError: A count is too small, an axis is empty, the phase or the tolerance is out of range, the direction is
            not known, the run would be too long or too large (see `extent`), or float64 is not to be had.
        KeyError: The scene has no such number.
        NumericalError: With `throw`: a lane stopped.
        Interrupted: Ctrl-C; its `done` is the result with the lanes that had ended, the others with status NOT_RUN, or
            None where none had.

    Source:
        Sec. 3.2 of the article: samples at one phase of the drive, and Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> curve = js.sweep(scene, {"contact.gamma": [1.0, 2.0]}, n_periods=2, transient=1, steps_per_period=200)
        >>> curve.motion.x.shape, curve.P_d.shape
        ((2, 2, 2), (2,))
    """
    door = asked(
        scene,
        n_periods=n_periods,
        transient=transient,
        steps_per_period=steps_per_period,
        method=method,
        accuracy=accuracy,
        dims=dims,
        of_sweep=True,
    )
    if not 0 <= phase < 2 * np.pi:
        raise InputError(f"Argument `phase` must be in [0, 2 pi), but is {phase}.")
    tolerance_argument("period_tol", period_tol)
    grid, direction = _grid_of(door, along, direction)
    ways = WAYS if direction == "both" else (direction,)
    lanes = len(ways) * math.prod(grid.shape)
    fits(lanes, door.transient, door.n_periods, None if samples else min(lanes, AT_ONCE))
    how = marched(grid.door, grid.lanes, FAST._replace(ledger=ledger))
    grid = grid._replace(lanes=in_precision(grid.lanes, how.method.precision))
    plan = Plan(door.transient, door.n_periods, how.steps, phase, how.method)
    states = None if state is None else door.states(state, grid.lanes)
    ticker = Ticker(lanes * (door.transient + door.n_periods), progress)
    one_way = _swept if samples else _mapped
    each = {way: one_way(grid, states, plan, ticker, way, how, period_tol) for way in ways}
    found = overlaid(each) if direction == "both" else each[direction]
    tell_failures(found.status, found.chatter, throw=throw)
    return found


AT_ONCE = 4096  # lanes whose samples are held at once where they are not kept


class _Grid(NamedTuple):
    """What is swept."""

    door: Asked
    lanes: Scene  # one leading axis: those of the scenes, then those of the sweep, the last fastest
    axes: dict[str, np.ndarray]

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.door.shape, *(len(values) for values in self.axes.values()))

    @property
    def dims(self) -> tuple[str, ...]:
        return (*self.door.dims, *map(dimension, self.axes))


def _grid_of(door: Asked, along: Mapping[str, Any] | None, direction: Direction | None) -> tuple[_Grid, Direction]:
    """The scenes of a sweep, and the order of its values."""
    if direction is not None:
        word_argument("direction", direction, Direction)
    file = door.file
    if along is not None and file is not None:
        door = door._replace(file=replace(file, axes=(), keep=None))  # its text is to tell of no other sweep
    elif file is not None:
        along, direction = {a.key: a.values for a in file.axes}, direction or file.direction
    axes = {key: np.atleast_1d(np.asarray(values, dtype=float)) for key, values in (along or {}).items()}
    if not (axes or door.shape) or len(axes) > 2 or any(v.ndim != 1 or v.size == 0 for v in axes.values()):
        raise InputError("Argument `along` must name one or two keys, each with at least one value.")
    if direction not in (None, "independent") and not axes:
        raise InputError(f"Argument `direction` = {direction!r} needs `along`: it follows the values of its first key.")
    build = grid_of_scenes
    for _ in door.shape:
        build = jax.vmap(build, in_axes=(0, None))
    scenes = build(door.scene, axes) if axes else door.scene
    return _Grid(door, in_line(scenes, len(door.shape) + len(axes)), axes), direction or "independent"


def _swept(
    grid: _Grid,
    states: State | None,
    plan: Plan,
    ticker: Ticker,
    direction: Direction,
    how: Marched,
    period_tol: float,
) -> SweepResult:
    """All lanes in one direction."""

    def result(runs: Runs) -> SweepResult:
        chatter = told_chatter(grid.lanes, runs, plan)
        return _result(grid, _numbers(grid.lanes, runs, plan, period_tol), chatter, plan, how, period_tol)

    try:
        return result(_run(grid, states, plan, ticker, direction))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result(stopped.done)) from None


def _mapped(
    grid: _Grid,
    states: State | None,
    plan: Plan,
    ticker: Ticker,
    direction: Direction,
    how: Marched,
    period_tol: float,
) -> SweepResult:
    """The same of independent lanes, some thousands at a time, without their samples."""
    if direction != "independent":
        raise InputError("Sweeps forward and backward keep their samples; leave out `samples`.")
    parts, chatter, count = [], None, math.prod(grid.shape)
    for first in range(0, count, AT_ONCE):
        at = slice(first, first + AT_ONCE)
        scenes, begin = jax.tree.map(lambda a: a[at], (grid.lanes, states))  # noqa: B023  called at once
        try:
            runs = independent(scenes, (len(scenes.drive.omega),), plan, ticker, begin)
        except Interrupted:
            raise Interrupted(None) from None
        chatter = chatter or told_chatter(scenes, runs, plan)
        numbers = _numbers(scenes, runs, plan, period_tol)
        parts.append({name: value for name, value in numbers.items() if name != "motion"})
    return _result(grid, jax.tree.map(lambda *a: np.concatenate(a), *parts), chatter, plan, how, period_tol)


def _run(grid: _Grid, states: State | None, plan: Plan, ticker: Ticker, direction: Direction) -> Runs:
    """All lanes (leading axis)."""
    if direction == "independent":
        return independent(grid.lanes, (math.prod(grid.shape),), plan, ticker, states)
    shape = (math.prod(grid.door.shape), *grid.shape[len(grid.door.shape) :])  # scenes, then the axes of the sweep
    swapped = (shape[1], shape[0], *shape[2:])
    first = lambda tree: jax.tree.map(lambda a: np.moveaxis(np.asarray(a).reshape(*shape, *a.shape[1:]), 1, 0), tree)  # noqa: E731
    back = lambda tree: jax.tree.map(lambda a: np.moveaxis(a, 0, 1).reshape(-1, *a.shape[len(shape) :]), tree)  # noqa: E731
    try:
        return back(continued(first(grid.lanes), swapped, plan, ticker, first(states), direction=direction))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and back(stopped.done)) from None


def _result(
    grid: _Grid, numbers: dict[str, Any], chatter: str | None, plan: Plan, how: Marched, period_tol: float
) -> SweepResult:
    """The result from the numbers of all lanes (leading axis)."""
    common = {"phase": plan.phase, "period_tol": period_tol, "chatter": chatter, **how.told}
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


def _numbers(scenes: Scene, runs: Runs, plan: Plan, period_tol: float) -> dict[str, Any]:
    """Numbers of lanes (leading axis)."""
    runs = jax.tree.map(in_full, runs)
    motion = by_blade(runs.samples.motion)
    (number, told), power, P_0 = averages(scenes, runs.samples, period_tol)
    log, before = runs.last.tally.log, runs.before.log
    spent = [getattr(log, n) - getattr(before, n) for n in ("time_apart", "time_stick", "time_slip")]
    whole = sum(spent)
    with np.errstate(invalid="ignore", divide="ignore"):
        times = [t / whole for t in spent]
        residual = relative_residual(runs.samples) if plan.method.ledger else None
        dropped = relative_drop(runs.samples) if plan.method.ledger else None
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
    }
