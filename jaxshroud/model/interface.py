"""The interface of two blocks: how their faces lie against each other, and the forces of contact there."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxshroud.model.arithmetic import ABSENT, Scalar, is_absent, where
from jaxshroud.model.contact import Load, contact_load, sprung_load
from jaxshroud.model.friction import Slider, Springs, friction_force, normal_force, smooth_slider_rate
from jaxshroud.model.geometry import (
    Case,
    ContactKinematics,
    ContactRates,
    Pose,
    blended_case,
    contact_kinematics,
    contact_rates,
    is_upper,
    pose,
    tip_is_left,
)
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.series import Series
from jaxshroud.scene.keys import Motion


class LawForces(NamedTuple):
    """The forces by the laws of contact."""

    N: Scalar  # [N]
    F: Scalar  # [N]
    u_s: Slider  # rate of the slider, where it is integrated with the motion


class LoadedContact(NamedTuple):
    """The forces of contact, and what they are to the blocks."""

    forces: LawForces
    load: Load


def law_forces(at: ContactKinematics, z: Motion, state: State, case: Case, model: Model) -> LawForces:
    """The normal and the friction force of the motion `z` in the mode of `state`."""
    spring = model.spring
    if not is_absent(spring.laws):
        return _own_law_forces(at, contact_rates(at, z, case, model.reading), state, spring)
    N = normal_force(at.v, state.mode, spring)
    F = friction_force(at.v, at.u, state.u_s, state.mode, spring)
    return LawForces(N, F, smooth_slider_rate(at.v, at.u, state.u_s, state.mode, spring))


def _own_law_forces(at: ContactKinematics, rate: ContactRates, state: State, spring: Springs) -> LawForces:
    touches = state.mode != Mode.APART
    N = where(touches, jnp.maximum(spring.laws.push(jnp.maximum(at.v, 0.0), rate.v), 0.0), 0.0)
    if is_absent(state.u_s):
        return LawForces(N, ABSENT, ABSENT)
    F, z_t = spring.laws.rub(state.u_s, rate.u, N)
    return LawForces(N, where(touches, F, 0.0), where(touches, z_t, jnp.zeros_like(z_t)))


class Placement(NamedTuple):
    """The position of the blocks against each other, and what it makes of contact."""

    pose: Pose
    case: Case
    at: ContactKinematics
    loaded: LoadedContact


def placement(now: State, model: Model) -> Placement:
    """The position of both blocks, and the kinematics and the forces of their contact in the current case."""
    z, spring = now.motion, model.spring
    q = pose(z.x, z.y, z.theta)
    case = blended_case(q, model.block, spring.width) if spring.smooth and has_torsion(model) else now.case
    at = contact_kinematics(q, case, model.block, model.reading)
    return Placement(q, case, at, loaded_contact(at, z, now, case, model))


def loaded_contact(at: ContactKinematics, z: Motion, state: State, case: Case, model: Model) -> LoadedContact:
    """The forces of contact and their load in the mode of `state`."""
    forces = law_forces(at, z, state, case, model)
    N, F = forces.N, forces.F
    if isinstance(at.v, Series) and model.spring.modal and has_torsion(model) and not model.reading:
        return LoadedContact(forces, sprung_load(at, _contact_stiffness(state, model), N, F, case, model.block))
    return LoadedContact(forces, contact_load(at, N, F, case, model.block, model.reading))


def _contact_stiffness(state: State, model: Model) -> Scalar:
    """The contact stiffness; absent when apart."""
    return where(state.mode == Mode.APART, ABSENT, model.spring.k)


class EndTorques(NamedTuple):
    """The torques on theta_1 - theta_2 of parallel blocks with contact at either end of the faces' overlap.

    Each is the reduced inertia times the relative angular acceleration; absent where the blocks do not turn. Where the
    lower torque is positive and the upper one negative, a resultant in between keeps the blocks parallel.
    """

    lower: Scalar  # of contact at corner b or d [N m]
    upper: Scalar  # of contact at corner a or c [N m]


def torques_along_face(
    torque: Scalar, forces: LawForces, at: ContactKinematics, state: State, model: Model
) -> EndTorques:
    """`end_torques` from the `torque` with contact at the corner of the current case."""
    N, F, _ = forces
    k = _contact_stiffness(state, model)
    along, corner = N * model.block.l_ab, (F - k * at.u) * at.v if isinstance(at.v, Series) else F * at.v - N * at.u
    shift = where(is_upper(state.case), along, ABSENT) - where(tip_is_left(state.case), corner, ABSENT)
    at_d, higher = torque + shift, at.height > 0
    return EndTorques(at_d + where(higher, corner, ABSENT), at_d - along + where(higher, ABSENT, corner))
