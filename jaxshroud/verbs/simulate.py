"""Trajectories of one scene or many, with all of their start-up."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxshroud.batch.lanes import final_states
from jaxshroud.batch.limits import STEP_BYTES, check_memory
from jaxshroud.batch.plan import Progress, Ticker
from jaxshroud.batch.runs import trajectories
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import zeno_of_trajectories
from jaxshroud.io.lane_status import warn_failures
from jaxshroud.march.method import REFERENCE, Choices
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.prepared import State
from jaxshroud.orbits.short_runs import trajectory_ends
from jaxshroud.results.amplitudes import contact_values
from jaxshroud.results.base import Labels
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.amplitudes import sampled_amplitude_values
from jaxshroud.signals.averages import contact_shares
from jaxshroud.verbs.arguments import MethodArgument, ResolvedOptions, plan_march, resolve_options, warn_missed
from jaxshroud.verbs.lanes import check_row, in_shape
from jaxshroud.verbs.trials import missed_lanes


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
    method: MethodArgument = None,
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
        whichever of these are kept. What is known of contact in a row ends with the interface.

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
    length = resolved.n_periods * march.steps
    half = max(resolved.n_periods // 2, 1)
    grid = SampleGrid(turns, march.steps, every, length, events, half * march.steps)
    count = grid.samples
    check_memory("what is stored of this run", len(scenes.drive.omega) * count * STEP_BYTES)
    states = resolved.states(state, scenes)
    index = np.arange(count + 1) * every
    ticker = Ticker(len(scenes.drive.omega) * length, progress)
    values = _sampled_values(scenes, states, grid, march.method, ticker)
    chatter, at_events = values.pop("chatter", None), values.pop("events", None)
    step_length = np.asarray(scenes.drive.period, float)[:, None] / march.steps
    after = float((turns + (index[-1] % march.steps) / march.steps) % 1)
    common = {"turns": after, "every": every, "chatter": chatter, **march.attributes}
    if at_events is not None:
        values["events"] = {**at_events, "t": t + at_events["t"] * step_length}
    columns = {"omega": scenes.drive.omega, "gap": scenes.running_shroud.gap, **values, "t": t + index * step_length}
    result = _trajectory(resolved, in_shape(columns, resolved.shape), common)
    warn_failures(result.status, chatter, throw=throw)
    if march.tried is not None:
        warn_missed(missed_lanes(lanes, march.tried, progress), march.tried, result.energy_dropped)
    return result


def _trajectory(resolved: ResolvedOptions, values: dict[str, Any], common: dict[str, Any]) -> Trajectory:
    """The result from the values of all lanes and those that they share."""
    attributes, numbers = resolved._replace(transient=0).provenance(common["steps_per_period"])
    times = values.pop("t")
    time = {"units": "s", "long_name": "time"}
    layout = resolved.scene.layout
    coords = {**layout.coords, **({} if resolved.shape else {"time": ("time", times, time)})}
    more = {"t": ((*resolved.dims, "time"), times, time)} if resolved.shape else {}
    labels: Labels = {"lanes": resolved.dims, "attrs": attributes, "more": {**numbers, **more}}
    return Trajectory.from_values({**values, **common}, coords=coords, layout=layout, **labels)


def _sampled_values(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Ticker) -> dict[str, Any]:
    """The values of lanes (leading axis)."""
    found = trajectories(scenes, states, grid, method, ticker)
    of_modes = {} if scenes.mode_numbers is None else contact_values(final_states(found.last.state))
    return {
        "modal": of_modes.get("modal"),
        **found.samples,
        "status": found.status,
        "counters": found.counters,
        **found.energy,
        **_load_values(scenes, found.loads, found.samples["mode"][:, 0], grid),
        **({} if found.times is None else contact_shares(found.times)),
        **sampled_amplitude_values(scenes, found.amplitudes),
        "chatter": zeno_of_trajectories(scenes, found, grid, method),
        "events": found.events,
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
