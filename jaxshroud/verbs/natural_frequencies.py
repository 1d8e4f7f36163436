"""The natural modes of the blades of a scene, apart, in contact, and in a flow, with what an engineer calls them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.linear.equilibrium import meets_at_corners, rubs
from jaxshroud.linear.natural_modes import LinearContact, NaturalContact, drive_shares, natural_modes
from jaxshroud.model.linear_system import LinearSystem, rate_matrix
from jaxshroud.results.data_sheet import FlowMode, NaturalMode
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray

RAD_PER_CYCLE = 2 * np.pi
ONE_BLADE = 0.95  # share of a mode's kinetic energy in one blade, beyond which it is a mode of that blade
ALIKE = 1e-9  # relative difference below which the frequencies of both blades are one
SAME_ENTRY = 1e-12  # relative difference of the entries of matrices that count as alike


class ModeWords(NamedTuple):
    """How the modes of a layout are described."""

    blades: Callable[[FloatArray, FloatArray], str]
    """(shares of a mode's energy, displacements) -> what the blades do."""
    merged: Callable[[list[NaturalMode], NaturalContact, int], list[NaturalMode]]
    """(modes, their contact, number of blades) -> the lowest first, one of those that differ in nothing but place."""


def modes_of(
    arrays: Scene, k: np.ndarray, system: LinearContact, loads: dict[int, np.ndarray]
) -> tuple[NaturalMode, ...]:
    """All natural modes: those of the free blades, then those of each state of contact, the lowest first.

    Args:
        arrays: The scene, its numbers as NumPy arrays.
        k: The stiffness of the contact [N/m], of a row at each interface.
        system: The blades and their contact, see `linear_contact`.
        loads: What drives them, see `drive_loads`.
    """
    blades = system_in_float64(system)
    driven = [load.astype(complex) for load in loads.values()]
    words = words_for(arrays)
    count = arrays.layout.blades
    modes = []
    for contact in contacts_of(arrays, k):
        modes += words.merged(modes_in(blades, contact, driven, words), contact, count)
    return tuple(modes)


def system_in_float64(system: LinearContact) -> LinearContact:
    """A linear system with its numbers in float64."""
    return jax.tree.map(lambda a: a if a.dtype == bool else a.astype(float), system)


def words_for(scene: Scene) -> ModeWords:
    """How the modes of a scene are described."""
    return WORDS_OF_PAIRS if scene.row is None else _words_of_row(scene.row.closed)


def contacts_of(scene: Scene, k: np.ndarray) -> list[NaturalContact]:
    """The states of contact that the model of a scene has."""
    if scene.parts.contact == "none" or not np.any(k):
        return ["apart"]
    if not (np.any(rubs(scene)) if scene.laws is None else scene.laws.has_friction):
        return ["apart", "sliding"]
    return ["apart", "sliding", "stuck", *(["corner"] if meets_at_corners(scene) else [])]


def modes_in(
    blades: LinearContact, contact: NaturalContact, loads: list[np.ndarray], words: ModeWords
) -> list[NaturalMode]:
    """All modes in one state of contact, the lowest first."""
    omega, zeta, shape = natural_modes(blades, contact)
    energy = shape**2 * blades.free.mass
    driven = drive_shares(shape, loads)
    modes = []
    for i, own_shape in enumerate(shape):
        of_shrouds = blades.shroud_motion(own_shape).reshape(3, -1)
        by_coordinate = (blades.shroud_mass.reshape(3, -1) * of_shrouds**2).sum(axis=1)
        by_coordinate = by_coordinate / by_coordinate.sum()
        main = int(np.argmax(by_coordinate))
        modes.append(
            NaturalMode(
                contact=contact,
                motion=COORDINATES[main],
                blades=words.blades(energy[i].reshape(-1, of_shrouds.shape[1]).sum(axis=0), of_shrouds[main]),
                frequency=float(omega[i] / RAD_PER_CYCLE),
                zeta=float(zeta[i]),
                energy=tuple(by_coordinate.tolist()),
                driven=float(driven[i]),
            )
        )
    return modes


def _blades_in_words(shares: FloatArray, displacements: FloatArray) -> str:
    """The blades that a mode moves, from their shares of its energy and their displacements."""
    left = float(shares[0])
    if max(left, 1 - left) > ONE_BLADE:
        return "left" if left > ONE_BLADE else "right"
    return "in phase" if displacements.prod() > 0 else "out of phase"


def _waves_in_words(shares: FloatArray, displacements: FloatArray, closed: bool) -> str:
    """The blade, or the waves of a row, that a mode moves."""
    if shares.max() > ONE_BLADE:
        return f"blade {int(shares.argmax())}"
    if not closed:
        nodes = int(np.sum(displacements[1:] * displacements[:-1] < 0))
        return f"{nodes} node{'' if nodes == 1 else 's'}"
    waves = np.abs(np.fft.rfft(displacements)) ** 2
    whole = np.sum(displacements**2) * len(displacements)
    paired = (np.arange(len(waves)) > 0) & (2 * np.arange(len(waves)) < len(displacements))
    shares_of_waves = np.where(paired, 2, 1) * waves / whole
    h = int(shares_of_waves.argmax())
    return f"{'' if shares_of_waves[h] > 1 - ALIKE else 'about '}nodal diameter {h}"


def _merged(modes: list[NaturalMode], common: Callable[[NaturalMode, NaturalMode], str]) -> list[NaturalMode]:
    """The modes, the lowest first, with one in the place of neighbours for whose blades there is `common` text."""
    shown: list[NaturalMode] = []
    for mode in sorted(modes, key=lambda mode: COORDINATES.index(mode.motion)):
        if shown and (blades := common(shown[-1], mode)):
            shown[-1] = replace(shown[-1], blades=blades, driven=shown[-1].driven + mode.driven)
        else:
            shown.append(mode)
    return sorted(shown, key=lambda mode: mode.frequency)


def _merged_waves(modes: list[NaturalMode], contact: NaturalContact, count: int) -> list[NaturalMode]:
    """The modes of a row, with one for those that differ in nothing but their place around it."""
    del contact

    def with_each(mode: NaturalMode) -> NaturalMode:
        alone = [one.frequency for one in modes if one.motion == mode.motion and one.blades.startswith("blade ")]
        every = mode.blades.startswith("blade ") and np.isclose(alone, mode.frequency, ALIKE, 0).sum() == count
        return replace(mode, blades="each blade") if every else mode

    def common(before: NaturalMode, mode: NaturalMode) -> str:
        same = (before.motion, before.blades) == (mode.motion, mode.blades)
        return mode.blades if same and np.isclose(before.frequency, mode.frequency, ALIKE, 0) else ""

    return _merged([*map(with_each, modes)], common)


def _merged_modes(modes: list[NaturalMode], contact: NaturalContact, count: int) -> list[NaturalMode]:
    """The modes of a pair; of free blades that are alike with one for both."""
    del count

    def common(before: NaturalMode, mode: NaturalMode) -> str:
        alike = np.allclose([before.frequency, before.zeta], [mode.frequency, mode.zeta], ALIKE, 0)
        return "either" if alike and before.blades != mode.blades else ""

    return _merged(modes, common) if contact == "apart" else modes


WORDS_OF_PAIRS = ModeWords(_blades_in_words, _merged_modes)


def _words_of_row(closed: bool) -> ModeWords:
    return ModeWords(partial(_waves_in_words, closed=closed), _merged_waves)


def flow_modes(blades: LinearSystem, flow: FloatArray, closed: bool) -> tuple[FlowMode, ...]:
    """The modes along x of the blades of a row in a flow, apart: the frequency and the damping of free decays.

    Args:
        blades: The row, with arrays of NumPy.
        flow: The damping by the flow within it, along x of all blades (N, N) [N s/m].
        closed: Whether it is a ring.

    Returns:
        The modes of a tuned ring by nodal diameter h from -N/2 on, a wave that travels forward where h > 0; those of
        other rows by frequency.

    Source:
        The roots of D_h + lambda C_h + lambda^2 m, with K + 4 sin^2(pi h / N) K_c + L0 + L1 exp(i 2 pi h / N)
        + L_1 exp(-i 2 pi h / N) as it is marched: Re L in D_h, and Im L / omega_drive in C_h. What the flow adds to the
        damping ratio is the rest that the dampers do not give.
    """
    x = slice(len(flow))
    row = LinearSystem(
        mass=np.asarray(blades.mass[x], float),
        damping=np.asarray(blades.damping[x, x], float),
        stiffness=np.asarray(blades.stiffness[x, x], float),
    )
    own_damping = row.damping - flow
    if not closed or not all(map(_is_circulant, (np.diag(row.mass), *row[1:]))):
        return _decays(row, own_damping, None)
    modes: tuple[FlowMode, ...] = ()
    for h in range(-((len(flow) - 1) // 2), len(flow) // 2 + 1):
        wave = LinearSystem(row.mass[:1], _of_wave(row.damping, h), _of_wave(row.stiffness, h))
        modes += _decays(wave, _of_wave(own_damping, h), h)
    return modes


def _is_circulant(matrix: FloatArray) -> bool:
    return bool(np.allclose(np.roll(matrix, (1, 1), (0, 1)), matrix, SAME_ENTRY, SAME_ENTRY * np.abs(matrix).max()))


def _of_wave(matrix: FloatArray, h: int) -> np.ndarray:
    """What a circulant matrix is to a wave of nodal diameter `h`, (1, 1)."""
    return matrix[:1] @ np.exp(2j * np.pi * h * np.arange(len(matrix)) / len(matrix))[:, None]


def _decays(system: LinearSystem, own_damping: np.ndarray, h: int | None) -> tuple[FlowMode, ...]:
    """The modes of all that oscillates, by size of their roots."""
    n = len(system.mass)
    roots, shapes = np.linalg.eig(rate_matrix(*system))
    turning = np.argsort(-np.imag(roots))[:n]
    turning = turning[np.argsort(np.abs(roots[turning]))]
    return tuple(_mode(roots[i], shapes[:n, i], own_damping, np.diag(system.mass), h) for i in turning)


def _mode(root: Any, shape: np.ndarray, own_damping: np.ndarray, mass: np.ndarray, h: int | None) -> FlowMode:
    def of_shape(matrix):
        return float(np.real(shape.conj() @ matrix @ shape))

    zeta = float(-root.real / abs(root))
    omega = float(abs(root))
    of_dampers = of_shape(own_damping) / (2 * omega * of_shape(mass))
    return FlowMode(h, omega / (2 * np.pi), zeta, zeta - of_dampers)
