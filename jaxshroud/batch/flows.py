"""Drive periods of pairs with the derivative along a given direction, forward in time, and their ends in a unique form.

Each lane carries one tangent, so that several directions of one scene are several lanes with the same scene: a batch
over scenes is also a batch over directions.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.batch.blocks import PeriodKernels
from jaxshroud.batch.duals import Dual, differentiable, with_tangent
from jaxshroud.batch.periods import CallLimits, lane_models, periods_within
from jaxshroud.batch.states import (
    by_blade,
    by_interface,
    carried_state,
    with_zeros,
)
from jaxshroud.batch.xla import compiled, vmapped
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane, time_grid
from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import select
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import begin_lane
from jaxshroud.model.arithmetic import Pair, Scalar, filled, is_zero
from jaxshroud.model.geometry import Kinematics
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.prepared import Model, State, prepared_model, touches_at_corners
from jaxshroud.model.rhs import Means, Moments, parallel_mean
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


class Flow(NamedTuple):
    """The result of whole drive periods."""

    state: State  # with its slider updated; motion as pairs
    power: Pair  # mean square displacement over block and time [m^2]
    status: Int[Array, "..."]
    margins: EventMargins | None = None  # so far; None unless the method has `margins`
    coarseness: Scalar | None = None  # see `StepVerdict`; None within a march
    means: Means | None = None  # averaged over time; None unless a march has `vibration`


class FlowWithMoments(NamedTuple):
    """The result of some drive periods, of any length."""

    state: State  # as of a `Flow`, and so are the next two
    power: Pair
    status: Int[Array, "..."]
    moments: Moments | None  # averaged over time; None unless the method has `amplitudes`
    means: Means | None  # averaged over time; None unless the method has `vibration`


def canonical(state: State, scene_model: Model) -> State:
    """The state with the numbers that its mode determines: the slider in slip and when apart, and one angle if flat.

    Numbers on which no later motion depends are then unique, and have no tangent.
    """
    if touches_at_corners(scene_model) and scene_model.law.has_events:

        def angles(motion):
            return (motion.theta, motion.v_theta)

        level = [select(state.case == FLAT, parallel_mean(pair, scene_model), pair) for pair in angles(state.motion)]
        state = eqx.tree_at(lambda s: angles(s.motion), state, tuple(level))
    at = place_contact(state.motion, state, scene_model)[2]
    if is_zero(state.u_s) or scene_model.law.flows:
        return state
    u_s = canonical_slider(at, state, scene_model)
    return eqx.tree_at(lambda s: s.u_s, state, u_s)


def canonical_slider(at: Kinematics, state: State, scene_model: Model) -> Scalar:
    """The slider that the mode determines in slip and when apart; else that of the state."""
    w = scene_model.law.stretch_at(at, state.u_s, state.mode)
    sliders = jax.tree.map(lambda w: at.u - w, w)
    return jax.tree.map(lambda u_s, mode: jnp.where(mode == Mode.APART, 0.0, u_s), sliders, state.mode)


LANES_PER_FLOW = (16, 64)  # for few and for many lanes: a loop of fewer does not amortise its dispatch


def begin_flow(scene: Scene, state: State, method: Choices) -> tuple[Lane, Model, Scalar]:
    """A lane at its start, its model and the drive period."""
    scene_model = prepared_model(scene)
    lane = begin_lane(canonical(carried_state(state, scene_model), scene_model), scene_model, method)
    return lane, scene_model, scene.drive.period


def end_flow(lane: Lane, scene_model: Model, time: Scalar) -> Flow:
    """The flow of a lane after `time` seconds."""
    left, right = filled(lane.accumulator.integrals.power, time)
    overflowed = (lane.status == Status.OK) & ~jnp.isfinite(left + right)
    status = jnp.where(overflowed, Status.NOT_FINITE, lane.status).astype(lane.status.dtype)
    state = with_zeros(canonical(lane.state, scene_model))
    return Flow(state, (left / time, right / time), status, lane.accumulator.margins)


def end_flow_with_moments(lane: Lane, scene_model: Model, time: Scalar) -> FlowWithMoments:
    """`end_flow`, with the moments and the means where they are kept."""
    sums, flow = lane.accumulator.integrals, end_flow(lane, scene_model, time)
    moments, means = mean_over(time, (sums.moments, sums.means))
    return FlowWithMoments(flow.state, flow.power, flow.status, moments, means)


def mean_over(time: Scalar, integrals: Tree) -> Tree:
    """The means over `time` of what was integrated."""
    return jax.tree.map(lambda a: a / time, filled(integrals, time))


def flow_constants(
    models: Model,
    periods: PerLane,
    steps: Int[Array, " lanes"],
    flat_return: PerLane | float,
    turns: PerLane | None = None,
) -> Fixed:
    """The constants of lanes that run `turns` drive periods, by default one, in `steps` steps from phase 0."""
    count = steps.astype(periods.dtype)
    per_period = count if turns is None else count / turns
    return Fixed(models, time_grid(jnp.zeros_like(per_period), per_period, periods, flat_return), steps)


@compiled("method")
def begin_flows(scenes: Dual, states: Dual, method: Choices) -> Dual:
    """The lanes at their start from `states`, with tangents."""

    def begin(scenes: Scene, states: State) -> Lane:
        return vmapped(lambda scene, state: begin_flow(scene, state, method)[0], scenes, states)

    return with_tangent(begin, scenes, states)


@compiled("method", "each", "kernels")
def flow_with_tangents(
    scenes: Dual,
    lanes: Dual,
    limits: CallLimits,
    steps: Int[Array, "..."],
    flat_return: PerLane,
    turns: PerLane | None,
    method: Choices,
    each: EachLane,
    kernels: PeriodKernels,
) -> tuple[Dual, Int[Array, ""]]:
    """Run lanes over drive periods from drive phase 0, with tangents, or each over a number of turns of its own.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        lanes: The lanes to continue, in the form of their layout, see `FlowPrograms.begin`.
        limits: What is done at most.
        steps: Runge-Kutta steps in one period, or in `turns`.
        flat_return: Of the method, see `time_grid`.
        turns: The drive periods of each lane, of any length, in the place of a period; its tangent is at that phase.
        method: The options of the march, `as_differentiable`: else the derivatives lack the contributions of events.
        each: How a function of one lane is applied to all.
        kernels: Those of the layout.

    Returns:
        The lanes at the end, with tangents, and how many periods have ended.
    """

    def flow(scenes: Scene, lanes: Any) -> tuple[Any, Int[Array, ""]]:
        models, periods = kernels.constants(scenes)
        fixed = flow_constants(models, periods, jnp.ones_like(lanes.step) * steps, flat_return, turns)

        def run(lanes: Any, passes: Any) -> Any:
            return kernels.march(lanes, fixed, method, differentiable(each), passes=passes)

        return periods_within(limits, run, lanes, fixed.stop)

    (end, ended), (along, _) = with_tangent(flow, scenes, lanes)
    return Dual(end, along), ended


@compiled()
def end_flows(scenes: Dual, lanes: Dual, n: Int[Array, ""], turns: PerLane | None) -> Dual:
    """The `FlowWithMoments` of lanes that have run `n` periods, or as often their `turns`, with its tangent."""

    def end(scenes: Scene, lanes: Lane) -> FlowWithMoments:
        models, periods = lane_models(scenes)
        times = n.astype(periods.dtype) * (periods if turns is None else turns * periods)
        return vmapped(end_flow_with_moments, lanes, models, times)

    return with_tangent(end, scenes, lanes)


def as_differentiable(method: Choices) -> Choices:
    """The method with derivatives of the times of events, and without the logs that a flow does not need."""
    return method._replace(derivative=True, ledger=False, within=False, forces=False)


class FlowPrograms(NamedTuple):
    """The compiled functions of a flow."""

    begin: Callable[..., Dual]
    end: Callable[..., Dual]
    expanded: Callable[[FlowWithMoments], FlowWithMoments]  # with an axis of blades, in NumPy arrays
    lanes_per_call: tuple[int, int]  # where there are few, and where there are many


def _expanded_pairs(flow: FlowWithMoments) -> FlowWithMoments:
    return by_blade(flow._replace(means=by_interface(flow.means)))  # of the left block alone


PAIR_FLOWS = FlowPrograms(begin_flows, end_flows, _expanded_pairs, LANES_PER_FLOW)
