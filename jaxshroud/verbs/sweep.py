"""Many scenes at once: bifurcation diagrams and power curves over any number of a scene."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress, Ticker
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import FAST, Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.state import State
from jaxshroud.motion.period import PERIOD_TOLERANCE
from jaxshroud.results.directions import overlaid
from jaxshroud.results.status import tell_failures
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import tolerance_argument, word_argument
from jaxshroud.scene.errors import InputError, StoreError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.parts import WAYS, Direction
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import Choice
from jaxshroud.verbs.door import Asked, asked, in_line, marched
from jaxshroud.verbs.stored import Ordered, stored
from jaxshroud.verbs.swept import AT_ONCE, Grid, Wanted, lane_periods, mapped, swept


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
    accuracy: str | float | Choice | None = None,
    state: State | None = None,
    ledger: bool = False,
    lyapunov: bool = False,
    forces: bool = False,
    samples: bool = True,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    scheduler: str | None = None,
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
            chooses steps and method, see `choose`; or what that has chosen.
        state: Where to start, at drive phase 0: one state, or one for each of the scenes.
        ledger: Keep every lane's energy balance.
        lyapunov: Compute the largest Lyapunov exponent too, with its interval: of as many periods more as are kept, in
            float64, from one tangent of each lane (some ten times the cost of these periods).
        forces: Keep every lane's largest forces of contact and the work of friction, and its energy balance with them.
            Forces are looked at on both sides of every event, and inside each step by cubics through values and rates
            at its ends, so that what is missed falls as the fourth power of the step; the friction of smooth contact is
            looked at where steps end.
        samples: Keep the samples of each lane. Without them memory is bounded: for maps of many lanes.
        store: Where to keep the result, a Zarr store that is written block by block: for more lanes than memory holds,
            and for runs that may be killed. What comes back is read from there.
        resume: Go on with the store that is there, which must be of the same sweep, version and kind of device: what is
            whole there is not computed again, and numbers are those of a run that nothing has ended. Forward and
            backward sweeps go on from their last finished block of values. Without a store, begin.
        scheduler: Have the blocks of a store computed by workers of Dask distributed, which is installed with
            `jaxshroud[cluster]`: the address of their scheduler, the file it has written, or "local:N" for N processes
            on this machine (in a script, under `if __name__ == "__main__":`). Workers may come and go.
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
        MachineError: The scheduler cannot be reached.
        StoreError: The store exists and is not to be gone on with, is of another sweep, in use, or cannot be written.
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
    place = _place(store, resume)
    fits(lanes, door.transient, door.n_periods, None if samples and place is None else min(lanes, AT_ONCE))
    how = marched(grid.door, grid.lanes, FAST._replace(ledger=ledger))
    if forces:
        how = how._replace(method=how.method._replace(ledger=True, forces=True))
    precise = in_precision(grid.lanes, "float64") if lyapunov else None
    marched_lanes, numbers = in_precision(grid.lanes, how.method.precision), np.arange(math.prod(grid.shape))
    grid = grid._replace(lanes=marched_lanes, precise=precise, numbers=numbers)
    states = None if state is None else door.states(state, grid.lanes)
    plan = Plan(door.transient, door.n_periods, how.steps, phase, how.method)
    wanted = Wanted(plan, how, period_tol, Ticker(lanes * lane_periods(plan, lyapunov), progress), samples)
    if place is None and scheduler is not None:
        raise InputError("Argument `scheduler` needs a `store`, which keeps what workers have computed.")
    one_way = swept if samples else mapped
    if place is not None:
        found = stored(Ordered(grid, states, direction, wanted), place, scheduler)
    elif direction == "both":
        found = _overlaid(lambda way: one_way(grid, states, way, wanted))
    else:
        found = one_way(grid, states, direction, wanted)
    tell_failures(found.status, found.chatter, throw=throw)
    return found


def _overlaid(one_way: Callable[[Direction], SweepResult]) -> SweepResult:
    """A sweep in all directions.

    Raises:
        Interrupted: Ctrl-C; `done` has the directions that had ended, and what had of the one under way.
    """
    found: dict[str, SweepResult] = {}
    for way in WAYS:
        try:
            found[way] = one_way(way)
        except Interrupted as stopped:
            known = found if stopped.done is None else {**found, way: stopped.done}
            raise Interrupted(overlaid(known) if known else None) from None
    return overlaid(found)


def _place(store: str | os.PathLike[str] | None, resume: bool) -> Path | None:
    """Where the result is to be kept."""
    if store is None:
        if resume:
            raise InputError("Argument `resume` needs a `store` to go on with.")
        return None
    place = Path(store)
    if place.suffix != ".zarr":
        raise InputError(f"Argument `store` must name a folder that ends in .zarr, but is {place}.")
    if place.exists() and not resume:
        raise StoreError(f"{place}: exists and is kept; resume it, or choose another place")
    return place


def _grid_of(door: Asked, along: Mapping[str, Any] | None, direction: Direction | None) -> tuple[Grid, Direction]:
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
    return Grid(door, in_line(scenes, len(door.shape) + len(axes)), axes), direction or "independent"
