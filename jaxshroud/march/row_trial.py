"""The trials of a row of blades: every trial ends at the earliest event over all interfaces, or where its step ends.

All interfaces whose guards are violated there are crossed, and every guard is looked at again: symmetry makes events
exactly simultaneous. Arrays have the axis of blades or interfaces first, then the lanes; see `model.row`.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from jaxshroud.march.carry import (
    Fixed,
    Lane,
    Search,
    TimeGrid,
    following_search,
    most_events,
    new_search,
    no_time,
    running,
)
from jaxshroud.march.event import above_zero, any_of, check_own_events, guards_after_event, guards_to_begin_with
from jaxshroud.march.locate import LocationDecision, event_tolerance, judge_trial, one_after_the_other, select
from jaxshroud.march.log import AcceptedTrial, new_accumulator, penetrations
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import (
    InterfaceEnding,
    InterfaceOutcome,
    change_of_row,
    interface_outcome,
    is_finite_row,
    lane_after,
    no_change,
    row_guards,
    row_outcome,
    row_torques,
)
from jaxshroud.march.row_step import (
    RowCrossing,
    RowStepEnd,
    differentiable_event_end,
    interval_in_step,
    row_step,
    trial_interval,
    whole,
)
from jaxshroud.model.arithmetic import any_along, is_unrolled, total, where, zeros_for
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import State
from jaxshroud.model.row import Each, RowModel, alone, clusters_of, over, pair_states


def begin_runge_kutta(state: State, model: RowModel, method: Choices, each: Each) -> Lane:
    """A row at step 0. The first trial has length zero: it sets the guards, and a start in overlap is an onset."""
    lanes = no_time(state)
    count = jnp.zeros(lanes.shape, jnp.int32)
    at = jax.tree.map(lambda case: jnp.zeros(case.shape, lanes.dtype), state.case)
    pending = at == 1 if method.derivative else None
    turns = None
    if model.turns_by_events and len(state.case) > 1:
        turns = jax.tree.map(jnp.zeros_like, state.case)
    search = new_search(lanes, lanes, jnp.ones(lanes.shape, bool), count, method.locate)
    search = search._replace(pending=pending, turns=turns)
    zero_step = interval_in_step(count, lanes, lanes, TimeGrid(lanes, lanes, lanes, lanes))
    nothing = zeros_for(lambda: row_step(zero_step, state, clusters_of(state, model), model, method, each).gain)
    guards = None
    check_own_events(method.events, model.interfaces.law.has_events)
    if model.interfaces.law.has_events:
        guards = zeros_for(lambda: row_guards(state, (lanes, lanes), model, each, method.all_events))
        guards = guards_to_begin_with(guards, method.all_events)
    return Lane(state, count, search, guards, new_accumulator(nothing, state, model, method, each), count)


class RowVerdict(NamedTuple):
    """What a trial leads to."""

    decision: LocationDecision
    outcome: InterfaceOutcome  # of each interface
    crossing: RowCrossing
    torque: Any  # of each interface, see `row_torques`, and so is the next
    joint: Any
    not_finite: Bool[Array, "..."]

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent: none."""
        return ()


def judge_row_trial(lane: Lane, end: RowStepEnd, fixed: Fixed[RowModel], method: Choices, each: Each) -> RowVerdict:
    """What a trial that ended at `end` leads to."""
    lane, end, fixed = lax.stop_gradient((lane, end, fixed))
    model, grid, stop = fixed.model, fixed.grid, fixed.stop
    assert lane.guards is not None  # contact has events
    search = lane.search
    h = trial_interval(lane, grid).h
    torque, joint = row_torques(end.state, end.wave, model, each)
    counts = (search.length > 0) | search.recheck
    pairs = pair_states(end.state, model)
    at_interface = partial(interface_outcome, events=method.all_events)
    width = h - search.low * grid.h
    outcome = over(each, at_interface, torque, pairs, lane.guards, counts, width, model.interfaces)
    judge = partial(judge_trial, method=method)
    of_row = row_outcome(search, outcome, lane.guards)
    decision = each(judge, search._replace(pending=None, turns=None), of_row, running(lane, stop), grid.h)
    fires = decision.fire & outcome.hit
    follows = (search.length == 0) & ((lane.step > 0) | (search.done > 0))  # another event of this instant
    delay = where(follows, event_tolerance(jnp.zeros((), bool), method, h.dtype) * grid.h, decision.delay)
    is_root, pending = decision.fire, search.pending
    if pending is not None:
        fires, is_root, pending = one_after_the_other(fires, of_row.crossed.place, pending, search.length > 0)
    crossing = RowCrossing(fires, outcome.kind, is_root, delay, pending)
    return RowVerdict(decision, outcome, crossing, torque, joint, ~is_finite_row(end.state))


