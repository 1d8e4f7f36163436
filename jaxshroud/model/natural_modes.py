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

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.activity import counted
from jaxshroud.model.coupling import (
    CouplingMatrices,
    coupling_matrices,
    over_coordinates,
)
from jaxshroud.model.geometry import Corners, contact_kinematics, face_kinematics, pose
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.drive import AnyLoad
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray

# How the blocks touch: not at all; face on face with the normal spring alone, or with both; corner at corner with both.
NaturalContact = Literal["apart", "sliding", "stuck", "corner"]
TINY = float(np.finfo(float).tiny)  # a square that rounding made negative, or a drive without force
POINTS_OF_RANGE = 65  # speeds at which it is looked whether faces are pressed together
HALVINGS = 60


class LinearContact(NamedTuple):
    """All blades and the contact between them as one linear system, with arrays of NumPy or of JAX."""

    mass: Any  # (3 N,) [kg, kg m^2]
    damping: Any  # (3 N,)
    stiffness: Any  # (3 N,)
    moves: np.ndarray  # (3 N,) whether the model has that coordinate
    v_q: Any  # (E, 3 N) gradient of the penetration of the upper corners of each interface, or of each of its points
    u_q: Any  # (E, 3 N) gradient of their slide
    k: Any  # (E,) normal spring [N/m]
    k_d: Any  # (E,) tangential spring [N/m]
    turns_as_one: np.ndarray  # () whether blocks whose faces touch turn together: those of several points need not
    coupled: CouplingMatrices | None = None  # (3 N, 3 N) each, between blades without contact

    @property
    def own_stiffness(self) -> Any:
        """The stiffness of all blades without contact, (3 N, 3 N)."""
        own = self.stiffness[:, None] * np.eye(len(self.stiffness), dtype=self.stiffness.dtype)
        return own if self.coupled is None else own + self.coupled.stiffness

    @property
    def own_damping(self) -> Any:
        """The damping of all blades, (3 N, 3 N)."""
        own = self.damping[:, None] * np.eye(len(self.damping), dtype=self.damping.dtype)
        return own if self.coupled is None else own + self.coupled.damping


class NaturalModes(NamedTuple):
    """Undamped natural modes, the lowest frequency first."""

    omega: FloatArray  # (n,) natural circular frequency [rad/s]
    zeta: FloatArray  # (n,) damping ratio, to first order in the damping
    shape: FloatArray  # (n, 3 N) normalised by the masses


def contact_gradients(
    case: int | Int[Array, ""], block: Corners, like: Array
) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """dv/dq and du/dq of the corner pair of `case`, q = (x_1, x_2, y_1, y_2, theta_1, theta_2) = 0."""

    def v_and_u(q):
        at = contact_kinematics(pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5])), jnp.asarray(case), block, frozenset())
        return jnp.stack([at.v, at.u])

    v_q, u_q = jax.jacfwd(v_and_u)(jnp.zeros_like(like))
    return v_q, u_q


def point_gradients(block: Corners, like: Array) -> tuple[Float[Array, "points 6"], Float[Array, "points 6"]]:
    """dv/dq and du/dq at each point of faces that touch at several, see `contact_gradients`."""

    def v_and_u(q):
        at = face_kinematics(pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5])), block)
        return jnp.stack([jnp.stack([point.v for point in at.points]), jnp.stack([point.u for point in at.points])])

    v_q, u_q = jax.jacfwd(v_and_u)(jnp.zeros_like(like))
    return v_q, u_q


