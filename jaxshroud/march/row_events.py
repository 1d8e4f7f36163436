"""The events at the interfaces of a row: their guards, what a trial shows of them, and what changes where it ends.

The earliest event is that over all interfaces, which `locate` closes in on.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.carry import Fixed, Lane, PerLane, Search, Target, TimeGrid, most_turns, no_time
from jaxshroud.march.event import (
    Events,
    GuardEvaluation,
    Guards,
    any_of,
    case_switches,
    first_kind,
    forces_jump,
    rounding_of,
    violated_guards,
)
from jaxshroud.march.events import (
    BUILT_IN_EVENTS,
    EVENTS,
    TURN,
    Transition,
    guards_at,
    happens,
    place_contact,
    transition,
)
from jaxshroud.march.forces_and_energy import ContactForces, contact_forces_at
from jaxshroud.march.locate import (
    TrialOutcome,
    at_least_two,
    first_crossed,
    first_interior_maximum,
    select,
    select_guard,
)
from jaxshroud.march.log import (
    AcceptedTrial,
    InterfaceChange,
    RowChange,
    takers_of_events,
    updated_accumulator,
    values_of_events,
)
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Ending, Lift
from jaxshroud.model.arithmetic import (
    ANGLE_RANGE,
    ZERO,
    Scalar,
    Unrolled,
    any_along,
    at_place,
    is_place,
    is_unrolled,
    is_zero,
    least,
    place_of_largest,
    total,
    where,
)
from jaxshroud.model.contact_law import starts_in_overlap
from jaxshroud.model.geometry import Kinematics
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.model.rhs import EndTorques, Recorded, contact_effects, law_forces, torques_along_face
from jaxshroud.model.row import (
    Each,
    FlagOfInterfaces,
    RowModel,
    blade_energies,
    blade_forces,
    clusters,
    coupling_energies,
    over,
    pair_states,
    rates_of_blades,
    turned_as_one,
)

ONLY_FORCES = Recorded()


def row_torques(state: State, wave: Any, model: RowModel, each: Each) -> tuple[Any, Any]:
    """The relative torque of each interface with contact at the corner of its case, and the inertia against it."""
    if not model.turns_by_events:
        return ZERO, ZERO
    cluster = clusters(state.case, model)
    effects = over(each, partial(contact_effects, recorded=ONLY_FORCES), pair_states(state, model), model.interfaces)
    R = blade_forces(effects, model.blades.shroud(state.motion), model)
    own = rates_of_blades(state.motion, wave, R, model, ONLY_FORCES, each)
    own = model.blades.turning(own.acceleration)
    return cluster.torques(own, model), cluster.joint


def interface_view(torque: Scalar, state: State, model: Model, events: Events = BUILT_IN_EVENTS) -> GuardEvaluation:
    """The kinematics and the guards of one interface under the relative torque of its corner."""
    placed = place_contact(state.motion, state, model)
    return guards_at(placed, _end_torques(torque, placed[2], state, model), state, model, events)


def _end_torques(torque: Scalar, at: Kinematics, state: State, model: Model) -> EndTorques:
    """The torques at both ends of the faces' overlap from the relative torque of the corner."""
    if is_zero(torque):
        return EndTorques(ZERO, ZERO)
    forces = law_forces(at, state.case, state, model)
    return torques_along_face(torque, forces, at, state, model)


def row_contact_forces(state: State, wave: Any, model: RowModel, each: Each) -> ContactForces:
    """The contact forces at each interface in a state, at (sin, cos) of omega t."""
    torque, _ = row_torques(state, wave, model, each)

    def at_interface(torque: Scalar, state: State, model: Model) -> ContactForces:
        placed = place_contact(state.motion, state, model)
        return contact_forces_at(placed, _end_torques(torque, placed[2], state, model), state, model)

    return over(each, at_interface, torque, pair_states(state, model), model.interfaces)


def row_guards(state: State, wave: Any, model: RowModel, each: Each, events: Events) -> Guards:
    """The guards of each interface in a state."""
    torque, _ = row_torques(state, wave, model, each)

    def guards(torque, state, model):
        return interface_view(torque, state, model, events).guards

    return over(each, guards, torque, pair_states(state, model), model.interfaces)


