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
from jaxtyping import Array, Float, Int

from jaxshroud.batch.lanes import Sampled, events_at_start, lane_models, lanes_first, lanes_last, next_at_start, sampled
from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.periods import (
    CallLimits,
    Clock,
    Interim,
    Part,
    first_passes,
    in_calls,
    marched_block,
    with_clock_reset,
)
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.carry import EachLane, Fixed, Lane, TimeGrid, running
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import interface_view, row_torques
from jaxshroud.march.row_trial import step_of_trial
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import Scalar, sincos_turns
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.model.prepared import State
from jaxshroud.model.row import over, pair_states
from jaxshroud.scene.scene import Scene

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
    forces: bool = True  # the forces of contact too

    @property
    def samples(self) -> int:
        """The number of samples after the first."""
        return self.length // self.every

    def stretches(self, lanes: int) -> "list[Stretch]":
        """The parts of the march of so many lanes, of whole periods: before the steps that count, and these.

        The march is the same whatever is kept: samples never lie further apart than they divide the period, and each
        of the steps that count has one. Where not all samples are kept, a part is as short as memory wants.
        """
        before = self.length - self.counted
        parts = []
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
        numbers = {"start": self.turns, "flat_return": method.flat_return, "dtype": scenes.drive.omega.dtype}
        return Clock.of_steps(self.steps, **numbers)


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

    states: Sampled  # (1, events), with two entries for each event: before and after
    steps: np.ndarray  # time of the event in steps since the beginning (events,)
    samples: np.ndarray  # index of the preceding sample (events,)


class SampledMarch(NamedTuple):
    """The result of a stretch of a march."""

    lanes: Lane  # at the end
    states: Sampled  # the samples (lanes, samples), without the first
    events: EventStates | None = None  # None unless they are kept


