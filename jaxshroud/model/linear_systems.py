"""The steady response of blades as one linear system.

Blades act on each other by their coupling alone, where they do not touch, or by contact that stays in one state at all
interfaces of a row.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

from jaxshroud.cache.programs import kept
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.blade import inverse_of, matrix_rows, times_vector
from jaxshroud.model.coupling import coupling_matrices
from jaxshroud.model.geometry import corners
from jaxshroud.model.natural_modes import (
    NaturalContact,
    contact_gradients,
    contact_stiffness,
    drive_loads,
    free_directions,
    linear_contact,
    point_gradients,
)
from jaxshroud.scene.drive import AnyLoad
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene

UPPER_CORNERS = 1  # the case whose corners are looked at
OfCoordinates = tuple[Complex[Array, "blades"], Complex[Array, "blades"], Complex[Array, "blades"]]


def coupled_response(scene: Scene, omega: Scalar, drive: AnyLoad) -> OfCoordinates:
    """The complex amplitudes of x, y and theta of all blades under one harmonic.

    They are infinite or not a number where an undamped row is driven at a natural frequency.

    Source:
        [K + K_c - omega^2 M + i omega (C + C_c)]^-1 F, with the matrices of `coupling_matrices`: of a tuned ring under
        a travelling wave of nodal diameter h that is [D_h - omega^2 M + i omega C]^-1 F with
        D_h = K + 4 sin^2(pi h / N) K_c + L0 + L1 exp(i 2 pi h / N) + L_1 exp(-i 2 pi h / N).
    """
    force = [_complex_load(scene, name, drive) for name in COORDINATES]
    between = coupling_matrices(scene)
    dynamic = [lax.complex(k, omega * c) for k, c in zip(between.stiffness, between.damping, strict=True)]
    if scene.blade_matrices is None:
        return _of_lumped_blades(scene, omega, dynamic, force)
    return _of_elastic_blades(scene, omega, dynamic, force)


def _complex_load(scene: Scene, name: str, drive: AnyLoad) -> Complex[Array, "blades"]:
    load = drive.parts(name, lambda part: jnp.where(_moves(scene, name), part, 0.0))
    return lax.complex(load.re, load.im)


def _moves(scene: Scene, name: str) -> Array:
    return jnp.array([scene.parts.has(name, min(i, 1)) for i in range(scene.layout.blades)])


def _of_lumped_blades(scene: Scene, omega: Scalar, between: list[Any], force: list[Any]) -> OfCoordinates:
    """Coordinate by coordinate, as lumped blades have them apart."""
    b = scene.mistuned_blades
    own = ((b.m, b.c_x, b.k_x), (b.inertia_y, b.c_y, b.k_y), (b.I, b.c_T, b.k_T))
    found = []
    for name, (m, c, k), coupled, load in zip(COORDINATES, own, between, force, strict=True):
        moves = _moves(scene, name)
        dynamic = jnp.diag(lax.complex(k - m * omega**2, c * omega)) + coupled
        held = jnp.where(moves[:, None] & moves[None], dynamic, jnp.eye(len(moves), dtype=dynamic.dtype))
        found.append(solved(held, load))
    x, y, theta = found
    return x, y, theta


def _of_elastic_blades(scene: Scene, omega: Scalar, between: list[Any], force: list[Any]) -> OfCoordinates:
    """By the receptances H of the free shrouds: u = H (F - D_c u)."""
    assert scene.blade_matrices is not None
    count = scene.layout.blades
    mass, damping, stiffness, shroud = map(matrix_rows, scene.blade_matrices)
    size = range(len(mass))
    inverse = inverse_of(
        [[lax.complex(stiffness[i][j] - mass[i][j] * omega**2, damping[i][j] * omega) for j in size] for i in size]
    )
    none = jnp.zeros_like(force[0])
    moving = [scene.parts.has(name, 0) for name in COORDINATES]

    def as_complex(a):
        return lax.complex(a, jnp.zeros_like(a))

    rows = [[as_complex(a) if moves else none for a in row] for moves, row in zip(moving, shroud, strict=True)]
    H = [times_vector(rows, times_vector(inverse, column)) for column in rows]  # H[b][a]: of a by a force along b
    blocks = [[jnp.diag(H[b][a]) for b in range(3)] for a in range(3)]
    receptance = jnp.block(blocks)
    coupled = jnp.zeros_like(receptance)
    for a, own in enumerate(between):
        coupled = coupled.at[a * count : (a + 1) * count, a * count : (a + 1) * count].set(own)
    system = jnp.eye(3 * count, dtype=receptance.dtype) + receptance @ coupled
    x, y, theta = solved(system, receptance @ jnp.concatenate(force)).reshape(3, count)
    return x, y, theta


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


def touching_gradients(scene: Scene) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """dv/dq and du/dq of a pair, or at any interface of a row, where the upper corners meet without a gap, (6,).

    Where faces have several points they are those of each of them, (points, 6).
    """
    block, like = corners(scene.shroud, scene.contact.reading, scene.contact.points), [scene.blades.m[:2]] * 3
    touching = block._replace(gap=jnp.zeros_like(scene.shroud.alpha))
    if touching.points:
        return point_gradients(touching, jnp.concatenate(like))
    return contact_gradients(UPPER_CORNERS, touching, jnp.concatenate(like))


class LinearSystem(NamedTuple):
    """A row as one linear system in the n directions in which its blocks can move; arrays start with axes of lanes."""

    stiffness: Any  # (n, n) without mistuning
    damping: Any  # (n, n)
    mass: Any  # (n,)
    mistuned: Any  # (n, blades) what the mistuning of a blade adds to the diagonal of the stiffness
    omega: Any  # () frequency of the drive
    loads: dict[int, tuple[Any, Any]]  # (n,) in phase and in quadrature, by order
    coordinate: Any  # (blades, n) the displacements that are asked for


@kept("contact", "coordinate")
def linear_systems(scenes: Scene, contact: NaturalContact, coordinate: int) -> LinearSystem:
    """Rows without mistuning (leading axis) with all interfaces in one state of contact, as linear systems.

    Args:
        scenes: The rows.
        contact: The state of contact.
        coordinate: The displacements that are asked for: x, y or theta, 0 to 2.

    Source:
        Eq. (1) with the stiffness K of the blades, of their coupling, and of `contact_stiffness`. Preload, offsets of
        sliders and mean displacements are not in it. Mistuning does not change how stiffnesses grow with the speed.
    """

    def one(scene: Scene) -> LinearSystem:
        system, b = linear_contact(scene, touching_gradients(scene)), scene.blades
        free = jnp.asarray(free_directions(system.moves, contact, scene.contact.points is None), b.m.dtype)
        each = jnp.tile(jnp.eye(b.m.shape[-1], dtype=b.m.dtype), (3, 1))
        own = jnp.concatenate([b.k_x, b.k_y, b.k_T])
        return LinearSystem(
            stiffness=free.T @ (contact_stiffness(system, contact) + system.own_stiffness) @ free,
            damping=free.T @ system.own_damping @ free,
            mass=system.mass @ free**2,  # no coordinate is in two directions
            mistuned=(free**2).T @ (own[:, None] * each),
            omega=scene.drive.omega,
            loads={n: (in_phase @ free, quadrature @ free) for n, (in_phase, quadrature) in drive_loads(scene).items()},
            coordinate=free.reshape(3, b.m.shape[-1], -1)[coordinate],
        )

    return jax.vmap(one)(scenes)


def moving_directions(systems: LinearSystem) -> np.ndarray:
    """Whether each direction (n,) acts on the displacements that are asked for, in any of some systems (leading axis).

    Blades that do not touch have coordinates that do not act on each other.
    """
    linked = np.any((systems.stiffness != 0) | (systems.damping != 0), axis=0)
    wanted: np.ndarray = np.any(systems.coordinate != 0, axis=(0, 1))
    for _ in wanted:
        wanted = wanted | linked[wanted].any(axis=0) | linked[:, wanted].any(axis=1)
    return wanted


def part_of(systems: LinearSystem, directions: np.ndarray) -> LinearSystem:
    """Systems (leading axis) in some of their directions, on which the others do not act."""
    return systems._replace(
        stiffness=systems.stiffness[:, directions][..., directions],
        damping=systems.damping[:, directions][..., directions],
        mass=systems.mass[:, directions],
        mistuned=systems.mistuned[:, directions],
        loads={n: (re[:, directions], im[:, directions]) for n, (re, im) in systems.loads.items()},
        coordinate=systems.coordinate[..., directions],
    )


def linear_waves(system: LinearSystem, mistuning: np.ndarray) -> dict[int, np.ndarray]:
    """The complex amplitudes of the displacements of rows with patterns of mistuning (..., blades), by order.

    They are (K - n^2 omega^2 M + i n omega C)^-1 Q. Leading axes of the systems and of the patterns broadcast.
    """
    return {n: _of_blades(system, _answer(system, mistuning, n)) for n in system.loads}


def wave_slopes(system: LinearSystem, mistuning: np.ndarray, blade: int) -> dict[int, np.ndarray]:
    """The derivatives of the complex amplitudes of one blade of a row by the mistuning of each blade, by order.

    Source:
        The derivative of Z^-1 Q is -Z^-1 (dZ) Z^-1 Q, where Z changes on its diagonal alone.
    """
    slopes = {}
    for n in system.loads:
        adjoint = np.linalg.solve(_dynamic_stiffness(system, mistuning, n).T, system.coordinate[blade])
        slopes[n] = -(adjoint * _answer(system, mistuning, n)) @ system.mistuned
    return slopes


def _dynamic_stiffness(system: LinearSystem, mistuning: np.ndarray, order: int) -> np.ndarray:
    omega = order * np.asarray(system.omega)[..., None]
    own = (system.mistuned @ mistuning[..., None])[..., 0] - omega**2 * system.mass
    matrix = system.stiffness + 1j * omega[..., None] * system.damping
    matrix = np.array(np.broadcast_to(matrix, (*own.shape, own.shape[-1])))
    place = np.arange(own.shape[-1])
    matrix[..., place, place] += own
    return matrix


def _answer(system: LinearSystem, mistuning: np.ndarray, order: int) -> np.ndarray:
    """The complex amplitudes along the directions."""
    matrix, (in_phase, quadrature) = _dynamic_stiffness(system, mistuning, order), system.loads[order]
    load = np.broadcast_to(in_phase + 1j * quadrature, matrix.shape[:-1])
    return np.linalg.solve(matrix, load[..., None])[..., 0]


def _of_blades(system: LinearSystem, answer: np.ndarray) -> np.ndarray:
    return (system.coordinate @ answer[..., None])[..., 0]
