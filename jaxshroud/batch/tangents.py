"""Tangents: the march with its derivative along given directions, forward in time.

Each lane carries one tangent, so that several directions of one scene are several lanes with the same scene: a batch
over scenes is also a batch over directions.
"""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.duals import Dual, dual_lanes
from jaxshroud.batch.flow_states import Flow, FlowWithMoments, canonical
from jaxshroud.batch.periods import march_steps, periods_at_once
from jaxshroud.batch.row_tangents import row_flow_with_tangents
from jaxshroud.batch.states import (
    by_blade,
    carried_state,
    from_vector,
    in_scene_precision,
    state_size,
    to_vector,
    with_zeros,
)
from jaxshroud.batch.threads import Check, in_chunks
from jaxshroud.batch.xla import best_mapping, compiled, repeat_lane, vmapped
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane, time_grid
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import begin_lane
from jaxshroud.model.arithmetic import Scalar, filled
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.scene.derived_inputs import DERIVED_BY_KEY, worked_out
from jaxshroud.scene.keys import find_key, number_shape
from jaxshroud.scene.numbers import given_of, numbers_of
from jaxshroud.scene.scene import Scene, without_given

LANES_PER_FLOW = (16, 64)  # for few and for many lanes: a loop of fewer does not amortise its dispatch
ROW_LANES_PER_FLOW = 16  # of rows, whose kernels have as many numbers again for each blade


def begin_flow(scene: Scene, state: State, method: Choices) -> tuple[Lane, Model, Scalar]:
    """A lane at its start, its model and the drive period."""
    scene_model = prepared_model(scene)
    lane = begin_lane(canonical(carried_state(state, scene_model), scene_model), scene_model, method)
    return lane, scene_model, scene.drive.period


def end_flow(lane: Lane, scene_model: Model, time: Scalar) -> Flow:
    """The flow of a lane after `time` seconds."""
    left, right = filled(lane.tally.integrals.power, time)
    overflowed = (lane.status == Status.OK) & ~jnp.isfinite(left + right)
    status = jnp.where(overflowed, Status.NOT_FINITE, lane.status).astype(lane.status.dtype)
    return Flow(with_zeros(canonical(lane.state, scene_model)), (left / time, right / time), status)


def end_flow_with_moments(lane: Lane, scene_model: Model, time: Scalar) -> FlowWithMoments:
    """`end_flow`, with the moments where they are kept."""
    moments = jax.tree.map(lambda a: a / time, filled(lane.tally.integrals.moments, time))
    return FlowWithMoments(*end_flow(lane, scene_model, time), moments)


def flow_constants(models: Model, periods: PerLane, steps: Int[Array, " lanes"], turns: PerLane | None = None) -> Fixed:
    """The constants of lanes that run `turns` drive periods, by default one, in `steps` steps from phase 0."""
    count = _steps_per_period(steps, periods, turns)
    return Fixed(models, time_grid(jnp.zeros_like(count), count, periods), steps)


def _steps_per_period(steps: Int[Array, " lanes"], periods: PerLane, turns: PerLane | None) -> PerLane:
    count = steps.astype(periods.dtype)
    return count if turns is None else count / turns


def dual_flow_constants(models: Dual, periods: Dual, steps: Int[Array, " lanes"], turns: PerLane | None = None) -> Dual:
    """The constants of the flow with tangents."""
    fixed = flow_constants(models.value, periods.value, steps, turns)
    count = _steps_per_period(steps, periods.value, turns)
    still = jax.tree.map(lambda _: None, fixed)
    along = still._replace(model=models.tangent, grid=still.grid._replace(h=periods.tangent / count))
    return Dual(fixed, along)


