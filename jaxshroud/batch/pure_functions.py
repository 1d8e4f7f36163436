"""Lanes inside JAX's transformations: samples of one lane, and whole periods of a chunk of lanes, with derivatives."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

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
from jaxshroud.batch.lanes import as_arrays_of_users, carried_states, lane_models, lanes_at_start, lanes_first
from jaxshroud.batch.periods import Clock, begin_period, end_period, march, with_clock_reset
from jaxshroud.batch.states import on_last_axis
from jaxshroud.batch.stopped import Admitted, lost_tangents, nan_where
from jaxshroud.batch.xla import best_mapping, one_lane, vmapped
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.carry import Fixed
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import row_contact_forces
from jaxshroud.model.arithmetic import Scalar, sincos_turns
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene

OfContact = Float[Array, "..."]  # of a row at each interface


class Moment(NamedTuple):
    """The argument of `save` in a rollout: one sample."""

    t: Scalar  # [s]
    state: State  # fields of `motion` (2,), of a row (blades,), as contact and forces are (interfaces,)
    N: OfContact  # normal force of contact [N]
    F: OfContact  # friction force [N]
    v: OfContact  # penetration [m]; when apart the negative remaining gap
    u: OfContact  # slide of the left block against the right one [m]


class SampledMoments(NamedTuple):
    """The samples (leading axis) of one lane."""

    moments: Moment
    power: Float[Array, "samples blades"]  # mean square displacement since the previous sample [m^2]
    status: Int[Array, " samples"]
    margins: EventMargins | None  # so far


def sampled_moments(begin: Admitted, schedule: Schedule) -> SampledMoments:
    """The samples of one lane, with derivatives; the method of the schedule is as the user gave it."""
    _check_start(begin.scene, begin.start)
    schedule = schedule._replace(method=as_differentiable(schedule.method)._replace(margins=True))
    flow = differentiable_samples(begin.scene, begin.start, schedule)
    model = lane_models(one_lane(begin.scene))[0]

    def at(t, turns, state, stopped):
        lanes = carried_states(one_lane(state), model)
        wave = vmapped(sincos_turns, one_lane(turns))
        forces = as_arrays_of_users(row_contact_forces(lanes, wave, model, vmapped))
        of_contact = jax.tree.map(lambda a: a[0], (forces.N, forces.F, forces.v, forces.u))
        # of the motion in any mode, so that the NaN of a stopped lane reaches all numbers in reverse mode
        N, F, v, u = jax.tree.map(lambda a: jnp.where(stopped, state.motion.x[0], a), of_contact)
        return Moment(t, state, N=N, F=F, v=v, u=u)

    moments = jax.vmap(at)(*sample_times(begin, schedule), flow.state, flow.status != Status.OK)
    return SampledMoments(moments, flow.power, flow.status, flow.margins)


def sample_times(begin: Admitted, schedule: Schedule) -> tuple[Float[Array, " samples"], Float[Array, " samples"]]:
    """The times [s] of samples, and the phases of the drive there [turns]."""
    index = np.arange(1, schedule.samples + 1) * schedule.every
    steps = schedule.steps
    period = nan_where(~begin.good, begin.scene.drive.period)
    turns = jnp.asarray(index % steps / steps, period.dtype)
    return period * jnp.asarray(index / steps, turns.dtype), turns


class SweepPlan(NamedTuple):
    """The static arguments of a sweep."""

    transient: int
    kept: int
    steps: int
    method: Choices

    @property
    def clock(self) -> Clock:
        """The grid of whole periods from drive phase 0."""
        return Clock.of_steps(self.steps, flat_return=self.method.flat_return)

    @property
    def schedule(self) -> Schedule:
        """The schedule of the same run with derivatives."""
        return Schedule(self.kept, self.steps, self.steps, as_differentiable(self.method), skipped=self.transient)


class LaneOutcomes(NamedTuple):
    """The results of lanes (leading axis)."""

    motion: Motion  # fields (lanes, periods, blades)
    power: Any  # mean square displacement over block and periods, (lanes, blades) [m^2]
    means: Any  # `Means` over the periods, of each block that counts, fields (lanes, blocks)
    status: Any  # (lanes,); None of tangents


def lane_outcomes(scenes: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of a chunk of lanes; their derivatives are those of the samples of the lanes."""
    outcomes_of = jax.custom_jvp(batching_by_lanes(lambda scenes, states: _lane_outcomes(scenes, states, plan)))

    def push(primals, tangents):
        run, flow = jax.vmap(partial(samples_and_tangents, schedule=plan.schedule))(primals, perturbed_only(tangents))
        lost = lost_tangents(run.status != Status.OK, (flow.state.motion, flow.power, flow.means))
        power, means = jax.tree.map(lambda a: jnp.mean(a, axis=1), lost[1:])
        value = outcomes_of(*primals)
        return value, no_tangents(value, LaneOutcomes(lost[0], power, means, None))

    outcomes_of.defjvp(push, symbolic_zeros=True)
    return outcomes_of(scenes, states)


def _lane_outcomes(scenes: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of lanes, by the periods of the verb `sweep`."""
    clock, method, each = plan.clock, plan.method, best_mapping()
    model, periods = lane_models(scenes)
    fixed = Fixed(model, clock.grids(periods), clock.steps)

    def one(lanes: Any, _: Any) -> Any:
        lanes, energies = begin_period(lanes, model, method, each)
        lanes = march(lanes, fixed, method, each)
        lanes = with_clock_reset(lanes, lanes.step == clock.steps)
        lanes, sample = end_period(lanes, energies, model, periods, clock.per_period, each)
        return lanes, on_last_axis(lanes_first((sample.motion, sample.power, sample.means)))

    begin = lanes_at_start(states, model, method, each)
    last, (motion, power, means) = lax.scan(skip_samples(one, plan.transient), begin, jnp.arange(plan.kept))
    motion = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), motion)
    power, means = jax.tree.map(lambda a: jnp.mean(a, axis=0), (power, means))
    return LaneOutcomes(motion, power, means, last.status)


def _check_start(scene: Scene, state: State) -> None:
    """Raise InputError if the state is not one of such a scene."""
    layout, points = scene.layout, scene.points
    of_contact = (*layout.interface_shape, points) if points else layout.interface_shape
    if (jnp.shape(jax.tree.leaves(state.motion)[0]), jnp.shape(state.u_s)) != ((layout.blades,), of_contact):
        at = f"{layout.interfaces}, {points} points each" if points else f"{layout.interfaces}"
        raise InputError(f"Argument `state` must have the motion of {layout.blades} blades and contact at {at}.")
