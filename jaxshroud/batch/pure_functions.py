"""Pairs and rows of blades inside JAX's transformations: samples and whole periods.

Derivatives of rows raise a TypeError there.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.batch.blocks import PAIR_KERNELS, period_function
from jaxshroud.batch.differentiable_samples import (
    Schedule,
    batching_by_lanes,
    differentiable_samples,
    no_tangents,
    perturbed_only,
    samples_and_tangents,
    skip_samples,
)
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.march_protocol import LaneOutcomes, Moment, PureMarch, SampledMoments, SweepPlan, sample_times
from jaxshroud.batch.periods import Clock, begin_lanes
from jaxshroud.batch.row_samples import RowSamples, next_row_sample
from jaxshroud.batch.rows import ROW_KERNELS, lanes_first, row_models, rows_at_start
from jaxshroud.batch.states import as_arrays, carried_state
from jaxshroud.batch.stopped import Admitted, lost_tangents, replaced_where
from jaxshroud.batch.xla import best_mapping, compiled, one_lane
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.forces_and_energy import contact_forces
from jaxshroud.march.locate import values_only
from jaxshroud.march.log import accumulator_of_new_period
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import Scalar, filled, sincos_turns
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.model.rhs import Means
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import require_capability
from jaxshroud.scene.scene import Scene


def _moments_of_pair(begin: Admitted, schedule: Schedule) -> SampledMoments:
    """The samples of a pair, with derivatives."""
    schedule = schedule._replace(method=as_differentiable(schedule.method)._replace(margins=True))
    flow = differentiable_samples(begin.scene, begin.start, schedule)
    model, (times, turns) = prepared_model(begin.scene), sample_times(begin, schedule)
    states = eqx.tree_at(lambda s: s.motion, flow.state, jax.vmap(as_arrays)(flow.state.motion))
    stopped = flow.status != Status.OK

    def at(t, turns, state, stopped):
        return _moment_at(t, turns, state, stopped, model)

    moments = jax.vmap(at)(times, turns, states, stopped)
    return SampledMoments(moments, jnp.stack(flow.power, -1), flow.status, flow.margins)


def _moment_at(t: Scalar, turns: Scalar, state: State, stopped: Bool[Array, ""], model: Model) -> Moment:
    carried = carried_state(state, model)
    forces = contact_forces(drive_waves(*sincos_turns(turns), model.drive), carried, model)
    of_contact = filled({name: getattr(forces, name) for name in "NFvu"}, forces.v)
    # of the motion in any mode, so that the NaN of a stopped lane reaches all numbers in reverse mode
    return Moment(t, state, **{name: jnp.where(stopped, state.motion.x[0], a) for name, a in of_contact.items()})


def _chunk_of_pairs(scenes: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of a chunk of pairs; their derivatives are those of the samples of the lanes."""
    outcomes_of = jax.custom_jvp(batching_by_lanes(lambda scenes, states: _lane_outcomes(scenes, states, plan)))

    def push(primals, tangents):
        run, flow = jax.vmap(partial(samples_and_tangents, schedule=plan.schedule))(primals, perturbed_only(tangents))
        told = flow.state.motion, flow.power, flow.means
        motion, power, means = lost_tangents(run.status != Status.OK, told)
        power, means = jax.tree.map(lambda a: jnp.mean(a, axis=1), (power, means))
        slope = LaneOutcomes(motion, power, means, None)
        value = outcomes_of(*primals)
        return value, no_tangents(value, slope)

    outcomes_of.defjvp(push, symbolic_zeros=True)
    found = outcomes_of(scenes, states)
    return found._replace(means=Means(*((left,) for left in found.means)))


