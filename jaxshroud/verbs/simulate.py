"""Trajectories of one scene or many, with all of their start-up."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.closed_form import free_samples
from jaxshroud.batch.runs import Progress, Ticker, zeno_report
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.size_limits import STEP_BYTES, check_memory
from jaxshroud.batch.trajectories import Trajectories, trajectories
from jaxshroud.io.lane_status import warn_failures
from jaxshroud.march.method import REFERENCE, Choices, Method
from jaxshroud.march.observables import is_unbalanced
from jaxshroud.march.tally import Counters
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import ContactLoads
from jaxshroud.motion.amplitudes import sampled_amplitude_values
from jaxshroud.motion.averages import contact_shares
from jaxshroud.motion.short_runs import trajectory_ends
from jaxshroud.results.base import Labels
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.accuracy import missed_lanes, warn_missed
from jaxshroud.verbs.options import ResolvedOptions, check_row, in_shape, plan_march, resolve_options


@typed
def simulate(
    scene: Scene | SceneFile,
    state: State | None = None,
    *,
    every: int = 1,
    turns: float = 0.0,
    t: float = 0.0,
    events: bool = False,
    n_periods: int | None = None,
    method: Method | str | float | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Trajectory:
    """Integrate Eq. (1), stopping inside a step at every contact change.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        state: Where to start, at drive phase `turns`: one state for all lanes, or one for each; by default
            `scene.initial`, apart. In a start with overlapping blocks contact begins at once.
        every: Steps from one sample to the next.
        turns: Phase of the drive at the start [turns]; 0 for t = 0.
        t: Time at the start [s].
        events: Also keep the states on both sides of every contact event, as `run.events`; for a single scene.
        n_periods: Drive periods run; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (lane-steps done, lane-steps in all).
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The initial state, after what happens there at once, and then every `every`-th of
        `n_periods * steps_per_period` steps, start-up included, with the contact forces `N` and `F` [N], `v`, `u` and
        `contact_point` [m], which is NaN while the faces are apart (JAX's `debug_nans` takes that for an error). A
        model without contact has none of these, a model whose blocks do not turn has no `contact_point`, and without
        friction `F` is 0. Amplitudes are those of the second half of the run, from the cubics between its steps,
        whichever of these are kept. What is told of contact in a row ends with the interface.

    Raises:
        ValueError: A count is not a positive integer, the samples would not fit into memory, or `events` is set for
            many scenes or for a model without events.
        NumericalError: With `throw`: a lane stopped.

    Source:
        Eq. (1), Sec. 3.1, in SI; not Eq. (21), whose time scaling is inconsistent.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> run = js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=200))
        >>> run.t.shape, run.motion.x.shape, run.status
        ((201,), (201, 2), 0)
    """
    count_argument("every", every, 1)
    resolved = resolve_options(scene, n_periods=n_periods, method=method, dims=dims, verb="simulate")
    check_row(resolved.scene, events=events)
    if events and (resolved.shape or resolved.scene.parts.contact != "spring"):
        raise InputError("Argument `events` keeps those of one scene with located contact; simulate it alone.")
    lanes = resolved.lanes
    march = plan_march(resolved, lanes, REFERENCE, periods=resolved.n_periods, ends=trajectory_ends)
    scenes = in_precision(without_given(lanes), march.method.precision)
    length, half = resolved.n_periods * march.steps, max(resolved.n_periods // 2, 1)
    grid = SampleGrid(turns, march.steps, every, length, events, half * march.steps)
    count = grid.samples
    check_memory("what is stored of this run", len(scenes.drive.omega) * count * STEP_BYTES)
    states = resolved.states(state, scenes)
    index = np.arange(count + 1) * every
    if scenes.parts.contact == "none":
        values = _values_without_contact(scenes, states, grid)
    else:
        values = _marched_values(scenes, states, grid, march.method, Ticker(len(scenes.drive.omega) * length, progress))
    chatter, at_events = values.pop("chatter", None), values.pop("events", None)
    step_length = np.asarray(scenes.drive.period, float)[:, None] / march.steps
    after = float((turns + (index[-1] % march.steps) / march.steps) % 1)
    common = {"turns": after, "every": every, "chatter": chatter, **march.attributes}
    if at_events is not None:
        values["events"] = {**at_events, "t": t + at_events["t"] * step_length}
    columns = {"omega": scenes.drive.omega, "gap": scenes.shroud.gap, **values, "t": t + index * step_length}
    result = _trajectory(resolved, in_shape(columns, resolved.shape), common)
    warn_failures(result.status, chatter, throw=throw)
    if march.choice is not None:
        warn_missed(missed_lanes(lanes, march.choice, trajectory_ends), march.choice)
    return result


def _trajectory(resolved: ResolvedOptions, values: dict[str, Any], common: dict[str, Any]) -> Trajectory:
    """The result from the values of all lanes and those that they share."""
    attributes, numbers = resolved.provenance(0, common["steps_per_period"])
    times = values.pop("t")
    time = {"units": "s", "long_name": "time"}
    layout = resolved.scene.layout
    coords = {**layout.coords, **({} if resolved.shape else {"time": ("time", times, time)})}
    more = {"t": ((*resolved.dims, "time"), times, time)} if resolved.shape else {}
    labels: Labels = {"lanes": resolved.dims, "attrs": attributes, "more": {**numbers, **more}}
    return Trajectory.from_values({**values, **common}, coords=coords, layout=layout, **labels)


def _marched_values(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Ticker) -> dict[str, Any]:
    """The values of lanes (leading axis) that are marched."""
    marched = trajectories(scenes, states, grid, method, ticker)
    log, at_start = marched.last.tally.log, marched.samples["mode"][:, 0]
    assert log is not None  # as derivatives are not computed
    return {
        **marched.samples,
        "counters": {n: np.asarray(a) for n, a in vars(filled(log.counters, at_start)).items()},
        **_energy_values(scenes, marched),
        **_load_values(scenes, marched.last.tally.integrals.loads, at_start, grid),
        **contact_shares(log.times),
        **sampled_amplitude_values(scenes, marched.amplitudes),
        "chatter": _chatter(scenes, marched, grid, method),
        "events": marched.events,
    }


def _energy_values(scenes: Scene, marched: Trajectories) -> dict[str, np.ndarray]:
    """The works [J], the energy balance, NaN without a ledger, and the status of lanes with what it shows."""
    last, (before, after), balance = marched.last, marched.energies, marched.balance
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        integrals = jax.tree.leaves((last.tally.integrals, after - before))
        finite = np.isfinite(sum(np.asarray(a, float).reshape(len(before), -1).sum(axis=-1) for a in integrals))
    status = np.where((last.status == Status.OK) & ~finite, Status.NOT_FINITE, last.status)
    if balance is None:
        missing = np.full(len(before), np.nan)
        return {"status": status, "energy_residual": missing, "energy_dropped": missing}
    gain, residual = balance.works, balance.residual
    if scenes.laws is not None:
        astray = is_unbalanced(*map(jnp.asarray, (residual, gain.gross, before, after)))
        status = np.where((status == Status.OK) & np.asarray(astray), Status.UNBALANCED, status)
    works = {"work_drive": gain.drive, "loss_viscous": gain.viscous, "loss_friction": gain.friction}
    return {
        "status": status,
        "energy_residual": (residual / np.where(gain.drive == 0, 1.0, np.abs(gain.drive))).astype(float),
        "energy_dropped": (balance.dropped / np.where(gain.gross > 0, gain.gross, 1.0)).astype(float),
        **{name: np.asarray(a, float) for name, a in {**works, **balance.of_blades}.items()},
    }


def _load_values(
    scenes: Scene, loads: ContactLoads | None, like: np.ndarray, grid: SampleGrid
) -> dict[str, np.ndarray]:
    """What wears the faces over the whole run, if it was logged."""
    if loads is None:
        return {}
    N, N_slip, time_slip, slip = (np.asarray(a, float) for a in filled(loads, like.astype(scenes.drive.omega.dtype)))
    periods = grid.length / grid.steps
    duration = np.asarray(scenes.drive.period, float)[:, None] * periods
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"slip": slip / periods, "N_mean": N / duration, "N_slip": N_slip / time_slip}


def _chatter(scenes: Scene, marched: Trajectories, grid: SampleGrid, method: Choices) -> str | None:
    """The report on events that follow each other without end; None if there are none."""
    last, times = marched.last, marched.last.tally.log.times
    took = sum(np.asarray(a).reshape(len(last.status), -1)[:, 0] for a in times)  # the same at all interfaces
    steps = took / grid.step_lengths(scenes)
    whole = np.round((steps - last.step - last.search.done) / grid.steps).astype(int)
    return zeno_report(scenes, last, whole + 1, grid.clock(scenes), method)


def _values_without_contact(scenes: Scene, states: State, grid: SampleGrid) -> dict[str, Any]:
    """The values of lanes (leading axis) in closed form."""
    motion, amplitudes, status = free_samples(scenes, states.motion, grid)
    shape = motion.x.shape[:2]
    apart, zero = np.zeros(shape, np.int32), np.zeros(shape[0])
    return {
        "motion": motion,
        **sampled_amplitude_values(scenes, amplitudes),
        "u_s": np.full(shape, np.nan),
        "mode": apart,
        "case": apart,
        "status": status,
        "counters": dict.fromkeys(Counters.__annotations__, np.zeros(shape[0], int)),
        "energy_residual": zero,
        "energy_dropped": zero,
    }
