"""The reference integrator: fixed-step Runge-Kutta that stops inside a step at every contact change.

It is written for one lane as one flat loop of trials: each pass makes one trial step of the lane's own length, either
marching to the end of its step or closing in on an event. Under `jax.vmap` every lane then pays for its own trials
only, where a bisection nested in the step would make all lanes wait for the one that is bisecting.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.march.each import EachLane
from jaxshroud.march.lane import Fixed, Grid, Lane, running
from jaxshroud.march.method import Choices
from jaxshroud.march.step import NO_STAGES, End, Stages, place_of, rk_stages, rk_step
from jaxshroud.march.trial import decide, trial
from jaxshroud.model.rhs import Model

STAGES_AT_ONCE = 7  # in one kernel: `lanes.fused` says why there is a limit
STAGES_WITH_EVENTS = 4  # in one kernel with everything else that a trial does
DUAL_STAGES = 4  # in one kernel where tangents come along
SMOOTH = 0.75  # of all these numbers in smooth contact, whose laws are longer: beyond, RK8 is 60 times slower


def advance(lanes: Any, fixed: Any, method: Choices, each: EachLane) -> Any:
    """One trial step of every lane on its way: of `Lane`s, or of whatever `each` makes of them.

    A short Runge-Kutta method and all that follows is one kernel. The stages of a long one come first, in groups.
    """
    size, known = len(method.tableau.b), NO_STAGES
    at_once = DUAL_STAGES if method.derivative else STAGES_AT_ONCE
    if getattr(fixed, "value", fixed).model.spring.smooth:
        at_once = int(at_once * SMOOTH)
    if size <= STAGES_WITH_EVENTS and not method.derivative:
        return each(lambda lane, fixed: _whole(lane, fixed, method), lanes, fixed)
    for upto in range(at_once, size, at_once):
        known = each(lambda lane, known, fixed, upto=upto: _some(lane, known, upto, fixed, method), lanes, known, fixed)
    end = each(lambda lane, known, fixed: _step(lane, known, fixed, method), lanes, known, fixed)
    if not method.derivative:
        return each(lambda lane, end, fixed: _judged(lane, end, fixed, method), lanes, end, fixed)
    decision = each(lambda lane, end, fixed: decide(lane, end, fixed, method), lanes, end, fixed)
    return each(lambda lane, end, what, fixed: trial(lane, end, what, fixed, method), lanes, end, decision, fixed)


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
    lanes: Lane,
    models: Model,
    grids: Grid,
    stops: Int[Array, " lanes"],
    method: Choices,
    each: EachLane,
    most_trials: int | None = None,
) -> Lane:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK.

    With `most_trials` it ends after so many trials anyway: a loop of known length can be differentiated in reverse.
    """
    fixed = Fixed(models, grids, stops)
    once = jax.jit(lambda lanes: advance(lanes, fixed, method, each))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    # two by two: the first writes to memory of its own, the second back where the lanes came from, and none is copied
    return lax.while_loop(lambda lanes: jnp.any(running(lanes, stops)), lambda lanes: once(once(lanes)), lanes)
