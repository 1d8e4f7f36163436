"""The forces of contact in a state, the energy that is stored there, and the balance of energy."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.accumulator import EnergyJumps
from jaxshroud.march.carry import PerLane
from jaxshroud.march.events import place_contact
from jaxshroud.model.arithmetic import ZERO, Scalar, blended, is_zero, summed, where
from jaxshroud.model.contact_law import Slider, SummedForces
from jaxshroud.model.geometry import Case, FaceKinematics, Kinematics, Pose, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.points_contact import interface_mode, points_last
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import EndTorques, Ledger, law_forces


class ContactForces(NamedTuple):
    """The forces of contact. The left block feels -N n - F t, with the normal n and the tangent t of the face.

    The right block feels the opposite. When apart, the forces are 0 and -v > 0 is the remaining gap along the normal.
    """

    N: Any  # normal force [N]
    F: Any  # friction force; positive against sliding to larger u [N]
    v: Any  # penetration [m]
    u: Any  # slide of the left block against the right one [m]
    contact_point: Any  # up the left block's face from its middle [m]; NaN when apart, absent where blocks do not turn
    points: Any = ZERO  # `PointForces`; absent where a corner touches


class PointForces(NamedTuple):
    """Quantities of each of several points of contact, as `ContactForces` of all: tuples, or arrays (..., points)."""

    N: Any  # [N]
    F: Any  # [N]
    v: Any  # [m]


def stacked_point_forces(points: Any, zero: Any) -> Any:
    """The forces of points as arrays with a last axis of points, with `zero` where they have none."""
    if is_zero(points):
        return points

    def stacked(numbers):
        return points_last(tuple(zero if is_zero(a) else a for a in numbers))

    return PointForces._make(map(stacked, points))


def contact_forces_at(
    placed: tuple[Pose, Case, Kinematics], torques: EndTorques, state: State, model: Model
) -> ContactForces:
    """The contact forces of placed blocks under known torques, by which flat contact finds its place."""
    _, case, at = placed
    forces = law_forces(at, case, state, model)

    def is_apart():
        return interface_mode(state.mode) == Mode.APART

    F = where(is_apart(), ZERO, forces.F)  # no negative zero
    point = ZERO
    if isinstance(forces, SummedForces) and has_torsion(model):
        point = where(is_apart(), jnp.nan, _centre_of_pressure(forces, model))
    elif has_torsion(model):
        place = _tip_position(at, case, model.block.l_ab)
        if model.law.has_events:
            place = where(case == FLAT, _flat_contact_position(at, torques, model), place)
        point = where(is_apart(), jnp.nan, place)
    of_points = ZERO
    if isinstance(forces, SummedForces) and isinstance(at, FaceKinematics):
        pairs = zip(state.mode, forces.points, strict=True)
        F_of = tuple(where(mode == Mode.APART, ZERO, own.F) for mode, own in pairs)
        of_points = PointForces(tuple(own.N for own in forces.points), F_of, tuple(own.v for own in at.points))
    return ContactForces(forces.N, F, at.v, at.u, point, of_points)


def _centre_of_pressure(forces: SummedForces, model: Model) -> Scalar:
    """The position of the resultant of the normal forces of several points along the face."""
    moment = summed(own.N * at.place for own, at in zip(forces.points, model.block.points, strict=True))
    return moment / where(forces.N == 0, 1.0, forces.N)


def _tip_position(at: Kinematics, case: Case, l_ab: Scalar) -> Scalar:
    """The position of the penetrating corner along the left block's face."""
    return blended(is_upper(case), l_ab, -l_ab) / 2 - blended(tip_is_left(case), 0.0, _offset_along_face(at))


def _offset_along_face(at: Kinematics) -> Scalar:
    """The offset of the left block's corner from the right one's, up the face: the slide of the consistent reading."""
    return at.offset[0] * at.tangent[0] + at.offset[1] * at.tangent[1]


def _flat_contact_position(at: Kinematics, torque: EndTorques, model: Model) -> Scalar:
    """The position at which the resultant of flat contact keeps the blocks parallel, between the ends of the overlap.

    The torque on theta_1 - theta_2 is linear along the overlap, whose ends are the corners d and a, or b and c.
    """
    l_ab = model.block.l_ab
    along = _offset_along_face(at)
    low = -l_ab / 2 - where(at.height > 0, 0.0, along)
    high = l_ab / 2 - where(at.height > 0, along, 0.0)
    apart = torque.lower - torque.upper
    return low + (high - low) * (torque.lower / where(apart == 0, 1.0, apart))


def contact_spring_energy(state: State, model: Model) -> Scalar:
    """The energy of the contact springs [J]."""
    at = place_contact(state.motion, state, model)[2]
    w = model.law.stretch_at(at, state.u_s, state.mode)
    return model.law.energy_at(at, w, state.mode)


def slider_position(state: State, model: Model) -> Slider:
    """The slider, which compiled loops do not carry along in slip [m]; the state itself of laws that integrate it."""
    if model.law.flows:
        return state.u_s
    at = place_contact(state.motion, state, model)[2]
    w = model.law.stretch_at(at, state.u_s, state.mode)
    return jax.tree.map(lambda w: at.u - w, w, is_leaf=is_zero)


def energy_residual(ledger: Ledger, jumps: EnergyJumps, stored: PerLane) -> PerLane:
    """The residual of the energy balance [J]: works and jumps less the change of the `stored` energy."""
    return ledger.drive + jumps.springs - jumps.dropped - ledger.viscous - ledger.friction - stored


MAX_IMBALANCE = 0.5  # largest residual over the energy involved; an acceptable march has thousandths


def is_unbalanced(residual: PerLane, gross: PerLane, before: PerLane, after: PerLane) -> Bool[Array, "..."]:
    """Whether the residual is so large, against the gross work and the stored energy, that the motion is invalid."""
    return jnp.abs(residual) > MAX_IMBALANCE * (gross + jnp.abs(before) + jnp.abs(after))
