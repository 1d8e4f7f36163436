"""What Eq. (1) takes from each interface and each blade while modes and cases are fixed: `row.row_rhs` joins it.

How the faces of two blocks lie against each other, the forces of contact there, and what is integrated with the motion.
"""

from typing import Any, NamedTuple

from jaxshroud.model.arithmetic import ZERO, Pair, Scalar, is_zero, sine_versine, where
from jaxshroud.model.blade import AnyBlade
from jaxshroud.model.contact import Load
from jaxshroud.model.contact_law import ContactLoads, ContactPoint, Forces, Slider
from jaxshroud.model.drive import Excitation, Wave
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
from jaxshroud.model.linear import StaticPosition, about_static
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


def parallel_mean(pair: Pair, model: Model) -> Pair:
    """The common value of two turning blocks that are held parallel: their mean, weighted by inertia."""
    mean = pair[1] + model.mobility.share * (pair[0] - pair[1])
    return mean, pair[1] if is_zero(pair[1]) else mean


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


def blade_works(z: Any, Q: Wave, blade: AnyBlade, drive: Excitation) -> tuple[Scalar, Scalar]:
    """The power of the drive on one blade, and that lost in its dampers [W]; all arguments are its own."""
    return blade.drive_power(z, Q, drive), blade.viscous_power(z)


class StateDerivative(NamedTuple):
    """The accelerations, and the rate of the slider where it moves without events."""

    acceleration: Any  # an `Acceleration`, or those of a blade's own coordinates
    u_s: Slider


def position_at(x: Any, y: Any, theta: Any) -> Means:
    """The position at some displacements, of any shape."""
    sine, versine = (theta, theta) if is_zero(theta) else sine_versine(theta)
    return Means(x, y, sine, versine)


class ContactEffects(NamedTuple):
    """What contact does to the blocks, and the rates of what is recorded of it."""

    load: Load
    u_s: Slider  # rate of the slider where it moves without events
    lost: Scalar | None  # power [W]; None where it is not recorded, as is the next
    loads: ContactLoads | None


def contact_effects(place: Placement, now: State, model: Model, recorded: Recorded) -> ContactEffects:
    """The effects of contact where the position is known already."""
    (forces, load), law = place.loaded, model.law
    point = contact_point(place.at, now.motion, now, place.case, model)
    lost = law.dissipated_power(point, forces) if recorded.ledger else None
    return ContactEffects(load, forces.u_s, lost, law.load_rates(point, forces) if recorded.loads else None)
