"""Pairs of blades inside JAX's transformations, with derivatives: samples and whole periods."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

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
from jaxshroud.batch.input_status import Admitted
from jaxshroud.batch.periods import begin_lanes
from jaxshroud.batch.pure_march import LaneOutcomes, Moment, PureMarch, SampledMoments, SweepPlan, sample_times
from jaxshroud.batch.states import as_arrays, carried_state
from jaxshroud.batch.stopped import lost_tangents, replaced_where
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march.observables import contact_forces
from jaxshroud.model.arithmetic import Scalar, filled, sincos_turns
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.model.rhs import Means
from jaxshroud.scene.scene import Scene


def _moments_of_pair(begin: Admitted, schedule: Schedule) -> SampledMoments:
    """The samples of a pair, with derivatives."""
    schedule = schedule._replace(method=as_differentiable(schedule.method)._replace(margins=True))
    flow = differentiable_samples(begin.scene, begin.start, schedule)
    model, (times, turns) = prepared_model(begin.scene), sample_times(begin, schedule)
    states = eqx.tree_at(lambda s: s.motion, flow.state, jax.vmap(as_arrays)(flow.state.motion))
    stopped = flow.status != Status.OK
    at = lambda t, turns, state, stopped: _moment_at(t, turns, state, stopped, model)
    moments = jax.vmap(at)(times, turns, states, stopped)
    return SampledMoments(moments, jnp.stack(flow.power, -1), flow.status, flow.margins)


def _moment_at(t: Scalar, turns: Scalar, state: State, stopped: Bool[Array, ""], model: Model) -> Moment:
    carried = carried_state(state, model)
    forces = contact_forces(drive_waves(*sincos_turns(turns), model.drive), carried, model)
    of_contact = filled((forces.N, forces.F, forces.v, forces.u), forces.v)
    # of the motion in any mode, so that the NaN of a stopped lane reaches all numbers in reverse mode
    return Moment(t, state, *(jnp.where(stopped, state.motion.x[0], a) for a in of_contact))


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
