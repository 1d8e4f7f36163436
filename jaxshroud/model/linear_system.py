"""Blades without contact as one linear system: mass, damping, stiffness and loads, and the response to them.

Coordinates are those of the shrouds, x of all N blades, then y, then theta. Blades act on each other by what couples
them beside their contact. A lumped blade is its shroud; one by modes is seen by the receptances of its shroud.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.coupling import SUFFIXES
from jaxshroud.model.geometry import Corners, contact_kinematics, face_kinematics, pose
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.drive import AnyLoad, ComplexLoad
from jaxshroud.scene.layout import COORDINATES, Layout
from jaxshroud.scene.modes import ModalBlades
from jaxshroud.scene.scene import Scene

RESONANCE_ROUNDINGS = 4  # rounding units between k and m omega^2 that count as none


class LinearSystem(NamedTuple):
    """Blades that do not touch, by arrays of NumPy or JAX, which may start with axes of lanes.

    There are D coordinates: the 3 N of the shrouds of lumped blades; or n N of blades by modes, the first of each
    blade, then the second and so on.
    """

    mass: Any  # (D,) [kg, kg m^2]; 1 of modes
    damping: Any  # (D, D)
    stiffness: Any  # (D, D)

    def dynamic(self, omega: Any) -> Any:
        """The load per displacement of one system at a circular frequency, (D, D) complex."""
        inertia = (self.mass * omega**2)[:, None] * np.eye(len(self.mass), dtype=self.mass.dtype)
        number = np.result_type(self.mass.dtype, np.complex64)
        return (self.stiffness - inertia).astype(number) + 1j * (omega * self.damping).astype(number)


def free_system(scene: Scene) -> LinearSystem:
    """The blades at the scene's speed with their mistuning, and what couples them beside contact."""
    modes = scene.mode_numbers
    shroud = shroud_map(scene)
    mass, damping, stiffness = _oscillators(scene)

    def total(own: Any, kind: str) -> Any:
        diagonal = own[..., None] * np.eye(own.shape[-1], dtype=own.dtype)
        if kind == "k" and modes is not None and modes.kappa:
            diagonal = diagonal + between_neighbours(scene.layout, modes.kappa, own.shape[:-1])
        if not scene.is_coupled:
            return diagonal
        between = coupling_matrix(scene, kind)
        return diagonal + (between if shroud is None else shroud.swapaxes(-1, -2) @ between @ shroud)

    return LinearSystem(mass, total(damping, "c"), total(stiffness, "k"))


def _oscillators(scene: Scene) -> Any:
    """The mass, damping and stiffness of each coordinate by itself, (..., D) each."""
    modes = scene.mode_numbers
    if modes is None:
        numbers = zip(*scene.mistuned_blades.oscillators.values(), strict=True)
    else:
        numbers = [a * 0 + 1 for a in modes.stiffness], modes.damping, modes.stiffness
    return tuple(a[0].__array_namespace__().concatenate(a, axis=-1) for a in numbers)


def moving_shapes(scene: Scene) -> Any:
    """The shapes (3, n, ..., blades) of blades by modes at their shrouds; 0 of coordinates that the model has not."""
    assert isinstance(scene.blades, ModalBlades)
    shapes = scene.blades.numbers().shapes
    xp = shapes[0][0].__array_namespace__()
    shapes = xp.stack([xp.stack(shape) for shape in shapes])
    moves = moving_coordinates(scene).reshape(3, *(1,) * (shapes.ndim - 2), -1)
    return shapes * moves.astype(shapes.dtype)


def shroud_map(scene: Scene) -> Any:
    """The map (..., 3 N, D) from the coordinates to those of the shrouds; None where they are those."""
    if scene.mode_numbers is None:
        return None
    shapes = moving_shapes(scene)
    xp = shapes.__array_namespace__()
    count = shapes.shape[-1]
    each = xp.moveaxis(shapes[..., None] * xp.eye(count, dtype=shapes.dtype), (0, 1), (-4, -2))
    return each.reshape(*each.shape[:-4], 3 * count, -1)


