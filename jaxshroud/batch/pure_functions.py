"""Lanes inside JAX's transformations, with derivatives: samples of one lane, and whole periods of a chunk of lanes.

The samples of a lane depend on some fifty numbers, so that their Jacobian is some fifty tangents, forward in time.
`differentiable_samples` computes those of the numbers that are perturbed. What remains is a product with the tangents
of JAX, which transposes and batches it by itself: reverse mode costs as much as forward mode and stores no history.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from jaxshroud.batch.duals import Dual, differentiable, with_tangent
from jaxshroud.batch.flows import Flow, as_differentiable, begin_flow, end_flow, flow_constants
from jaxshroud.batch.lanes import (
    as_arrays_of_users,
    carried_states,
    lane_models,
    lanes_at_start,
    lanes_first,
    on_last_axis,
)
from jaxshroud.batch.periods import Clock, begin_period, end_period, march, with_clock_reset
from jaxshroud.batch.stopped import Admitted, lost_tangents, nan_where, replaced_where
from jaxshroud.batch.xla import (
    FOR_SERIES,
    accepts_options,
    best_mapping,
    has_several_kernels,
    method_without_options,
    one_lane,
    repeated_while,
    vmapped,
)
from jaxshroud.cache.programs import is_traced, kept
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane, running
from jaxshroud.march.locate import first_order_only
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import row_contact_forces
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import Scalar, sincos_turns
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.row import RowModel
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


class Schedule(NamedTuple):
    """How far lanes are run from drive phase 0, and which samples are kept."""

    samples: int
    every: int  # steps from sample to sample; a divisor of `steps`
    steps: int  # in a period
    method: Choices  # `differentiable`
    most_trials: int | None = None  # of a lane; None: no bound
    skipped: int = 0  # samples before the first kept one

    def share(self, dtype: Any) -> Any:
        """The share of a period from sample to sample; `every` and `steps` are numbers, or traced integers."""
        if is_traced((self.every, self.steps)):
            return jnp.asarray(self.every, dtype) / jnp.asarray(self.steps, dtype)
        return self.every / self.steps


def sampled_flow(
    scenes: Any, states: Any, schedule: Schedule, wanted: Int[Array, ""] | None = None
) -> tuple[Any, Int[Array, " lanes"]]:
    """The samples of lanes, and the number of trials of each lane, which are counted only where they are bounded.

    Args:
        scenes: Scenes with a leading lane axis, or a `Dual` of these.
        states: Their initial states, likewise.
        schedule: How far they are run.
        wanted: The samples that are wanted, after which the march ends; None: all.

    Returns:
        A `Flow`, or a `Dual` of one, with axes (lane, sample): the states, the mean square displacements since the
        previous sample, and the statuses; with `vibration` the mean positions likewise.
    """
    if isinstance(scenes, Dual):
        value, along = with_tangent(partial(sampled_flow, schedule=schedule, wanted=wanted), scenes, states)
        return Dual(value[0], along[0]), value[1]
    each = differentiable(best_mapping())
    model, periods = lane_models(scenes)
    lanes = begin_flow(scenes, states, schedule.method, each)
    steps = jnp.full(periods.shape, schedule.steps, jnp.int32)
    fixed = flow_constants(model, periods, steps, schedule.method.flat_return)

    def one(carry, i):
        lanes, trials = _next_sample(carry[0], carry[1], fixed, schedule, each)
        lanes, flow = _sample_lanes(lanes, model, periods, schedule, each)
        return (lanes, trials), flow

    next_kept = skip_samples(one, schedule.skipped)
    start = lanes, jnp.zeros_like(steps)
    if wanted is None:
        (_, trials), flows = lax.scan(next_kept, start, jnp.arange(schedule.samples, dtype=jnp.int32))
    else:
        (_, trials), flows = _first_of_scan(next_kept, start, schedule.samples, wanted)
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), flows), trials


def _first_of_scan(one: Callable, start: Tree, samples: int, wanted: Int[Array, ""]) -> tuple[Tree, Tree]:
    """The first `wanted` of a `lax.scan` over so many samples, with zeros for the others."""
    shapes = jax.eval_shape(one, start, jnp.int32(0))[1]
    empty = jax.tree.map(lambda a: jnp.zeros((samples, *a.shape), a.dtype), shapes)

    def next_one(i, pair):
        carry, flow = one(pair[0], i)
        return carry, jax.tree.map(lambda all, a: lax.dynamic_update_index_in_dim(all, a, i, 0), pair[1], flow)

    return lax.fori_loop(0, wanted, next_one, (start, empty))


def skip_samples(one: Callable, skipped: int) -> Callable:
    """A step of a `lax.scan` over a count from 0, which first repeats the step `skipped` times without output."""
    if not skipped:
        return one

    def after_skipping(carry, i):
        empty = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(one, carry, i)[1])
        return lax.fori_loop(0, jnp.where(i == 0, skipped + 1, 1), lambda _, pair: one(pair[0], i), (carry, empty))

    return after_skipping


def _next_sample(
    lanes: Lane, trials: Int[Array, " lanes"], fixed: Fixed[RowModel], schedule: Schedule, each: EachLane
) -> tuple[Lane, Int[Array, " lanes"]]:
    """The lanes at their next sample, and the number of trials so far."""
    method, most = schedule.method, schedule.most_trials
    stop = lanes.step + schedule.every
    fixed = Fixed(fixed.model, fixed.grid, stop)
    if most is None:
        return march(lanes, fixed, method, each), trials

    def once(pair):
        lanes, trials = pair
        spent = running(lanes, stop) & (trials >= most)
        status = jnp.where(spent, Status.OUT_OF_TRIALS, lanes.status).astype(jnp.int32)
        lanes = eqx.tree_at(lambda lanes: lanes.status, lanes, status)
        trials = trials + running(lanes, stop).astype(jnp.int32)
        return stepper_for(method).trial(lanes, fixed, method, each), trials

    several = has_several_kernels(method)
    return repeated_while(lambda pair: jnp.any(running(pair[0], stop)), once, (lanes, trials), several)


def _sample_lanes(
    lanes: Lane, model: RowModel, periods: PerLane, schedule: Schedule, each: EachLane
) -> tuple[Lane, Flow]:
    """The lanes as they continue after a sample, and the sample."""
    flow = end_flow(lanes, model, periods * schedule.share(periods.dtype), each)

    def places(lane):
        return (lane.accumulator.integrals, lane.step, lane.status)

    empty = jax.tree.map(jnp.zeros_like, lanes.accumulator.integrals)
    step = jnp.where(lanes.step == schedule.steps, 0, lanes.step)
    return eqx.tree_at(places, lanes, (empty, step, flow.status)), flow


def batching_by_lanes(f: Callable[..., Tree]) -> Callable[..., Tree]:
    """`f` of trees with a leading lane axis, batched such that an axis of `jax.vmap` joins the lane axis."""

    @custom_vmap
    def call(*args):
        return f(*args)

    @call.def_vmap
    def _(size, batched, *args):
        if not size:
            raise InputError("There is nothing to run: jax.vmap was given an axis of no lanes.")
        every = jax.tree.map(lambda a, own: a if own else jnp.broadcast_to(a, (size, *a.shape)), args, tuple(batched))
        out = call(*jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), every))
        return jax.tree.map(lambda a: a.reshape(size, -1, *a.shape[1:]), out), jax.tree.map(lambda _: True, out)

    return call


def _run_compiled(scenes: Any, states: Any, schedule: Schedule) -> tuple[Any, Int[Array, " lanes"]]:
    layout = (scenes.value if isinstance(scenes, Dual) else scenes).layout
    if layout == PAIR and not is_traced((scenes, states)) and accepts_options():
        return _run_large(scenes, states, schedule)
    return _run_plain(scenes, states, schedule._replace(method=method_without_options(schedule.method)))


def _run_samples(scenes: Any, states: Any, schedule: Schedule) -> tuple[Any, Int[Array, " lanes"]]:
    return batching_by_lanes(lambda scenes, states: sampled_flow(scenes, states, schedule))(scenes, states)


def samples_with_tangents(scenes: Dual, states: Dual, schedule: Schedule, wanted: int) -> Dual:
    """The samples of lanes, a `Flow` with axes (lane, sample), with the tangent of each lane along its direction.

    Only the `wanted` first ones mean anything; one compiled program serves any number of them, and of steps.
    """
    large = stepper_for(schedule.method).large_kernels and accepts_options()
    counts = jnp.asarray([wanted, schedule.every, schedule.steps], jnp.int32)
    run = _run_large_part if large else _run_plain_part
    return run(scenes, states, counts, schedule._replace(every=1, steps=1))[0]


def _run_part(
    scenes: Dual, states: Dual, counts: Int[Array, " 3"], schedule: Schedule
) -> tuple[Any, Int[Array, " lanes"]]:
    wanted, every, steps = counts
    return sampled_flow(scenes, states, schedule._replace(every=every, steps=steps), wanted)


def trial_counts(scenes: Scene, states: State, schedule: Schedule) -> Int[Array, " lanes"]:
    """The number of trials of each lane, at most the bound of the schedule."""
    return _run_compiled(scenes, states, schedule)[1]


def differentiable_samples(scene: Scene, state: State, schedule: Schedule) -> Flow:
    """The samples (leading axis) of one lane; they and their derivatives are zero once it has stopped."""
    samples_of = jax.custom_jvp(
        lambda scene, state: _first_lane_flow(_run_compiled(one_lane(scene), one_lane(state), schedule)[0])
    )
    samples_of.defjvp(
        lambda primals, tangents: samples_and_tangents(primals, perturbed_only(tangents), schedule), symbolic_zeros=True
    )
    return samples_of(scene, state)


def perturbed_only(tangents: Tree) -> Tree:
    """The tangents, with None for those that are known to be zero."""

    def zero(a):
        return isinstance(a, SymbolicZero)

    return jax.tree.map(lambda a: None if zero(a) else a, tangents, is_leaf=zero)


def samples_and_tangents(primals: tuple[Scene, State], tangents: Any, schedule: Schedule) -> tuple[Flow, Flow]:
    """The samples of one lane, and their tangents along `perturbed_only` tangents of the scene and the state."""
    leaves, tree = jax.tree.flatten(first_order_only(primals))
    moving = [a is not None for a in tree.flatten_up_to(tangents)]
    along = jnp.concatenate([jnp.ravel(a) for a in jax.tree.leaves(tangents)])
    lanes = jax.tree.map(lambda a: jnp.broadcast_to(a, (len(along), *jnp.shape(a))), tree.unflatten(leaves))
    units = tree.unflatten(_unit_directions(leaves, moving, len(along)))
    flows, _ = _run_compiled(*map(Dual._make, zip(lanes, units, strict=True)), schedule=schedule)
    flow = _first_lane_flow(flows.value)
    slopes = flows.tangent

    def of_going(a):
        going = lax.broadcast_in_dim(flow.status == Status.OK, a.shape, (1,))  # the axis of samples
        return jnp.where(going, a, jnp.zeros_like(a))

    slopes = jax.tree.map(of_going, slopes)

    def slope(a, by):
        return None if by is None else jnp.tensordot(along, by, 1)

    return flow, no_tangents(flow, jax.tree.map(slope, flow, slopes))


def no_tangents(values: Tree, tangents: Tree) -> Tree:
    """The tangents with those of integers, which are None, as JAX requires them."""
    return jax.tree.map(lambda a, by: np.zeros(a.shape, jax.dtypes.float0) if by is None else by, values, tangents)


def _first_lane_flow(flow: Flow) -> Flow:
    """The samples of the first lane, with zeros where it had stopped."""
    first = jax.tree.map(lambda a: a[0], flow)
    return replaced_where(first.status != Status.OK, first, 0.0)._replace(margins=first.margins)


def _unit_directions(leaves: list[Any], moving: list[bool], count: int) -> list[Any]:
    """The parts, leaf by leaf, of `count` unit directions (leading axis) along the leaves that are `moving`."""
    units = []
    done = 0
    for leaf, moves in zip(leaves, moving, strict=True):
        if not jnp.issubdtype(jnp.result_type(leaf), jnp.floating):
            units.append(None)
            continue
        unit = np.zeros((count, jnp.size(leaf)), jnp.result_type(leaf))
        if moves:
            unit[done : done + jnp.size(leaf)] = np.eye(jnp.size(leaf))
            done += jnp.size(leaf)
        units.append(jnp.asarray(unit.reshape(count, *jnp.shape(leaf))))
    return units


_run_plain = kept("schedule")(_run_samples)
_run_large = kept("schedule", compiler_options=FOR_SERIES)(_run_samples)
_run_plain_part = kept("schedule")(_run_part)
_run_large_part = kept("schedule", compiler_options=FOR_SERIES)(_run_part)


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
    clock, method = plan.clock, plan.method
    each = best_mapping()
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