@compiled("method", "each")
def flow_with_tangents(
    scenes: Dual,
    states: Dual,
    n: Int[Array, ""],
    steps: Int[Array, "..."],
    turns: PerLane | None,
    method: Choices,
    each: EachLane,
) -> Dual:
    """Run `n` drive periods from drive phase 0, with tangents, or in each lane a number of its own.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        states: The initial states, with the same axis, and one direction for each.
        n: Periods to run.
        steps: Runge-Kutta steps in one period, or in `turns`.
        turns: The drive periods of each lane, of any length, in the place of a period; its tangent is at that phase.
        method: The options of the march, `as_differentiable`: else the derivatives lack the contributions of events.
        each: How a function of one lane is applied to all.

    Returns:
        A `FlowWithMoments` with leading lane axis and its tangent.
    """
    first = dual_lanes(vmapped)(lambda scene, state: begin_flow(scene, state, method), scenes, states)
    lanes, models, periods = (Dual(a, b) for a, b in zip(*first, strict=True))
    fixed = dual_flow_constants(models, periods, jnp.full_like(lanes.value.step, 1) * steps, turns)
    one_period = lambda _, lanes: march_steps(lanes, fixed, steps, method, dual_lanes(each), attrgetter("value"))[0]
    lanes = lax.fori_loop(0, n, one_period, lanes)
    times = jax.tree.map(lambda a: n.astype(a.dtype) * (a if turns is None else turns * a), periods)
    return dual_lanes(vmapped)(end_flow_with_moments, lanes, models, times)


def as_differentiable(method: Choices) -> Choices:
    """The method with derivatives of the times of events, and without the logs that a flow does not need."""
    return method._replace(derivative=True, ledger=False, within=False, forces=False)


def run_flow(scenes: Dual, states: Dual, n: int, steps: int, method: Choices, turns: np.ndarray | None = None) -> Dual:
    """`flow_with_tangents` of any number of lanes, in chunks that share one compiled function; NumPy arrays.

    With `turns` (lanes,) they run as many drive periods each, of any length, `n` times; `steps` are those of a period.
    """
    lanes = len(scenes.value.drive.omega)
    width = LANES_PER_FLOW[lanes > LANES_PER_FLOW[0] * 2] if scenes.value.row is None else ROW_LANES_PER_FLOW
    if turns is None and method.amplitudes:  # one program for both
        turns = np.ones(lanes)

    def run(check: Check, at: np.ndarray) -> Dual:
        scene, state, lengths = jax.tree.map(lambda a: np.asarray(a)[at], (scenes, states, turns))
        return _run_in_parts(scene, state, n, steps, lengths, method, check)

    return in_chunks(run, lanes, width)


def _run_in_parts(
    scenes: Dual, states: Dual, n: int, steps: int, turns: np.ndarray | None, method: Choices, check: Check
) -> Dual:
    """`flow_with_tangents` in parts that are short enough for an interruption to take effect soon."""
    omega = scenes.value.drive.omega
    longest = periods_at_once(len(omega), steps, method)
    counts, lengths = jnp.int32(steps), None
    if turns is not None:
        counts, lengths = jnp.asarray(np.ceil(steps * turns), jnp.int32), jnp.asarray(turns, omega.dtype)
    flow = flow_with_tangents if scenes.value.row is None else row_flow_with_tangents
    whole, done = None, 0
    while whole is None or done < n:
        check()
        now = min(longest, n - done)
        part = flow(scenes, states, jnp.int32(now), counts, lengths, method, best_mapping())
        part = jax.tree.map(np.asarray, part)
        whole = part if whole is None else _concatenated_flow(whole, part, now / (done + now))
        states, done = end_as_start(part), done + now
    return whole


def _concatenated_flow(first: Dual, then: Dual, weight: float) -> Dual:
    """Two consecutive flows as one; the second has the share `weight` of their time."""
    mean = lambda a, b: a + np.asarray(weight, a.dtype) * (b - a)
    integrals = lambda both: [(flow.power, flow.moments) for flow in both]
    value, tangent = jax.tree.map(mean, integrals(first), integrals(then))
    status = np.where(first.value.status == Status.OK, then.value.status, first.value.status)
    with_means = lambda flow, means: flow._replace(power=means[0], moments=means[1])
    return Dual(with_means(then.value, value)._replace(status=status), with_means(then.tangent, tangent))


