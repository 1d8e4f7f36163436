"""A blade: mass, damping and stiffness of its coordinates, and the map from them to the shroud's x, y and theta.

The coordinates of a lumped blade are x, y and theta of its shroud. An elastic blade has n coordinates of its own, modal
ones for example. Both have the same methods: of numbers of one blade, or of arrays for all blades of a row. The pair's
kernels know lumped blades only.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx

from jaxshroud.model.arithmetic import ZERO, is_zero, summed
from jaxshroud.model.drive import Excitation, Wave
from jaxshroud.scene.blades import BladeMatrices, Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES, Parts
from jaxshroud.scene.scene import Scene

MatrixRows = tuple[tuple[Any, ...], ...]  # a matrix


class BladeForces(NamedTuple):
    """The forces of contact on one blade, or on each of several."""

    x: Any  # [N]
    y: Any
    M: Any  # clockwise, about the block's centre [N m]

    def plus(self, other: "BladeForces") -> "BladeForces":
        """The sum of both."""
        return BladeForces(*(a + b for a, b in zip(self, other, strict=True)))


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
        y = 1 / self.inertia_y if parts.has("y", 0) else ZERO
        theta = 1 / self.I if parts.has("theta", 0) else ZERO
        return InverseMasses(1 / self.m, y, theta)

    def shroud(self, z: Motion) -> Motion:
        """The motion of the shroud."""
        return z

    def carried(self, z: Motion) -> Motion:
        """The motion of the blade's coordinates that moves its shroud so."""
        return z

    def accelerations(self, z: Motion, Q: Wave, drive: Excitation, R: BladeForces, inverse: InverseMasses) -> Any:
        """The accelerations by Eq. (1), at the wave `Q` of the drive and the forces `R` of contact."""
        a_x = (drive.force("x", Q) + R.x - self.c_x * z.v_x - self.k_x * z.x) * inverse.x
        a_y = (drive.force("y", Q) + R.y - self.c_y * z.v_y - self.k_y * z.y) * inverse.y
        a_theta = (drive.force("theta", Q) + R.M - self.c_T * z.v_theta - self.k_T * z.theta) * inverse.theta
        return Acceleration(a_x, a_y, a_theta)

    def rate(self, z: Motion, a: Acceleration) -> Motion:
        """The rate of a motion with these accelerations."""
        return Motion(z.v_x, z.v_y, z.v_theta, *a)

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

    def viscous_power(self, z: Motion) -> Any:
        """The power lost in the dampers [W]."""
        return self.c_x * z.v_x**2 + self.c_y * z.v_y**2 + self.c_T * z.v_theta**2

    def twice_energy(self, z: Motion) -> Any:
        """Twice the kinetic energy and the energy of the springs [J]."""
        kinetic = self.m * z.v_x**2 + self.inertia_y * z.v_y**2 + self.I * z.v_theta**2
        return kinetic + self.k_x * z.x**2 + self.k_y * z.y**2 + self.k_T * z.theta**2


class ElasticMotion(NamedTuple):
    """The coordinates of an elastic blade and their rates."""

    q: tuple[Any, ...]
    rate: tuple[Any, ...]


