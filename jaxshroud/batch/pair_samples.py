"""Samples of pairs of blades at any time: their states, their contact forces, and the states around their events.

They are taken inside trials where the stepper has dense output.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.batch.periods import Clock, begin_lanes
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.sampling import (
    EventStates,
    SampledMarch,
    SampleGrid,
    Stretch,
    concatenated_events,
    current_states,
    empty_stretch,
    event_fired,
    interleaved_sides,
    march_by_steps,
    march_by_trials,
    sampled_state,
    with_slider_updated,
)
from jaxshroud.batch.states import carried_state, events_at_start, next_at_start, sampled_contact_forces
from jaxshroud.batch.stretches import EnergyBalance, SampledLanes, march_in_stretches, values_by_name
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.cache.programs import kept
from jaxshroud.march.accumulator import Accumulator
from jaxshroud.march.carry import EachLane, Fixed, Lane
from jaxshroud.march.events import evaluate_guards
from jaxshroud.march.forces_and_energy import energy_residual, total_energy
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import DenseOutput, stepper_for
from jaxshroud.model.arithmetic import Scalar, filled, sincos_turns
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene

DENSE_TRIALS_PER_CALL = 256
EVALUATIONS_PER_CALL = 1024  # of interpolants of each lane


class DenseTrial(NamedTuple):
    """One trial of a lane, with the motion inside it."""

    interpolant: Any  # for `DenseOutput.motion`
    u_s: Scalar  # constant within the trial, like the next two
    mode: Int[Array, ""]
    case: Int[Array, ""]
    status: Int[Array, ""]  # at its end
    steps_into: Scalar  # steps from the beginning of the step to its start
    length: Scalar  # in steps
    whole: Int[Array, ""]  # number of steps that it completed
    done: Scalar  # the part of the next step at its end; never before a sample within the trial
    after: State  # at its end, after the event there, if any
    fired: Bool[Array, ""]


def march_with_dense_output(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March lanes (leading axis), with samples inside their trials; `tick` gets the number of further steps."""
    dense = stepper_for(method).dense_output
    assert dense is not None
    clock, apart, count = grid.clock(scenes, method), stretch.apart, stretch.samples
    width = len(lanes.status)
    left, done, written = np.full(width, stretch.length, np.int32), np.zeros((width, 1), int), np.zeros(width, int)

    def empty(a):
        return np.zeros((width, count, *a.shape[1:]), a.dtype)

    first = current_states(scenes, lanes)
    samples, event_states = jax.tree.map(empty, first), [empty_stretch(first)]
    while np.any((left > 0) & (np.asarray(lanes.status) == Status.OK)):
        (lanes, remaining), trials = _dense_trials(scenes, lanes, clock, left, method, best_mapping())
        ends = done + np.cumsum(np.asarray(trials.whole), axis=1)  # steps of the stretch done after each trial
        reached = ends[:, -1] // apart
        states = _states_at(scenes, trials, *_trials_of_samples(trials, ends, apart, written, reached), clock, dense)
        for lane, (first, end) in enumerate(zip(written, reached, strict=True)):
            _write_samples(samples, lane, slice(first, end), jax.tree.map(lambda a, n=end - first: a[:, :n], states))
        if grid.events:
            event_states.append(_event_states(scenes, trials, stretch.first + ends, grid.every, clock, dense))
        tick(int(ends[:, -1].min() - done.min()))
        written, done, left = reached, ends[:, -1:], np.asarray(remaining)
    stopped = jax.tree.map(np.asarray, current_states(scenes, lanes))
    for lane, first in enumerate(written):
        _write_samples(samples, lane, slice(first, count), stopped)
    tick(stretch.length - int(done.min()))
    return SampledMarch(lanes, samples, concatenated_events(event_states) if grid.events else None)


def _write_samples(samples: State, lane: int, at: slice, states: State) -> None:
    """Write the states of one lane into its samples."""
    for whole, part in zip(jax.tree.leaves(samples), jax.tree.leaves(states), strict=True):
        whole[lane, at] = part[lane]


