"""The steady response of rows with patterns of mistuning whose contact stays in one state at all interfaces."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import kept
from jaxshroud.linear.natural_modes import (
    LinearContact,
    NaturalContact,
    drive_loads,
    linear_contact,
)
from jaxshroud.model.linear_system import ReducedSystem, solutions
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.modes import ModalBlades
from jaxshroud.scene.scene import Scene


class MistunedSystem(NamedTuple):
    """A row as one linear system in the n directions in which its blocks can move; arrays start with axes of lanes."""

    stiffness: Any  # (n, n) without mistuning
    damping: Any  # (n, n)
    mass: Any  # (n,)
    mistuned: Any  # (n, blades) what the mistuning of a blade adds to the diagonal of the stiffness
    omega: Any  # () frequency of the drive
    loads: dict[int, Any]  # (n,) complex, by order
    coordinate: Any  # (blades, n) the displacements that are requested


@kept("contact", "coordinate")
def linear_systems(scenes: Scene, contact: NaturalContact, coordinate: int) -> MistunedSystem:
    """Rows without mistuning (leading axis) with all interfaces in one state of contact, as linear systems.

    Args:
        scenes: The rows.
        contact: The state of contact.
        coordinate: The displacements that are requested: x, y or theta, 0 to 2.

    Source:
        Eq. (1) with the stiffness K of the blades, of their coupling, and of `linear_contact`. Preload, offsets of
        sliders and mean displacements are not in it. Mistuning does not change how stiffnesses grow with the speed.
    """

    def one(scene: Scene) -> MistunedSystem:
        system = linear_contact(scene)
        blades = scene.layout.blades
        b = scene.blades
        dtype = scene.drive.omega.dtype
        if isinstance(b, ModalBlades):
            _require_no_common_turn(system, contact)
            own = jnp.concatenate(b.numbers().stiffness)
        else:
            own = jnp.concatenate([b.k_x, b.k_y, b.k_T])
        free = jnp.asarray(system.directions(contact), dtype)
        each = jnp.tile(jnp.eye(blades, dtype=dtype), (len(own) // blades, 1))
        mass, damping, stiffness = ReducedSystem(free).system(system.system_in(contact))
        return MistunedSystem(
            stiffness=stiffness,
            damping=damping,
            mass=mass,
            mistuned=(free**2).T @ (own[:, None] * each),
            omega=scene.drive.omega,
            loads={n: load @ free.astype(load.dtype) for n, load in drive_loads(scene).items()},
            coordinate=system.shroud_motion(free.T).T.reshape(3, blades, -1)[coordinate],
        )

    return jax.vmap(one)(scenes)


def _require_no_common_turn(system: LinearContact, contact: NaturalContact) -> None:
    """Raise an InputError where the directions of blades by modes would depend on their shapes."""
    if bool(system.turns_as_one) and contact in ("sliding", "stuck"):
        raise InputError(
            "Rows of blades by modes whose faces are flat on each other have no closed form with patterns of mistuning "
            "yet; give faces of points, `contact.points`, or leave theta out of `parts.motion`."
        )


def moving_directions(systems: MistunedSystem) -> np.ndarray:
    """Whether each direction (n,) acts on the displacements that are requested, in any of some systems (leading axis).

    Blades that do not touch have coordinates that do not act on each other.
    """
    linked = np.any((systems.stiffness != 0) | (systems.damping != 0), axis=0)
    wanted: np.ndarray = np.any(systems.coordinate != 0, axis=(0, 1))
    for _ in wanted:
        wanted = wanted | linked[wanted].any(axis=0) | linked[:, wanted].any(axis=1)
    return wanted


def part_of(systems: MistunedSystem, directions: np.ndarray) -> MistunedSystem:
    """Systems (leading axis) in some of their directions, on which the others do not act."""
    return systems._replace(
        stiffness=systems.stiffness[:, directions][..., directions],
        damping=systems.damping[:, directions][..., directions],
        mass=systems.mass[:, directions],
        mistuned=systems.mistuned[:, directions],
        loads={n: load[:, directions] for n, load in systems.loads.items()},
        coordinate=systems.coordinate[..., directions],
    )


def linear_waves(system: MistunedSystem, mistuning: np.ndarray) -> dict[int, np.ndarray]:
    """The complex amplitudes of the displacements of rows with patterns of mistuning (..., blades), by order.

    They are (K - n^2 omega^2 M + i n omega C)^-1 Q. Leading axes of the systems and of the patterns broadcast.
    """
    return {n: (system.coordinate @ _answer(system, mistuning, n)[..., None])[..., 0] for n in system.loads}


def wave_slopes(system: MistunedSystem, mistuning: np.ndarray, blade: int) -> dict[int, np.ndarray]:
    """The derivatives of the complex amplitudes of one blade of a row by the mistuning of each blade, by order.

    Source:
        The derivative of Z^-1 Q is -Z^-1 (dZ) Z^-1 Q, where Z changes on its diagonal alone.
    """
    slopes = {}
    for n in system.loads:
        adjoint = solutions(_dynamic_stiffness(system, mistuning, n).T, system.coordinate[blade])
        slopes[n] = -(adjoint * _answer(system, mistuning, n)) @ system.mistuned
    return slopes


def _dynamic_stiffness(system: MistunedSystem, mistuning: np.ndarray, order: int) -> np.ndarray:
    omega = order * np.asarray(system.omega)[..., None]
    own = (system.mistuned @ mistuning[..., None])[..., 0] - omega**2 * system.mass
    matrix = system.stiffness + 1j * omega[..., None] * system.damping
    matrix = np.array(np.broadcast_to(matrix, (*own.shape, own.shape[-1])))
    place = np.arange(own.shape[-1])
    matrix[..., place, place] += own
    return matrix


def _answer(system: MistunedSystem, mistuning: np.ndarray, order: int) -> np.ndarray:
    """The complex amplitudes along the directions."""
    matrix = _dynamic_stiffness(system, mistuning, order)
    return solutions(matrix, np.broadcast_to(system.loads[order], matrix.shape[:-1]))
