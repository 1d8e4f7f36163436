"""The steady response of a row whose interfaces all stay in one state of contact: linear, and so in closed form.

It is that to the only harmonic of the drive.
"""

from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.cache.programs import kept
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
from jaxshroud.scene.scene import Scene

UPPER_CORNERS = 1  # the case whose corners are looked at


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
