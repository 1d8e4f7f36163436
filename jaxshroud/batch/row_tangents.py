"""Rows of blades through drive periods with tangents: `batch.tangents` for rows.

A row has kernels of blades and of interfaces with sums in between, which JAX differentiates; the kernels compute the
tangents of their values. Every lane has one direction.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.duals import Dual, differentiable
from jaxshroud.batch.flow_states import FlowWithMoments, canonical_slider
from jaxshroud.batch.rows import carried_row, lanes_first, lanes_last, march_rows, row_models
from jaxshroud.batch.xla import compiled
from jaxshroud.march.carry import EachLane, PerLane, time_grid
from jaxshroud.march.events import place_contact
from jaxshroud.march.method import Choices
from jaxshroud.march.row_carry import RowFixed, RowLane
from jaxshroud.march.row_trial import begin_row
from jaxshroud.model.arithmetic import filled, is_absent
from jaxshroud.model.modes import FLAT, Status
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.row import RowModel, clusters, over, pair_states
from jaxshroud.scene.scene import Scene


@compiled("method", "each")
def row_flow_with_tangents(
    scenes: Dual,
    states: Dual,
    n: Int[Array, ""],
    steps: Int[Array, "..."],
    turns: PerLane | None,
    method: Choices,
    each: EachLane,
) -> Dual:
    """`flow_with_tangents` for rows, with the same arguments; powers and moments are tuples of all blades."""

    def flow(scenes: Scene, motion: Any, u_s: Any) -> FlowWithMoments:
        begin = State(motion, u_s, states.value.mode, states.value.case)
        return _row_flow(scenes, begin, n, steps, turns, method, differentiable(each))

    value, along = states
    values, tangents = (scenes.value, value.motion, value.u_s), (scenes.tangent, along.motion, along.u_s)
    end, by = jax.jvp(flow, values, tangents)
    return Dual(end, eqx.filter(by, eqx.is_inexact_array))


def _row_flow(
    scenes: Scene, states: State, n: Any, steps: Any, turns: PerLane | None, method: Choices, each: EachLane
) -> FlowWithMoments:
    model, period = row_models(scenes)
    start = canonical_row(carried_row(lanes_last(states), model), model, each)
    lanes = begin_row(start, model, method, each)
    stop = jnp.ones_like(lanes.step) * steps
    count = stop.astype(period.dtype)
    grid = time_grid(jnp.zeros_like(period), count if turns is None else count / turns, period)

    def one(_: Any, lanes: RowLane) -> RowLane:
        lanes = march_rows(lanes, RowFixed(model, grid, stop), method, each)
        return eqx.tree_at(lambda lane: lane.step, lanes, jnp.where(lanes.step == stop, 0, lanes.step))

    lanes = lax.fori_loop(0, n, one, lanes)
    time = n.astype(period.dtype) * (period if turns is None else turns * period)
    flow = lanes_first(_end_of_rows(lanes, model, time, each))
    power, moments = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), (flow.power, flow.moments))
    return flow._replace(power=power, moments=moments)


def _end_of_rows(lanes: RowLane, model: RowModel, time: Any, each: EachLane) -> FlowWithMoments:
    """The flow of rows, lanes last, after `time` seconds."""
    gain: Any = lanes.tally.integrals
    mean = lambda tree: jax.tree.map(lambda a: a / time, filled(tree, gain.power))
    power = mean(gain.power)
    overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(jnp.sum(power, axis=0))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    end = canonical_row(lanes.state, model, each)
    motion, u_s = filled(end.motion, end.motion.x), filled(end.u_s, jnp.zeros(end.mode.shape, power.dtype))
    return FlowWithMoments(State(motion, u_s, end.mode, end.case), power, status, mean(gain.moments))


def canonical_row(state: State, model: RowModel, each: EachLane) -> State:
    """The state of rows, lanes last, with the numbers that its modes determine, as `canonical` of the pair."""
    motion, u_s = state.motion, state.u_s
    if model.turns_by_events:
        cluster = clusters(state.case, model)
        flat = jnp.any(state.case == FLAT, axis=0)
        level = lambda a: jnp.where(flat, cluster.mean(a), a)
        motion = motion._replace(theta=level(motion.theta), v_theta=level(motion.v_theta))
    state = State(motion, u_s, state.mode, state.case)
    if is_absent(u_s) or model.interfaces.spring.flows:
        return state

    def slider(state: State, model: Model) -> Any:
        return canonical_slider(place_contact(state.motion, state, model)[2], state, model)

    u_s = over(each, slider, pair_states(state, model.closed), model.interfaces)
    return State(motion, u_s, state.mode, state.case)
