"""The natural modes of the blades: Eq. (1) linearised, with the springs of contact engaged or not, at any speed.

Coordinates are q = (x_1, x_2, y_1, y_2, theta_1, theta_2), as in `contact_gradients`; of N blades, those of x of all
blades, then y, then theta. All interfaces of a row are in the same state of contact. Contact is looked at where it
begins: the blocks at their unloaded angles, corner at corner, without preload. Blades have their stiffness at the
scene's speed. Over the speed of a rotor it grows with the square of the speed, see `Growth`:

    K(Omega) = K_0 + Omega^2 diag(B) M

An engine order e meets a natural frequency where omega = e Omega, so that Omega^2 is an eigenvalue of
(K_0 + K_c) phi = Omega^2 (e^2 M - diag(B) M) phi: exact, with none where e^2 <= B for all that moves.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.activity import counted
from jaxshroud.linear.equilibrium import PRESSED, friction_free, meets_at_corners
from jaxshroud.linear.held_contact import sprung
from jaxshroud.linear.resting_contact import resting_contact_of
from jaxshroud.model.linear_system import (
    LinearSystem,
    ReducedSystem,
    coordinates_that_move,
    directions,
    free_system,
    loads_on_coordinates,
    over_coordinates,
    shroud_map,
)
from jaxshroud.model.modes import Mode
from jaxshroud.scene.scene import Scene, Shroud
from jaxshroud.scene.typed import FloatArray

# How the blocks touch: not at all; face on face with the normal spring alone, or with both; corner at corner with both.
NaturalContact = Literal["apart", "sliding", "stuck", "corner"]
TINY = float(np.finfo(float).tiny)  # a square that rounding made negative, or a drive without force
UPPER_CORNERS = 1  # the case whose corners are looked at


class LinearContact(NamedTuple):
    """All blades and the contact between them as one linear system, with arrays of NumPy or of JAX.

    Its D coordinates are those of a `LinearSystem`.
    """

    free: LinearSystem  # without contact
    moves: np.ndarray  # (D,) whether the model has that coordinate
    sliding: Any  # (D, D) what contact without friction adds to the stiffness
    stuck: Any  # (D, D) what it adds where the faces stick
    turns_as_one: np.ndarray  # () whether blocks whose faces touch turn together: those of several points need not
    shroud: Any  # (3 N, D), see `shroud_map`
    shroud_mass: Any  # (3 N,) of the shrouds, or of lumped blades that stand for blades by modes [kg, kg m^2]

    def directions(self, contact: NaturalContact) -> FloatArray:
        """The directions in which the blocks can move in one state of contact, as columns."""
        as_one = bool(self.turns_as_one) and contact in ("sliding", "stuck")
        if self.shroud is None:
            return free_directions(self.moves, as_one)
        own = np.eye(len(self.moves))[:, self.moves]
        return own @ _turning_as_one(np.asarray(self.shroud) @ own) if as_one else own

    def system_in(self, contact: NaturalContact) -> LinearSystem:
        """The blades in one state of contact.

        Faces that stay on each other turn all blocks by one angle; where they have several points, each has its share
        of the springs, which resist a turn against each other.
        """
        if contact == "apart":
            return self.free
        of_contact = self.sliding if contact == "sliding" else self.stuck
        return self.free._replace(stiffness=self.free.stiffness + of_contact)

    def shroud_motion(self, shape: Any) -> Any:
        """The displacements (..., 3 N) of the shrouds from those of the coordinates."""
        return shape if self.shroud is None else shape @ self.shroud.T


class NaturalModes(NamedTuple):
    """Undamped natural modes, the lowest frequency first."""

    omega: FloatArray  # (n,) natural circular frequency [rad/s]
    zeta: FloatArray  # (n,) damping ratio, to first order in the damping
    shape: FloatArray  # (n, 3 N) normalised by the masses


def linear_contact(scene: Scene) -> LinearContact:
    """All blades of a scene, with their mistuning, and their contact as a linear system, with arrays of JAX.

    Contact is where the upper corners meet without a gap, or at all points of the faces.
    """
    shroud = shroud_map(scene)
    sliding, stuck = _stiffnesses_of_contact(scene)
    return LinearContact(
        free=free_system(scene),
        moves=coordinates_that_move(scene),
        sliding=over_coordinates(over_coordinates(sliding, shroud).T, shroud).T,
        stuck=over_coordinates(over_coordinates(stuck, shroud).T, shroud).T,
        turns_as_one=np.array(meets_at_corners(scene)),
        shroud=shroud,
        shroud_mass=jnp.concatenate([mass for mass, _, _ in scene.resting_blades.oscillators.values()]),
    )


def _stiffnesses_of_contact(scene: Scene) -> Any:
    """What contact adds to the stiffness of the shrouds where faces slide, and where they stick, (2, 3 N, 3 N).

    Source:
        The derivative of the forces of Eq. (1) where faces meet without a force: along x and y k n n' + k_d t t' on the
        relative displacement, with n = (sin alpha, -cos alpha) and t = (cos alpha, sin alpha).
    """
    s = scene.shroud
    closed = Shroud(s.alpha, s.l_oa, s.l_ab, 0 * s.gap)
    touching = eqx.tree_at(lambda scene: scene.shroud, friction_free(sprung(scene)), closed)
    layout = scene.layout
    case = jnp.full(layout.interfaces, UPPER_CORNERS, jnp.int32)
    q = jnp.zeros((3, layout.blades), scene.drive.omega.dtype)

    def stiffness(mode: Any) -> Any:
        modes = jnp.full((layout.interfaces, max(scene.points, 1)), mode)
        return -resting_contact_of(touching, q, modes, case, None).load_q

    return jax.vmap(stiffness)(jnp.array([PRESSED, Mode.STICK], jnp.int32))


def _turning_as_one(shroud: FloatArray) -> FloatArray:
    """The directions, orthonormal columns, in which all shrouds turn by one angle, or none where one cannot.

    Args:
        shroud: The map from coordinates to x, y and theta of all shrouds (3 N, D).
    """
    theta = shroud[2 * len(shroud) // 3 :]
    unlike = np.diff(theta, axis=0) if np.all(np.any(theta != 0, axis=1)) else theta
    _, values, rows = np.linalg.svd(unlike)
    return rows[np.sum(values > TINY) :].T


def drive_loads(scene: Scene) -> dict[int, Any]:
    """The complex amplitudes (D,) of the forces and moments on the coordinates, as in Eq. (1), by order n > 0."""
    return {n: loads_on_coordinates(scene, one) for n, one in scene.drive.harmonics().items() if n > 0}


def natural_modes(blades: LinearContact, contact: NaturalContact) -> NaturalModes:
    """The modes of all blades in one state of contact, from arrays of NumPy.

    Forces of the flow that are not symmetric count by their symmetric part; see `flow_modes` for all of them.
    """
    free = blades.directions(contact)
    root, K = _by_mass(blades, contact, free)
    squares, vectors = np.linalg.eigh(K)
    omega = np.sqrt(np.maximum(squares, TINY))
    shape = (free @ (vectors / root[:, None])).T
    damping = np.einsum("ni,ij,nj->n", shape, blades.free.damping, shape)
    return NaturalModes(omega, damping / (2 * omega), shape)


def _by_mass(blades: LinearContact, contact: NaturalContact, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The roots of the masses along directions, and the symmetric stiffness over these."""
    mass, _, K = ReducedSystem(free).system(blades.system_in(contact))
    root = np.sqrt(mass)
    return root, (K + K.T) / 2 / np.outer(root, root)


