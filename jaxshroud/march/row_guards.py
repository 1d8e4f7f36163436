"""The guards at the interfaces of a row of blades, its contact forces, and the location of its earliest event.

That is the earliest over all interfaces, which `locate` closes in on.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import Search, Target
from jaxshroud.march.event import (
    Events,
    GuardEvaluation,
    Guards,
    any_of,
    first_kind,
    forces_jump,
    rounding_of,
    violated_guards,
)
from jaxshroud.march.events import BUILT_IN_EVENTS, guards_at, place_contact
from jaxshroud.march.forces_and_energy import ContactForces, contact_forces_at
from jaxshroud.march.locate import (
    TrialOutcome,
    at_least_two,
    first_crossed,
    first_interior_maximum,
    select,
    select_guard,
)
from jaxshroud.model.arithmetic import (
    ZERO,
    Scalar,
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
from jaxshroud.model.geometry import Kinematics
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import EndTorques, Recorded, contact_effects, law_forces, torques_along_face
from jaxshroud.model.row import (
    Each,
    RowModel,
    blade_forces,
    clusters,
    joint_inertia,
    over,
    pair_states,
    rates_of_blades,
    relative_torques,
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
    return relative_torques(own, state.case, cluster, model), joint_inertia(cluster, model)


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
    torque: Scalar, state: State, low: Guards, counts: Bool[Array, ""], length: Scalar, model: Model, events: Events
) -> InterfaceOutcome:
    """The outcome at one interface of a trial of so many seconds that ended in `state`.

    Args:
        torque: The relative torque of its corner.
        state: Its end, in the mode and case of the trial.
        low: The guards at the lower end of the bracket, or at the start of the trial.
        counts: Whether a violated guard counts.
        length: The length of the trial [s].
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
    zero, none = jnp.zeros_like(length), jnp.zeros_like(kind)
    share, crossed = first_crossed(low, guards, violated, Target(none, zero, zero, zero, none))
    top = first_interior_maximum(low, guards, length)
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
