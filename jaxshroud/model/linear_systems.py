"""The steady response of blades as one linear system.

Blades act on each other by their coupling alone, where they do not touch, or by contact that stays in one state at all
interfaces of a row: then it is the response to the only harmonic of the drive.
"""

from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float, Int

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

    real: Any  # (n, n) K - omega^2 M without mistuning
    imaginary: Any  # (n, n) omega C
    mistuned: Any  # (n, blades) what the mistuning of a blade adds to the diagonal
    load: tuple[Any, Any]  # (n,) in phase and in quadrature
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
        sliders and mean displacements are not in it.
    """

    def one(scene: Scene) -> LinearSystem:
        ((order, load),) = drive_loads(scene).items()
        system, omega = linear_contact(scene, touching_gradients(scene)), scene.drive.frequency(order)
        free = jnp.asarray(free_directions(system.moves, contact, scene.contact.points is None), omega.dtype)

        def diagonal(numbers):
            return jnp.diag(numbers @ free**2)  # no coordinate is in two directions

        coupling, damping = free.T @ contact_stiffness(system, contact) @ free, diagonal(system.damping)
        if system.coupled is not None:
            coupling = coupling + free.T @ system.coupled.stiffness @ free
            damping = damping + free.T @ system.coupled.damping @ free
        in_phase, quadrature = load
        blades = scene.blades.m.shape[-1]
        each = jnp.tile(jnp.eye(blades, dtype=omega.dtype), (3, 1))
        return LinearSystem(
            coupling + diagonal(system.stiffness) - omega**2 * diagonal(system.mass),
            omega * damping,
            (free**2).T @ (system.stiffness[:, None] * each),
            (in_phase @ free, quadrature @ free),
            free.reshape(3, blades, -1)[coordinate],
        )

    return jax.vmap(one)(scenes)


def linear_amplitudes(system: LinearSystem, mistuning: Any, xp: ModuleType = np) -> Any:
    """The amplitudes of rows with patterns of mistuning (..., blades), by NumPy or JAX.

    They are |(K - omega^2 M + i omega C)^-1 Q|. Leading axes of the systems and of the patterns broadcast.
    """
    of_parts = lax.complex if xp is jnp else lambda real, imaginary: real + 1j * imaginary
    added = (system.mistuned @ mistuning[..., None])[..., 0]
    stiff = system.real + added[..., None] * np.eye(added.shape[-1], dtype=added.dtype)
    matrix = of_parts(stiff, xp.broadcast_to(system.imaginary, stiff.shape))
    load = xp.broadcast_to(of_parts(*system.load), stiff.shape[:-1])
    response = xp.linalg.solve(matrix, load[..., None])
    return xp.abs(system.coordinate.astype(response.dtype) @ response)[..., 0]


@kept()
def linear_slopes(
    systems: LinearSystem, mistuning: Float[Array, "n blades"], blade: Int[Array, " n"]
) -> Float[Array, "n blades"]:
    """The derivatives of the amplitude of one `blade` of each row (leading axis) by the mistuning of each blade."""

    def amplitude(delta, system, i):
        return linear_amplitudes(system, delta, jnp)[i]

    return jax.vmap(jax.grad(amplitude))(mistuning, systems, blade)
