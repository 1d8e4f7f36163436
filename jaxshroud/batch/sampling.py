"""Samples of a march at the ends of steps, and of its trials where events are kept too."""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.periods import CallLimits, Clock, first_passes, march_steps
from jaxshroud.batch.states import as_arrays, with_zeros
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.cache.programs import kept
from jaxshroud.march.carry import EachLane, Fixed, Lane, running
from jaxshroud.march.forces_and_energy import slider_position
from jaxshroud.march.method import Choices
from jaxshroud.march.pair_as_row import end_of_trial
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.points_contact import points_last
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree

SAMPLES_PER_BLOCK = 1024  # samples per call
MAX_UNKEPT = 1 << 19  # samples of all lanes that are held at once, where only some of them are kept
EVENT_TRIALS_PER_CALL = 1024


class SampleGrid(NamedTuple):
    """The time grid of a march, and which of its states are kept besides the first."""

    turns: float  # drive phase at the start [turns]
    steps: int  # in a period
    every: int  # steps from sample to sample
    length: int  # steps in all, whole periods; some may follow the last sample
    events: bool = False  # the states on both sides of every event too; of a single lane
    counted: int = 0  # of these steps the last ones, whole periods, at the end of each of which the motion counts

    @property
    def samples(self) -> int:
        """The number of samples after the first."""
        return self.length // self.every

    def stretches(self, lanes: int) -> "list[Stretch]":
        """The parts of the march of so many lanes, of whole periods: before the steps that count, and these.

        The march is the same whatever is kept: samples never lie further apart than they divide the period, and each
        of the steps that count has one. Where not all samples are kept, a part is as short as memory wants.
        """
        before, parts = self.length - self.counted, []
        for begin, end, apart in ((0, before, math.gcd(self.every, self.steps)), (before, self.length, 1)):
            periods = max(MAX_UNKEPT * apart // (lanes * self.steps), 1)
            longest = max(end - begin, 1) if apart == self.every else periods * self.steps
            parts += [Stretch(first, apart, min(longest, end - first)) for first in range(begin, end, longest)]
        return parts

    def step_lengths(self, scenes: Scene) -> np.ndarray:
        """The length of a step of each scene [s], (lanes,)."""
        return math.tau / np.asarray(scenes.drive.omega, float) / self.steps

    def clock(self, scenes: Scene, method: Choices) -> Clock:
        """The time grid of a method in the precision of the scenes."""
        dtype = scenes.drive.omega.dtype
        start, steps = jnp.asarray(self.turns, dtype), jnp.asarray(self.steps, dtype)
        return Clock(start, jnp.int32(self.steps), steps, np.asarray(method.flat_return, dtype))


class Stretch(NamedTuple):
    """A part of a march."""

    first: int  # steps before it
    apart: int  # steps from sample to sample
    length: int  # in steps, whole periods

    @property
    def samples(self) -> int:
        """The number of samples in it."""
        return self.length // self.apart

    def kept(self, grid: SampleGrid) -> np.ndarray:
        """The indices of the samples that are kept."""
        return np.flatnonzero((self.first + self.apart * np.arange(1, self.samples + 1)) % grid.every == 0)


class EventStates(NamedTuple):
    """The states on both sides of every event of one lane."""

    states: State  # (1, events), with two entries for each event: before and after
    steps: np.ndarray  # time of the event in steps since the beginning (events,)
    samples: np.ndarray  # index of the preceding sample (events,)


def sampled_state(lane: Lane, scene_model: Model) -> State:
    """The state of a lane with its slider updated; NaN once the lane has stopped."""
    return with_slider_updated(lane.state, lane.status, scene_model)


def with_slider_updated(state: State, status: Int[Array, ""], scene_model: Model) -> State:
    """A state with its slider updated; NaN where the status is not OK."""
    motion, state = state.motion, with_zeros(state)
    u_s = slider_position(State(motion, state.u_s, state.mode, state.case), scene_model)
    motion, u_s = jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), (as_arrays(state.motion), u_s))
    return State(motion, points_last(u_s), points_last(state.mode), state.case)


class SampledMarch(NamedTuple):
    """The result of a stretch of a march."""

    lanes: Lane  # at the end
    states: State  # the samples (lanes, samples), without the first
    events: EventStates | None = None  # None unless they are kept