def shroud_statics(scene: Scene) -> tuple[Any, Any]:
    """The stiffness (..., 3 N, 3 N) of shrouds at rest, and all coordinates by their displacements, (..., D, 3 N).

    The numbers of the scene are arrays of NumPy. The map is None where coordinates are those of the shrouds.

    Raises:
        InputError: A blade is free to move as a whole.
    """
    stiffness = free_system(scene).stiffness
    shroud = shroud_map(scene)
    if shroud is None:
        return stiffness, None
    try:
        bent = np.linalg.solve(stiffness, shroud.swapaxes(-1, -2))
        own = np.linalg.inv(shroud @ bent + np.diag(1.0 - moving_coordinates(scene)))
    except np.linalg.LinAlgError:
        raise InputError("Blades with a mode of frequency 0 have no static position; start them in motion.") from None
    return own, bent @ own


def spring_stiffness(k: Any, stretch_q: Any) -> Any:
    """The stiffness (..., n, n) of springs (..., springs) by the gradients (springs, n) of their stretches."""
    return stretch_q.T @ (k[..., None] * stretch_q)


def coordinates_that_move(scene: Scene) -> np.ndarray:
    """Whether the model has each coordinate, (D,)."""
    modes = scene.mode_numbers
    if modes is None:
        return moving_coordinates(scene)
    return np.tile([scene.parts.has("x", min(i, 1)) for i in range(scene.layout.blades)], len(modes.stiffness))


def over_coordinates(a: Any, shroud: Any) -> Any:
    """Forces on the shrouds, or gradients by their coordinates, (..., 3 N) as those by the coordinates (..., D)."""
    return a if shroud is None else a @ shroud.astype(a.dtype)


def coupling_matrix(scene: Scene, kind: str) -> Any:
    """The stiffness ("k") or the damping ("c") between the blades of a scene, (..., 3 N, 3 N): of springs and flow."""
    numbers = [
        getattr(scene.coupling, f"{kind}_{suffix}") if scene.parts.has(name, 0) else None
        for name, suffix in SUFFIXES.items()
    ]
    springs = between_neighbours(scene.layout, numbers, scene.drive.omega.shape)
    return over_x(flow_matrix(scene, kind)) + springs


def between_neighbours(layout: Layout, numbers: Sequence[Any], lanes: tuple[int, ...]) -> Any:
    """The stiffness of springs between neighbours, a number (or None) at each interface of each coordinate."""
    apart = (np.eye(layout.blades) - next_blade(layout))[: layout.interfaces]  # left of each interface less right of it
    whole = 0.0
    for i, k in enumerate(numbers):
        if k is not None:
            D = np.kron(np.eye(len(numbers))[[i]], apart).astype(k.dtype)
            whole = whole + spring_stiffness(k.reshape(*lanes, -1), D)
    return whole


def flow_matrix(scene: Scene, kind: str) -> Any:
    """What the flow adds to the stiffness ("k") or the damping ("c") along x of all blades, (..., N, N).

    Source:
        Re L, and Im L over the frequency of the drive, as in `forces_of_flow`; it is not symmetric.
    """
    omega = scene.drive.omega
    after = next_blade(scene.layout)
    whole = 0 * omega[..., None, None] * np.zeros(after.shape, omega.dtype)
    for name, shift in (("L0", np.eye(len(after))), ("L1", after), ("L_1", after.T)):
        L = scene.aero.coefficient(name)
        if L is not None:
            force = L[0] if kind == "k" else L[1] / omega
            whole = whole + force[..., None, None] * shift.astype(omega.dtype)
    return whole