def free_directions(moves: np.ndarray, as_one: bool) -> FloatArray:
    """The directions in which the blocks can move, as columns; those of all blocks may turn `as_one`."""
    free = directions(moves, np.full((1, len(moves) // 3 - 1), as_one), False)[0]
    return free[:, free.any(axis=0)]


def drive_shares(shape: FloatArray, loads: Sequence[np.ndarray]) -> FloatArray:
    """The share of the drive that works on each mode (n,): |shape . load|^2 over the sum for all modes.

    Args:
        shape: The modes (n, 3 N), normalised by the masses.
        loads: The complex amplitudes (3 N,) of the forces and moments of each harmonic of the drive.
    """
    squares = np.sum([np.abs(shape @ load) ** 2 for load in loads], axis=0)
    return squares / max(float(squares.sum()), TINY)


class Growth(NamedTuple):
    """How the stiffness of all blades grows, and the speed at which they have that of a `LinearContact`."""

    by_square: FloatArray  # (3 N,) B times the mass of each coordinate
    square: float  # Omega^2 [rad^2/s^2]


class _Oscillators(NamedTuple):
    """All that moves in one state of contact, in coordinates in which its mass is 1."""

    at_rest: FloatArray  # (n, n) stiffness
    growth: FloatArray  # (n, n) its growth by Omega^2
    square: float  # Omega^2 of the scene's own speed

    def modes(self, square: float) -> tuple[FloatArray, FloatArray]:
        """The squares of the natural frequencies at a speed, the lowest first, and the modes, in columns."""
        squares, vectors = np.linalg.eigh(self.at_rest + square * self.growth)
        return squares, vectors


def _oscillators(blades: LinearContact, contact: NaturalContact, growth: Growth) -> _Oscillators:
    free = blades.directions(contact)
    root, own = _by_mass(blades, contact, free)
    grown = free.T @ np.diag(growth.by_square) @ free / np.outer(root, root)
    return _Oscillators(own - growth.square * grown, grown, growth.square)


def speed_curves(blades: LinearContact, contact: NaturalContact, growth: Growth, squares: FloatArray) -> FloatArray:
    """The natural frequencies [rad/s] of each mode at speeds, (modes, speeds); modes are followed by their shapes.

    Args:
        blades: The blades at the scene's own speed.
        contact: The state of contact.
        growth: How their stiffness grows.
        squares: The squares of the speeds (speeds,), increasing [rad^2/s^2].
    """
    of = _oscillators(blades, contact, growth)
    found = np.empty((len(of.at_rest), len(squares)))
    with counted(f"speeds of blades that are {contact}", len(squares)) as count:
        for places in (np.flatnonzero(squares >= of.square), np.flatnonzero(squares < of.square)[::-1]):
            shapes = of.modes(of.square)[1]
            for i in places:
                values, vectors = of.modes(float(squares[i]))
                order = _matching(shapes, vectors)
                shapes = vectors[:, order]
                found[:, i] = np.sqrt(np.maximum(values[order], 0.0))
                count(1)
    return found


def order_crossings(
    blades: LinearContact, contact: NaturalContact, growth: Growth, orders: Sequence[float]
) -> FloatArray:
    """The speeds at which engine orders meet each mode, (modes, orders) [rad/s]; NaN where one does at none."""
    of = _oscillators(blades, contact, growth)
    root = np.linalg.cholesky(of.at_rest)
    modes = of.modes(of.square)[1]

    def crossed_by(order: float) -> FloatArray:
        half = np.linalg.solve(root, order**2 * np.eye(len(root)) - of.growth)
        inverse_squares, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
        shapes = np.linalg.solve(root.T, vectors)
        shapes = shapes / np.linalg.norm(shapes, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            speeds = 1 / np.sqrt(inverse_squares)
        return np.where(inverse_squares > 0, speeds, np.nan)[_matching(modes, shapes)]

    return np.stack([crossed_by(order) for order in orders], axis=-1)


def _matching(modes: FloatArray, others: FloatArray) -> np.ndarray:
    """Which of the `others` is each of the modes, both in columns: those whose shapes agree best."""
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(-((modes.T @ others) ** 2))[1]
