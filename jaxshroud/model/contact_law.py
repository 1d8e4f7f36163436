"""What a law of contact is: its forces at a point of contact, what they store and lose, and what ends a mode.

`ContactLaw` is contact without friction that begins and ends where the penetration changes its sign. A law states in
what it differs: its forces and its energy at least, then friction, guards of its own, or that it has no events. There
are `spring_contact` (the article's, with the friction element of Eq. (2) or without, and a smooth one) and
`user_contact`. The fields of a law are numbers of the scene; nothing but the law reads them.

All methods are of one point of contact at one instant. Its mode and its slider are arguments, so that an interface of
several points can have one law.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.arithmetic import ZERO, Scalar, where
from jaxshroud.model.contact import Load, contact_load
from jaxshroud.model.geometry import (
    AtPoint,
    Case,
    CaseBlend,
    Corners,
    Kinematics,
    Pose,
    Rates,
    RatesAtPoint,
    contact_rates,
)
from jaxshroud.model.modes import Mode
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.laws import SceneLaw

Slider = Any  # a scalar, or the state z of user laws, of any shape
Modes = Int[Array, "..."]  # see `Mode`


class LawForces(NamedTuple):
    """The forces by the laws of contact."""

    N: Scalar  # [N]
    F: Scalar  # positive against sliding to larger u [N]
    u_s: Slider  # rate of the slider where it is integrated with the motion, else absent


class SummedForces(NamedTuple):
    """The sums of the forces of several points, as `LawForces`, and those of each."""

    N: Scalar
    F: Scalar
    u_s: Slider
    points: tuple[Any, ...]  # `LawForces`


Forces = LawForces | SummedForces


class ContactLoads(NamedTuple):
    """What wears the faces, integrated in time."""

    N: Scalar  # impulse of the normal force [N s]
    N_slip: Scalar  # the part of it while the faces slip [N s]; 0 for smooth contact and user laws
    time_slip: Scalar  # [s]; 0 for smooth contact and user laws
    slip: Scalar  # path of the slider [m]; 0 for user laws


class ContactPoint(NamedTuple):
    """A point of contact at an instant: how the faces lie and move there, and what is known of its past."""

    at: Any  # `AtPoint`; of an interface of several points `FaceKinematics`
    motion: Motion  # of the blocks
    case: Case
    u_s: Slider
    mode: Any  # `Modes`, of an interface of several points a tuple of them
    reading: frozenset[str]
    own_rates: Any = None  # the rates of a point among several, where they are requested

    def rates(self) -> Any:
        """The time derivatives of the kinematics, `RatesAtPoint`."""
        if self.own_rates is not None:
            return self.own_rates
        return contact_rates(self.at, self.motion, self.case, self.reading)


class GuardCrossing(NamedTuple):
    """A point of contact where a guard has been crossed, before the transition."""

    at: Any  # `AtPoint`, of an interface of several points all of them, and so are the next three
    rate: Any  # `RatesAtPoint`
    u_s: Slider
    mode: Any  # `Modes`
    delay: Scalar  # upper bound of the time since the crossing [s]


class FrictionGuard(NamedTuple):
    """The guard of the friction element: negative while it sticks, or while it slips; absent where there is none."""

    value: Scalar
    rate: Scalar  # d(value)/dt in stick; unknown, and set to 0, in slip
    slip_path: Scalar  # in slip the path of the slider, an integral of the guard; else 0


class ContactLaw(SceneLaw):
    """A law of contact; what it can do is given by its class, and known without its numbers."""

    called: ClassVar[str] = "own laws"  # in messages
    by_series: ClassVar[bool] = False  # power series march it
    is_examined: ClassVar[bool] = False  # the accuracy of its marches is, and can be requested
    has_events: ClassVar[bool] = True  # contact begins, ends and changes its case by events, and may be flat
    has_stick: ClassVar[bool] = False  # friction sticks and slips, with events in between
    flows: ClassVar[bool] = False  # its slider, or internal state, is integrated with the motion
    relaxes: ClassVar[bool] = False  # an internal state of friction relaxes by itself, which bounds the step
    jumps_at_onset: ClassVar[bool] = False  # forces jump where contact begins or ends
    may_create_energy: ClassVar[bool] = False  # it is not known to be passive: the balance of energy stops bad marches
    has_points: ClassVar[bool] = (
        False  # an interface has several points of contact, with modes and sliders of their own
    )

    @property
    def has_friction(self) -> bool:
        """Whether the faces rub."""
        return self.has_stick or self.flows

    @property
    def of_points(self) -> tuple["ContactLaw", ...]:
        """The law of each point of contact of an interface."""
        return (self,)

    @abstractmethod
    def forces(self, point: ContactPoint) -> Forces:
        """The normal and the friction force, and the rate of the slider where it is integrated."""

    @abstractmethod
    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy stored at a penetration `v` [m] and a `stretch` w [J]."""

    @property
    @abstractmethod
    def normal_stiffness(self) -> Scalar:
        """The largest stiffness dN/dv [N/m], on which the choice of steps relies; absent without contact."""

    @property
    def tangential_stiffness(self) -> Scalar:
        """The largest stiffness dF/du [N/m], in full stick; absent without friction."""
        return ZERO

    @property
    def slider_haste(self) -> Scalar:
        """The rate at which an integrated slider follows the motion [1/s]; absent where there is none."""
        return ZERO

    def relaxation(self, speed: Scalar) -> Scalar:
        """The fastest relaxation rate of an internal state at a `speed` of the blades [m/s], in 1/s."""
        return jnp.zeros_like(speed)

    def load(self, point: ContactPoint, forces: Any, block: Corners) -> Load:
        """The load of its forces on both blocks."""
        return contact_load(point.at, forces.N, forces.F, point.case, block, point.reading)

    def shift_torque(self, at: Kinematics, forces: Any, mode: Modes) -> Scalar:
        """F v - N u: the torque of the forces where they act at the other end of the offset, less that here [N m]."""
        del mode
        return forces.F * at.v - forces.N * at.u

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        """What the friction element stores energy by: the stretch w of its spring [m]; absent without friction."""
        del v, u, u_s, mode
        return ZERO

    def stretch_at(self, at: Kinematics, u_s: Slider, mode: Any) -> Any:
        """The `stretch` at an interface, of several points that of each."""
        return self.stretch(at.v, at.u, u_s, mode)

    def energy_at(self, at: Kinematics, w: Any, mode: Any) -> Scalar:
        """The energy stored at an interface under a `stretch_at` [J]."""
        return self.stored_energy(at.v, w, mode)

    def dissipated_power(self, point: ContactPoint, forces: Any) -> Scalar:
        """The power that contact dissipates [W]."""
        del point, forces
        return ZERO

    def load_rates(self, point: ContactPoint, forces: Any) -> ContactLoads:
        """The rates of the loads."""
        del point
        return ContactLoads(forces.N, ZERO, ZERO, ZERO)

    def loads_of_interface(self, of_points: list[ContactLoads]) -> ContactLoads:
        """The loads of an interface, or their rates, from those of its points."""
        return of_points[0]

    def case_blend(self, q: Pose, block: Corners) -> CaseBlend | None:
        """The mixture of the four cases of blocks that turn; None where contact switches from corner to corner."""
        del q, block
        return None

    def carried_mode(self, mode: Any) -> Any:
        """A user's mode in the form that compiled loops carry."""
        return mode

    def carried_slider(self, u_s: Slider, mode: Any) -> Slider:
        """A user's slider in the form that compiled loops carry; absent without one."""
        del u_s, mode
        return ZERO

    def lift_guard(self, at: AtPoint, rate: RatesAtPoint, apart: Bool[Array, ""]) -> tuple[Scalar, Scalar]:
        """The value [m] and the rate of the guard of onset and separation: v when `apart`, -v in contact."""
        lift = where(apart, 1.0, -1.0)
        return lift * at.v, lift * rate.v

    def friction_guard(self, at: AtPoint, rate: RatesAtPoint, u_s: Slider, mode: Modes) -> FrictionGuard:
        """The guard of the friction element."""
        del at, rate, u_s, mode
        return FrictionGuard(ZERO, ZERO, ZERO)

    def onset_mode(self, crossing: GuardCrossing) -> Modes:
        """The mode as contact begins."""
        del crossing
        return jnp.int32(Mode.SLIP_PLUS)

    def mode_after_rub(self, crossing: GuardCrossing) -> Modes:
        """The mode after the guard of the friction element."""
        return crossing.mode

    def crossing_at(self, m: int, crossing: GuardCrossing) -> GuardCrossing:
        """The crossing at point `m` of an interface."""
        del m
        return crossing

    def with_mode_at(self, m: int, modes: Any, mode: Modes) -> Any:
        """The modes of an interface with that of point `m` anew."""
        del m, modes
        return mode

    def slider_after(self, crossing: GuardCrossing, w: Slider, mode: Modes, u: Scalar) -> Slider:
        """The slider after an event that leads into a `mode` and a slide `u`, from the stretch `w` before it."""
        del crossing, w, mode, u
        return ZERO

    def largest_normal_force(self, deepest: Scalar, mode: Modes, at_ends: tuple[Scalar, Scalar]) -> Scalar:
        """The largest normal force of a trial [N], from the largest penetration [m] and the forces at its ends [N]."""
        del deepest, mode
        return jnp.maximum(*at_ends)

    def friction_rate(self, rate: RatesAtPoint, mode: Modes) -> Scalar:
        """The rate of the friction force [N/s]; absent where it is not known, or there is no friction."""
        del rate, mode
        return ZERO


