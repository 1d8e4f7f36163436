"""Samples of lanes inside their trials, where the stepper has dense output, and the samples around their events."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.batch.lanes import Sampled, lane_models, lanes_first, lanes_last, sampled
from jaxshroud.batch.periods import Clock, with_clock_reset
from jaxshroud.batch.sampling import (
    EventStates,
    SampledMarch,
    SampleGrid,
    Stretch,
    concatenated_events,
    empty_stretch,
    event_fired,
    interleaved_sides,
    sampled_now,
    turns_of,
)
from jaxshroud.batch.xla import best_mapping, compiled, vmapped
from jaxshroud.cache.programs import kept
from jaxshroud.march.carry import EachLane, Fixed, Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import DenseOutput, stepper_for
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
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
    step: Int[Array, ""]  # in which it was made
    steps_into: Scalar  # steps from the beginning of the step to its start
    length: Scalar  # in steps
    whole: Int[Array, ""]  # number of steps that it completed
    done: Scalar  # the part of the next step at its end; never before a sample within the trial
    after: Sampled | None  # at its end, after the event there, if any; None where events are not kept
    fired: Bool[Array, ""]


def march_with_dense_output(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March lanes (leading axis), with samples inside their trials; `tick` gets the number of further steps."""
    dense = stepper_for(method).dense_output
    assert dense is not None
    clock = grid.clock(scenes, method)
    apart = stretch.apart
    count = stretch.samples
    width = len(lanes.status)
    left = np.full(width, stretch.length, np.int32)
    done = np.zeros((width, 1), int)
    written = np.zeros(width, int)

    def empty(a):
        return np.zeros((width, count, *a.shape[1:]), a.dtype)

    first = sampled_now(scenes, lanes, clock, best_mapping(), grid.forces)
    samples = jax.tree.map(empty, first)
    event_states = [empty_stretch(first)]
    while np.any((left > 0) & (np.asarray(lanes.status) == Status.OK)):
        kept_of_trials = grid.forces, grid.events
        (lanes, remaining), trials = _dense_trials(scenes, lanes, clock, left, method, best_mapping(), *kept_of_trials)
        ends = done + np.cumsum(np.asarray(trials.whole), axis=1)  # steps of the stretch done after each trial
        reached = ends[:, -1] // apart
        index, at = _trials_of_samples(trials, ends, apart, written, reached)
        states = _samples_at(scenes, trials, index, at, clock, dense, grid.forces)
        for lane, (first, end) in enumerate(zip(written, reached, strict=True)):
            _write_samples(samples, lane, slice(first, end), jax.tree.map(lambda a, n=end - first: a[:, :n], states))
        if grid.events:
            event_states.append(_event_states(scenes, trials, stretch.first + ends, grid, clock, dense))
        tick(int(ends[:, -1].min() - done.min()))
        written = reached
        done = ends[:, -1:]
        left = np.asarray(remaining)
    stopped = jax.tree.map(np.asarray, sampled_now(scenes, lanes, clock, best_mapping(), grid.forces))
    for lane, first in enumerate(written):
        _write_samples(samples, lane, slice(first, count), stopped)
    tick(stretch.length - int(done.min()))
    return SampledMarch(lanes, samples, concatenated_events(event_states) if grid.events else None)


