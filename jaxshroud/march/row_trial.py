"""The trials of a row of blades: every trial ends at the earliest event over all interfaces, or where its step ends.

All interfaces whose guards are violated there are crossed, and every guard is looked at again: symmetry makes events
exactly simultaneous. Arrays have the axis of blades or interfaces first, then the lanes; see `model.row`.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.accumulator import Accumulator, EnergyJumps, EventMargins, Log, no_margins
from jaxshroud.march.carry import (
    Fixed,
    InterfaceChange,
    Lane,
    Search,
    TimeGrid,
    change_at,
    following_search,
    most_events,
    most_turns,
    new_search,
    running,
    status_of,
    updated_margins,
)
from jaxshroud.march.event import (
    Guards,
    above_zero,
    any_of,
    case_switches,
    check_own_events,
    guards_after_event,
    guards_to_begin_with,
)
from jaxshroud.march.locate import LocationDecision, event_tolerance, select
from jaxshroud.march.log import (
    AcceptedTrial,
    lane_after,
    mode_of_smooth_contact,
    new_log,
    penetrations,
    takers_of_events,
    takers_of_one,
    updated_accumulator,
    value_in,
)
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Ending, Lift
from jaxshroud.march.rk_step import interval_in_step, trial_interval
from jaxshroud.march.row_guards import (
    InterfaceOutcome,
    interface_outcome,
    interface_view,
    judge_row,
    row_guards,
    row_outcome,
    row_torques,
)
from jaxshroud.march.row_step import (
    OfLanes,
    RowCrossing,
    RowStepEnd,
    differentiable_event_end,
    one_after_the_other,
    row_step,
    whole,
)
from jaxshroud.model.arithmetic import (
    ANGLE_RANGE,
    Scalar,
    Unrolled,
    any_along,
    is_unrolled,
    is_zero,
    total,
    where,
    zeros_for,
)
from jaxshroud.model.modes import FLAT, Status
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import (
    Each,
    FlagOfInterfaces,
    RowModel,
    alone,
    blade_energies,
    clusters,
    clusters_of,
    coupling_energies,
    over,
    pair_states,
)


def begin_runge_kutta(state: State, model: RowModel, method: Choices, each: Each) -> Lane:
    """A row at step 0. The first trial has length zero: it sets the guards, and a start in overlap is an onset."""
    lanes = no_time(state)
    count = jnp.zeros(lanes.shape, jnp.int32)
    at = jax.tree.map(lambda case: jnp.zeros(case.shape, lanes.dtype), state.case)
    pending = at == 1 if method.derivative else None
    turns = None
    if model.turns_by_events and len(state.case) > 1:
        turns = jax.tree.map(jnp.zeros_like, state.case)
    search = new_search(lanes, lanes, jnp.ones(lanes.shape, bool), count, method.locate, of_row=True)
    search = search._replace(pending=pending, turns=turns)
    zero_step = interval_in_step(count, lanes, lanes, TimeGrid(lanes, lanes, lanes, lanes))
    nothing = zeros_for(lambda: row_step(zero_step, state, clusters_of(state, model), model, method, each).gain)
    guards = None
    check_own_events(method.events, model.interfaces.law.has_events)
    if model.interfaces.law.has_events:
        guards = zeros_for(lambda: row_guards(state, (lanes, lanes), model, each, method.all_events))
        guards = guards_to_begin_with(guards, method.all_events)
    return Lane(state, count, search, guards, new_accumulator(nothing, state, model, method, each), count)


def new_accumulator(nothing: Integrals, state: State, model: RowModel, method: Choices, each: Each) -> Accumulator:
    """The accumulator of a row that starts from `state`, with its integrals, which are `nothing` so far."""
    lanes = no_time(state)
    at = jax.tree.map(lambda case: jnp.zeros(case.shape, lanes.dtype), state.case)
    log = None if method.derivative else new_log(state, at, model, method, each)
    margins = over(each, no_margins, at) if method.margins else None
    return Accumulator(nothing, EnergyJumps(at, lanes) if method.ledger else None, log, margins)


class InterfaceEnding(NamedTuple):
    """How a trial of a row ended, at each interface."""

    fires: Any  # in an event
    kind: Any  # of that event
    several: Any  # several guards are violated
    inside: Any  # at a maximum of the guard within a step
    delay: Any  # upper bound of the time since the event [s]


def interface_change(
    torque: Scalar,
    joint: Scalar,
    start: State,
    ending: InterfaceEnding,
    grid: TimeGrid,
    counted: dict[str, Any],
    margins: EventMargins | None,
    turns: Int[Array, ""] | None,
    model: Model,
    method: Choices,
) -> InterfaceChange:
    """The change of one interface whose trial ended in `start`, and perhaps in an event there.

    With `counted`, the values of the observables that take the event, before it.
    """
    fire, kind, several, inside, delay = ending
    if not is_zero(joint):
        model = eqx.tree_at(lambda m: m.mobility.joint, model, joint)
    view = interface_view(torque, start, model, method.all_events)
    rocks = None if turns is None else turns >= most_turns(grid)
    soon = grid.flat * grid.h
    events = method.all_events
    change = change_at(view, start.motion, start, fire, kind, delay, soon, model, rocks, events)
    now = change.transition.after
    u_s, mode, case = select(fire, (now.u_s, now.mode, now.case), (start.u_s, start.mode, start.case))
    becomes_flat = fire & (case == FLAT) & (start.case != FLAT)
    turned = any_of(case_switches(kind, events))
    springs, v = lax.stop_gradient((change.springs, view.at.v))
    counting = Ending(change.transition, fire, inside)
    takers = [one for one in takers_of_events(method) if one.name in counted]
    return InterfaceChange(
        u_s,
        mode,
        case,
        becomes_flat,
        None if turns is None else turns + (fire & turned).astype(jnp.int32),
        fire & (several | turned | (case == FLAT)),
        springs,
        {one.name: one.update(counted[one.name], counting) for one in takers},
        v,
        updated_margins(margins, change, fire, model),
        change.lift if takers_of_one("interface", method) else None,
    )


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
    outcome = over(each, at_interface, torque, pairs, lane.guards, counts, h, model.interfaces)
    judge = partial(judge_row, method=method)
    of_row = row_outcome(search, outcome, lane.guards)
    decision = each(judge, search._replace(pending=None, turns=None), of_row, running(lane, stop), grid.h)
    fires = decision.fire & outcome.hit
    follows = (search.length == 0) & ((lane.step > 0) | (search.done > 0))  # another event of this instant
    delay = where(follows, event_tolerance(jnp.zeros((), bool), method, h.dtype) * grid.h, decision.delay)
    crossing = RowCrossing(fires, outcome.kind, decision.fire, delay, None)
    if method.derivative:
        crossing = one_after_the_other(crossing, lane, of_row.crossed.place)
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
    model, grid, stop = fixed.model, fixed.grid, fixed.stop
    decision = verdict.decision
    repeated = decision.search._replace(done=lane.search.done, pending=lane.search.pending, turns=lane.search.turns)
    active = running(lane, stop)
    accept = decision.accept | (verdict.not_finite & active)
    crossing = verdict.crossing
    ending = InterfaceEnding(
        fires=crossing.fires,
        kind=crossing.kind,
        several=verdict.outcome.several,
        inside=lane.search.inside,
        delay=crossing.delay,
    )
    change = changes_of_row(lane, end.state, (verdict.torque, verdict.joint), ending, fixed, method, each)
    after = State(end.state.motion, change.u_s, change.mode, change.case)
    after, dropped = as_flat(after, change.becomes_flat, model, each)
    guards = row_guards(*lax.stop_gradient((after, end.wave, model)), each, method.all_events)
    guards, waiting = _guards_after_events(guards, lane, verdict, method)
    guards = select(decision.fire, guards, verdict.outcome.guards)
    violated = any_of([any_along(above) for above in above_zero(guards, method.all_events)])
    several = total((decision.fire & verdict.outcome.hit).astype(jnp.int32)) > 1
    recheck = decision.fire & (any_along(change.jumped) | several) & violated
    recheck = any_of([recheck, *(decision.fire & waits for waits in waiting)])
    next_search, step = following_search(
        search._replace(turns=change.turns), lane.step, decision.fire, recheck, method.locate
    )
    trial = AcceptedTrial(
        start=lane.state,
        mode=interface_mode(lane.state.mode),
        h=trial_interval(lane, grid).h,
        end=end.state.motion,
        after=after.motion,
        v=change.v,
        lift=change.lift,
        gain=end.gain,
        jumps=EnergyJumps(change.springs, dropped),
        step=lane.step,
        next_step=step,
        events=change.counted,
    )
    accumulator = updated_accumulator(lane.accumulator, trial, model, method, each)._replace(margins=change.margins)
    limit = most_events(grid, model.turns_by_events) * len(verdict.outcome.hit)
    too_many = next_search.events > limit
    status = status_of(row_turned(after, verdict.not_finite, model), verdict.not_finite, too_many)
    status = where(accept, status, Status.OK).astype(jnp.int32)
    later = Lane(after, step, next_search, guards, accumulator, status)
    return lane_after(lane, later, accept, decision.move_low, active, repeated)


def _guards_after_events(
    after: Guards, lane: Lane, verdict: RowVerdict, method: Choices
) -> tuple[Guards, list[Bool[Array, "..."]]]:
    """`guards_after_event` of all interfaces, and whether an event waits at any of them."""
    assert lane.guards is not None
    end, (fires, kind, *_) = verdict.outcome.guards, verdict.crossing
    guards, waiting = guards_after_event(after, end, lane.guards, fires, kind, method.all_events)
    return guards, [any_along(waits) for waits in waiting]


def _of_events(log: Log | None, method: Choices) -> dict[str, Any]:
    """The values of the observables that take the event; none where there is no log."""
    return {} if log is None else {one.name: value_in(log, one.name) for one in takers_of_events(method)}


def changes_of_row(
    lane: Lane, end: State, torques: tuple[Any, Any], ending: InterfaceEnding, fixed: Fixed, method: Choices, each: Each
) -> InterfaceChange:
    """The change of each interface where a trial ended in the state `end`; for its `torques` see `row_torques`."""
    model, log = fixed.model, lane.accumulator.log
    return over(
        each,
        partial(interface_change, method=method),
        *torques,
        pair_states(end, model),
        ending,
        lax.stop_gradient(fixed.grid),
        _of_events(log, method),
        lane.accumulator.margins,
        lane.search.turns,
        model.interfaces,
    )


def as_flat(state: State, becomes_flat: FlagOfInterfaces, model: RowModel, each: Each) -> tuple[State, OfLanes]:
    """The state once the blocks of new flat faces turn as one with their clusters, and the energy that is lost [J].

    The angular momentum of each cluster is kept.
    """
    if not model.turns_by_events:
        return state, no_time(state)
    z = state.motion
    cluster = clusters(state.case, model)
    now = any_along(becomes_flat)

    def as_one(a):
        return where(now, cluster.mean(a), a)

    shroud = model.blades.shroud(z)
    parallel = model.blades.with_turn(z, as_one(shroud.theta), as_one(shroud.v_theta), model.inverse)
    before, now_parallel, still = lax.stop_gradient((z, parallel, model))
    lost = total(blade_energies(before, still, each) - blade_energies(now_parallel, still, each))
    if not is_zero(between := coupling_energies(before, still)):
        lost = lost + total(between - coupling_energies(now_parallel, still))
    return State(parallel, state.u_s, state.mode, state.case), where(now, lost, 0.0)


def no_time(state: State) -> OfLanes:
    """A zero for each lane."""
    first = jax.tree.leaves(state.motion, is_leaf=is_unrolled)[0]
    return jnp.zeros_like(first[0])


def is_finite_row(state: State) -> Bool[Array, "..."]:
    """Whether all numbers of the motion are finite."""
    return jnp.isfinite(sum(total(a) for a in jax.tree.leaves(state.motion, is_leaf=is_unrolled)))


def row_turned(state: State, lost: Bool[Array, "..."], model: RowModel) -> Bool[Array, "..."]:
    """Whether a block has turned too far, or the motion is `lost`."""
    theta: Any = model.blades.shroud(state.motion).theta
    if is_unrolled(theta):
        theta = Unrolled(*(a for a in theta if not is_zero(a)))
    return lost if is_zero(theta) else lost | any_along(abs(theta) > ANGLE_RANGE)


def _without_events(lane: Lane, end: RowStepEnd, fixed: Fixed[RowModel], method: Choices, each: Each) -> Lane:
    """The rows after a trial of smooth contact, which is accepted in any case."""
    model = fixed.model
    active = running(lane, fixed.stop)
    h = trial_interval(lane, fixed.grid).h
    no = jnp.zeros_like(active)
    v = penetrations(end.state, model, each)
    next_search, step = following_search(lane.search, lane.step, no, no, method.locate)
    trial = AcceptedTrial(
        start=lane.state,
        mode=mode_of_smooth_contact(v),
        h=h,
        end=end.state.motion,
        after=end.state.motion,
        v=v,
        lift=Lift(no, no, no),
        gain=end.gain,
        jumps=EnergyJumps(jax.tree.map(jnp.zeros_like, v), jnp.zeros_like(h)),
        step=lane.step,
        next_step=step,
        events=_of_events(lane.accumulator.log, method),
    )
    accumulator = updated_accumulator(lane.accumulator, trial, model, method, each)
    lost = ~is_finite_row(end.state)
    status = status_of(row_turned(end.state, lost, model), lost, no)
    later = Lane(end.state, step, next_search, None, accumulator, status)
    return lane_after(lane, later, active, no, active, lane.search)