def march_by_steps(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March lanes (leading axis) with samples at the ends of steps; `tick` gets the number of further steps."""
    clock, each = grid.clock(scenes, method), best_mapping()

    def block(interim: tuple[Any, Lane], limits: CallLimits) -> tuple[tuple[Any, Lane], Any, State]:
        begun, lanes = interim
        every = np.int32(stretch.apart)
        begun, lanes, ended, states = _block_of_samples(scenes, lanes, begun, clock, every, limits, method, each)
        return (begun, lanes), ended, states

    pace = CallPace(first_passes(len(lanes.status), scenes.layout))
    (_, lanes), states = sampled_in_calls(block, (np.int32(0), lanes), stretch, SAMPLES_PER_BLOCK, pace, tick)
    return SampledMarch(lanes, states)


def sampled_in_calls(
    block: Callable[[Any, CallLimits], tuple[Any, Any, Tree]],
    interim: Any,
    stretch: Stretch,
    most: int,
    pace: CallPace,
    tick: Callable[[int], None],
) -> tuple[Any, Tree]:
    """March over a stretch in calls to the device that are short.

    Args:
        block: A call: what lies between two calls, how many samples have ended, and samples (leading axis, then the
            lanes), of which further ones are meaningless.
        interim: What lies before the first call.
        stretch: The stretch.
        most: The samples of a call at most.
        pace: How much a call does.
        tick: Called with the number of further steps.

    Returns:
        What lies after the last call, and the samples (lanes, samples, ...).
    """
    blocks, done = [], 0
    while done < stretch.samples:

        def call(passes: np.int32, left: int = stretch.samples - done, interim: Any = interim) -> Any:
            after, ended, samples = block(interim, CallLimits(jnp.int32(min(left, most)), jnp.asarray(passes)))
            return after, int(ended), samples

        interim, ended, samples = pace.timed(call, lambda result, left=stretch.samples - done: result[1] < left)
        blocks.append(jax.tree.map(lambda a, n=ended: np.moveaxis(np.asarray(a)[:n], 0, 1), samples))
        done += ended
        tick(ended * stretch.apart)
    return interim, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)


@compiled("method", "each")
def _block_of_samples(
    scenes: Scene,
    lanes: Lane,
    begun: Int[Array, ""],
    clock: Clock,
    every: Int[Array, ""],
    limits: CallLimits,
    method: Choices,
    each: EachLane,
) -> tuple[Int[Array, ""], Lane, Int[Array, ""], State]:
    """The next samples (leading axis, then the lanes), `every` steps apart; `begun` steps of the first are done.

    Returns:
        The steps done of the sample that is not ended, the lanes at the end, how many samples have ended, and these;
        further ones are meaningless. A step counts as a pass.
    """
    models, period = jax.vmap(lambda scene: (prepared_model(scene), scene.drive.period))(scenes)
    grids = clock.grids(period)

    def one_step(_, lanes):
        return march_steps(lanes, Fixed(models, grids, lanes.step + 1), clock.steps, method, each)[0]

    def one_sample(carry, i):
        lanes, done, left = carry
        now = jnp.where(i < limits.most, jnp.minimum(every - done, left), 0)
        lanes = lax.fori_loop(0, now, one_step, lanes)
        over = (i < limits.most) & (done + now == every)
        return (lanes, jnp.where(over, 0, done + now), left - now), (jax.vmap(sampled_state)(lanes, models), over)

    begin = lanes, begun, limits.passes
    (lanes, begun, _), (samples, over) = lax.scan(one_sample, begin, jnp.arange(SAMPLES_PER_BLOCK, dtype=jnp.int32))
    return begun, lanes, jnp.sum(over, dtype=jnp.int32), samples


def march_by_trials(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March a single lane (leading axis) trial by trial, with its events; `tick` gets the number of further steps.

    The steps must end trials, as with a stepper without dense output.
    """
    clock, left, done, samples, events = grid.clock(scenes, method), np.int32(stretch.length), stretch.first, [], []
    while left and int(np.asarray(lanes.status)[0]) == Status.OK:
        (lanes, remaining), trials = _event_trials(scenes, lanes, clock, left, method, best_mapping())
        trials = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, 1), trials)
        arrived, fired = trials.arrived[0], np.repeat(trials.fired[0], 2)
        ends = done + np.cumsum(arrived)  # steps done after each trial
        wanted = arrived & ((ends - stretch.first) % stretch.apart == 0)
        samples.append(jax.tree.map(lambda a, wanted=wanted: a[:, wanted], trials.after))
        steps = np.repeat(ends - arrived + trials.steps_into[0], 2)[fired]
        before = np.repeat((ends - arrived) // grid.every, 2)[fired]
        events.append(
            EventStates(
                jax.tree.map(lambda *a, of=fired: interleaved_sides(*a)[:, of], trials.before, trials.after),
                steps,
                before,
            )
        )
        tick(int(ends[-1]) - done)
        done, left = int(ends[-1]), remaining
    missing = stretch.samples - sum(block.mode.shape[1] for block in samples)
    if missing:  # the lane has stopped
        last = current_states(scenes, lanes)
        samples.append(jax.tree.map(lambda a: np.repeat(np.asarray(a)[:, None], missing, axis=1), last))
    states = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *samples)
    return SampledMarch(lanes, states, concatenated_events(events or [empty_stretch(current_states(scenes, lanes))]))