def linear_contact(scene: Scene, gradients: Any) -> LinearContact:
    """All blades of a scene and their contact as a linear system, with arrays of JAX.

    Args:
        scene: A pair or a row, with its mistuning.
        gradients: dv/dq and du/dq of a pair where the upper corners meet, see `contact_gradients`, or of each point.
    """
    if scene.blade_matrices is not None:
        raise InputError("Natural modes with contact are those of lumped blades so far, not of blades by matrices.")
    b, count = scene.mistuned_blades, scene.blades.m.shape[-1]
    points, interfaces = scene.contact.points, scene.layout.interfaces

    def of_each(k):
        return jnp.atleast_1d(k) if points is None else jnp.outer(jnp.atleast_1d(k), points.shares).ravel()

    def at_interfaces(gradient):
        return jnp.stack([_at_interface(own, j, count) for j in range(interfaces) for own in jnp.atleast_2d(gradient)])

    return LinearContact(
        mass=jnp.concatenate([b.m, b.inertia_y, b.I]),
        damping=jnp.concatenate([b.c_x, b.c_y, b.c_T]),
        stiffness=jnp.concatenate([b.k_x, b.k_y, b.k_T]),
        moves=np.array([scene.parts.has(name, min(i, 1)) for name in COORDINATES for i in range(count)]),
        v_q=at_interfaces(gradients[0]),
        u_q=at_interfaces(gradients[1]),
        k=of_each(scene.k),
        k_d=of_each(scene.friction.k_d),
        turns_as_one=np.array(points is None),
        coupled=_coupled(scene) if scene.is_coupled else None,
    )


def _coupled(scene: Scene) -> CouplingMatrices:
    """The matrices between blades over all coordinates."""
    return CouplingMatrices._make(map(over_coordinates, coupling_matrices(scene)))


def _at_interface(gradient: Any, j: int, count: int) -> Any:
    """The gradient of a pair (6,) as that of interface `j` of so many blades, (3 count,)."""
    sides = np.array([j, (j + 1) % count])
    return jnp.zeros((3, count), gradient.dtype).at[:, sides].add(gradient.reshape(3, 2)).ravel()


def drive_loads(scene: Scene) -> dict[int, tuple[Any, Any]]:
    """The in-phase and the quadrature amplitude (3 N,) of the forces and moments, as in Eq. (1), by order n > 0."""
    return {n: _load(one) for n, one in scene.drive.harmonics().items() if n > 0}


def _load(drive: AnyLoad) -> tuple[Any, Any]:
    re, im, _ = zip(*map(drive.parts, COORDINATES), strict=True)
    return jnp.concatenate(re), jnp.concatenate(im)


def contact_stiffness(blades: LinearContact, contact: NaturalContact) -> Any:
    """What one state of contact adds to the stiffness of all blades, (3 N, 3 N).

    Source:
        With w = v for the normal spring and w = u for the tangential one, contact adds k w_q w_q' to the stiffness of
        Eq. (1): along x and y that is k n n' + k_d t t' on the relative displacement, with n = (sin alpha, -cos alpha)
        and t = (cos alpha, sin alpha). Faces that stay on each other turn all blocks by one angle; where they have
        several points, each has its share of the springs, which resist a turn against each other.
    """
    K = 0 * blades.v_q.T @ blades.v_q
    if contact != "apart":
        K = K + blades.v_q.T @ (blades.k[:, None] * blades.v_q)
    if contact in ("stuck", "corner"):
        K = K + blades.u_q.T @ (blades.k_d[:, None] * blades.u_q)
    return K


def natural_modes(blades: LinearContact, contact: NaturalContact) -> NaturalModes:
    """The modes of all blades in one state of contact, from arrays of NumPy.

    Forces of the flow that are not symmetric count by their symmetric part; see `flow_modes` for all of them.
    """
    K = blades.own_stiffness + contact_stiffness(blades, contact)
    K, free = (K + K.T) / 2, free_directions(blades.moves, contact, bool(blades.turns_as_one))
    root = np.sqrt(free.T**2 @ blades.mass)
    squares, vectors = np.linalg.eigh(free.T @ K @ free / np.outer(root, root))
    omega, shape = np.sqrt(np.maximum(squares, TINY)), (free @ (vectors / root[:, None])).T
    damping = np.einsum("ni,ij,nj->n", shape, blades.own_damping, shape)
    return NaturalModes(omega, damping / (2 * omega), shape)


