"""A Runge-Kutta trial and its outcome: it is accepted, ends at an event, or is repeated."""

from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import (
    EachLane,
    Fixed,
    Lane,
    LaneTree,
    Search,
    event_change,
    following_search,
    is_finite,
    most_events,
    new_search,
    running,
    status_of,
    turned_too_far,
    updated_lanes,
    updated_margins,
)
from jaxshroud.march.event import (
    Events,
    above_zero,
    any_of,
    case_switches,
    check_own_events,
    first_kind,
    forces_jump,
    guards_after_event,
    guards_to_begin_with,
    rounding_of,
    violated_guards,
)
from jaxshroud.march.events import evaluate_guards, place_contact
from jaxshroud.march.locate import at_event, at_least_two, judge_trial, outcome_of_pair, select, select_guard
from jaxshroud.march.log import AcceptedTrial, lane_after, mode_of_smooth_contact, new_accumulator, updated_accumulator
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Ending, Lift
from jaxshroud.march.rk_step import NO_STAGES, Stages, StepEnd, rk_stages, rk_step, trial_interval
from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where, zeros_for
from jaxshroud.model.contact_law import Slider
from jaxshroud.model.drive import Waves, drive_waves
from jaxshroud.model.modes import FLAT, Status
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.scene.keys import Motion

# Derivatives only. The time of an event moves with the slope of the solution, which differs from that of the step by
# the error of the method; each repetition raises the power of this error. After two repetitions it was up to 6e-6
# between nearly parallel faces.
EVENT_REFINEMENTS = 3


def begin_rk(state: State, model: Model, method: Choices) -> Lane:
    """`Stepper.begin`. The first trial has length zero: it sets the guards."""
    zero, step = jnp.zeros_like(state.motion.x[0]), jnp.zeros((), jnp.int32)
    accumulator = new_accumulator(state, model, method)
    guards = None
    check_own_events(method.events, model.law.has_events)
    if model.law.has_events:

        def waves():
            return drive_waves(zero, zero, model.drive)

        def evaluate():
            return evaluate_guards(state.motion, waves(), state, model, method.all_events)

        guards = guards_to_begin_with(zeros_for(evaluate).guards, method.all_events)
    search = new_search(zero, zero, jnp.ones((), bool), step, method.locate, method.derivative)
    return Lane(state, step, search, guards, accumulator, step)


def rk_trials(
    lanes: LaneTree, fixed: LaneTree, method: Choices, each: EachLane, stage_groups: tuple[int, ...]
) -> LaneTree:
    """`Stepper.trial`: a `StepEnd` of every lane."""

    def group(stage_count: int, lane: Lane, stages: Stages, fixed: Fixed[Model]) -> Stages:
        return rk_stages(stages, stage_count, trial_interval(lane, fixed.grid), lane.state, fixed.model, method)[0]

    def end(lane: Lane, stages: Stages, fixed: Fixed[Model]) -> StepEnd:
        return rk_step(stages, trial_interval(lane, fixed.grid), lane.state, fixed.model, method)

    stages = NO_STAGES
    for stage_count in stage_groups:
        stages = each(partial(group, stage_count), lanes, stages, fixed)
    return each(end, lanes, stages, fixed)


def update_after_rk(lanes: LaneTree, ends: LaneTree, fixed: LaneTree, method: Choices, each: EachLane) -> LaneTree:
    """`Stepper.update`. With derivatives, long accumulators or laws, the decision is a kernel of its own."""

    def decide(lane: Lane, end: StepEnd, fixed: Fixed[Model]) -> Decision:
        return decide_trial(lane, end, fixed, method)

    def apply(lane: Lane, end: StepEnd, decision: Decision, fixed: Fixed[Model]) -> Lane:
        return apply_decision(lane, end, decision, fixed, method)

    in_one = not (method.derivative or method.has_long_accumulator or fixed.model.law.fills_kernels)
    if in_one:
        return each(lambda lane, end, fixed: apply(lane, end, decide(lane, end, fixed), fixed), lanes, ends, fixed)
    return updated_lanes(apply, method, each, lanes, ends, each(decide, lanes, ends, fixed), fixed)


