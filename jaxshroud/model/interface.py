"""The interface of two blocks: how their faces lie against each other, and the forces of contact there."""

from typing import NamedTuple

from jaxshroud.model.arithmetic import ZERO, Scalar, where
from jaxshroud.model.contact import Load
from jaxshroud.model.contact_law import ContactPoint, Forces
from jaxshroud.model.geometry import (
    Case,
    FaceKinematics,
    Kinematics,
    Pose,
    contact_kinematics,
    contact_rates,
    is_upper,
    pose,
    tip_is_left,
)
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.scene.keys import Motion


class LoadedContact(NamedTuple):
    """The forces of contact, and what they are to the blocks."""

    forces: Forces
    load: Load


def contact_point(at: Kinematics, z: Motion, state: State, case: Case, model: Model) -> ContactPoint:
    """The point of contact at the motion `z`, in the mode and with the slider of `state`."""
    rates = contact_rates(at, z, case, model.reading) if isinstance(at, FaceKinematics) else None
    return ContactPoint(at, z, case, state.u_s, state.mode, model.reading, rates)


def law_forces(at: Kinematics, z: Motion, state: State, case: Case, model: Model) -> Forces:
    """The forces of the model's law at the motion `z` in the mode of `state`."""
    return model.law.forces(contact_point(at, z, state, case, model))


class Placement(NamedTuple):
    """The position of the blocks against each other, and what it makes of contact."""

    pose: Pose
    case: Case
    at: Kinematics
    loaded: LoadedContact


def placement(now: State, model: Model) -> Placement:
    """The position of both blocks, and the kinematics and the forces of their contact in the current case."""
    z = now.motion
    q = pose(z.x, z.y, z.theta)
    blend = model.law.case_blend(q, model.block) if has_torsion(model) else None
    case = now.case if blend is None else blend
    at = contact_kinematics(q, case, model.block, model.reading)
    return Placement(q, case, at, loaded_contact(at, z, now, case, model))


def loaded_contact(at: Kinematics, z: Motion, state: State, case: Case, model: Model) -> LoadedContact:
    """The forces of contact and their load in the mode of `state`."""
    point = contact_point(at, z, state, case, model)
    forces = model.law.forces(point)
    return LoadedContact(forces, model.law.load(point, forces, model.block))


class EndTorques(NamedTuple):
    """The torques on theta_1 - theta_2 of parallel blocks with contact at either end of the faces' overlap.

    Each is the reduced inertia times the relative angular acceleration; absent where the blocks do not turn. Where the
    lower torque is positive and the upper one negative, a resultant in between keeps the blocks parallel.
    """

    lower: Scalar  # of contact at corner b or d [N m]
    upper: Scalar  # of contact at corner a or c [N m]


def torques_along_face(torque: Scalar, forces: Forces, at: Kinematics, state: State, model: Model) -> EndTorques:
    """`end_torques` from the `torque` with contact at the corner of the current case."""
    along, corner = forces.N * model.block.l_ab, model.law.shift_torque(at, forces, state.mode)
    shift = where(is_upper(state.case), along, ZERO) - where(tip_is_left(state.case), corner, ZERO)
    at_d, higher = torque + shift, at.height > 0
    return EndTorques(at_d + where(higher, corner, ZERO), at_d - along + where(higher, ZERO, corner))
