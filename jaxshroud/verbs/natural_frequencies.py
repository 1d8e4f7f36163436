"""The natural modes of the blades of a scene, apart and in contact, with what an engineer calls them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxshroud.model.natural_modes import COORDINATES, LinearPair, NaturalContact, drive_shares, natural_modes
from jaxshroud.results.campbell import NaturalMode
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray

RAD_PER_CYCLE = 2 * np.pi
ONE_BLADE = 0.95  # share of a mode's kinetic energy in one blade, beyond which it is a mode of that blade
ALIKE = 1e-9  # relative difference below which the frequencies of both blades are one


def modes_of(arrays: Scene, k: float, gradients: Sequence[np.ndarray]) -> tuple[NaturalMode, ...]:
    """All natural modes: those of the free blades, then those of each state of contact, the lowest first.

    Args:
        arrays: The scene, its numbers as NumPy arrays.
        k: The stiffness of the contact [N/m].
        gradients: dv/dq and du/dq where the upper corners meet, see `contact_gradients`.
    """
    b, d, has = arrays.blades, arrays.drive, arrays.parts.has
    pair = LinearPair(
        mass=np.concatenate([b.m, b.inertia_y, b.I]).astype(float),
        damping=np.concatenate([b.c_x, b.c_y, b.c_T]).astype(float),
        stiffness=np.concatenate([b.k_x, b.k_y, b.k_T]).astype(float),
        moves=np.array([has(name, i) for name in COORDINATES for i in (0, 1)]),
        v_q=np.asarray(gradients[0], float),
        u_q=np.asarray(gradients[1], float),
        k=k,
        k_d=float(arrays.friction.k_d),
    )
    load = np.concatenate([d.F_0 * np.cos(d.beta), d.F_0 * np.sin(d.beta), d.M_0]) * np.exp(1j * np.tile(d.phase, 3))
    found = [mode for contact in _contacts_of(arrays, k) for mode in _modes_in(pair, contact, load * pair.moves)]
    return tuple(found)


def _contacts_of(scene: Scene, k: float) -> list[NaturalContact]:
    """The states of contact that the model of a scene has."""
    if scene.parts.contact == "none" or k == 0:
        return ["apart"]
    if not _has_friction(scene):
        return ["apart", "sliding"]
    return ["apart", "sliding", "stuck", *(["corner"] if "theta" in scene.parts.motion else [])]


def _has_friction(scene: Scene) -> bool:
    if scene.laws is not None:
        return scene.laws.friction is not None
    return scene.parts.friction != "none" and bool(scene.friction.mu > 0) and bool(scene.friction.k_d > 0)


def _modes_in(pair: LinearPair, contact: NaturalContact, load: np.ndarray) -> list[NaturalMode]:
    """The modes in one state of contact."""
    omega, zeta, shape = natural_modes(pair, contact)
    energy, driven = shape**2 * pair.mass, drive_shares(shape, load)
    modes = []
    for i, own_shape in enumerate(shape):
        by_coordinate = energy[i].reshape(3, 2).sum(axis=1)
        main = int(np.argmax(by_coordinate))
        modes.append(
            NaturalMode(
                contact=contact,
                motion=COORDINATES[main],
                blades=_blades_in_words(float(energy[i, ::2].sum()), own_shape[2 * main : 2 * main + 2]),
                frequency=float(omega[i] / RAD_PER_CYCLE),
                zeta=float(zeta[i]),
                energy=tuple(by_coordinate.tolist()),
                driven=float(driven[i]),
            )
        )
    return _told_once(modes) if contact == "apart" else modes


def _blades_in_words(left: float, displacements: FloatArray) -> str:
    """The blades that a mode moves, from the left one's share of its energy and the displacements of both."""
    if max(left, 1 - left) > ONE_BLADE:
        return "left" if left > ONE_BLADE else "right"
    return "in phase" if displacements.prod() > 0 else "out of phase"


def _told_once(modes: list[NaturalMode]) -> list[NaturalMode]:
    """The modes of free blades, with one for both blades where these are alike."""
    told = []
    for motion in COORDINATES:
        own = [mode for mode in modes if mode.motion == motion]
        if len(own) == 2 and np.allclose([own[0].frequency, own[0].zeta], [own[1].frequency, own[1].zeta], ALIKE, 0):
            own = [replace(own[0], blades="either", driven=own[0].driven + own[1].driven)]
        told += own
    return sorted(told, key=lambda mode: mode.frequency)
