"""Many scenes at once: bifurcation diagrams and power curves over numbers of a scene."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress, Ticker
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.lane_status import warn_failures
from jaxshroud.linear.held_contact import LinearState, is_linear
from jaxshroud.march.method import FOR_P_D
from jaxshroud.model.prepared import State
from jaxshroud.results.sweep import SweepResult, overlay_directions
from jaxshroud.scene.checks import InputError, StoreError, tolerance_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.period import PERIOD_TOLERANCE
from jaxshroud.verbs.arguments import MethodArgument, ResolvedOptions, plan_march, resolve_options, warn_missed
from jaxshroud.verbs.jumps import with_jumps
from jaxshroud.verbs.lanes import check_row, flatten_lanes, refuse_traced
from jaxshroud.verbs.settled import in_state, require_state
from jaxshroud.verbs.stored import SweepTask, store_sweep
from jaxshroud.verbs.sweep_run import (
    MAX_LANES_AT_ONCE,
    Grid,
    SweepSettings,
    confirmed_run,
    lane_periods,
    run_map,
    run_sweep,
)


@typed
def sweep(
    scene: Scene | SceneFile,
    along: Mapping[str, ArrayLike | Sequence[float]] | None = None,
    *,
    direction: Direction | None = None,
    phase: float = 0.0,
    period_tol: float = PERIOD_TOLERANCE,
    ledger: bool = False,
    lyapunov: bool = False,
    forces: bool = False,
    amplitudes: bool = False,
    confirm: bool = False,
    keep_samples: bool = True,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    scheduler: str | None = None,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
    linear: LinearState | None = None,
) -> SweepResult:
    """Simulate scenes at every value (or pair of values) of one or two of their numbers, or as they are.

    Args:
        scene: The scene that all lanes share, or many with leading axes, which then come first in all results; or a
            scene file, whose [run] and [sweep] count where an argument is not given.
        along: One or two keys as for `vary`, each with its values (n,) in SI units; two make a grid. None: those of the
            file, or the scenes as they are (one scene is a lane of its own).
        direction: "independent" (the default): every lane starts from `scene.initial`. "forward" or "backward": along
            the first key each value starts from the final state of its neighbour, including slider and mode. "both":
            these two and "independent", in a leading dimension `direction`; over one key the result shows where the
            motion jumps (`jump`; every large step is halved up to five times for this, in stores and of interrupted
            runs it is given as `steep`) and where the directions reach different motions (`coexisting`).
        phase: Drive phase omega t at which samples are taken, 0 <= phase < 2 pi [rad].
        period_tol: Tolerance of the period number, see `periodicity`.
        ledger: Keep the energy balance of every lane.
        lyapunov: Also compute the largest Lyapunov exponent and its interval: over as many further periods as are kept,
            in float64, from one tangent per lane (at some ten times the cost of these periods).
        forces: Keep the largest contact forces and the work of friction of every lane, and its energy balance with
            them. Forces are taken on both sides of every event, and inside each step from cubics through the values and
            rates at its ends, so that the part of a maximum that is missed falls as the fourth power of the step; the
            friction of smooth contact is taken at the ends of steps only. With them come the loads that wear the faces
            (slip, normal load, impacts). Of rows of blades all of these are given for each interface.
        amplitudes: Keep the mean of x, y and theta of both blades, their root mean square about it with the half width
            of its 95 % interval (`x_rms_ci`, ...), and their amplitude (largest distance from the mean; of an aperiodic
            motion the largest of the kept periods), at a third more time.
        confirm: Run every lane again with half the step, a tenth of the tolerance and a quarter of `flat_return`, and
            mark those that settle on another motion (`unconfirmed`); of independent lanes, at some twice the time.
        keep_samples: Keep the samples of each lane. Without them memory is bounded: for maps of many lanes.
        store: The folder (.zarr) of a Zarr store, to which the result is written block by block: for more lanes than
            fit in memory, and for runs that may be killed. The result is read from there.
        resume: Continue the store if it exists; it must be of the same sweep, version and kind of device. Complete
            blocks are not computed again, and the numbers are those of a run without an interruption. Forward and
            backward sweeps continue after their last finished stretch of values. If there is no store, begin one.
        scheduler: Have the blocks of a store computed by workers of Dask distributed, which is installed with
            `jaxshroud[cluster]`: the address of their scheduler, the file that it has written, or "local:N" for N
            processes on this machine (in a script, under `if __name__ == "__main__":`). Workers may come and go.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0: one state for all lanes, or one for each; by default `scene.initial`,
            apart.
        progress: Called with (lane-periods done, lane-periods in all) after every block.
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.
        linear: "apart" or "stuck": in closed form, of contact that stays in this state, see `power`; a lane whose
            contact leaves it has the status NOT_LINEAR.

    Returns:
        Samples and statistics of every lane. A lane that failed has a status and NaN; the others are not affected.

    Raises:
        ValueError: A count is too small, an axis is empty, the phase or the tolerance is out of range, the direction is
            unknown, the run would be too long or too large, or JAX has no float64.
        KeyError: The scene has no such number.
        NumericalError: With `throw`: a lane stopped.
        MachineError: The scheduler cannot be reached.
        StoreError: The store exists and `resume` is not set, is of another sweep, is in use, or cannot be written.
        Interrupted: Ctrl-C; its `done` is the result with the lanes that had ended, the others with status NOT_RUN, or
            None where none had.

    Source:
        Sec. 3.2 of the article: samples at one phase of the drive, and Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> short = dict(n_periods=2, transient=1, method=js.RungeKutta(steps=200))
        >>> curve = js.sweep(scene, {"contact.gamma": [1.0, 2.0]}, **short)
        >>> curve.motion.x.shape, curve.P_d.shape
        ((2, 2, 2), (2,))
    """
    resolved = resolve_options(
        in_state(scene, linear),
        n_periods=n_periods,
        transient=transient,
        method=method,
        dims=dims,
        of_sweep=True,
        verb="sweep",
    )
    check_row(resolved.scene, lyapunov=lyapunov)
    if not 0 <= phase < 2 * np.pi:
        raise InputError(f"Argument `phase` must be in [0, 2 pi), but is {phase}.")
    tolerance_argument("period_tol", period_tol)
    grid, direction = _grid_of(resolved, along, direction)
    require_state(grid.lanes)
    if confirm and direction != "independent":
        raise InputError(f"Argument `confirm` is of independent lanes, but `direction` is {direction!r}.")
    directions = SINGLE_DIRECTIONS if direction == "both" and not is_linear(grid.lanes) else (direction,)
    lanes = len(directions) * math.prod(grid.shape)
    path = _store_path(store, resume)
    lanes_in_memory = None if keep_samples and path is None else min(lanes, MAX_LANES_AT_ONCE)
    blades = resolved.scene.layout.blades
    check_size(lanes, resolved.transient, resolved.n_periods, lanes_in_memory, blades)
    grid = grid._replace(lanes=without_given(grid.lanes))
    march = plan_march(grid.resolved, grid.lanes, FOR_P_D._replace(ledger=ledger))
    ledger = march.method.ledger or forces
    march = march._replace(method=march.method._replace(ledger=ledger, forces=forces, amplitudes=amplitudes))
    grid = grid._replace(
        precise=in_precision(grid.lanes, "float64") if lyapunov else None,
        lanes=in_precision(grid.lanes, march.method.precision),
        numbers=np.arange(math.prod(grid.shape)),
    )
    states = None if state is None else resolved.states(state, grid.lanes)
    plan = march.plan(resolved.transient, resolved.n_periods, phase)
    periods = lane_periods(plan, lyapunov) + confirm * lane_periods(plan, lyapunov=False)
    ticker = Ticker(lanes * periods, progress)
    settings = SweepSettings(plan, march, period_tol, ticker, keep_samples, confirm=confirm)
    if path is None and scheduler is not None:
        raise InputError("Argument `scheduler` needs a `store`, which keeps what workers have computed.")
    run_direction = run_sweep if keep_samples else run_map
    if path is not None:
        result = store_sweep(SweepTask(grid, states, direction, settings), path, scheduler)
    elif direction == "both" and is_linear(grid.lanes):  # a settled motion has no direction
        settled = run_direction(grid, states, "independent", settings)
        result = overlay_directions(dict.fromkeys(SINGLE_DIRECTIONS, settled))
    elif direction == "both":
        result = _in_all_directions(grid, states, settings)
    else:
        result = confirmed_run(lambda how: run_direction(grid, states, direction, how), settings)
    warn_failures(result.status, result.chatter, throw=throw)
    if march.tried is not None:
        warn_missed(result.inaccurate, march.tried, result.energy_dropped)
    return result


def _in_all_directions(grid: Grid, states: State | None, settings: SweepSettings) -> SweepResult:
    """The result of a sweep in all directions, with its jumps where it is along one number alone.

    Raises:
        Interrupted: Ctrl-C; `done` has the directions that had ended, and the finished part of the current one.
    """
    results: dict[str, SweepResult] = {}
    ends: dict[str, list[SweepHandover]] = {}
    for direction in SINGLE_DIRECTIONS:
        handover = SweepHandover(history=[])
        try:
            results[direction] = run_sweep(grid, states, direction, settings, handover)
        except Interrupted as stopped:
            finished = results if stopped.done is None else {**results, direction: stopped.done}
            raise Interrupted(overlay_directions(finished) if finished else None) from None
        if handover.history:
            ends[direction] = handover.history
    result = overlay_directions(results)
    if result.steep is None:
        return result
    try:
        return with_jumps(result, ends, partial(_lane_between, grid, settings))
    except Interrupted:
        raise Interrupted(result) from None


def _lane_between(grid: Grid, settings: SweepSettings, value: float, handover: SweepHandover) -> SweepResult:
    """A lane between two values of a sweep along one number, from where a neighbour has ended."""
    axes = {key: np.array([value]) for key in grid.axes}
    scenes = flatten_lanes(grid_of_scenes(grid.resolved.scene, axes), len(axes))
    lane = in_precision(without_given(scenes), settings.march.method.precision)
    settings.ticker.total += lane_periods(settings.plan, lyapunov=False)
    untried = settings._replace(march=settings.march.untried)
    return run_sweep(Grid(grid.resolved, lane, axes), None, "forward", untried, handover)


def _store_path(store: str | os.PathLike[str] | None, resume: bool) -> Path | None:
    """The folder of the store; None without a store.

    Raises:
        InputError: `resume` is given without a store, or the name does not end in .zarr.
        StoreError: The folder exists, and is not to be resumed.
    """
    if store is None:
        if resume:
            raise InputError("Argument `resume` needs a `store` to continue.")
        return None
    path = Path(store)
    if path.suffix != ".zarr":
        raise InputError(f"Argument `store` must name a folder that ends in .zarr, but is {path}.")
    if path.exists() and not resume:
        raise StoreError(f"{path}: exists and is kept; resume it, or choose another place")
    return path


def _grid_of(
    resolved: ResolvedOptions, along: Mapping[str, ArrayLike | Sequence[float]] | None, direction: Direction | None
) -> tuple[Grid, Direction]:
    """The scenes of a sweep, and its direction."""
    file = resolved.file
    if along is not None and file is not None:
        resolved = resolved._replace(file=replace(file, axes=(), keep=None))  # results show no other sweep
    elif file is not None:
        along = {a.key: a.values for a in file.axes}
        direction = direction or file.direction
    refuse_traced(along)
    axes = {key: np.atleast_1d(np.asarray(values, dtype=float)) for key, values in (along or {}).items()}
    is_empty = along is not None and file is None and not axes
    if is_empty or len(axes) > 2 or any(v.ndim != 1 or v.size == 0 for v in axes.values()):
        raise InputError("Argument `along` must name one or two keys, each with at least one value.")
    if not axes and not resolved.shape:
        resolved = resolved._replace(scene=resolved.lanes, shape=(1,), dims=("lane",))
    if direction not in (None, "independent") and not axes:
        raise InputError(f"Argument `direction` = {direction!r} needs `along`: it follows the values of its first key.")
    scenes = grid_of_scenes(resolved.scene, axes) if axes else resolved.scene
    return Grid(resolved, flatten_lanes(scenes, len(resolved.shape) + len(axes)), axes), direction or "independent"