def _write_samples(samples: Sampled, lane: int, at: slice, some: Sampled) -> None:
    """Write some samples of one lane into all of them."""
    for whole, part in zip(jax.tree.leaves(samples), jax.tree.leaves(some), strict=True):
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
    scenes: Scene, trials: DenseTrial, ends: np.ndarray, grid: SampleGrid, clock: Clock, dense: DenseOutput
) -> EventStates:
    """The samples on both sides of the events of the only lane."""
    index = np.flatnonzero(np.asarray(trials.fired)[0])
    length = np.asarray(trials.length)[:, index]
    before = _samples_at(scenes, trials, index[None], length, clock, dense, grid.forces)
    steps = (ends + np.asarray(trials.done))[0, index]
    after = jax.tree.map(lambda a: np.asarray(a)[:, index], trials.after)
    sides = jax.tree.map(interleaved_sides, before, after)
    return EventStates(sides, np.repeat(steps, 2), np.repeat(ends[0, index] // grid.every, 2))


def _samples_at(
    scenes: Scene,
    trials: DenseTrial,
    index: np.ndarray,
    at: np.ndarray,
    clock: Clock,
    dense: DenseOutput,
    forces: bool,
) -> Sampled:
    """The samples of the lanes `at` so many steps from the starts of trials (lanes, evaluations)."""
    count = index.shape[1]
    blocks = []
    for begin in range(0, max(count, 1), EVALUATIONS_PER_CALL):
        some = np.minimum(np.arange(begin, begin + EVALUATIONS_PER_CALL), max(count - 1, 0))
        indices, steps = (
            a[:, some] if count else np.zeros((len(a), EVALUATIONS_PER_CALL), a.dtype) for a in (index, at)
        )
        block = _interpolated(scenes, trials, indices, steps, clock, dense, forces)
        blocks.append(jax.tree.map(np.asarray, block))
    return jax.tree.map(lambda *a: np.concatenate(a, axis=1)[:, :count], *blocks)


@kept("dense", "forces")
def _interpolated(
    scenes: Scene, trials: DenseTrial, index, at, clock: Clock, dense: DenseOutput, forces: bool
) -> Sampled:
    """`_samples_at` of as many evaluations of each lane: each is a lane by itself."""
    lanes, evaluations = index.shape
    place = jnp.arange(lanes)[:, None]
    own = lanes_last(jax.tree.map(lambda a: a[place, index].reshape(-1, *a.shape[2:]), trials))
    model, period = jax.tree.map(lambda a: jnp.repeat(a, evaluations, axis=-1), lane_models(scenes))
    at = at.reshape(-1)
    z = dense.motion(own.interpolant, model, period, clock.per_period, at)
    into = own.step.astype(at.dtype) + own.steps_into + at
    turns = (clock.start + into / clock.per_period).astype(own.length.dtype)
    states = sampled(State(z, own.u_s, own.mode, own.case), own.status, turns, model, vmapped, forces)
    return jax.tree.map(lambda a: a.reshape(lanes, evaluations, *a.shape[1:]), states)


@compiled("method", "each", "forces", "events")
def _dense_trials(
    scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane, forces: bool, events: bool
) -> tuple[tuple[Lane, Any], DenseTrial]:
    """The next trials (lanes, trials); those after the last of the steps `left` (lanes,) are idle."""
    model, period = lane_models(scenes)
    grids = clock.grids(period)
    dense = stepper_for(method).dense_output
    assert dense is not None

    def one(carry):
        lanes, left = carry
        fixed = Fixed(model, grids, jnp.minimum(lanes.step + left, clock.steps))
        tried, interpolants = dense.trial(lanes, fixed, method, each)
        ahead = dense.update(lanes, tried, fixed, method, each)
        trials = DenseTrial(
            interpolant=lanes_first(interpolants),
            u_s=lanes_first(lanes.state.u_s),
            mode=lanes_first(lanes.state.mode),
            case=lanes_first(lanes.state.case),
            status=ahead.status,
            step=lanes.step,
            steps_into=lanes.search.done,
            length=tried.length,
            whole=ahead.step - lanes.step,
            done=ahead.search.done,
            after=sampled(ahead.state, ahead.status, turns_of(ahead, grids), model, each, forces) if events else None,
            fired=event_fired(lanes, ahead),
        )
        ahead = with_clock_reset(ahead, ahead.step == clock.steps)
        return (ahead, left - trials.whole), trials

    (lanes, left), trials = _scan_in_columns(one, (lanes_last(lanes), left), DENSE_TRIALS_PER_CALL)
    return (lanes_first(lanes), left), trials


def _scan_in_columns(one: Callable[[Any], tuple[Any, Any]], carry: Any, length: int) -> tuple[Any, Any]:
    """The last carry and the outputs (lanes, length, ...) of `carry, output = one(carry)`, repeated.

    The outputs of a turn, arrays (lanes, ...), leave it as one array of each type: to store some hundred small arrays
    takes longer than a trial.
    """
    structure = None
    like = []

    def turn(carry, _):
        nonlocal structure, like
        carry, output = one(carry)
        leaves, structure = jax.tree.flatten(output)
        like = [(str(a.dtype), a.shape[1:]) for a in leaves]
        columns = {}
        for leaf, (kind, _) in zip(leaves, like, strict=True):
            columns.setdefault(kind, []).append(leaf.reshape(len(leaf), -1))
        return carry, {kind: jnp.concatenate(group, axis=1) for kind, group in columns.items()}

    carry, joined = lax.scan(turn, carry, None, length=length)
    leaves = []
    first = dict.fromkeys(joined, 0)
    for kind, shape in like:
        end = first[kind] + math.prod(shape)
        column = jnp.moveaxis(joined[kind][..., first[kind] : end], 0, 1)
        leaves.append(column.reshape(*column.shape[:2], *shape))
        first[kind] = end
    return carry, jax.tree.unflatten(structure, leaves)