def _trials_of_samples(
    trials: DenseTrial, ends: np.ndarray, every: int, written: np.ndarray, reached: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The trials in which the next samples of each lane lie, and their distances from the starts of these in steps.

    Args:
        trials: The trials.
        ends: Steps done after each trial (lanes, trials).
        every: Steps from sample to sample.
        written: The number of samples before (lanes,).
        reached: The number of samples after (lanes,).
    """
    numbers = written[:, None] + np.arange(1, (reached - written).max() + 1)
    steps = np.minimum(numbers, np.maximum(reached, written + 1)[:, None]) * every
    index = np.stack([np.searchsorted(end, step) for end, step in zip(ends, steps, strict=True)])
    index = np.minimum(index, ends.shape[1] - 1)
    begun = np.take_along_axis(ends - np.asarray(trials.whole), index, axis=1)
    return index, (steps - begun) - np.take_along_axis(np.asarray(trials.steps_into), index, axis=1)


def _event_states(
    scenes: Scene, trials: DenseTrial, ends: np.ndarray, every: int, clock: Clock, dense: DenseOutput
) -> EventStates:
    """The states on both sides of the events of the only lane."""
    index = np.flatnonzero(np.asarray(trials.fired)[0])
    before = _states_at(scenes, trials, index[None], np.asarray(trials.length)[:, index], clock, dense)
    steps = (ends + np.asarray(trials.done))[0, index]
    after = jax.tree.map(lambda a: np.asarray(a)[:, index], trials.after)
    return EventStates(
        jax.tree.map(interleaved_sides, before, after), np.repeat(steps, 2), np.repeat(ends[0, index] // every, 2)
    )


def _states_at(
    scenes: Scene, trials: DenseTrial, index: np.ndarray, at: np.ndarray, clock: Clock, dense: DenseOutput
) -> State:
    """The states of the lanes `at` so many steps from the starts of trials (lanes, evaluations)."""
    count, blocks = index.shape[1], []
    for begin in range(0, max(count, 1), EVALUATIONS_PER_CALL):
        some = np.minimum(np.arange(begin, begin + EVALUATIONS_PER_CALL), max(count - 1, 0))
        indices, steps = (
            a[:, some] if count else np.zeros((len(a), EVALUATIONS_PER_CALL), a.dtype) for a in (index, at)
        )
        blocks.append(jax.tree.map(np.asarray, _interpolated(scenes, trials, indices, steps, clock.per_period, dense)))
    return jax.tree.map(lambda *a: np.concatenate(a, axis=1)[:, :count], *blocks)


@kept("dense")
def _interpolated(scenes: Scene, trials: DenseTrial, index, at, per_period: Scalar, dense: DenseOutput) -> State:
    def one_lane(scene: Scene, trials: DenseTrial, index, at) -> State:
        model = prepared_model(scene)

        def one(index, at) -> State:
            own = jax.tree.map(lambda a: a[index], trials)
            z = dense.motion(own.interpolant, scene.drive.period, per_period, at)
            return with_slider_updated(State(z, own.u_s, own.mode, own.case), own.status, model)

        return jax.vmap(one)(index, at)

    return jax.vmap(one_lane)(scenes, trials, index, at)


@compiled("method", "each")
def _dense_trials(scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane):
    """The next trials (lanes, trials); those after the last of the steps `left` (lanes,) are idle."""
    models, period = jax.vmap(lambda scene: (prepared_model(scene), scene.drive.period))(scenes)
    grids, dense = clock.grids(period), stepper_for(method).dense_output
    assert dense is not None

    def one(carry):
        lanes, left = carry
        fixed = Fixed(models, grids, jnp.minimum(lanes.step + left, clock.steps))
        tried, interpolants = each(lambda lane, fixed: dense.trial(lane, fixed, method), lanes, fixed)
        ahead = dense.update(lanes, tried, fixed, method, each)
        trials = DenseTrial(
            interpolant=interpolants,
            u_s=lanes.state.u_s,
            mode=lanes.state.mode,
            case=lanes.state.case,
            status=ahead.status,
            steps_into=lanes.search.done,
            length=tried.length,
            whole=ahead.step - lanes.step,
            done=ahead.search.done,
            after=jax.vmap(sampled_state)(ahead, models),
            fired=event_fired(lanes, ahead),
        )
        ahead = eqx.tree_at(lambda lanes: lanes.step, ahead, jnp.where(ahead.step == clock.steps, 0, ahead.step))
        return (ahead, left - trials.whole), trials

    return _scan_in_columns(one, (lanes, left), DENSE_TRIALS_PER_CALL)


def _scan_in_columns(one: Callable[[Any], tuple[Any, Any]], carry: Any, length: int) -> tuple[Any, Any]:
    """The last carry and the outputs (lanes, length, ...) of `carry, output = one(carry)`, repeated.

    The outputs of a turn, arrays (lanes, ...), leave it as one array of each type: to store some hundred small arrays
    takes longer than a trial.
    """
    structure, like = None, []

    def turn(carry, _):
        nonlocal structure, like
        carry, output = one(carry)
        leaves, structure = jax.tree.flatten(output)
        like, columns = [(str(a.dtype), a.shape[1:]) for a in leaves], {}
        for leaf, (kind, _) in zip(leaves, like, strict=True):
            columns.setdefault(kind, []).append(leaf.reshape(len(leaf), -1))
        return carry, {kind: jnp.concatenate(group, axis=1) for kind, group in columns.items()}

    carry, joined = lax.scan(turn, carry, None, length=length)
    leaves, first = [], dict.fromkeys(joined, 0)
    for kind, shape in like:
        end = first[kind] + math.prod(shape)
        column = jnp.moveaxis(joined[kind][..., first[kind] : end], 0, 1)
        leaves.append(column.reshape(*column.shape[:2], *shape))
        first[kind] = end
    return carry, jax.tree.unflatten(structure, leaves)


def sampled_pairs(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> SampledLanes:
    """March pairs (leading axis) and keep samples; `tick` gets the number of further steps."""
    lanes, first = _begin_sampled(scenes, states, method)
    first = _begun(scenes, first, grid.turns)
    before = stored_energies(scenes, lanes)
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    lanes, whole, amplitudes, events = march_in_stretches(march, scenes, lanes, first, grid)
    samples = _values(scenes, whole, grid.turns + np.arange(grid.samples + 1) * grid.every / grid.steps)
    at_events = None
    if events is not None:
        at_events = _values(scenes, events.states, grid.turns + events.steps / grid.steps)
        after = np.where(events.steps == 0, -1, events.samples)  # the first sample comes after what happens at once
        at_events |= {"t": events.steps[None], "after": after[None]}
    energies = np.asarray(before), np.asarray(stored_energies(scenes, lanes))
    return SampledLanes(samples, amplitudes, jax.tree.map(np.asarray, lanes), energies, at_events)


def _begun(scenes: Scene, first: State, turns: float) -> State:
    """The states (leading axis) once all has happened that happens at the instant of their start."""
    forces = sampled_contact_forces(scenes, jax.tree.map(lambda a: np.asarray(a)[:, None], first), np.array([turns]))
    apart = np.asarray(interface_mode(by_point(first.mode, first.case))) == Mode.APART
    overlap = apart & (forces.v[:, 0] >= 0)
    return _states_once_begun(scenes, first, np.asarray(turns, first.u_s.dtype)) if overlap.any() else first


@kept()
def _states_once_begun(scenes: Scene, states: State, turns) -> State:
    def one(scene: Scene, state: State) -> State:
        model = prepared_model(scene)
        start = now = carried_state(state, model)
        wave = drive_waves(*sincos_turns(turns), model.drive)
        for _ in range(events_at_start(model)):
            now = next_at_start(now, start, evaluate_guards(now.motion, wave, now, model), model)
        return with_slider_updated(now, jnp.int32(Status.OK), model)

    return jax.vmap(one)(scenes, states)


def motions_of_pairs(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Motion:
    """The motion of the samples of pairs (leading axis) alone."""
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    return march_in_stretches(march, scenes, begin_lanes(scenes, states, method), states, grid).samples.motion


def _march_stretch(
    scenes: Scene, lanes: Lane, stretch: Stretch, *, grid: SampleGrid, method: Choices, tick: Tick
) -> SampledMarch:
    march = march_by_trials if grid.events else march_by_steps
    if stepper_for(method).dense_output is not None:
        march = march_with_dense_output
    return march(scenes, lanes, stretch, grid, method, tick)


@kept("method")
def _begin_sampled(scenes: Scene, states: State, method: Choices) -> tuple[Lane, State]:
    """The lanes at their start, and their states there as samples."""
    lanes = begin_lanes(scenes, states, method)
    return lanes, current_states(scenes, lanes)


def _values(scenes: Scene, states: State, turns: np.ndarray) -> dict[str, Any]:
    """The stored values of states (lanes, samples) at phases of the drive (samples,) [turns]."""
    return values_by_name(states, sampled_contact_forces(scenes, states, turns))


def balance_of_pairs(accumulator: Accumulator, gained: np.ndarray) -> EnergyBalance | None:
    """The energy balance of pairs that have `gained` energies [J]; None without a ledger."""
    gain, jumps = accumulator.integrals.ledger, accumulator.jumps
    if gain is None or jumps is None:
        return None
    residual = np.asarray(energy_residual(*jax.tree.map(jnp.asarray, (gain, jumps, gained))))
    return EnergyBalance(filled(gain, gain.drive), {}, residual, np.asarray(filled(jumps.dropped, gain.gross)))


@kept()
def stored_energies(scenes: Scene, lanes: Lane) -> Float[Array, " lanes"]:
    """The kinetic energies, and the energies of the springs, of lanes (leading axis) [J]."""
    return jax.vmap(lambda scene, lane: total_energy(lane.state, prepared_model(scene)))(scenes, lanes)