def over_x(matrix: Any) -> Any:
    """A matrix along x of all blades (..., N, N) as one over all coordinates, (..., 3 N, 3 N)."""
    along = np.eye(len(COORDINATES) * matrix.shape[-1], matrix.shape[-1], dtype=matrix.dtype)
    return along @ matrix @ along.T


def next_blade(layout: Layout) -> np.ndarray:
    """The matrix (blades, blades) that gives each blade the number of the next one; 0 at the end of a chain."""
    return np.roll(np.eye(layout.blades), 1, axis=1) * (np.arange(layout.blades) < layout.interfaces)[:, None]


def coordinates_at(layout: Layout) -> np.ndarray:
    """The places (interfaces, 6) of the coordinates of both blades at each interface among those of all blades."""
    left = np.arange(layout.interfaces)
    sides = left, (left + 1) % layout.blades
    return np.stack([row * layout.blades + side for row in range(3) for side in sides], axis=1)


def over_blades(by: Array, layout: Layout) -> Array:
    """Derivatives (interfaces, points, 6) by the coordinates at each interface as those by all, (..., 3 N)."""
    interface, point = np.ogrid[: by.shape[0], : by.shape[1]]
    at = interface[..., None], point[..., None], coordinates_at(layout)[:, None]
    return jnp.zeros((*by.shape[:2], 3 * layout.blades), by.dtype).at[at].set(by)


def contact_gradients(
    case: int | Int[Array, ""], block: Corners, like: Array
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """dv/dq and du/dq of the corner pair of `case`, q = (x_1, x_2, y_1, y_2, theta_1, theta_2) = 0, (6,).

    Where faces have several points they are those of each of them, (points, 6).
    """

    def v_and_u(q):
        place = pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5]))
        if block.points:
            points = face_kinematics(place, block).points
            return jnp.stack([at.v for at in points]), jnp.stack([at.u for at in points])
        at = contact_kinematics(place, jnp.asarray(case), block, frozenset())
        return at.v, at.u

    return jax.jacfwd(v_and_u)(jnp.zeros_like(like))


def moving_coordinates(scene: Scene) -> np.ndarray:
    """Whether the model has each coordinate, (3 N,)."""
    return np.array([scene.parts.has(name, min(i, 1)) for name in COORDINATES for i in range(scene.layout.blades)])


def complex_loads(scene: Scene, drive: AnyLoad) -> Complex[Array, "coordinates"]:
    """The complex amplitudes (3 N,) of the loads of one harmonic on the coordinates that move, as in Eq. (1)."""
    re, im = (jnp.concatenate(part) for part in zip(*map(drive.parts, COORDINATES), strict=True))
    moves = moving_coordinates(scene)
    return lax.complex(jnp.where(moves, re, 0.0), jnp.where(moves, im, 0.0))


def loads_on_coordinates(scene: Scene, drive: AnyLoad) -> Complex[Array, "coordinates"]:
    """The complex amplitudes (D,) of the loads of one harmonic on all coordinates, also those on modes themselves."""
    on_shroud = over_coordinates(complex_loads(scene, drive), shroud_map(scene))
    if not isinstance(drive, ComplexLoad) or not drive.modal:
        return on_shroud
    names = [f"Q{j}" for j in range(scene.coordinates)]
    re, im = (jnp.concatenate(part) for part in zip(*map(drive.parts, names), strict=True))
    return on_shroud + lax.complex(re, im)


def mean_loads(scene: Scene) -> Any:
    """The mean loads (..., 3 N) on the coordinates that move."""
    mean = scene.drive.harmonics().get(0)
    phase = scene.drive.phase
    xp = phase.__array_namespace__()
    parts = [0 * phase] * 3 if mean is None else [mean.load(name) for name in COORDINATES]
    return xp.where(moving_coordinates(scene), xp.concatenate(parts, axis=-1), 0.0)


