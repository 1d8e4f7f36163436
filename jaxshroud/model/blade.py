"""A blade: mass, damping and stiffness of its coordinates, and the map from them to the shroud's x, y and theta.

The coordinates of a lumped blade are x, y and theta of its shroud. A blade by modes has n coordinates of its own. Both
have the same methods: of numbers of one blade, or of arrays for all blades of a row.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, is_zero, summed
from jaxshroud.model.drive import Excitation, Wave
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES, Parts
from jaxshroud.scene.modes import ModeNumbers
from jaxshroud.scene.scene import Scene


class BladeForces(NamedTuple):
    """The forces of contact on one blade, or on each of several."""

    x: Any  # [N]
    y: Any
    M: Any  # clockwise, about the block's centre [N m]

    def plus(self, other: "BladeForces") -> "BladeForces":
        """The sum of both."""
        return BladeForces._make(a + b for a, b in zip(self, other, strict=True))


class InverseMasses(NamedTuple):
    """The reciprocal masses, as products are cheaper than quotients; absent where a block cannot move."""

    x: Any  # 1 / m [1/kg]: a `Pair`, or one blade's
    y: Any  # [1/kg]
    theta: Any  # 1 / I [1/(kg m^2)]


class Acceleration(NamedTuple):
    """Second derivatives of the displacements."""

    x: Any  # [m/s^2]: a `Pair`, or one blade's
    y: Any
    theta: Any  # [rad/s^2]


def rate_of_motion(z: Motion, a: Acceleration) -> Motion:
    """The time derivative of a motion."""
    return Motion(x=z.v_x, y=z.v_y, theta=z.v_theta, v_x=a.x, v_y=a.y, v_theta=a.theta)


class LumpedBlade(eqx.Module):
    """A mass on springs and dampers (Sec. 2.1): the fields of `Blades`, of both blades, or of one."""

    m: Any
    I: Any
    k_x: Any
    k_y: Any
    k_T: Any
    c_x: Any
    c_y: Any
    c_T: Any
    m_y: Any = None

    @property
    def inertia_y(self) -> Any:
        """The mass against motion in y [kg]."""
        return self.m if self.m_y is None else self.m_y

    def inverse_masses(self, parts: Parts) -> InverseMasses:
        """What multiplies forces to accelerations: the reciprocal masses of the blades of a row."""

        def inverse(name, mass):
            return 1 / mass if parts.has(name, 0) else ZERO

        return InverseMasses(x=1 / self.m, y=inverse("y", self.inertia_y), theta=inverse("theta", self.I))

    def shroud(self, z: Motion) -> Motion:
        """The motion of the shroud."""
        return z

    watched = shroud

    def coordinates(self, z: Motion) -> tuple[Any, Any]:
        """Its coordinates and their rates."""
        return z[:3], z[3:]

    def motion(self, places: Sequence[Any], rates: Sequence[Any]) -> Motion:
        """The motion with these coordinates and rates."""
        return Motion._make((*places, *rates))

    def in_one_unit(self, numbers: Sequence[Any], lever: Any) -> Sequence[Any]:
        """Numbers of its coordinates as displacements of a corner [m]."""
        x, y, theta = numbers
        return x, y, lever * theta

    @property
    def springs(self) -> list[Any]:
        """The stiffnesses of its coordinates."""
        return [self.k_x, self.k_y, self.k_T]

    @property
    def dampers(self) -> list[Any]:
        """The damping of its coordinates."""
        return [self.c_x, self.c_y, self.c_T]

    def squared_rates(self, inverse: InverseMasses) -> list[Any]:
        """The squares of its natural frequencies, and of half of what its dampers take in a second [1/s^2]."""
        springs = [k * w for k, w in zip(self.springs, inverse, strict=True)]
        return [*springs, *((c * w / 2) ** 2 for c, w in zip(self.dampers, inverse, strict=True))]

    def accelerations(self, z: Motion, Q: Wave, drive: Excitation, R: BladeForces, inverse: InverseMasses) -> Any:
        """The accelerations by Eq. (1), at the wave `Q` of the drive and the forces `R` of contact."""
        a_x = (drive.force("x", Q) + R.x - self.c_x * z.v_x - self.k_x * z.x) * inverse.x
        a_y = (drive.force("y", Q) + R.y - self.c_y * z.v_y - self.k_y * z.y) * inverse.y
        a_theta = (drive.force("theta", Q) + R.M - self.c_T * z.v_theta - self.k_T * z.theta) * inverse.theta
        return Acceleration(a_x, a_y, a_theta)

    def rate(self, z: Motion, a: Acceleration) -> Motion:
        """The rate of a motion with these accelerations."""
        return rate_of_motion(z, a)

    def turning(self, a: Acceleration) -> Any:
        """The angular acceleration of the shroud."""
        return a.theta

    def turned(self, a: Acceleration, theta: Any, inverse: InverseMasses) -> Acceleration:
        """The accelerations once a torque on the shroud gives it the angular acceleration `theta`."""
        del inverse
        return a._replace(theta=theta)

    def with_turn(self, z: Motion, theta: Any, v_theta: Any, inverse: InverseMasses) -> Motion:
        """The motion once an impulsive torque on the shroud gives it this angle and this angular speed."""
        del inverse
        return z._replace(theta=theta, v_theta=v_theta)

    def drive_power(self, z: Motion, Q: Wave, drive: Excitation) -> Any:
        """The power of the drive [W]."""
        return drive.power(Q, z)

    def viscous_power(self, z: Motion) -> Any:
        """The power lost in the dampers [W]."""
        return self.c_x * z.v_x**2 + self.c_y * z.v_y**2 + self.c_T * z.v_theta**2

    def twice_energy(self, z: Motion) -> Any:
        """Twice the kinetic energy and the energy of the springs [J]."""
        kinetic = self.m * z.v_x**2 + self.inertia_y * z.v_y**2 + self.I * z.v_theta**2
        return kinetic + self.k_x * z.x**2 + self.k_y * z.y**2 + self.k_T * z.theta**2


class StressedMotion(NamedTuple):
    """The motion of a shroud, and the stress at one place of its blade."""

    x: Any
    y: Any
    theta: Any
    v_x: Any
    v_y: Any
    v_theta: Any
    sigma: Any  # [Pa]
    v_sigma: Any  # [Pa/s]


class ModalMotion(NamedTuple):
    """The coordinates of a blade by modes and their rates, a number of each mode."""

    q: tuple[Any, ...]
    rate: tuple[Any, ...]


class ModalBlade(eqx.Module):
    """A blade by its modes, see `ModalBlades`: motions `z` are `ModalMotion`s, and accelerations tuples."""

    stiffness: tuple[Any, ...]  # omega^2 of each mode [1/s^2]
    damping: tuple[Any, ...]  # 2 zeta omega at rest [1/s]
    shapes: tuple[tuple[Any, ...], ...]  # of x, y and theta, a number of each mode; absent where blocks cannot move
    I: Any  # inertia of the shroud against a turn by itself [kg m^2]
    sigma: tuple[Any, ...]  # stress of a unit of each coordinate; empty without any

    def inverse_masses(self, parts: Parts) -> None:
        """Nothing: the masses of modes are 1."""
        del parts

    def shroud(self, z: Any) -> Motion:
        """The motion of the shroud."""
        return Motion._make(dot(shape, numbers) for numbers in (z.q, z.rate) for shape in self.shapes)

    def watched(self, z: Any) -> Any:
        """The motion of the shroud, with the stress where there is one."""
        shroud = self.shroud(z)
        if not self.sigma:
            return shroud
        return StressedMotion(**shroud._asdict(), sigma=dot(self.sigma, z.q), v_sigma=dot(self.sigma, z.rate))

    def coordinates(self, z: Any) -> tuple[Any, Any]:
        """Its coordinates and their rates."""
        return z

    def motion(self, places: Sequence[Any], rates: Sequence[Any]) -> ModalMotion:
        """The motion with these coordinates and rates."""
        return ModalMotion(tuple(places), tuple(rates))

    def in_one_unit(self, numbers: Sequence[Any], lever: Any) -> Sequence[Any]:
        """Numbers of its coordinates: they are in one unit, as all masses are 1."""
        del lever
        return numbers

    @property
    def springs(self) -> list[Any]:
        """The stiffnesses of its coordinates."""
        return [self.stiffness]

    @property
    def dampers(self) -> list[Any]:
        """The damping of its coordinates."""
        return [self.damping]

    def squared_rates(self, inverse: None) -> list[Any]:
        """The squares of its natural frequencies, and of half of what its dampers take in a second [1/s^2]."""
        del inverse
        return [*self.stiffness, *((c / 2) ** 2 for c in self.damping)]

    def accelerations(self, z: Any, Q: Wave, drive: Excitation, R: BladeForces, inverse: None) -> Any:
        """The accelerations of all coordinates, at the wave `Q` of the drive and the forces `R` of contact."""
        del inverse
        on_shroud = [drive.force(name, Q) + own for name, own in zip(COORDINATES, R, strict=True)]
        forces = (dot(column, on_shroud) for column in zip(*self.shapes, strict=True))
        own = zip(forces, self.damping, z.rate, self.stiffness, z.q, strict=True)
        return tuple(force + drive.on_mode(j, Q) - c * rate - k * q for j, (force, c, rate, k, q) in enumerate(own))

    def rate(self, z: Any, a: tuple[Any, ...]) -> ModalMotion:
        """The rate of a motion with these accelerations."""
        return ModalMotion(z.rate, a)

    def turning(self, a: tuple[Any, ...]) -> Any:
        """The angular acceleration of the shroud."""
        return dot(self.shapes[2], a)

    def turned(self, a: tuple[Any, ...], theta: Any, inverse: None) -> tuple[Any, ...]:
        """The accelerations once a torque on the shroud gives it the angular acceleration `theta`."""
        del inverse
        torque = self.I * (theta - self.turning(a))
        return tuple(own + by * torque for own, by in zip(a, self.shapes[2], strict=True))

    def with_turn(self, z: Any, theta: Any, v_theta: Any, inverse: None) -> Any:
        """The motion once an impulsive torque on the shroud gives it this angle and this angular speed."""
        return ModalMotion(self.turned(z.q, theta, inverse), self.turned(z.rate, v_theta, inverse))

    def drive_power(self, z: Any, Q: Wave, drive: Excitation) -> Any:
        """The power of the drive [W]."""
        return drive.power(Q, self.shroud(z)) + summed(drive.on_mode(j, Q) * v for j, v in enumerate(z.rate))

    def viscous_power(self, z: Any) -> Any:
        """The power lost in the dampers [W]."""
        return dot(self.damping, [v * v for v in z.rate])

    def twice_energy(self, z: Any) -> Any:
        """Twice the kinetic energy and the energy of the springs [J]."""
        return summed(v * v for v in z.rate) + dot(self.stiffness, [q * q for q in z.q])


AnyBlade = LumpedBlade | ModalBlade


def lumped_blades(b: Blades) -> LumpedBlade:
    """The lumped blades of a scene, fields (blades,)."""
    return LumpedBlade(b.m, b.I, b.k_x, b.k_y, b.k_T, b.c_x, b.c_y, b.c_T, b.m_y)


def blades_of_row(scene: Scene) -> AnyBlade:
    """The blades of a row with their mistuning, fields (blades,)."""
    modes = scene.mode_numbers
    return lumped_blades(scene.mistuned_blades) if modes is None else modal_blades_of(modes, scene.parts)


def modal_blades_of(modes: ModeNumbers, parts: Parts) -> ModalBlade:
    """Blades by modes, fields (blades,)."""
    none = (ZERO,) * len(modes.stiffness)
    turn = dot(modes.shapes[2], modes.shapes[2])
    return ModalBlade(
        stiffness=modes.stiffness,
        damping=modes.damping,
        shapes=tuple(
            shape if parts.has(name, 0) else none for name, shape in zip(COORDINATES, modes.shapes, strict=True)
        ),
        I=1 / jnp.where(turn > 0, turn, 1.0),
        sigma=modes.sigma,
    )


def moving_pair(blades: AnyBlade, inverse: Any, parts: Parts) -> tuple[AnyBlade, Any]:
    """Two blades and their inverse masses, pairs of numbers, of which a rigid neighbour does not move."""

    def moving(pair: Any) -> tuple[Any, Any]:
        left, right = (ZERO, ZERO) if is_zero(pair) else pair
        return left, right if parts.neighbour == "blade" else ZERO

    if isinstance(blades, LumpedBlade):
        return blades, InverseMasses._make(map(moving, inverse))
    return replace(blades, shapes=tuple(tuple(map(moving, row)) for row in blades.shapes)), None


def dot(row: Sequence[Any], numbers: Sequence[Any]) -> Any:
    """The sum of the products of the entries of two vectors."""
    return summed(a * b for a, b in zip(row, numbers, strict=True))