def _lane_outcomes(scenes: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of lanes, by the kernels of the verb `sweep`."""
    period = period_function(scenes, plan.clock, plan.method, best_mapping(), PAIR_KERNELS)
    begin = begin_lanes(scenes, states, plan.method)
    one = skip_samples(lambda lanes, _: period(lanes, True), plan.transient)
    last, sample = lax.scan(one, begin, jnp.arange(plan.kept))
    lanes_first = jax.tree.map(lambda a: a.T, sample.motion)
    power, means = jax.tree.map(lambda a: jnp.mean(a, axis=0), (sample.power, sample.means))
    return LaneOutcomes(lanes_first, power, means, last.status)


PURE_PAIRS = PureMarch(
    moments=_moments_of_pair,
    outcomes=_chunk_of_pairs,
    within_bounds=lambda stopped, scenes: replaced_where(stopped, scenes, 1.0),
    counted=lambda a: a[:, 0],
    told=lambda _: None,
)


class RowFlow(NamedTuple):
    """Samples (leading axis) of a row; NaN once it has stopped."""

    at: RowSamples
    power: Float[Array, "..."]  # mean square displacement of each block since the previous sample, (samples, N) [m^2]
    status: Int[Array, "..."]  # (samples,)
    margins: EventMargins  # so far, at all interfaces


def _row_flow(scene: Scene, state: State, schedule: Schedule) -> RowFlow:
    """The samples of one row by a `schedule` without a bound of trials; a TypeError where it is differentiated."""
    flows = _sampled_rows(*one_lane(values_only((scene, state))), schedule)
    return jax.tree.map(lambda a: a[0], flows)


@compiled("schedule")
def _sampled_rows(scenes: Scene, states: State, schedule: Schedule) -> RowFlow:
    return batching_by_lanes(lambda scenes, states: _row_samples_in_lanes(scenes, states, schedule))(scenes, states)


def _row_samples_in_lanes(scenes: Scene, states: State, schedule: Schedule) -> RowFlow:
    """The samples of rows (leading axis): a `RowFlow` with axes (lane, sample)."""
    (model, period), each, steps = row_models(scenes), best_mapping(), schedule.steps
    clock = Clock.from_phase_0(steps, schedule.method.flat_return)
    begin = rows_at_start(states, model, schedule.method, each)
    time = period * (schedule.every / steps)

    def one(lanes, _):
        empty = accumulator_of_new_period(lanes.accumulator, model.blades.shroud(lanes.state.motion), schedule.method)
        lanes = eqx.tree_at(lambda lane: lane.accumulator, lanes, empty)
        lanes, sample = next_row_sample(lanes, jnp.int32(schedule.every), model, period, clock, schedule.method, each)
        gain: Any = lanes.accumulator.integrals.power
        power = gain / time[None]
        overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(jnp.sum(power, axis=0))
        status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
        lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
        return lanes, lanes_first(
            RowFlow(sample, jnp.where(status == Status.OK, power, jnp.nan), status, _of_all(lanes.accumulator.margins))
        )

    _, flows = lax.scan(one, begin, length=schedule.samples)
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), flows)


def _of_all(margins: EventMargins | None) -> EventMargins:
    """The margins of rows, lanes last, from those of their interfaces."""
    assert margins is not None

    def least(speeds):
        return jnp.min(speeds, axis=0)

    return EventMargins(jnp.sum(margins.events, axis=0), least(margins.slowest_onset), least(margins.slowest_switch))


class RowStrobe(NamedTuple):
    """Rows (leading axis) over whole periods; NaN where a row has stopped."""

    motion: Motion  # at the end of each kept period, (lanes, periods, N)
    power: Float[Array, "..."]  # mean square displacement of each block over these, (lanes, N) [m^2]
    means: Any  # `Means` of each block over these, fields (lanes, N); None unless the method has `vibration`
    status: Int[Array, "..."]  # (lanes,)


def row_strobe(scenes: Scene, states: State, transient: int, kept: int, steps: int, method: Choices) -> RowStrobe:
    """Rows (leading axis) run for `transient` and `kept` periods; a TypeError where it is differentiated."""

    def run(scenes: Scene, states: State) -> RowStrobe:
        each = best_mapping()
        period = period_function(scenes, Clock.from_phase_0(steps, method.flat_return), method, each, ROW_KERNELS)

        def one(lanes: Any, _: Any) -> Any:
            lanes, sample = period(lanes, True)
            return lanes, lanes_first((sample.motion, sample.power, sample.means))

        begin = rows_at_start(states, row_models(scenes)[0], method, each)
        last, (motion, power, means) = lax.scan(skip_samples(one, transient), begin, jnp.arange(kept))
        motion = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), motion)
        power, means = jax.tree.map(lambda a: jnp.mean(a, axis=0), (power, means))
        return RowStrobe(motion, power, means, last.status)

    return batching_by_lanes(run)(*values_only((scenes, states)))


def _check_row_start(scene: Scene, state: State) -> None:
    """Raise InputError if the state is not one of such a row."""
    blades, interfaces, points = scene.layout.blades, scene.layout.interfaces, scene.points
    of_contact = (interfaces, points) if points else (interfaces,)
    if (jnp.shape(state.motion.x), jnp.shape(state.u_s)) != ((blades,), of_contact):
        at = f"{interfaces}, {points} points each" if points else f"{interfaces}"
        raise InputError(f"Argument `state` must have the motion of {blades} blades and contact at {at}.")


def _moments_of_row(begin: Admitted, schedule: Schedule) -> SampledMoments:
    """The samples of a row, whose derivatives raise a TypeError."""
    if schedule.most_trials is not None:
        require_capability("Argument `most_trials`", begin.scene.layout)
    _check_row_start(begin.scene, begin.start)
    schedule = schedule._replace(method=schedule.method._replace(margins=True))
    flow = _row_flow(begin.scene, begin.start, schedule)
    f = flow.at.forces
    moments = Moment(sample_times(begin, schedule)[0], flow.at.state, f.N, f.F, f.v, f.u)
    return SampledMoments(moments, flow.power, flow.status, flow.margins)


def _chunk_of_rows(rows: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of a chunk of rows, by the kernels of the verb `sweep`."""
    strobe = row_strobe(rows, states, *plan)
    told = strobe.motion, strobe.power, strobe.means
    motion, power, means = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), told)
    return LaneOutcomes(motion, power, means, strobe.status)


PURE_ROWS = PureMarch(
    moments=_moments_of_row,
    outcomes=_chunk_of_rows,
    within_bounds=lambda _, scenes: scenes,
    counted=lambda a: a.sum(axis=-1),
    told=lambda P_0: P_0,
)
