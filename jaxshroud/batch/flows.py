"""Drive periods of lanes with the derivative along a given direction, forward in time, and their ends in a unique form.

Each lane carries one tangent, so that several directions of one scene are several lanes with the same scene: a batch
over scenes is also a batch over directions.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.duals import Dual, differentiable, with_tangent
from jaxshroud.batch.lanes import as_users_have, canonical, carried_states, lane_models, lanes_first, on_last_axis
from jaxshroud.batch.periods import CallLimits, march, periods_within
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane, time_grid
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import Scalar, filled, least, total
from jaxshroud.model.blade import LumpedBlade, ModalMotion
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Means, Moments
from jaxshroud.model.row import RowModel, of_blades_that_count
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.scene import Scene


class Flow(NamedTuple):
    """The result of some drive periods, of any length, of lanes or of one lane: numbers of blades along a last axis."""

    state: State  # of the shrouds, with its slider updated
    power: Float[Array, "... blades"]  # mean square displacement over block and time [m^2]
    status: Int[Array, "..."]
    margins: EventMargins | None = None  # so far; None unless the method has `margins`
    coarseness: Scalar | None = None  # see `StepVerdict`; None within a march
    moments: Moments | None = None  # averaged over time; None unless the method has `amplitudes`
    means: Means | None = None  # averaged over time, of the blocks that count; None unless a march has `vibration`
    own_motion: ModalMotion | None = None  # of the blades' own coordinates, where these are not the shrouds'

    @property
    def own(self) -> State:
        """The state with the motion of the blades' own coordinates, which a march can start from."""
        motion = self.state.motion if self.own_motion is None else self.own_motion
        return State(motion, self.state.u_s, self.state.mode, self.state.case)


FEW_LANES, MANY_LANES = 16, 64  # of a flow of pairs: a loop of fewer does not amortise its dispatch


def lanes_per_flow(layout: Layout) -> tuple[int, int]:
    """The lanes of a chunk where there are few, and where there are many; rows have as many numbers for each blade."""
    return FEW_LANES, MANY_LANES if layout == PAIR else FEW_LANES


def begin_flow(scenes: Scene, states: State, method: Choices, each: EachLane) -> Lane:
    """The lanes, lanes last, at their start from `states`."""
    model = lane_models(scenes)[0]
    start = canonical(carried_states(states, model), model, each)
    return stepper_for(method).begin(start, model, method, each)


def end_flow(lanes: Lane, model: RowModel, time: PerLane, each: EachLane) -> Flow:
    """The flow of lanes, lanes last, after `time` seconds."""
    sums: Any = lanes.accumulator.integrals

    def mean(tree):
        return jax.tree.map(lambda a: a / lax.broadcast_to_rank(time, a.ndim), tree)

    power_of_all = filled(sums.power, sums.power)
    power, moments = mean((power_of_all, filled(sums.moments, power_of_all)))
    means = mean(filled(sums.means, of_blades_that_count(power_of_all, model)))
    overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(total(power))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    end = canonical(lanes.state, model, each)
    of_blades = on_last_axis(lanes_first((power, moments, means)))
    own = None if isinstance(model.blades, LumpedBlade) else as_users_have(end).motion
    return Flow(
        state=as_users_have(State(model.blades.shroud(end.motion), end.u_s, end.mode, end.case)),
        power=of_blades[0],
        status=status,
        margins=margins_of_all(lanes.accumulator.margins),
        moments=of_blades[1],
        means=of_blades[2],
        own_motion=own,
    )


def margins_of_all(margins: EventMargins | None) -> EventMargins | None:
    """The margins of lanes from those of their interfaces."""
    if margins is None:
        return None
    return EventMargins(total(margins.events), least(margins.slowest_onset), least(margins.slowest_switch))


def flow_constants(
    model: RowModel,
    periods: PerLane,
    steps: Int[Array, " lanes"],
    flat_return: PerLane | float,
    turns: PerLane | None = None,
) -> Fixed:
    """The constants of lanes that run `turns` drive periods, by default one, in `steps` steps from phase 0."""
    count = steps.astype(periods.dtype)
    per_period = count if turns is None else count / turns
    return Fixed(model, time_grid(jnp.zeros_like(per_period), per_period, periods, flat_return), steps)


@compiled("method")
def begin_flows(scenes: Dual, states: Dual, method: Choices) -> Dual:
    """The lanes at their start from `states`, with tangents; lanes last."""
    each = differentiable(best_mapping())
    return with_tangent(lambda scenes, states: begin_flow(scenes, states, method, each), scenes, states)


@compiled("method", "each")
def flow_with_tangents(
    scenes: Dual,
    lanes: Dual,
    limits: CallLimits,
    steps: Int[Array, "..."],
    flat_return: PerLane,
    turns: PerLane | None,
    method: Choices,
    each: EachLane,
) -> tuple[Dual, Int[Array, ""]]:
    """Run lanes over drive periods from drive phase 0, with tangents, or each over a number of turns of its own.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        lanes: The lanes to continue, see `begin_flows`.
        limits: What is done at most.
        steps: Runge-Kutta steps in one period, or in `turns`.
        flat_return: Of the method, see `time_grid`.
        turns: The drive periods of each lane, of any length, in the place of a period; its tangent is at that phase.
        method: The options of the march, `as_differentiable`: else the derivatives lack the contributions of events.
        each: How a function of one lane is applied to all.

    Returns:
        The lanes at the end, with tangents, and how many periods have ended.
    """

    def flow(scenes: Scene, lanes: Any) -> tuple[Any, Int[Array, ""]]:
        model, periods = lane_models(scenes)
        fixed = flow_constants(model, periods, jnp.ones_like(lanes.step) * steps, flat_return, turns)

        def run(lanes: Any, passes: Any) -> Any:
            return march(lanes, fixed, method, differentiable(each), passes=passes)

        return periods_within(limits, run, lanes, fixed.stop)

    (end, ended), (along, _) = with_tangent(flow, scenes, lanes)
    return Dual(end, along), ended


@compiled()
def end_flows(scenes: Dual, lanes: Dual, n: Int[Array, ""], turns: PerLane | None) -> Dual:
    """The flow of lanes that have run `n` periods, or as often their `turns`, with its tangent."""
    each = differentiable(best_mapping())

    def end(scenes: Scene, lanes: Lane) -> Flow:
        model, periods = lane_models(scenes)
        return end_flow(lanes, model, n.astype(periods.dtype) * (periods if turns is None else turns * periods), each)

    return with_tangent(end, scenes, lanes)


def as_differentiable(method: Choices) -> Choices:
    """The method with derivatives of the times of events, and without the logs that a flow does not need."""
    return method._replace(derivative=True, ledger=False, within=False, forces=False)
