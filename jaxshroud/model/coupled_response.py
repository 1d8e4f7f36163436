"""The steady response of blades that act on each other without contact: all of them as one linear system."""

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex

from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.blade import inverse_of, matrix_rows, times_vector
from jaxshroud.model.coupling import coupling_matrices
from jaxshroud.scene.drive import AnyLoad
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene

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