class Decision(NamedTuple):
    """The decision on a trial step."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept and change mode
    refine: Bool[Array, ""]  # an event was found, but is located once more for its derivative
    kind: Int[Array, ""]  # of the event
    several: Bool[Array, ""]  # several guards were violated at once
    move_low: Bool[Array, ""]  # the trial's end is the new lower end of the bracket
    not_finite: Bool[Array, ""]
    delay: Scalar  # upper bound of the time since the event [s]
    search: Search  # if the trial is not accepted

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent: none."""
        return ()


def decide_trial(lane: Lane, end: StepEnd, fixed: Fixed[Model], method: Choices) -> Decision:
    """Decide on a trial step that ended at `end`. Nothing here has a derivative."""
    lane, end, fixed = lax.stop_gradient((lane, end, fixed))
    model, grid, stop, search = fixed.model, fixed.grid, fixed.stop, lane.search
    active, not_finite, h = running(lane, stop), ~is_finite(end.state.motion), grid.h
    if not model.law.has_events:
        no = jnp.zeros_like(active)
        return Decision(active, no, no, jnp.int32(0), no, no, not_finite, jnp.zeros_like(h), search)
    assert lane.guards is not None
    before, events = _with_slider_of(lane.state, end.state), method.all_events
    _, at, _, _, _, guards = evaluate_guards(end.state.motion, end.Q, before, model, events)
    violated = violated_guards(guards, lane.guards, (search.length > 0) | search.recheck, events)
    kind = first_kind(violated)
    jumps = forces_jump(kind, lane.state, model, events)
    rounding = rounding_of(kind, at, events)
    several = at_least_two(tuple(violated.values()))
    exact = jumps & ~several & (select_guard(guards.value, kind) <= rounding)
    outcome = judge_trial(search, outcome_of_pair(search, lane.guards, guards, violated, jumps, exact, h), h, method)
    refine = jnp.zeros_like(active)
    if search.refinements is not None:  # derivatives need an event to be located several times
        refine = outcome.fire & active & (search.refinements < EVENT_REFINEMENTS - 1) & (search.length > 0)
    return Decision(
        accept=(outcome.accept | not_finite) & active & ~refine,
        fire=outcome.fire & active & ~refine,
        refine=refine,
        kind=kind,
        several=several,
        move_low=outcome.move_low & active,
        not_finite=not_finite,
        delay=outcome.delay,
        search=select(active & ~refine, outcome.search, search),
    )


def apply_decision(lane: Lane, end: StepEnd, decision: Decision, fixed: Fixed[Model], method: Choices) -> Lane:
    """The lane after a trial that ended at `end`; unchanged if it has arrived or failed."""
    model, grid, stop = fixed.model, fixed.grid, fixed.stop
    search, start = lane.search, lane.state
    accept, fire, refine, kind = decision.accept, decision.fire, decision.refine, decision.kind
    h = trial_interval(lane, grid).h
    if not model.law.has_events:
        return _apply_without_events(lane, end, decision, fixed, method)
    state, Q, gain, _ = end
    repeated = decision.search._replace(done=search.done)  # which may have a derivative
    if search.refinements is not None:
        at_root = _differentiable_event_end(end, lane, kind, fixed, method.all_events)
        state, Q, gain, length = select(fire | refine, at_root, (state, Q, gain, search.length))
        refined = repeated._replace(length=length, refinements=search.refinements + 1)
        search, repeated = search._replace(length=length), select(refine, refined, repeated)
    z = state.motion
    change = event_change(z, Q, _with_slider_of(start, state), fire, kind, decision.delay, fixed, method.all_events)
    view, transition, lift, jumps = change
    state = select(fire, transition.after, state)
    assert lane.guards is not None
    after = guards_after_event(transition.guards, view.guards, lane.guards, fire, kind, method.all_events)
    guards = select(fire, after.guards, view.guards)
    # where guards may have jumped, or several were violated, a guard that still is fires in a trial of length zero
    jumped = any_of(chain([decision.several], case_switches(kind, method.all_events)))
    jumped = jumped | (transition.after.case == FLAT)
    recheck = fire & jumped & any_of(above_zero(guards, method.all_events))
    recheck = any_of([recheck, *(fire & waits for waits in after.waiting)])
    next_search, step = following_search(search, lane.step, fire, recheck, method.locate)
    ending = Ending(transition, fire, search.inside)
    trial = AcceptedTrial(start, start.mode, h, z, z, view.at.v, lift, gain, jumps, lane.step, step, ending)
    accumulator = updated_accumulator(lane.accumulator, trial, model, method)
    accumulator = accumulator._replace(margins=updated_margins(accumulator.margins, change, fire, model))
    too_many = next_search.events > most_events(grid, touches_at_corners(model))
    status = status_of(turned_too_far(z, decision.not_finite), decision.not_finite, too_many)
    status = where(accept, status, Status.OK).astype(jnp.int32)
    later = Lane(state, step, next_search, guards, accumulator, status)
    return lane_after(lane, later, accept, decision.move_low, running(lane, stop), repeated)


