"""The torques, the guards and the contact forces at the interfaces of a row of blades."""

from functools import partial
from typing import Any

from jaxshroud.march.event import Events
from jaxshroud.march.events import BUILT_IN_EVENTS, guards_at, place_contact
from jaxshroud.march.guards import GuardEvaluation, Guards
from jaxshroud.march.observables import ContactForces, contact_forces_at
from jaxshroud.model.arithmetic import ZERO, Scalar, Zero, is_zero
from jaxshroud.model.geometry import Kinematics
from jaxshroud.model.interface import EndTorques, law_forces, torques_along_face
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import (
    Each,
    OfInterfaces,
    RowModel,
    blade_forces,
    clusters,
    interface_effects,
    joint_inertia,
    over,
    pair_states,
    rates_of_blades,
    relative_torques,
)

ONLY_FORCES = Recorded()


def row_torques(
    state: State, wave: Any, model: RowModel, each: Each
) -> tuple[OfInterfaces | Zero, OfInterfaces | Zero]:
    """The relative torque of each interface with contact at the corner of its case, and the inertia against it."""
    if not model.turns_by_events:
        return ZERO, ZERO
    cluster = clusters(state.case, model)
    effects = over(each, partial(interface_effects, recorded=ONLY_FORCES), pair_states(state, model), model.interfaces)
    own = rates_of_blades(state.motion, wave, blade_forces(effects, state.motion, model), model, ONLY_FORCES, each)
    own = model.blades.turning(own.acceleration)
    return relative_torques(own, state.case, cluster, model), joint_inertia(cluster, model)


def interface_view(torque: Scalar, state: State, model: Model, events: Events = BUILT_IN_EVENTS) -> GuardEvaluation:
    """The kinematics and the guards of one interface under the relative torque of its corner."""
    placed = place_contact(state.motion, state, model)
    return guards_at(placed, state.motion, _end_torques(torque, placed[2], state, model), state, model, events)


def _end_torques(torque: Scalar, at: Kinematics, state: State, model: Model) -> EndTorques:
    """The torques at both ends of the faces' overlap from the relative torque of the corner."""
    if is_zero(torque):
        return EndTorques(ZERO, ZERO)
    forces = law_forces(at, state.motion, state, state.case, model)
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