def without_direction(states: State) -> Dual:
    """States that do not depend on the direction."""
    motion, u_s = jax.tree.map(np.zeros_like, (states.motion, states.u_s))
    return Dual(states, State(motion, u_s, None, None))


def end_as_start(end: Dual) -> Dual:
    """The states at the end of a flow, as initial states of the next."""
    state, tangent = end.value.state, end.tangent.state
    moved = State(by_blade(tangent.motion), tangent.u_s, None, None)
    return Dual(State(by_blade(state.motion), state.u_s, state.mode, state.case), moved)


class Tangents(NamedTuple):
    """The flow of a scene over some periods, and its derivatives by the initial state and by some parameters.

    A state is a vector of so many numbers, 13 of the pair: x, y, theta and their rates, each blade by blade, then the
    sliders.
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


class TangentProblem(NamedTuple):
    """A scene, its initial state, and the directions in which its flow is differentiated."""

    scene: Scene
    state: State
    directions: Sequence[Scene] = ()  # derivative of the scene by each parameter
    by_state: bool = True  # whether to differentiate by the initial state too

    @property
    def by_start(self) -> int:
        """The number of directions of the initial state."""
        return state_size(self.scene.row_size) if self.by_state else 0

    @property
    def lanes(self) -> int:
        """The number of lanes, one for each direction, and at least one."""
        return max(self.by_start + len(self.directions), 1)

    @property
    def duals(self) -> tuple[Dual, Dual]:
        """The scenes and the states of its lanes."""
        lanes, state, scene = self.lanes, in_scene_precision(self.state, self.scene), without_given(self.scene)
        still = [jax.tree.map(np.zeros_like, scene)] * (lanes - len(self.directions))
        along = jax.tree.map(lambda *a: np.stack(a), *still, *self.directions)
        size = state_size(scene.row_size)
        unit = np.zeros((lanes, size), scene.drive.omega.dtype)
        unit[: self.by_start] = np.eye(size)[: self.by_start]
        shift = from_vector(unit, None, None, scene.row_size)
        return Dual(repeat_lane(scene, lanes), along), Dual(repeat_lane(state, lanes), shift)

    def tangents(self, flows: Dual) -> Tangents:
        """The tangents from the flow of its lanes."""
        (value, slope), end = flows, jax.tree.map(lambda a: a[0], end_as_start(flows).value)
        by, count = to_vector(slope.state), self.by_start
        power, power_by = np.stack([a[0] for a in value.power]), np.stack(slope.power)
        parts = by[:count].T, power_by[:, :count], by[count:].T, power_by[:, count:]
        if value.moments is not None:
            moments, moments_by = (np.array([list(m) for m in a.moments]) for a in (value, slope))
            parts = *parts, moments[..., 0], moments_by[..., :count], moments_by[..., count:]
        return Tangents(end, to_vector(end), power, int(value.status[0]), *parts)


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
    part = lambda end, lanes: jax.tree.map(lambda a: a[end - lanes : end], flows)
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
    (row, place), numbers, given = find_key(key, row=scene.row_size), numbers_of(scene), given_of(scene)
    holder = given if row.name in DERIVED_BY_KEY else numbers
    old = holder[row.name]
    unit = np.ones(()) if place is None else np.eye(number_shape(row, scene.row_size)[0])[place]
    unit = np.broadcast_to(unit, old.shape).astype(old.dtype)

    def dependent(value: Any) -> dict[str, Any]:
        if holder is given:
            return worked_out(numbers, {**given, row.name: value}, {row.name}, scene.row_size)
        return worked_out({**numbers, row.name: value}, given, {row.name}, scene.row_size)

    rates = jax.jvp(dependent, (old,), (unit,))[1] if given else {}
    rates |= {} if holder is given else {row.name: unit}
    places = lambda s: [getattr(getattr(s, table), name) for table, name in (name.split(".") for name in rates)]
    return eqx.tree_at(places, jax.tree.map(np.zeros_like, without_given(scene)), list(rates.values()))