def free_response(scene: Scene, omega: Scalar, drive: AnyLoad) -> Complex[Array, "3 blades"]:
    """The complex amplitudes of x, y and theta of blades that do not touch, under one harmonic.

    They are infinite at an undamped natural frequency, or not a number where blades are coupled.

    Source:
        [K - omega^2 M + i omega C]^-1 F, with the coupling in K and C: of a tuned ring under a travelling wave of nodal
        diameter h that is [D_h - omega^2 M + i omega C]^-1 F with
        D_h = K + 4 sin^2(pi h / N) K_c + L0 + L1 exp(i 2 pi h / N) + L_1 exp(-i 2 pi h / N).
    """
    q = _coordinates_under(scene, omega, drive)
    return q if scene.mode_numbers is None else jnp.einsum("amn,mn->an", moving_shapes(scene).astype(q.dtype), q)


def stress_response(scene: Scene, omega: Scalar, drive: AnyLoad) -> Complex[Array, " blades"]:
    """The complex amplitude of the stress of blades by modes under one harmonic, as `free_response` [Pa]."""
    modes = scene.mode_numbers
    assert modes is not None
    q = _coordinates_under(scene, omega, drive)
    return jnp.sum(jnp.stack(modes.sigma).astype(q.dtype) * q, axis=0)


def _coordinates_under(scene: Scene, omega: Scalar, drive: AnyLoad) -> Complex[Array, "coordinates blades"]:
    """The complex amplitudes of the coordinates of each blade under one harmonic."""
    load = loads_on_coordinates(scene, drive)
    modes = scene.mode_numbers
    if not scene.is_coupled and not (modes is not None and modes.kappa):
        q = _apart(omega, load, *_oscillators(scene))
        return q.reshape(-1, scene.layout.blades)
    dynamic = free_system(scene).dynamic(omega)
    if modes is not None:
        return solved(dynamic, load).reshape(-1, scene.layout.blades)
    moves = moving_coordinates(scene)
    held = jnp.where(moves[:, None] & moves, dynamic, np.eye(len(moves), dtype=dynamic.dtype))
    alone = np.split(np.arange(len(moves)), 3)  # x, y and theta do not act on each other
    return jnp.stack([solved(held[np.ix_(own, own)], load[own]) for own in alone])


def _apart(omega: Scalar, load: Any, mass: Any, damping: Any, stiffness: Any) -> Any:
    """The amplitudes of oscillators by themselves; a rigid motion has no static place."""
    detuning = stiffness - mass * omega**2
    loss = damping * omega
    # driven at its natural frequency, up to the rounding of numbers
    is_undamped = (loss == 0) & (jnp.abs(detuning) <= RESONANCE_ROUNDINGS * jnp.finfo(omega.dtype).eps * stiffness)
    unbounded = jnp.where((load == 0) | (omega == 0), 0.0, jnp.inf)
    return jnp.where(is_undamped, unbounded, load / jnp.where(is_undamped, 1.0, lax.complex(detuning, loss)))


def solved(matrix: Complex[Array, "n n"], right: Complex[Array, " n"]) -> Complex[Array, " n"]:
    """The solution of a linear system by Gauss-Jordan elimination with partial pivots.

    It calls no routine of LAPACK, which many lanes on several devices of a CPU may wait for without end.
    """
    n = len(right)

    def eliminate(i: Any, system: Array) -> Array:
        candidates = jnp.where(jnp.arange(n) >= i, jnp.abs(lax.stop_gradient(system[:, i])), -1.0)
        at = jnp.argmax(candidates)
        system = system.at[jnp.stack([jnp.asarray(i, at.dtype), at])].set(
            system[jnp.stack([at, jnp.asarray(i, at.dtype)])]
        )
        pivot = system[i] / system[i, i]
        others = jnp.where(jnp.arange(n) == i, 0.0, 1.0).astype(system.dtype) * system[:, i]
        return (system - others[:, None] * pivot[None]).at[i].set(pivot)

    return lax.fori_loop(0, n, eliminate, jnp.concatenate([matrix, right[:, None]], axis=1))[:, n]