def march_by_steps(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March lanes (leading axis) with samples at the ends of steps; `tick` gets the number of further steps."""
    options = grid.clock(scenes, method), jnp.int32(stretch.apart)

    def block(interim: Interim, limits: CallLimits) -> tuple[Interim, Any, Sampled]:
        return _block_of_samples(scenes, interim, *options, limits, method, best_mapping(), grid.forces)

    def steps_done(samples: float) -> None:
        tick(round(samples * stretch.apart))

    pace = CallPace(first_passes(len(lanes.status), scenes.layout))
    begin = Interim(lanes, np.zeros(lanes.status.shape, np.int32), np.bool_(False))
    end, states = in_calls(block, begin, stretch.samples, SAMPLES_PER_BLOCK, pace, steps_done)
    return SampledMarch(end.lanes, states)


@compiled("method", "each", "forces")
def _block_of_samples(
    scenes: Scene,
    begin: Interim,
    clock: Clock,
    every: Int[Array, ""],
    limits: CallLimits,
    method: Choices,
    each: EachLane,
    forces: bool,
) -> tuple[Interim, Int[Array, ""], Sampled]:
    """The next samples (leading axis, then the lanes), `every` steps apart, after how many there are."""
    model, period = lane_models(scenes)
    grids = clock.grids(period)

    def end(lanes, _, over):
        sample = sampled(lanes.state, lanes.status, turns_of(lanes, grids), model, each, forces)
        step = jnp.where(over, lanes.step % clock.steps, lanes.step)
        return eqx.tree_at(lambda lane: lane.step, lanes, step), sample

    part = Part(lambda lanes: (lanes, lanes.step + every), lambda stops: stops, end)
    return marched_block(part, begin, (model, grids), limits, SAMPLES_PER_BLOCK, method, each)


def march_by_trials(
    scenes: Scene, lanes: Lane, stretch: Stretch, grid: SampleGrid, method: Choices, tick: Callable[[int], None]
) -> SampledMarch:
    """March a single lane (leading axis) trial by trial, with its events; `tick` gets the number of further steps.

    The steps must end trials, as with a stepper without dense output.
    """
    clock = grid.clock(scenes, method)
    left = np.int32(stretch.length)
    done = stretch.first
    samples = []
    events = []
    while left and int(np.asarray(lanes.status)[0]) == Status.OK:
        (lanes, remaining), trials = _event_trials(scenes, lanes, clock, left, method, best_mapping(), grid.forces)
        trials = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, 1), trials)
        arrived = trials.arrived[0]
        fired = np.repeat(trials.fired[0], 2)
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
        done = int(ends[-1])
        left = remaining
    missing = stretch.samples - sum(block.state.case.shape[1] for block in samples)
    last = sampled_now(scenes, lanes, clock, best_mapping(), grid.forces)
    if missing:  # the lane has stopped
        samples.append(jax.tree.map(lambda a: np.repeat(np.asarray(a)[:, None], missing, axis=1), last))
    states = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *samples)
    return SampledMarch(lanes, states, concatenated_events(events or [empty_stretch(last)]))


def empty_stretch(states: Sampled) -> EventStates:
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

    before: Sampled  # at its end, in the mode of the trial
    after: Sampled
    steps_into: Scalar  # steps from the beginning of the step to the trial's end
    fired: Array  # it ended at an event
    arrived: Array  # it ended a step


@compiled("method", "each", "forces")
def _event_trials(scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane, forces: bool):
    """The next trials that ended a step or at an event; those after the last of the steps `left` are idle."""
    model, period = lane_models(scenes)
    grids = clock.grids(period)
    trial = stepper_for(method).trial

    def one(carry, _):
        lanes, left = carry
        fixed = Fixed(model, grids, jnp.where(left > 0, lanes.step + 1, lanes.step))

        def once(lanes):
            return trial(lanes, fixed, method, each)

        def idle(pair):
            return jnp.any(~(event_fired(*pair) | _step_ended(*pair)) & running(pair[1], fixed.stop))

        before, ahead = lax.while_loop(idle, lambda pair: (pair[1], once(pair[1])), (lanes, once(lanes)))
        into = before.search.done + before.search.length
        end = step_of_trial(before, fixed, method, each)
        turns = turns_of(before, grids) + before.search.length * grids.turn
        trials = _SampledTrial(
            sampled(end.state, before.status, turns, model, each, forces),
            sampled(ahead.state, ahead.status, turns, model, each, forces),
            into,
            event_fired(before, ahead),
            _step_ended(before, ahead),
        )
        ahead = with_clock_reset(ahead, ahead.step == clock.steps)
        return (ahead, left - trials.arrived[0].astype(left.dtype)), trials

    (lanes, left), trials = lax.scan(one, (lanes_last(lanes), left), None, length=EVENT_TRIALS_PER_CALL)
    return (lanes_first(lanes), left), trials


def event_fired(before: Lane, after: Lane) -> Array:
    """Whether trials of lanes, lanes last, ended at an event: each event changes a mode or a case."""
    contact = [(lane.state.mode, lane.state.case) for lane in (before, after)]
    changed = jax.tree.leaves(jax.tree.map(jnp.not_equal, *contact))
    return reduce(jnp.logical_or, (jnp.any(jnp.atleast_2d(a), axis=0) for a in changed))


def _step_ended(before: Lane, after: Lane) -> Array:
    """Whether a step has ended."""
    return after.step > before.step


def turns_of(lanes: Lane, grids: TimeGrid) -> Float[Array, " lanes"]:
    """The phase of the drive where lanes are [turns]."""
    return grids.start + (lanes.step.astype(grids.start.dtype) + lanes.search.done) * grids.turn


@compiled("each", "forces", "begun")
def sampled_now(scenes: Scene, lanes: Lane, clock: Clock, each: EachLane, forces: bool, begun: bool = False) -> Sampled:
    """The sample of lanes (leading axis) where they are; NaN once a lane has stopped.

    Of lanes at their start that is once all has happened that happens at that instant, if the march is to have `begun`.
    """
    model, period = lane_models(scenes)
    lanes = lanes_last(lanes)
    turns = turns_of(lanes, clock.grids(period))
    wave = each(sincos_turns, turns)
    now = lanes.state

    def at_interface(torque: Any, now: State, start: State, model: Any) -> tuple[Any, Any, Any]:
        after = next_at_start(now, start, interface_view(torque, now, model), model)
        return after.u_s, after.mode, after.case

    for _ in range(events_at_start(model.interfaces) if begun else 0):
        torque, _ = row_torques(now, wave, model, each)
        pairs = pair_states(now, model), pair_states(lanes.state, model)
        u_s, mode, case = over(each, at_interface, torque, *pairs, model.interfaces)
        now = State(now.motion, u_s, mode, case)
    return sampled(now, lanes.status, turns, model, each, forces)


def first_sample(scenes: Scene, lanes: Lane, clock: Clock, forces: bool) -> Sampled:
    """The sample at the start of lanes (leading axis), where faces that overlap are in contact."""
    how = clock, best_mapping(), forces
    first = sampled_now(scenes, lanes, *how)
    if first.forces is None:
        return first
    apart = np.asarray(interface_mode(by_point(first.state.mode, first.state.case))) == Mode.APART
    return sampled_now(scenes, lanes, *how, begun=True) if np.any(apart & (np.asarray(first.forces.v) >= 0)) else first
