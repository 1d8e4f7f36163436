"""Many lanes, trial by trial, until each has come to the step at which it stops.

A lane is one flat loop of trials: each pass makes one trial step of the lane's own length, either marching to the end
of its step or closing in on an event. Side by side, every lane then pays for its own trials only, where a bisection
nested in the step would make all lanes wait for the one that is bisecting.

What is marched are `Lane`s, or something that holds them: `lane_of` says where.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.batch.xla import EachLane, Tree, groups, in_parts, repeated_while
from jaxshroud.march.lane import Fixed, Lane, running
from jaxshroud.march.method import Choices
from jaxshroud.march.step import NO_STAGES, End, Stages, place_of, rk_stages, rk_step
from jaxshroud.march.stride import leg, settle
from jaxshroud.march.trial import decide, trial

Where = Callable[[Any], Any]  # where the plain values are in what is marched


def itself(lanes: Tree) -> Tree:
    """What is marched is the lanes themselves."""
    return lanes


def advance(lanes: Tree, fixed: Any, method: Choices, each: EachLane, lane_of: Where = itself) -> Tree:
    """One trial step of every lane on its way.

    A short Runge-Kutta method and all that follows is one kernel. The stages of a long one come first, in groups.
    Power series are one kernel, what becomes of the lane another.
    """
    if method.taylor:
        legs = each(lambda lane, fixed: leg(lane, fixed, method), lanes, fixed)
        return each(lambda lane, leg, fixed: settle(lane, leg, fixed, method), lanes, legs, fixed)
    if groups(method, lane_of(fixed).model.spring.smooth) is None:
        return each(lambda lane, fixed: _whole(lane, fixed, method), lanes, fixed)
    end = ends(lanes, fixed, method, each, lane_of)
    if not method.derivative:
        return each(lambda lane, end, fixed: _judged(lane, end, fixed, method), lanes, end, fixed)
    decision = each(lambda lane, end, fixed: decide(lane, end, fixed, method), lanes, end, fixed)
    return each(lambda lane, end, what, fixed: trial(lane, end, what, fixed, method), lanes, end, decision, fixed)


def ends(lanes: Any, fixed: Any, method: Choices, each: EachLane, lane_of: Where = itself) -> Any:
    """Where the next trial step of every lane ends by a Runge-Kutta method: stages in groups."""
    known = NO_STAGES
    for upto in groups(method, lane_of(fixed).model.spring.smooth) or ():
        known = each(lambda lane, known, fixed, upto=upto: _some(lane, known, upto, fixed, method), lanes, known, fixed)
    return each(lambda lane, known, fixed: _step(lane, known, fixed, method), lanes, known, fixed)


def _whole(lane: Lane, fixed: Fixed, method: Choices) -> Lane:
    return _judged(lane, _step(lane, NO_STAGES, fixed, method), fixed, method)


def _judged(lane: Lane, end: End, fixed: Fixed, method: Choices) -> Lane:
    return trial(lane, end, decide(lane, end, fixed, method), fixed, method)


def _some(lane: Lane, known: Stages, upto: int, fixed: Fixed, method: Choices) -> Stages:
    model, grid, _ = fixed
    return rk_stages(known, upto, place_of(lane, grid), lane.state, model, method)[0]


def _step(lane: Lane, known: Stages, fixed: Fixed, method: Choices) -> End:
    model, grid, _ = fixed
    return rk_step(known, place_of(lane, grid), lane.state, model, method)


def march(
    lanes: Tree,
    fixed: Any,
    method: Choices,
    each: EachLane,
    lane_of: Where = itself,
    most_trials: int | None = None,
) -> Tree:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK.

    With `most_trials` it ends after so many trials anyway: a loop of known length can be differentiated in reverse.
    """
    once = jax.jit(lambda lanes: advance(lanes, fixed, method, each, lane_of))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    stops = lane_of(fixed).stop
    parts = in_parts(method, lane_of(fixed).model.spring.smooth)
    return repeated_while(lambda lanes: jnp.any(running(lane_of(lanes), stops)), once, lanes, parts)


def driven(
    lanes: Tree,
    fixed: Any,
    steps: Int[Array, "..."],
    method: Choices,
    each: EachLane,
    lane_of: Where = itself,
    most_trials: int | None = None,
) -> tuple[Tree, Bool[Array, " lanes"]]:
    """The lanes marched, and which of them have come to the end of their `steps` steps: their clock is set back."""
    lanes = march(lanes, fixed, method, each, lane_of, most_trials)
    clock = lane_of(lanes).step
    arrived = clock == steps
    return eqx.tree_at(lambda lanes: lane_of(lanes).step, lanes, jnp.where(arrived, 0, clock)), arrived
