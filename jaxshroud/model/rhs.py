"""What Eq. (1) takes from each interface and each blade while modes and cases are fixed: `row.row_rhs` joins it.

How the faces of two blocks lie against each other, the forces of contact there, and what is integrated with the motion.
"""

from typing import Any, NamedTuple

from jaxshroud.model.arithmetic import ZERO, Pair, Scalar, is_zero, sine_versine, where
from jaxshroud.model.contact import Load
from jaxshroud.model.contact_law import ContactLoads, ContactPoint, Forces, Slider
from jaxshroud.model.geometry import (
    Case,
    FaceKinematics,
    Kinematics,
    contact_kinematics,
    contact_rates,
    is_upper,
    pose,
    tip_is_left,
)
from jaxshroud.model.linear import StaticPosition, about_static
from jaxshroud.model.prepared import Model, State, has_torsion


class LoadedContact(NamedTuple):
    """How the faces of two blocks lie against each other, the forces of contact, and what these do to the blocks."""

    point: ContactPoint
    forces: Forces
    load: Load


def contact_point(at: Kinematics, case: Case, now: State, model: Model) -> ContactPoint:
    """The point of contact of blocks that lie so."""
    rates = contact_rates(at, now.motion, case, model.reading) if isinstance(at, FaceKinematics) else None
    return ContactPoint(at, now.motion, case, now.u_s, now.mode, model.reading, rates)


def law_forces(at: Kinematics, case: Case, now: State, model: Model) -> Forces:
    """The forces of the model's law there."""
    return model.law.forces(contact_point(at, case, now, model))


def loaded_contact(now: State, model: Model) -> LoadedContact:
    """The contact of two blocks in the current case."""
    q = pose(now.motion.x, now.motion.y, now.motion.theta)
    blend = model.law.case_blend(q, model.block) if has_torsion(model) else None
    case = now.case if blend is None else blend
    point = contact_point(contact_kinematics(q, case, model.block, model.reading), case, now, model)
    forces = model.law.forces(point)
    return LoadedContact(point, forces, model.law.load(point, forces, model.block))


class EndTorques(NamedTuple):
    """The torques on theta_1 - theta_2 of parallel blocks with contact at either end of the faces' overlap.

    Each is the reduced inertia times the relative angular acceleration; absent where the blocks do not turn. Where the
    lower torque is positive and the upper one negative, a resultant in between keeps the blocks parallel.
    """

    lower: Scalar  # of contact at corner b or d [N m]
    upper: Scalar  # of contact at corner a or c [N m]


def torques_along_face(torque: Scalar, forces: Forces, at: Kinematics, state: State, model: Model) -> EndTorques:
    """The torques at both ends of the overlap from the `torque` with contact at the corner of the current case.

    Shifting the resultant -N n - F t by s t + r n changes the torque by F r - N s. From d, the corner b is at
    u t + v n, c is at l_ab t, and a is at the sum of both; the overlap ends at d and a, or at b and c.
    """
    along = forces.N * model.block.l_ab
    corner = model.law.shift_torque(at, forces, state.mode)
    shift = where(is_upper(state.case), along, ZERO) - where(tip_is_left(state.case), corner, ZERO)
    at_d = torque + shift
    higher = at.height > 0
    return EndTorques(at_d + where(higher, corner, ZERO), at_d - along + where(higher, ZERO, corner))


class Ledger(NamedTuple):
    """The works of the energy balance."""

    drive: Scalar  # done by the drive [J]
    gross: Scalar  # integral of the magnitude of its power [J]
    viscous: Scalar  # lost in the dampers [J]
    friction: Scalar  # lost in the sliding contact [J]


Displacements = tuple[Pair, Pair, Pair]  # a number for each of x, y and theta


class Moments(NamedTuple):
    """The displacements x, y and theta, and their squares, integrated in time."""

    first: Displacements  # [m s], [rad s]
    second: Displacements  # [m^2 s], [rad^2 s]


class Means(NamedTuple):
    """The position about which a block vibrates, integrated in time: of the left block of a pair, of all of a row."""

    x: Any  # [m s]
    y: Any
    sin: Any  # of theta [s]
    versine: Any  # 1 - cos(theta) [s]


class Recorded(NamedTuple):
    """Which integrals are computed beside the power."""

    ledger: bool = False
    moments: bool = False
    loads: bool = False
    means: bool = False


class Integrals(NamedTuple):
    """The integrals in time that are computed with the motion, to the order of the integrator."""

    power: Pair  # mean square displacement over the block, Eq. (23) divided by its area [m^2 s]
    ledger: Ledger | None  # None where it is not kept, as are the next three
    moments: Moments | None = None
    loads: ContactLoads | None = None
    means: Means | None = None


def blade_mean_square(x: Any, y: Any, sine: Any, versine: Any, gyration: Scalar, static: StaticPosition | None) -> Any:
    """The square displacement averaged over a block: x^2 + y^2 + 4 (J_A/A) sin^2(theta/2) [m^2]; arrays in its shape.

    With mean loads it is that from the static position of this blade.

    Source:
        Eqs. (22), (23): over a centrally symmetric block the cross terms vanish, so no area quadrature is needed.
    """
    if static is not None:
        x, y = (a if is_zero(a) else a - at for a, at in ((x, static.x), (y, static.y)))
        if not is_zero(versine):
            versine = about_static((x, y, sine, versine), static)[3]
    return x**2 + y**2 + gyration * 2 * versine


class StateDerivative(NamedTuple):
    """The accelerations, and the rate of the slider where it moves without events."""

    acceleration: Any  # an `Acceleration`, or those of a blade's own coordinates
    u_s: Slider


def position_of(z: Any) -> Means:
    """The position at displacements x, y and theta, of any shape; they may be those of a motion."""
    x, y, theta = z[:3]
    sine, versine = (theta, theta) if is_zero(theta) else sine_versine(theta)
    return Means(x, y, sine, versine)


class ContactEffects(NamedTuple):
    """What contact does to the blocks, and the rates of what is recorded of it."""

    load: Load
    u_s: Slider  # rate of the slider where it moves without events
    lost: Scalar | None  # power [W]; None where it is not recorded, as is the next
    loads: ContactLoads | None


def contact_effects(now: State, model: Model, recorded: Recorded) -> ContactEffects:
    """The effects of contact at one interface."""
    point, forces, load = loaded_contact(now, model)
    law = model.law
    lost = law.dissipated_power(point, forces) if recorded.ledger else None
    return ContactEffects(load, forces.u_s, lost, law.load_rates(point, forces) if recorded.loads else None)