class InterfaceOutcome(NamedTuple):
    """What a trial has shown at one interface."""

    guards: Guards  # at its end
    hit: Bool[Array, ""]  # a guard is violated
    kind: Int[Array, ""]  # the violated guard that takes precedence
    several: Bool[Array, ""]  # several are violated
    jumps: Bool[Array, ""]  # the forces jump there
    exact: Bool[Array, ""]  # the guard is zero to rounding
    top: Scalar  # the fraction of the trial at which a guard seems to be above zero; 1 if there is none
    share: Scalar  # of the width above zero, of the guard that was crossed first
    crossed: Target


def interface_outcome(
    torque: Scalar, state: State, low: Guards, counts: Bool[Array, ""], width: Scalar, model: Model, events: Events
) -> InterfaceOutcome:
    """The outcome at one interface of a trial that ended in `state`.

    Args:
        torque: The relative torque of its corner.
        state: Its end, in the mode and case of the trial.
        low: The guards at the lower end of the bracket, or at the start of the trial.
        counts: Whether a violated guard counts.
        width: The time since the lower end of the bracket, or the start of the trial [s].
        model: The constants of the pair.
        events: The events of the march.
    """
    view = interface_view(torque, state, model, events)
    guards = view.guards
    violated = violated_guards(guards, low, counts, events)
    kind = first_kind(violated)
    hit = any_of(violated.values())
    several = at_least_two(tuple(violated.values()))
    jumps = forces_jump(kind, state, model, events)
    rounding = rounding_of(kind, view.at, events)
    exact = jumps & ~several & (select_guard(guards.value, kind) <= rounding)
    zero, none = jnp.zeros_like(width), jnp.zeros_like(kind)
    share, crossed = first_crossed(low, guards, violated, width, Target(none, zero, zero, zero, none))
    top = first_interior_maximum(low, guards, width)
    return InterfaceOutcome(guards, hit, kind, several, jumps & hit, exact, top, share[0] / share[1], crossed)


def row_outcome(search: Search, outcome: InterfaceOutcome, low: Guards) -> TrialOutcome:
    """The outcome of each lane, from those of its interfaces."""
    hit, target = outcome.hit, search.target
    any_hit = any_along(hit)
    first = place_of_largest(where(hit, outcome.share, -1.0))
    place = first if target is None else where(any_hit, first, target.place)
    here = is_place(place, hit)
    now = select(any_hit | ~search.bracketing, low, outcome.guards)
    crossed, low_there = jax.tree.map(partial(at_place, here), (outcome.crossed, now), is_leaf=is_unrolled)
    return TrialOutcome(
        hits=total(hit.astype(jnp.int32)),
        jumps=any_along(outcome.jumps),
        exact=~any_along(hit & ~outcome.exact),
        top=least(outcome.top),
        crossed=crossed._replace(place=place),
        low=low_there,
    )


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
    events = method.all_events
    view = interface_view(torque, start, model, events)
    rocks = None if turns is None else turns >= most_turns(grid)
    change = transition(start, view, kind, delay, grid.flat * grid.h, model, rocks, events)
    now = change.after
    u_s, mode, case = select(fire, (now.u_s, now.mode, now.case), (start.u_s, start.mode, start.case))
    becomes_flat = fire & (case == FLAT) & (start.case != FLAT)
    turned = any_of(case_switches(kind, events))
    springs, v = lax.stop_gradient((where(fire, change.energy, 0.0), view.at.v))
    was_apart, is_apart = (interface_mode(a) == Mode.APART for a in (start.mode, mode))
    onset = was_apart & ~is_apart
    lift = Lift(onset, onset & ~starts_in_overlap(view.at, delay), ~was_apart & is_apart)
    counting = Ending(change, fire, inside)
    takers = [one for one in takers_of_events(method) if one.name in counted]
    asked = any(one.per == "interface" and one.takes == "one" for one in observables_of(method))
    return InterfaceChange(
        u_s=u_s,
        mode=mode,
        case=case,
        becomes_flat=becomes_flat,
        turns=None if turns is None else turns + (fire & turned).astype(jnp.int32),
        jumped=fire & (several | turned | (case == FLAT)),
        springs=springs,
        counted={one.name: one.update(counted[one.name], counting) for one in takers},
        v=v,
        margins=None if margins is None else _updated_margins(margins, change, view, lift, fire, model),
        lift=lift if asked else None,
    )