def _with_slider_of(start: State, end: State) -> State:
    """The state at the start of the trial, with the slider, or the state of a user law, of its end."""
    return State(start.motion, end.u_s, start.mode, start.case)


def _apply_without_events(lane: Lane, end: StepEnd, decision: Decision, fixed: Fixed[Model], method: Choices) -> Lane:
    """`apply_decision` without events."""
    model, grid, stop, accept = fixed.model, fixed.grid, fixed.stop, decision.accept
    z, no, no_jumps = end.state.motion, jnp.zeros_like(accept), jax.tree.map(jnp.zeros_like, lane.accumulator.jumps)
    at = place_contact(z, lane.state, model)[2]
    next_search, step = following_search(lane.search, lane.step, no, no, method.locate)
    mode, h, lift = mode_of_smooth_contact(at.v), trial_interval(lane, grid).h, Lift(no, no, no)
    trial = AcceptedTrial(lane.state, mode, h, z, z, at.v, lift, end.gain, no_jumps, lane.step, step)
    accumulator = updated_accumulator(lane.accumulator, trial, model, method)
    status = status_of(turned_too_far(z, decision.not_finite), decision.not_finite, no)
    status = where(accept, status, Status.OK).astype(jnp.int32)
    later = Lane(end.state, step, next_search, None, accumulator, status)
    return lane_after(lane, later, accept, no, running(lane, stop), lane.search)


def _differentiable_event_end(end: StepEnd, lane: Lane, kind: Int[Array, ""], fixed: Fixed[Model], events: Events):
    """The end of a trial where the guard of `kind` vanishes, with derivatives: state, wave, integrals and length."""
    assert end.slope is not None
    model, grid, start, length = fixed.model, fixed.grid, lane.state, lane.search.length

    def flowing(state):
        return state.u_s if model.law.flows else ZERO

    def guard(z: Motion, Q: Waves, u_s: Slider) -> Scalar:
        at = _with_slider_of(start, end.state) if is_zero(u_s) else State(start.motion, u_s, start.mode, start.case)
        return select_guard(evaluate_guards(z, Q, at, model, events).guards.value, kind)

    slope, Q_rate, _ = lax.stop_gradient(end.slope)
    at_end, rates = (end.state.motion, end.Q, flowing(end.state)), (slope.motion, Q_rate, flowing(slope))
    value, rate = jax.jvp(guard, at_end, rates)
    rate = where((length > 0) & (rate > 0), rate, jnp.inf)  # a trial of length zero ends at a prescribed time
    z, Q, gain, length, u_s = at_event(
        (end.state.motion, end.Q, end.gain, length, flowing(end.state)),
        (end.slope[0].motion, *end.slope[1:], 1 / grid.h, flowing(end.slope[0])),
        value,
        rate,
    )
    return State(z, u_s if model.law.flows else start.u_s, start.mode, start.case), Q, gain, length
