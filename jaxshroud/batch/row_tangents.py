"""Rows of blades through drive periods with tangents: `batch.tangents` for rows.

A row has kernels of blades and of interfaces with sums in between, which JAX differentiates; the kernels compute the
tangents of their values. Every lane has one direction.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.duals import Dual, differentiable
from jaxshroud.batch.flow_states import FlowWithMoments, canonical_slider
from jaxshroud.batch.flows import FlowPrograms
from jaxshroud.batch.periods import CallLimits, periods_within
from jaxshroud.batch.rows import carried_row, lanes_first, lanes_last, march_rows, row_models
from jaxshroud.batch.states import by_blade
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane, time_grid
from jaxshroud.march.events import place_contact
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import begin_row
from jaxshroud.model.arithmetic import filled, is_absent
from jaxshroud.model.modes import FLAT, Status
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.row import RowModel, clusters, over, pair_states
from jaxshroud.scene.scene import Scene

ROW_LANES_PER_FLOW = (16, 16)  # of rows, whose kernels have as many numbers again for each blade


@compiled("method")
def begin_row_flows(scenes: Dual, states: Dual, method: Choices) -> Dual:
    """`begin_flows` for rows; the lanes are last."""
    each, (value, along) = differentiable(best_mapping()), states

    def begin(scenes: Scene, motion: Any, u_s: Any) -> Lane:
        model, state = row_models(scenes)[0], lanes_last(State(motion, u_s, value.mode, value.case))
        return begin_row(canonical_row(carried_row(state, model), model, each), model, method, each)

    along = scenes.tangent, along.motion, along.u_s
    return _with_tangent(begin, (scenes.value, value.motion, value.u_s), along)


def _with_tangent(f: Callable[..., Any], values: tuple[Any, ...], tangents: tuple[Any, ...]) -> Dual:
    """`f(*values)` and its tangent, of all real numbers, whether they depend on the direction or not."""
    real, rest = eqx.partition(values, eqx.is_inexact_array)
    parts = lambda real: eqx.partition(f(*eqx.combine(real, rest)), eqx.is_inexact_array)
    out, along, fixed = jax.jvp(parts, (real,), (tangents,), has_aux=True)
    return Dual(eqx.combine(out, fixed), along)


@compiled("method", "each")
def row_flow_with_tangents(
    scenes: Dual,
    lanes: Dual,
    limits: CallLimits,
    steps: Int[Array, "..."],
    turns: PerLane | None,
    method: Choices,
    each: EachLane,
) -> tuple[Dual, Int[Array, ""]]:
    """`flow_with_tangents` for rows, with the same arguments; the lanes are last."""

    def flow(scenes: Scene, lanes: Lane) -> tuple[Lane, Int[Array, ""]]:
        model, period = row_models(scenes)
        stop = jnp.ones_like(lanes.step) * steps
        count = stop.astype(period.dtype)
        grid = time_grid(jnp.zeros_like(period), count if turns is None else count / turns, period)
        fixed = Fixed(model, grid, stop)
        run = lambda lanes, passes: march_rows(lanes, fixed, method, differentiable(each), passes)
        return periods_within(limits, run, lanes, stop)

    (end, ended), (along, _) = _with_tangent(flow, (scenes.value, lanes.value), (scenes.tangent, lanes.tangent))
    return Dual(end, along), ended


@compiled()
def end_row_flows(scenes: Dual, lanes: Dual, n: Int[Array, ""], turns: PerLane | None) -> Dual:
    """`end_flows` for rows; powers and moments are tuples of all blades."""
    each = differentiable(best_mapping())

    def end(scenes: Scene, lanes: Lane) -> FlowWithMoments:
        model, period = row_models(scenes)
        time = n.astype(period.dtype) * (period if turns is None else turns * period)
        flow = lanes_first(_end_of_rows(lanes, model, time, each))
        sums = flow.power, flow.moments, flow.means
        power, moments, means = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), sums)
        return flow._replace(power=power, moments=moments, means=means)

    return _with_tangent(end, (scenes.value, lanes.value), (scenes.tangent, lanes.tangent))


def _end_of_rows(lanes: Lane, model: RowModel, time: Any, each: EachLane) -> FlowWithMoments:
    """The flow of rows, lanes last, after `time` seconds."""
    gain: Any = lanes.tally.integrals
    mean = lambda tree: jax.tree.map(lambda a: a / lax.broadcast_to_rank(time, a.ndim), filled(tree, gain.power))
    power = mean(gain.power)
    overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(jnp.sum(power, axis=0))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    end = canonical_row(lanes.state, model, each)
    motion, u_s = filled(end.motion, end.motion.x), filled(end.u_s, jnp.zeros(end.case.shape, power.dtype))
    return FlowWithMoments(State(motion, u_s, end.mode, end.case), power, status, mean(gain.moments), mean(gain.means))


def canonical_row(state: State, model: RowModel, each: EachLane) -> State:
    """The state of rows, lanes last, with the numbers that its modes determine, as `canonical` of the pair."""
    motion, u_s = state.motion, state.u_s
    if model.turns_by_events:
        cluster = clusters(state.case, model)
        flat = jnp.any(state.case == FLAT, axis=0)
        level = lambda a: jnp.where(flat, cluster.mean(a), a)
        motion = motion._replace(theta=level(motion.theta), v_theta=level(motion.v_theta))
    state = State(motion, u_s, state.mode, state.case)
    if is_absent(u_s) or model.interfaces.law.flows:
        return state

    def slider(state: State, model: Model) -> Any:
        return canonical_slider(place_contact(state.motion, state, model)[2], state, model)

    u_s = over(each, slider, pair_states(state, model), model.interfaces)
    return State(motion, u_s, state.mode, state.case)


ROW_FLOWS = FlowPrograms(begin_row_flows, row_flow_with_tangents, end_row_flows, by_blade, ROW_LANES_PER_FLOW)