def _updated_margins(
    before: EventMargins, turn: Transition, view: GuardEvaluation, lift: Lift, fire: Bool[Array, ""], model: Model
) -> EventMargins:
    """The margins after a trial that ends in a transition if `fire` is true."""
    rate, slowest = view.rate, before.slowest_switch
    if touches_at_corners(model):
        of_case = any_of(case_switches(turn.kind, EVENTS))
        switched = fire & of_case & (turn.before.case != FLAT) & (turn.after.case != FLAT)
        speed = jnp.abs(where(happens(turn.kind, TURN), rate.turn * model.block.a_x, rate.height))
        slowest = where(switched, jnp.minimum(slowest, speed), slowest)
    onset = where(lift.impact, jnp.minimum(before.slowest_onset, rate.v), before.slowest_onset)
    return EventMargins(before.events + fire.astype(jnp.int32), onset, slowest)


def change_of_row(
    lane: Lane, end: State, torques: tuple[Any, Any], ending: InterfaceEnding, fixed: Fixed, method: Choices, each: Each
) -> RowChange:
    """What happens where a trial ended in the state `end`; for its `torques` see `row_torques`."""
    model, accumulator = fixed.model, lane.accumulator
    at = over(
        each,
        partial(interface_change, method=method),
        *torques,
        pair_states(end, model),
        ending,
        lax.stop_gradient(fixed.grid),
        values_of_events(accumulator.log, method),
        accumulator.margins,
        lane.search.turns,
        model.interfaces,
    )
    after, dropped = as_flat(State(end.motion, at.u_s, at.mode, at.case), at.becomes_flat, model, each)
    return RowChange(after, dropped, at)


def no_change(lane: Lane, end: State, v: Any, method: Choices) -> RowChange:
    """What happens where a trial of contact without events ended, with penetrations `v` [m]: nothing."""
    accumulator = lane.accumulator
    no = jnp.zeros_like(lane.step, bool)
    at = InterfaceChange(
        u_s=end.u_s,
        mode=end.mode,
        case=end.case,
        becomes_flat=no,
        turns=None,
        jumped=no,
        springs=jax.tree.map(jnp.zeros_like, v),
        counted=values_of_events(accumulator.log, method),
        v=v,
        margins=accumulator.margins,
        lift=Lift(no, no, no),
    )
    return RowChange(end, no_time(end), at)


def as_flat(state: State, becomes_flat: FlagOfInterfaces, model: RowModel, each: Each) -> tuple[State, PerLane]:
    """The state once the blocks of new flat faces turn as one with their clusters, and the energy that is lost [J].

    The angular momentum of each cluster is kept.
    """
    if not model.turns_by_events:
        return state, no_time(state)
    now = any_along(becomes_flat)
    parallel = turned_as_one(state.motion, clusters(state.case, model), now, model)
    before, now_parallel, still = lax.stop_gradient((state.motion, parallel, model))
    lost = total(blade_energies(before, still, each) - blade_energies(now_parallel, still, each))
    if not is_zero(between := coupling_energies(before, still)):
        lost = lost + total(between - coupling_energies(now_parallel, still))
    return State(parallel, state.u_s, state.mode, state.case), where(now, lost, 0.0)


def is_finite_row(state: State) -> Bool[Array, "..."]:
    """Whether all numbers of the motion are finite."""
    return jnp.isfinite(sum(total(a) for a in jax.tree.leaves(state.motion, is_leaf=is_unrolled)))


def lane_after(
    lane: Lane,
    trial: AcceptedTrial,
    search: Any,
    guards: Guards | None,
    lost: Bool[Array, "..."],
    too_many: Bool[Array, "..."],
    model: RowModel,
    method: Choices,
    each: Each,
) -> Lane:
    """The lane after a `trial`, with the search and the guards of the next one.

    Its motion may be `lost`, which is not finite any more, and its step have `too_many` events.
    """
    after = trial.change.state
    theta: Any = model.blades.shroud(after.motion).theta
    if is_unrolled(theta):
        theta = Unrolled(*(a for a in theta if not is_zero(a)))
    status = where(too_many, Status.TOO_MANY_EVENTS, Status.OK)
    if not is_zero(theta):
        status = where(any_along(abs(theta) > ANGLE_RANGE), Status.ANGLE_OUT_OF_RANGE, status)
    status = where(lost, Status.NOT_FINITE, status).astype(jnp.int32)
    accumulator = updated_accumulator(lane.accumulator, trial, model, method, each)
    return Lane(after, trial.next_step, search, guards, accumulator, status)