def empty_stretch(states: State) -> EventStates:
    """The events of a lane with such states before the first one."""
    return EventStates(jax.tree.map(lambda a: np.asarray(a)[:, None][:, :0], states), np.empty(0), np.empty(0, int))


def concatenated_events(stretches: list[EventStates]) -> EventStates:
    """The events of consecutive parts of a run, of one at least."""
    return jax.tree.map(lambda *a: np.concatenate(a, axis=-1 if a[0].ndim < 3 else 1), *stretches)


def interleaved_sides(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Both sides of trials (lanes, trials, ...), interleaved along the trials."""
    return np.stack([before, after], axis=2).reshape(len(before), -1, *before.shape[2:])


class _SampledTrial(NamedTuple):
    """A trial that ended a step or at an event."""

    before: State  # at its end, in the mode of the trial
    after: State
    steps_into: Scalar  # steps from the beginning of the step to the trial's end
    fired: Array  # it ended at an event
    arrived: Array  # it ended a step


@compiled("method", "each")
def _event_trials(scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane):
    """The next trials that ended a step or at an event; those after the last of the steps `left` are idle."""
    models, period = jax.vmap(lambda scene: (prepared_model(scene), scene.drive.period))(scenes)
    grids, trial = clock.grids(period), stepper_for(method).trial

    def one(carry, _):
        lanes, left = carry
        fixed = Fixed(models, grids, jnp.where(left > 0, lanes.step + 1, lanes.step))

        def once(lanes):
            return trial(lanes, fixed, method, each)

        def idle(pair):
            return jnp.any(~(event_fired(*pair) | _step_ended(*pair)) & running(pair[1], fixed.stop))

        before, ahead = lax.while_loop(idle, lambda pair: (pair[1], once(pair[1])), (lanes, once(lanes)))
        sampled = _SampledTrial(
            jax.vmap(with_slider_updated)(end_of_trial(before, fixed, method, each), before.status, models),
            jax.vmap(sampled_state)(ahead, models),
            before.search.done + before.search.length,
            event_fired(before, ahead),
            _step_ended(before, ahead),
        )
        around = jnp.where(ahead.step == clock.steps, 0, ahead.step)
        ahead = eqx.tree_at(lambda lanes: lanes.step, ahead, around)
        return (ahead, left - sampled.arrived[0].astype(left.dtype)), sampled

    return lax.scan(one, (lanes, left), None, length=EVENT_TRIALS_PER_CALL)


def event_fired(before: Lane, after: Lane) -> Array:
    """Whether a trial ended at an event: each event changes the mode or the case."""
    changed = jax.tree.leaves(jax.tree.map(jnp.not_equal, after.state.mode, before.state.mode))
    return reduce(jnp.logical_or, changed) | (after.state.case != before.state.case)


def _step_ended(before: Lane, after: Lane) -> Array:
    """Whether a step has ended."""
    return after.step > before.step


@kept()
def current_states(scenes: Scene, lanes: Lane) -> State:
    """The state of each lane with its slider updated; NaN once the lane has stopped."""
    return jax.vmap(lambda scene, lane: sampled_state(lane, prepared_model(scene)))(scenes, lanes)