class ElasticBlade(eqx.Module):
    """A blade with n coordinates of its own, see `BladeMatrices`.

    Motions `z` are `ElasticMotion`s, accelerations tuples, and `inverse` is that of its mass matrix.
    """

    mass: MatrixRows
    damping: MatrixRows
    stiffness: MatrixRows
    map: tuple[Any, ...]  # three rows: x, y and theta of the shroud; absent where blocks cannot move
    lift: MatrixRows  # n rows: the coordinates of least norm for each displacement of the shroud that is not absent
    I: Any  # inertia of the shroud against a turn by itself [kg m^2]

    def inverse_masses(self, parts: Parts) -> MatrixRows:
        """What multiplies forces to accelerations: the inverse of the mass matrix."""
        del parts
        return inverse_of(self.mass)

    def shroud(self, z: Any) -> Motion:
        """The motion of the shroud."""

        def of(numbers):
            return [row if is_zero(row) else dot(row, numbers) for row in self.map]

        return Motion(*of(z.q), *of(z.rate))

    def carried(self, z: Motion) -> Any:
        """The motion of the blade's coordinates, of least norm, that moves its shroud so."""

        def of(numbers):
            return tuple(dot(row, [a for a in numbers if not is_zero(a)]) for row in self.lift)

        return ElasticMotion(of(z[:3]), of(z[3:]))

    def accelerations(self, z: Any, Q: Wave, drive: Excitation, R: BladeForces, inverse: MatrixRows) -> Any:
        """The accelerations of all coordinates, at the wave `Q` of the drive and the forces `R` of contact."""
        on_shroud = [drive.force(name, Q) + own for name, own in zip(COORDINATES, R, strict=True)]
        lost = zip(times_vector(self.damping, z.rate), times_vector(self.stiffness, z.q), strict=True)
        forces = [own - c - k for own, (c, k) in zip(self._generalized(on_shroud), lost, strict=True)]
        return times_vector(inverse, forces)

    def _generalized(self, forces: Sequence[Any]) -> list[Any]:
        """The generalized force on each coordinate of forces on the shroud along x, y and theta."""
        acting = [(row, force) for row, force in zip(self.map, forces, strict=True) if not is_zero(row)]
        return [summed(row[j] * force for row, force in acting) for j in range(len(self.mass))]

    def rate(self, z: Any, a: tuple[Any, ...]) -> ElasticMotion:
        """The rate of a motion with these accelerations."""
        return ElasticMotion(z.rate, a)

    def turning(self, a: tuple[Any, ...]) -> Any:
        """The angular acceleration of the shroud."""
        return ZERO if is_zero(self.map[2]) else dot(self.map[2], a)

    def turned(self, a: tuple[Any, ...], theta: Any, inverse: MatrixRows) -> tuple[Any, ...]:
        """The accelerations once a torque on the shroud gives it the angular acceleration `theta`."""
        torque = self.I * (theta - self.turning(a))
        return tuple(own + by * torque for own, by in zip(a, times_vector(inverse, self.map[2]), strict=True))

    def with_turn(self, z: Any, theta: Any, v_theta: Any, inverse: MatrixRows) -> Any:
        """The motion once an impulsive torque on the shroud gives it this angle and this angular speed."""
        return ElasticMotion(self.turned(z.q, theta, inverse), self.turned(z.rate, v_theta, inverse))

    def viscous_power(self, z: Any) -> Any:
        """The power lost in the dampers [W]."""
        return dot(z.rate, times_vector(self.damping, z.rate))

    def twice_energy(self, z: Any) -> Any:
        """Twice the kinetic energy and the energy of the springs [J]."""
        return dot(z.rate, times_vector(self.mass, z.rate)) + dot(z.q, times_vector(self.stiffness, z.q))


AnyBlade = LumpedBlade | ElasticBlade


def lumped_blades(b: Blades) -> LumpedBlade:
    """The lumped blades of a scene, fields (blades,)."""
    return LumpedBlade(b.m, b.I, b.k_x, b.k_y, b.k_T, b.c_x, b.c_y, b.c_T, b.m_y)


def blades_of_row(scene: Scene) -> AnyBlade:
    """The blades of a row with their mistuning, fields (blades,)."""
    matrices = scene.blade_matrices
    return lumped_blades(scene.mistuned_blades) if matrices is None else elastic_blades(matrices, scene.parts)


def elastic_blades(matrices: BladeMatrices, parts: Parts) -> ElasticBlade:
    """Elastic blades, fields (blades,)."""
    mass, damping, stiffness, shroud = map(matrix_rows, matrices)
    rows = tuple(row if parts.has(name, 0) else ZERO for name, row in zip(COORDINATES, shroud, strict=True))
    moving = [row for row in rows if not is_zero(row)]
    gram = inverse_of([times_vector(moving, row) for row in moving])
    lift = tuple(times_vector(gram, [row[j] for row in moving]) for j in range(len(mass)))
    I = 1 / dot(shroud[2], times_vector(inverse_of(mass), shroud[2])) if parts.has("theta", 0) else ZERO
    return ElasticBlade(mass, damping, stiffness, rows, lift, I)


def matrix_rows(matrix: Any) -> MatrixRows:
    """The entries of matrices (..., r, c)."""
    return tuple(tuple(matrix[..., i, j] for j in range(matrix.shape[-1])) for i in range(matrix.shape[-2]))


def inverse_of(matrix: Sequence[Sequence[Any]]) -> MatrixRows:
    """The inverse of a small symmetric matrix by Gauss-Jordan elimination, without calls of LAPACK."""
    n = len(matrix)
    left, right = [list(row) for row in matrix], [[float(i == j) for j in range(n)] for i in range(n)]
    for i in range(n):
        pivot = left[i][i]
        left[i], right[i] = [a / pivot for a in left[i]], [a / pivot for a in right[i]]
        for j in range(n):
            if j != i:
                factor = left[j][i]
                left[j] = [a - factor * b for a, b in zip(left[j], left[i], strict=True)]
                right[j] = [a - factor * b for a, b in zip(right[j], right[i], strict=True)]
    return tuple(map(tuple, right))


def dot(row: Sequence[Any], numbers: Sequence[Any]) -> Any:
    """The sum of the products of the entries of two vectors."""
    return summed(a * b for a, b in zip(row, numbers, strict=True))


def times_vector(matrix: Sequence[Sequence[Any]], numbers: Sequence[Any]) -> tuple[Any, ...]:
    """A matrix times a vector."""
    return tuple(dot(row, numbers) for row in matrix)
