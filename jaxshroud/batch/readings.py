"""Samples and events of a march by power series, read off the series of its trials: they cost no trial.

Trials are made as if nobody looked, and their polynomials kept, so many at a time; what is asked for lies within them.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.batch.instants import Instants, fired, joined, last_state, sampled, sides, up_to_date
from jaxshroud.batch.periods import Clock
from jaxshroud.batch.xla import EachLane, best, compiled
from jaxshroud.march.course import RADIANS
from jaxshroud.march.lane import Fixed, Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.stride import Places, leg_and_places, moved, settle
from jaxshroud.model.absent import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import model
from jaxshroud.model.state import State
from jaxshroud.scene.scene import Scene

TRIALS = 256  # per call
READ = 1024  # instants per call


class Trial(NamedTuple):
    """One trial of a lane, and where the lane is within it."""

    places: Places  # in radians from its start
    u_s: Scalar  # these three hold all the way
    mode: Int[Array, ""]
    case: Int[Array, ""]
    status: Int[Array, ""]  # at its end
    begun: Scalar  # steps from the beginning of the step to its start
    length: Scalar  # in steps
    whole: Int[Array, ""]  # steps that it has completed
    done: Scalar  # and of the one after, at its end: never before a sample that it holds
    after: State  # at its end, behind the event there if one has `fired`
    fired: Bool[Array, ""]


def march_with_series(
    scenes: Scene,
    lanes: Lane,
    clock: Clock,
    every: int,
    count: int,
    method: Choices,
    tick: Callable[[int], None],
    events: bool,
) -> tuple[Lane, list[State], Instants | None]:
    """Lanes marched to their last sample.

    Args:
        scenes: The scenes, with a leading axis of lanes, like all arrays of the others.
        lanes: Where they begin.
        clock: The time grid.
        every: Steps from sample to sample.
        count: Samples.
        method: Static choices of the march, by power series.
        tick: Told how many samples more are done.
        events: Keep those of the only lane too.

    Returns:
        The lanes at the end, their samples (lanes, samples) without the first, in one block, and the events.
    """
    width = len(lanes.status)
    left, done, ready = np.full(width, count * every, np.int32), np.zeros((width, 1), int), np.zeros(width, int)
    empty = lambda a: np.zeros((width, count, *a.shape[1:]), a.dtype)  # noqa: E731
    samples, instants = jax.tree.map(empty, last_state(scenes, lanes)), []
    while np.any((left > 0) & (np.asarray(lanes.status) == Status.OK)):
        (lanes, remaining), trials = _trials(scenes, lanes, clock, left, method, best())
        made = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, 1), trials)
        ends = done + np.cumsum(made.whole, axis=1)  # steps done after each trial
        now = ends[:, -1] // every
        found = _read(scenes, made, *_asked(made, ends, every, ready, now), clock)
        for lane, (first, end) in enumerate(zip(ready, now, strict=True)):
            _put(samples, lane, slice(first, end), jax.tree.map(lambda a, n=end - first: a[:, :n], found))
        if events:
            instants.append(_events(scenes, made, ends, every, clock))
        tick(int(now.min() - ready.min()))
        ready, done, left = now, ends[:, -1:], np.asarray(remaining)
    stopped = jax.tree.map(np.asarray, last_state(scenes, lanes))
    for lane, first in enumerate(ready):
        _put(samples, lane, slice(first, count), stopped)
    tick(count - int(ready.min()))
    return lanes, [samples], joined(instants) if instants else None


def _put(samples: State, lane: int, at: slice, found: State) -> None:
    """Write what was found, of all lanes, into the samples of one."""
    for whole, part in zip(jax.tree.leaves(samples), jax.tree.leaves(found), strict=True):
        whole[lane, at] = part[lane]


def _asked(
    made: Trial, ends: np.ndarray, every: int, ready: np.ndarray, now: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """In which trial the next samples of each lane are, and how many steps from its start; those beyond do not count.

    Args:
        made: The trials.
        ends: Steps done after each trial (lanes, trials).
        every: Steps from sample to sample.
        ready: Samples that are known (lanes,).
        now: Samples that will be (lanes,).
    """
    numbers = ready[:, None] + np.arange(1, (now - ready).max() + 1)
    steps = np.minimum(numbers, np.maximum(now, ready + 1)[:, None]) * every
    trial = np.stack([np.searchsorted(end, step) for end, step in zip(ends, steps, strict=True)])
    trial = np.minimum(trial, ends.shape[1] - 1)
    begun = np.take_along_axis(ends - made.whole, trial, axis=1)
    return trial, (steps - begun) - np.take_along_axis(np.asarray(made.begun), trial, axis=1)


def _events(scenes: Scene, made: Trial, ends: np.ndarray, every: int, clock: Clock) -> Instants:
    """Both sides of the events of the only lane."""
    trial = np.flatnonzero(made.fired[0])
    before = _read(scenes, made, trial[None], np.asarray(made.length)[:, trial], clock)
    steps = (ends + made.done)[0, trial]
    after = jax.tree.map(lambda a: a[:, trial], made.after)
    return Instants(jax.tree.map(sides, before, after), np.repeat(steps, 2), np.repeat(ends[0, trial] // every, 2))


def _read(scenes: Scene, made: Trial, trial: np.ndarray, at: np.ndarray, clock: Clock) -> State:
    """States of the lanes so many steps from the start of these trials (lanes, instants)."""
    count, found = trial.shape[1], []
    for begin in range(0, max(count, 1), READ):
        some = np.minimum(np.arange(begin, begin + READ), max(count - 1, 0))
        trials, ats = (a[:, some] if count else np.zeros((len(a), READ), a.dtype) for a in (trial, at))
        found.append(jax.tree.map(np.asarray, _states(scenes, made, trials, ats, clock.per_period)))
    return jax.tree.map(lambda *a: np.concatenate(a, axis=1)[:, :count], *found)


@jax.jit
def _states(scenes: Scene, made: Trial, trial, at, per_period: Scalar) -> State:
    def one_lane(scene: Scene, made: Trial, trial, at) -> State:
        ready, unit = model(scene), scene.drive.period / RADIANS

        def one(trial, at) -> State:
            mine = jax.tree.map(lambda a: a[trial], made)
            z = moved(mine.places, unit, at * (RADIANS / per_period))
            return up_to_date(State(z, mine.u_s, mine.mode, mine.case), mine.status, ready)

        return jax.vmap(one)(trial, at)

    return jax.vmap(one_lane)(scenes, made, trial, at)


@compiled("method", "each")
def _trials(scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane):
    """So many trials; those after the last of the steps `left` (lanes,) come to nothing."""
    models, period = jax.vmap(lambda scene: (model(scene), scene.drive.period))(scenes)
    grids = clock.grids(period)

    def one(carry, _):
        lanes, left = carry
        fixed = Fixed(models, grids, jnp.minimum(lanes.step + left, clock.steps))
        legs, places = each(lambda lane, fixed: leg_and_places(lane, fixed, method), lanes, fixed)
        ahead = each(lambda lane, leg, fixed: settle(lane, leg, fixed, method), lanes, legs, fixed)
        held, whole, after = lanes.state, ahead.step - lanes.step, jax.vmap(sampled)(ahead, models)
        span = lanes.search.done, legs.length, whole, ahead.search.done
        made = Trial(places, held.u_s, held.mode, held.case, ahead.status, *span, after, fired(lanes, ahead))
        ahead = eqx.tree_at(lambda lanes: lanes.step, ahead, jnp.where(ahead.step == clock.steps, 0, ahead.step))
        return (ahead, left - whole), made

    return lax.scan(one, (lanes, left), None, length=TRIALS)