def free_directions(moves: np.ndarray, contact: NaturalContact, turns_as_one: bool = True) -> FloatArray:
    """The directions in which the blocks can move, as columns; blocks whose faces touch may turn as one."""
    columns, turns = np.eye(moves.size), moves.size // 3 * 2  # the first coordinate of rotation
    if turns_as_one and contact in ("sliding", "stuck"):
        columns = np.column_stack([columns[:, :turns], columns[:, turns:].sum(axis=1)])
        moves = np.append(moves[:turns], moves[turns:].all())
    return columns[:, moves]


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
    free = free_directions(blades.moves, contact, bool(blades.turns_as_one))
    root = np.sqrt(free.T**2 @ blades.mass)

    def reduced(K):
        return free.T @ K @ free / np.outer(root, root)

    grown = reduced(np.diag(growth.by_square))
    K = blades.own_stiffness + contact_stiffness(blades, contact)
    own = reduced((K + K.T) / 2)
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
                shapes, found[:, i] = vectors[:, order], np.sqrt(np.maximum(values[order], 0.0))
                count(1)
    return found


def order_crossings(blades: LinearContact, contact: NaturalContact, growth: Growth, order: float) -> FloatArray:
    """The speed at which an engine order meets each mode, (modes,) [rad/s]; NaN where it does at none."""
    of = _oscillators(blades, contact, growth)
    root = np.linalg.cholesky(of.at_rest)
    half = np.linalg.solve(root, order**2 * np.eye(len(root)) - of.growth)
    inverse_squares, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
    shapes = np.linalg.solve(root.T, vectors)
    shapes = shapes / np.linalg.norm(shapes, axis=0)
    matching = _matching(of.modes(of.square)[1], shapes)
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = 1 / np.sqrt(inverse_squares)
    return np.where(inverse_squares > 0, speeds, np.nan)[matching]


def _matching(modes: FloatArray, others: FloatArray) -> np.ndarray:
    """Which of the `others` is each of the modes, both in columns: those whose shapes agree best."""
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(-((modes.T @ others) ** 2))[1]


class Pressing(NamedTuple):
    """What presses the faces of all blades together at rest, as a linear function of Omega^2."""

    mean: FloatArray  # (3 N,) mean loads [N, N m]
    gap: FloatArray  # (E,) at rest [m]
    gap_by_square: FloatArray  # (E,) its growth by Omega^2
    sine: float  # of the angle of the faces


def static_normal_forces(blades: LinearContact, growth: Growth, by: Pressing, square: float) -> FloatArray:
    """The normal force at each interface (E,) at rest, where all faces are held together; negative: they come apart.

    The faces are on each other and slide freely: where the normal force vanishes so does friction.
    """
    free = free_directions(blades.moves, "sliding", bool(blades.turns_as_one))
    wedge = (by.gap + square * by.gap_by_square) * by.sine
    v_q, k = blades.v_q, blades.k
    grown = np.diag((square - growth.square) * growth.by_square)
    stiffness = blades.own_stiffness + grown + v_q.T @ (k[:, None] * v_q)
    loads = by.mean * blades.moves + v_q.T @ (k * wedge)
    q = free @ np.linalg.solve(free.T @ stiffness @ free, free.T @ loads)
    return k * (v_q @ q - wedge)


def pressed_ranges(
    blades: LinearContact, growth: Growth, by: Pressing, start: float, stop: float
) -> list[tuple[float, float]]:
    """The ranges of speeds [rad/s] in which all faces are pressed together at rest, from `start` to `stop`."""

    def least(speed):
        return float(np.min(static_normal_forces(blades, growth, by, speed**2)))

    speeds, pressed = np.linspace(start, stop, POINTS_OF_RANGE), np.zeros(POINTS_OF_RANGE, bool)
    with counted("speeds at which faces are pressed", POINTS_OF_RANGE) as count:
        for i, speed in enumerate(speeds):
            pressed[i] = least(speed) > 0
            count(1)
    changes = np.flatnonzero(pressed[1:] != pressed[:-1])
    ends = [_change_of_sign(least, float(speeds[i]), float(speeds[i + 1])) for i in changes]
    ends = [*([start] if pressed[0] else []), *ends, *([stop] if pressed[-1] else [])]
    return list(zip(ends[::2], ends[1::2], strict=True))


def _change_of_sign(f, low: float, high: float) -> float:
    """Where a function that has different signs at two places passes from one to the other, by bisection."""
    rises = f(low) <= 0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if (f(middle) > 0) == rises:
            high = middle
        else:
            low = middle
    return (low + high) / 2