class LinearLaw(ContactLaw):
    """A law whose forces are linear in v and u within a mode. Power series march it; see `linear_law`."""

    by_series: ClassVar[bool] = True

    @property
    def stiffnesses(self) -> tuple[Any, ...]:
        """The fields in units of force, which depend on that of time."""
        return ()

    @abstractmethod
    def normal_force(self, v: Scalar, mode: Modes) -> Scalar:
        """The normal force [N], or with the integral of v [m s] its impulse."""

    def slider_speed(self, v_rate: Scalar, u_rate: Scalar, mode: Modes) -> Scalar:
        """The rate of the slider [m/s], or with changes of v and u [m] its own; absent without friction."""
        del v_rate, u_rate, mode
        return ZERO

    def friction_series(self, at: Kinematics, rate: Rates, u_s: Slider, mode: Modes) -> tuple[Scalar, ...]:
        """The guards of the friction element as series, which have no magnitude: one for each direction in stick."""
        del at, rate, u_s, mode
        return ()


def linear_laws(law: ContactLaw) -> list[LinearLaw]:
    """The laws of the points of an interface as those that power series march.

    Raises:
        TypeError: One is not linear.
    """
    laws = []
    for own in law.of_points:
        if not isinstance(own, LinearLaw):
            raise TypeError(f"Power series march no contact by {type(own).__name__}, which is not linear.")
        laws.append(own)
    return laws


def starts_in_overlap(at: AtPoint, delay: Scalar) -> Bool[Array, ""]:
    """Whether an onset is that of blocks which start pressed together, rather than one from a gap."""
    return (delay == 0) & (at.v > at.rounding)
