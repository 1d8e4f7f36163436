"""A march that keeps the states on both sides of every event, beside the ends of steps.

It makes the same trials as `driven`, and looks at each that ended a step or met an event.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.loop import advance, ends
from jaxshroud.batch.periods import Clock
from jaxshroud.batch.states import as_arrays, whole
from jaxshroud.batch.xla import EachLane, best, compiled
from jaxshroud.march.events import seat
from jaxshroud.march.lane import Fixed, Lane, running
from jaxshroud.march.method import Choices
from jaxshroud.model.absent import Scalar
from jaxshroud.model.friction import stretch
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import Model, model
from jaxshroud.model.state import State
from jaxshroud.scene.scene import Scene

TRIALS = 1024  # per call


class Instants(NamedTuple):
    """States on both sides of every event of one lane."""

    states: State  # (1, events): before and after, one after the other
    steps: np.ndarray  # when, since the beginning (events,)
    samples: np.ndarray  # the one that each comes after (events,)


def sampled(lane: Lane, scene_model: Model) -> State:
    """The lane's state with its slider brought up to date; NaN once the lane has stopped."""
    return up_to_date(lane.state, lane.status, scene_model)


def up_to_date(held: State, status: Int[Array, ""], scene_model: Model) -> State:
    """A state with its slider brought up to date; NaN where the status is not OK."""
    at = seat(held.motion, held, scene_model)[2]
    flows, held = scene_model.spring.flows, whole(held)
    u_s = held.u_s if flows else at.u - stretch(at.v, at.u, held.u_s, held.mode, scene_model.spring)
    motion, u_s = jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), (as_arrays(held.motion), u_s))
    return State(motion, u_s, held.mode, held.case)


def march_with_events(
    scenes: Scene, lanes: Lane, clock: Clock, every: int, count: int, method: Choices, tick: Callable[[int], None]
) -> tuple[Lane, list[State], Instants]:
    """One lane marched trial by trial.

    Args:
        scenes: The scene, with a leading axis of one lane, like all arrays of the others.
        lanes: Where it begins.
        clock: The time grid.
        every: Steps from sample to sample.
        count: Samples.
        method: Static choices of the march.
        tick: Told how many samples more are done.

    Returns:
        The lane at the end, its samples (lanes, samples) without the first, in blocks, and its events.
    """
    left, done, samples, instants = np.int32(count * every), 0, [], []
    while left and int(lanes.status[0]) == Status.OK:
        (lanes, remaining), trials = _trials(scenes, lanes, clock, left, method, best())
        met = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, 1), trials)
        arrived, fired = met.arrived[0], np.repeat(met.fired[0], 2)
        ends = done + np.cumsum(arrived)  # steps done after each trial
        wanted = arrived & (ends % every == 0)
        samples.append(jax.tree.map(lambda a, wanted=wanted: a[:, wanted], met.after))
        steps = np.repeat(ends - arrived + met.begun[0], 2)[fired]
        before = np.repeat((ends - arrived) // every, 2)[fired]
        instants.append(
            Instants(jax.tree.map(lambda *a, of=fired: sides(*a)[:, of], met.before, met.after), steps, before)
        )
        tick(int(wanted.sum()))
        done, left = int(ends[-1]), remaining
    missing = count - sum(block.mode.shape[1] for block in samples)
    if missing:  # the lane has stopped
        last = last_state(scenes, lanes)
        samples.append(jax.tree.map(lambda a: np.repeat(np.asarray(a)[:, None], missing, axis=1), last))
    return lanes, samples, joined(instants)


def joined(instants: list[Instants]) -> Instants:
    """Instants of one stretch after another."""
    return jax.tree.map(lambda *a: np.concatenate(a, axis=-1 if a[0].ndim < 3 else 1), *instants)


def sides(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Both sides of trials (lanes, trials, ...), one after the other."""
    return np.stack([before, after], axis=2).reshape(len(before), -1, *before.shape[2:])


class _Trial(NamedTuple):
    """What a trial has come to that ended a step or met an event."""

    before: State  # at its end, in the mode it was made in
    after: State
    begun: Scalar  # steps from the beginning of the step to the trial's end
    fired: Array  # an event was met
    arrived: Array  # the step has ended


@compiled("method", "each")
def _trials(scenes: Scene, lanes: Lane, clock: Clock, left, method: Choices, each: EachLane):
    """So many trials that ended a step or met an event; those after the last of the steps `left` do neither."""
    models, period = jax.vmap(lambda scene: (model(scene), scene.drive.period))(scenes)
    grids = clock.grids(period)

    def one(carry, _):
        lanes, left = carry
        fixed = Fixed(models, grids, jnp.where(left > 0, lanes.step + 1, lanes.step))
        once = lambda lanes: advance(lanes, fixed, method, each)  # noqa: E731
        idle = lambda pair: jnp.any(~(fired(*pair) | _arrived(*pair)) & running(pair[1], fixed.stop))  # noqa: E731
        held, ahead = lax.while_loop(idle, lambda pair: (pair[1], once(pair[1])), (lanes, once(lanes)))
        trial = _Trial(
            jax.vmap(up_to_date)(ends(held, fixed, method, each).state, held.status, models),
            jax.vmap(sampled)(ahead, models),
            held.search.done + held.search.length,
            fired(held, ahead),
            _arrived(held, ahead),
        )
        around = jnp.where(ahead.step == clock.steps, 0, ahead.step)
        ahead = eqx.tree_at(lambda lanes: lanes.step, ahead, around)
        return (ahead, left - trial.arrived[0].astype(left.dtype)), trial

    return lax.scan(one, (lanes, left), None, length=TRIALS)


def fired(before: Lane, after: Lane) -> Array:
    """Whether an event was met: each changes the mode or the case."""
    return (after.state.mode != before.state.mode) | (after.state.case != before.state.case)


def _arrived(before: Lane, after: Lane) -> Array:
    """Whether a step has ended."""
    return after.step > before.step


@jax.jit
def last_state(scenes: Scene, lanes: Lane) -> State:
    """The state of each lane, likewise."""
    return jax.vmap(lambda scene, lane: sampled(lane, model(scene)))(scenes, lanes)