def row_trial(lane: Lane, fixed: Fixed[RowModel], method: Choices, each: Each) -> Lane:
    """One trial step of every lane that has neither arrived nor failed, and what follows from its end."""
    if is_unrolled(lane.state.case) and each is not alone and method.large_kernels and not method.derivative:
        return each(lambda lane, fixed: row_trial(lane, fixed, method, alone), lane, fixed)
    end = step_of_trial(lane, fixed, method, each)
    if not fixed.model.interfaces.law.has_events:
        return whole(each, partial(_without_events, method=method), lane, end, fixed)
    verdict = whole(each, partial(judge_row_trial, method=method), lane, end, fixed)
    search = lane.search
    if method.derivative:
        end, length = differentiable_event_end(end, lane, verdict.crossing, fixed, method, each)
        search = search._replace(length=length, pending=verdict.crossing.pending)
    return whole(each, partial(_after_trial, method=method), lane, search, end, verdict, fixed)


def step_of_trial(lane: Lane, fixed: Fixed[RowModel], method: Choices, each: Each) -> RowStepEnd:
    """The next trial step."""
    if each is not alone and method.large_kernels:
        return whole(each, partial(step_of_trial, method=method._replace(large_kernels=False)), lane, fixed)
    cluster = clusters_of(lane.state, fixed.model)
    return row_step(trial_interval(lane, fixed.grid), lane.state, cluster, fixed.model, method, each)


def _after_trial(
    lane: Lane,
    search: Search,
    end: RowStepEnd,
    verdict: RowVerdict,
    fixed: Fixed[RowModel],
    method: Choices,
    each: Each,
) -> Lane:
    """The rows after a trial that ended at `end`; its `search` has the length that it took."""
    model, grid, events = fixed.model, fixed.grid, method.all_events
    decision, crossing, seen = verdict.decision, verdict.crossing, verdict.outcome
    assert lane.guards is not None  # contact has events
    ending = InterfaceEnding(
        fires=crossing.fires,
        kind=crossing.kind,
        several=seen.several,
        inside=lane.search.inside,
        delay=crossing.delay,
    )
    change = change_of_row(lane, end.state, (verdict.torque, verdict.joint), ending, fixed, method, each)
    guards = row_guards(*lax.stop_gradient((change.state, end.wave, model)), each, events)
    guards, waiting = guards_after_event(guards, seen.guards, lane.guards, crossing.fires, crossing.kind, events)
    guards = select(decision.fire, guards, seen.guards)
    violated = any_of([any_along(above) for above in above_zero(guards, events)])
    several = total((decision.fire & seen.hit).astype(jnp.int32)) > 1
    recheck = decision.fire & (any_along(change.at.jumped) | several) & violated
    recheck = any_of([recheck, *(decision.fire & any_along(waits) for waits in waiting)])
    search = search._replace(turns=change.at.turns)
    next_search, step = following_search(search, lane.step, decision.fire, recheck, method.locate)
    trial = AcceptedTrial(
        start=lane.state,
        mode=interface_mode(lane.state.mode),
        h=trial_interval(lane, grid).h,
        end=end.state.motion,
        change=change,
        v=change.at.v,
        gain=end.gain,
        step=lane.step,
        next_step=step,
    )
    too_many = next_search.events > most_events(grid, model.turns_by_events) * len(seen.hit)
    later = lane_after(lane, trial, next_search, guards, verdict.not_finite, too_many, model, method, each)
    before = lane.search
    repeated = decision.search._replace(done=before.done, pending=before.pending, turns=before.turns)
    low = select(decision.move_low, guards, lane.guards)
    accept = decision.accept | (verdict.not_finite & running(lane, fixed.stop))
    return select(accept, later, Lane(lane.state, lane.step, repeated, low, lane.accumulator, lane.status))


def _without_events(lane: Lane, end: RowStepEnd, fixed: Fixed[RowModel], method: Choices, each: Each) -> Lane:
    """The rows after a trial of smooth contact, which is accepted in any case."""
    model = fixed.model
    active = running(lane, fixed.stop)
    no = jnp.zeros_like(active)
    v = penetrations(end.state, model, each)
    next_search, step = following_search(lane.search, lane.step, no, no, method.locate)
    trial = AcceptedTrial(
        start=lane.state,
        mode=where(v < 0, jnp.int32(Mode.APART), jnp.int32(Mode.SLIP_PLUS)),  # smooth contact has none of its own
        h=trial_interval(lane, fixed.grid).h,
        end=end.state.motion,
        change=no_change(lane, end.state, v, method),
        v=v,
        gain=end.gain,
        step=lane.step,
        next_step=step,
    )
    lost = ~is_finite_row(end.state)
    return select(active, lane_after(lane, trial, next_search, None, lost, no, model, method, each), lane)