def solutions(matrix: Any, right: Any) -> np.ndarray:
    """The solutions (..., n) of linear systems by LAPACK on the host; NaN where there is none."""
    matrix, right = np.asarray(matrix), np.asarray(right)
    usable = np.isfinite(matrix).all(axis=(-2, -1), keepdims=True)
    try:
        found = np.linalg.solve(np.where(usable, matrix, np.eye(matrix.shape[-1])), right[..., None])
    except np.linalg.LinAlgError:
        if matrix.ndim == 2:
            return np.full(right.shape, np.nan, right.dtype)
        return np.stack([solutions(*one) for one in zip(matrix, right, strict=True)])
    return np.where(usable, found, np.nan)[..., 0]


def rate_matrix(mass: Any, damping: Any, stiffness: Any) -> np.ndarray:
    """The matrix of the first-order system of places and their rates; directions without mass are left out."""
    own = np.flatnonzero(mass)
    size = len(own)
    K, C = (matrix[own[:, None], own] / mass[own, None] for matrix in (stiffness, damping))
    return np.block([[np.zeros((size, size)), np.eye(size)], [-K, -C]])


def directions(moves: np.ndarray, flat: np.ndarray, closed: bool) -> np.ndarray:
    """The directions in which blocks can move, as columns (lanes, 3 N, n), n coordinates move; 0 for one that is none.

    Blocks whose faces are flat on each other turn together, or not at all where one of them cannot.

    Args:
        moves: Whether the model has each coordinate, (3 N,).
        flat: Whether the faces of each interface are flat on each other, (lanes, interfaces).
        closed: Whether the last block touches the first.
    """
    n = len(moves) // 3
    lanes = len(flat)
    first = np.tile(np.arange(n), (lanes, 1))
    for _ in range(2 if closed else 1):
        for j in range(flat.shape[1]):
            right = (j + 1) % n
            low = np.minimum(first[:, j], first[:, right])
            high = np.maximum(first[:, j], first[:, right])
            joined = flat[:, j, None] & (first == high[:, None])
            first = np.where(joined, low[:, None], first)
    free = np.zeros((lanes, 3 * n, 3 * n))
    free[:, np.arange(2 * n), np.arange(2 * n)] = 1.0
    free[np.arange(lanes)[:, None], 2 * n + np.arange(n), 2 * n + first] = 1.0
    held = np.any(free * ~moves[:, None], axis=1, keepdims=True)
    return (free * ~held)[..., moves]


class ReducedSystem(NamedTuple):
    """A linear system over directions as columns of `free`, (..., 3 N, n); a direction that is none has a stiffness."""

    free: Any

    def over(self, a: Any) -> Any:
        """Forces (..., 3 N) over the directions."""
        return (a[..., None, :] @ self.free.astype(a.dtype))[..., 0, :]

    def reduced(self, matrix: Any) -> Any:
        """A matrix over the directions; 1 for one that is none."""
        idle = (abs(self.free).max(axis=-2) == 0).astype(self.free.dtype)
        return self.free.swapaxes(-1, -2) @ matrix @ self.free + idle[..., None] * np.eye(
            idle.shape[-1], dtype=idle.dtype
        )

    def system(self, whole: LinearSystem) -> LinearSystem:
        """A system over the directions."""
        damping = self.over(self.free.swapaxes(-1, -2) @ whole.damping)
        return LinearSystem(self.diagonal(whole.mass), damping, self.reduced(whole.stiffness))

    def diagonal(self, numbers: Any) -> Any:
        """A diagonal matrix over the directions, which are orthogonal."""
        return self.free.swapaxes(-1, -2) ** 2 @ numbers

    def expanded(self, y: Any) -> Any:
        """The displacements (..., 3 N) from those along the directions."""
        return (self.free.astype(y.dtype) @ y[..., None])[..., 0]
