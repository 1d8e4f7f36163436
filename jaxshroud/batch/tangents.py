"""Tangents: the march, and sampled motions, with the derivative along given directions, forward in time.

Each lane carries one tangent, so that several directions of one scene are several lanes with the same scene: a batch
over scenes is also a batch over directions.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.activity import counted
from jaxshroud.batch.duals import Dual, with_tangent
from jaxshroud.batch.flows import begin_flows, end_flows, flow_with_tangents, lanes_per_flow
from jaxshroud.batch.lanes import (
    from_vector,
    in_scene_precision,
    initial_states,
    motion_rows,
    shroud_motion,
    to_vector,
)
from jaxshroud.batch.limits import CallPace, check_memory
from jaxshroud.batch.periods import CallLimits, first_passes, in_calls, part_done
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.pure_functions import Schedule, samples_with_tangents
from jaxshroud.batch.runs import require_march
from jaxshroud.batch.threads import Check, in_chunks
from jaxshroud.batch.xla import best_mapping, repeat_lane
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.derived_inputs import DERIVED_BY_KEY, worked_out
from jaxshroud.scene.keys import find_key, number_shape
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.vary import field_of, given_of, numbers_of


def run_flow(scenes: Dual, states: Dual, n: int, steps: int, method: Choices, turns: np.ndarray | None = None) -> Dual:
    """`flow_with_tangents` of any number of lanes, in chunks that share one compiled function; NumPy arrays.

    Numbers of blades have a last axis of them; a row's means are of all blades, those of the pair of the left block.
    With `turns` (lanes,) they run as many drive periods each, of any length, `n` times; `steps` are those of a period.
    """
    require_march(scenes.value, method)
    lanes = len(scenes.value.drive.omega)
    few, many = lanes_per_flow(scenes.value.layout)
    width = many if lanes > 2 * few else few
    if turns is None and method.amplitudes:  # one program for both
        turns = np.ones(lanes)

    with counted("periods with derivatives", lanes * n) as count:

        def run(check: Check, at: np.ndarray) -> Dual:
            scene, state, lengths = jax.tree.map(lambda a: np.asarray(a)[at], (scenes, states, turns))
            own = min(width, lanes - int(at[0]))  # the rest of the last chunk are copies

            def tick(periods: float) -> None:
                count(periods * own)
                check()

            return _run_in_calls(scene, state, n, steps, lengths, method, tick)

        return in_chunks(run, lanes, width)


def _run_in_calls(
    scenes: Dual, states: Dual, n: int, steps: int, turns: np.ndarray | None, method: Choices, tick: Tick
) -> Dual:
    """The flow of lanes, in calls to the device that are short enough for an interruption to take effect soon.

    `tick` is called after each with the number of periods that it made, parts of one included.
    """
    omega, layout = scenes.value.drive.omega, scenes.value.layout
    counts = jnp.int32(steps)
    lengths = None
    if turns is not None:
        counts, lengths = jnp.asarray(np.ceil(steps * turns), jnp.int32), jnp.asarray(turns, omega.dtype)
    flat = np.asarray(method.flat_return, omega.dtype)

    def call(lanes: Dual, limits: CallLimits) -> tuple[Dual, Any, None]:
        options = {"steps": counts, "flat_return": flat, "turns": lengths, "method": method, "each": best_mapping()}
        return *flow_with_tangents(scenes, lanes, limits, **options), None

    def part(lanes: Dual) -> float:
        return part_done(lanes.value, counts)

    pace = CallPace(first_passes(len(omega), layout))
    lanes, _ = in_calls(call, begin_flows(scenes, states, method), n, n, pace, tick, part)
    return jax.tree.map(np.asarray, end_flows(scenes, lanes, jnp.int32(n), lengths))


def without_direction(states: State) -> Dual:
    """States that do not depend on the direction."""
    motion, u_s = jax.tree.map(np.zeros_like, (states.motion, states.u_s))
    return Dual(states, State(motion, u_s, None, None))


def end_as_start(end: Dual) -> Dual:
    """The states at the end of a flow, as initial states of the next."""
    state, tangent = end.value.own, end.tangent.own
    return Dual(state, State(tangent.motion, tangent.u_s, None, None))


class Tangents(NamedTuple):
    """The flow of a scene over some periods, and its derivatives by the initial state and by some parameters.

    A state is a vector of so many numbers, 13 of the pair: x, y, theta, or the modal coordinates, and their rates, each
    blade by blade, then the sliders.
    """

    end: State
    vector: np.ndarray  # (numbers,) of `end`
    power: np.ndarray  # (blades,) mean square displacement over block and time [m^2]
    status: int
    by_state: np.ndarray  # (numbers, numbers) d vector / d start
    power_by_state: np.ndarray  # (blades, numbers)
    by_parameter: np.ndarray  # (numbers, parameters)
    power_by_parameter: np.ndarray  # (blades, parameters)
    # The means over time of x, y, theta and of their squares; None unless the method has `amplitudes`.
    moments: np.ndarray | None = None  # (2, 3, blades)
    moments_by_state: np.ndarray | None = None  # (2, 3, blades, numbers)
    moments_by_parameter: np.ndarray | None = None  # (2, 3, blades, parameters)
    # The means over time of x, y, sin(theta) and 1 - cos(theta), of the left block of a pair or of all of a row; None
    # unless the method has `vibration`.
    means: np.ndarray | None = None  # (4, blades)
    means_by_state: np.ndarray | None = None  # (4, blades, numbers)
    means_by_parameter: np.ndarray | None = None  # (4, blades, parameters)
    # The shrouds at the end: x, y and theta, each blade by blade, and their rates.
    shroud: np.ndarray | None = None  # (6 blades,)
    shroud_by_state: np.ndarray | None = None  # (6 blades, numbers)
    shroud_by_parameter: np.ndarray | None = None  # (6 blades, parameters)


class TangentProblem(NamedTuple):
    """A scene, its initial state, and the directions in which its flow is differentiated."""

    scene: Scene
    state: State
    directions: Sequence[Scene] = ()  # derivative of the scene by each parameter
    by_state: bool = True  # whether to differentiate by the initial state too

    @property
    def by_start(self) -> int:
        """The number of directions of the initial state."""
        return self.scene.state_size if self.by_state else 0

    @property
    def lanes(self) -> int:
        """The number of lanes, one for each direction, and at least one."""
        return max(self.by_start + len(self.directions), 1)

    @property
    def duals(self) -> tuple[Dual, Dual]:
        """The scenes and the states of its lanes."""
        lanes = self.lanes
        state = in_scene_precision(self.state, self.scene)
        scene = without_given(self.scene)
        still = [jax.tree.map(np.zeros_like, scene)] * (lanes - len(self.directions))
        along = jax.tree.map(lambda *a: np.stack(a), *still, *self.directions)
        size = scene.state_size
        unit = np.zeros((lanes, size), scene.drive.omega.dtype)
        unit[: self.by_start] = np.eye(size)[: self.by_start]
        shift = from_vector(unit, None, None, scene)
        return Dual(repeat_lane(scene, lanes), along), Dual(repeat_lane(state, lanes), shift)

    def tangents(self, flows: Dual) -> Tangents:
        """The tangents from the flow of its lanes."""
        value, slope = flows
        end = jax.tree.map(lambda a: a[0], end_as_start(flows).value)
        by = to_vector(slope.own)
        count = self.by_start
        power_by = np.ascontiguousarray(slope.power.T)
        found = Tangents(
            end=end,
            vector=to_vector(end),
            power=value.power[0],
            status=int(value.status[0]),
            by_state=by[:count].T,
            power_by_state=power_by[:, :count],
            by_parameter=by[count:].T,
            power_by_parameter=power_by[:, count:],
        )
        more = {}
        arrays = {"moments": _moments_array, "means": _means_array, "shroud": lambda motion: motion_rows(motion).T}
        parts = [{"shroud": flow.state.motion, "moments": flow.moments, "means": flow.means} for flow in flows]
        for name, array in arrays.items():
            if parts[0][name] is not None:
                a, a_by = (array(part[name]) for part in parts)
                more |= {name: a[..., 0], f"{name}_by_state": a_by[..., :count]}
                more |= {f"{name}_by_parameter": a_by[..., count:]}
        return found._replace(**more)


def _moments_array(moments: Any) -> np.ndarray:
    """Moments, (2, 3, blades, lanes)."""
    return np.array([[a.T for a in m] for m in moments])


def _means_array(means: Any) -> np.ndarray:
    """Means of x, y, sin(theta) and 1 - cos(theta), (4, blades, lanes)."""
    return np.array([a.T for a in means])


def batched_tangents(
    problems: Sequence[TangentProblem],
    *,
    n: int,
    steps: int,
    method: Choices,
    turns: Sequence[float] | None = None,
) -> list[Tangents]:
    """The flows over `n` periods from drive phase 0 with all tangents, as one batch of lanes.

    Args:
        problems: Those whose scenes have one structure.
        n: Drive periods.
        steps: Runge-Kutta steps in one period.
        method: The options of the march, `as_differentiable`.
        turns: Drive periods of each problem, of any length, in the place of one.
    """
    scenes, states = jax.tree.map(lambda *a: np.concatenate(a), *(problem.duals for problem in problems))
    lengths = None if turns is None else np.repeat(turns, [problem.lanes for problem in problems])
    flows = run_flow(scenes, states, n, steps, method, lengths)
    ends = np.cumsum([problem.lanes for problem in problems])

    def part(end, lanes):
        return jax.tree.map(lambda a: a[end - lanes : end], flows)

    return [problem.tangents(part(end, problem.lanes)) for problem, end in zip(problems, ends, strict=True)]


def tangents(
    scene: Scene,
    state: State,
    directions: Sequence[Scene],
    *,
    n: int,
    steps: int,
    method: Choices,
    by_state: bool = True,
) -> Tangents:
    """The flow of one scene with all its tangents; see `batched_tangents`."""
    (result,) = batched_tangents([TangentProblem(scene, state, directions, by_state)], n=n, steps=steps, method=method)
    return result


def direction(scene: Scene, key: str) -> Scene:
    """The derivative of scenes by one of their own numbers or inputs, or by that of all blades together.

    Numbers that are worked out from it move with it. What the scenes are given by is left out.
    """
    row, place = find_key(key, layout=scene.layout)
    numbers = numbers_of(scene)
    given = given_of(scene)
    holder = given if row.name in DERIVED_BY_KEY else numbers
    old = holder[row.name]
    unit = np.ones(()) if place is None else np.eye(number_shape(row, scene.layout)[0])[place]
    unit = np.broadcast_to(unit, old.shape).astype(old.dtype)

    def dependent(value: Any) -> dict[str, Any]:
        if holder is given:
            return worked_out(numbers, {**given, row.name: value}, {row.name}, scene.layout)
        return worked_out({**numbers, row.name: value}, given, {row.name}, scene.layout)

    rates = jax.jvp(dependent, (old,), (unit,))[1] if given else {}
    rates |= {} if holder is given else {row.name: unit}
    zeros = jax.tree.map(np.zeros_like, without_given(scene))

    def places(s):
        return [field_of(s, name) for name in rates]

    along = eqx.tree_at(places, zeros, list(rates.values()))
    if row.name not in along.given:
        return along
    return eqx.tree_at(lambda s: s.given[row.name], along, unit)


LANES_PER_CHUNK = 16  # that share one compiled function
SAMPLE_NUMBERS = 32  # of a sample and its tangent


class SampledMotions(NamedTuple):
    """Displacements and their rates at samples, the start included; NaN once a lane has stopped."""

    place: np.ndarray  # (lanes, 1 + samples, 6): x, y, theta, left before right [m, rad]
    rate: np.ndarray  # their rates
    place_by: np.ndarray  # tangents of the same
    rate_by: np.ndarray
    end_by: np.ndarray  # (lanes, numbers) tangent of the state at the end


def motions_with_tangents(scenes: Dual, states: Dual, schedule: Schedule, wanted: int | None = None) -> SampledMotions:
    """The sampled motions of lanes from their states, with tangents along the direction of each lane.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        states: The initial states and their directions, likewise.
        schedule: How far they are run.
        wanted: The samples that are wanted, of which there are so many; None: all. They do not depend on it.

    Raises:
        InputError: The samples would not fit into memory.
    """
    lanes = len(scenes.value.drive.omega)
    check_memory("what is sampled of the motions", lanes * schedule.samples * SAMPLE_NUMBERS * 8)

    with counted("motions with derivatives", lanes) as count:

        def run(check: Check, at: np.ndarray) -> SampledMotions:
            check()
            scene, state = jax.tree.map(lambda a: np.asarray(a)[at], (scenes, states))
            chunk = _sampled_chunk(scene, state, schedule, schedule.samples if wanted is None else wanted)
            count(min(LANES_PER_CHUNK, lanes - int(at[0])))
            return chunk

        return in_chunks(run, lanes, LANES_PER_CHUNK)


def _sampled_chunk(scenes: Dual, states: Dual, schedule: Schedule, wanted: int) -> SampledMotions:
    flow = samples_with_tangents(scenes, states, schedule, wanted)
    value, slope = jax.tree.map(lambda a: np.asarray(a[:, :wanted]), flow)
    stopped = (value.status != Status.OK)[..., None]
    first = [motion_rows(motion) for motion in _shrouds_at_start(scenes, states)]
    rows = [motion_rows(flow.state.motion) for flow in (value, slope)]
    rows = [np.where(stopped, np.nan, row) for row in rows]
    (place, rate), (place_by, rate_by) = (
        np.split(np.concatenate([start[:, None], row], axis=1), 2, axis=-1)
        for start, row in zip(first, rows, strict=True)
    )
    last = jax.tree.map(lambda a: a[:, -1], slope.own)
    return SampledMotions(place, rate, place_by, rate_by, to_vector(last))


def _shrouds_at_start(scenes: Dual, states: Dual) -> Dual:
    """The motion of the shrouds in states, and its direction by those of the states and of the shapes of modes."""
    start, along = states.value.motion, states.tangent.motion
    shroud = shroud_motion(start, scenes.value)
    if shroud is start:
        return Dual(start, along)
    moved = shroud_motion(along, scenes.value)
    return Dual(shroud, jax.tree.map(np.add, moved, shroud_motion(start, scenes.tangent)))


def start_duals(scenes: Dual) -> Dual:
    """The initial states of scenes with directions, with the directions of their numbers `initial`."""
    if scenes.value.start != "motion":
        raise InputError("A record is fitted from an initial motion so far: a static start has no derivatives there.")
    return with_tangent(initial_states, scenes)
