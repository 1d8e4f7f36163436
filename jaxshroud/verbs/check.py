"""The data sheet of a scene: what its numbers mean in an engineer's terms, and what about them is doubtful."""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import numpy as np

from jaxshroud.march.stability import steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.motion.averages import half_diagonal
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.lanes import one_scene

TURN = 2 * np.pi
MANY_GAPS = 10.0  # that a free block's corner may move by its moment alone before that is doubtful
FAR = 200.0  # gaps by which the free blades may approach each other
HEAVY = 10.0  # times the inertia of a uniform block of that mass
OVERDAMPED = 1.0  # damping ratio
NAMES = {"x": "bending along x", "y": "bending along y", "theta": "torsion"}


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the two free blades; pairs, left blade first."""

    frequency: tuple[float, float]  # natural, undamped [Hz]
    zeta: tuple[float, float]  # damping ratio
    static: tuple[float, float]  # what the drive's amplitude would do at rest [m or rad]
    amplitude: tuple[float, float]  # steady, at the drive's frequency [m or rad]
    resonant: tuple[float, float]  # steady, were the drive at the undamped natural frequency [m or rad]; inf undamped


@dataclass(frozen=True)
class Sheet:
    """What the numbers of a scene mean."""

    coordinates: dict[str, Coordinate]  # x, y and theta, as far as the model has them
    drive: float  # frequency [Hz]
    gap: float  # [m]
    approach: float  # how far the free blades' contact faces move towards each other, rotation apart [m]
    corner: tuple[float, float]  # how far the free blocks' corners move by their rotation [m]
    inertia: tuple[float, float]  # over that of a uniform block of that mass and size
    gamma: float  # k / k_x of the left blade
    omega_max: float  # largest frequency with contact and friction springs engaged [rad/s]
    steps: int  # per period, "auto", by RK4
    doubts: tuple[str, ...]  # what to look at again


def check(scene: Scene | SceneFile) -> Sheet:
    """What the numbers of a scene mean: frequencies, ratios, amplitudes against the gap, and what is doubtful.

    Args:
        scene: One scene.

    Returns:
        Amplitudes are those of the free blades, in closed form: what contact has to reduce.

    Raises:
        ValueError: There are many scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> sheet = js.check(js.load("table1"))
        >>> round(sheet.drive, 2), round(sheet.coordinates["x"].zeta[0], 4)
        (85.31, 0.02)
    """
    scene = one_scene("check", scene)
    held = jax.tree.map(np.asarray, scene)
    b, d, s = held.blades, held.drive, held.shroud
    free = jax.tree.map(np.asarray, steady_amplitudes(scene))
    loads = {"x": d.F_0 * np.cos(d.beta), "y": d.F_0 * np.sin(d.beta), "theta": d.M_0}
    held_by = {"x": (b.m, b.c_x, b.k_x), "y": (b.inertia_y, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    coordinates = {
        name: _coordinate(*held_by[name], np.abs(loads[name]), np.abs(getattr(free, name)))
        for name in scene.parts.motion
    }
    block = b.m * float(gyration(scene.shroud))
    corner = float(half_diagonal(scene.shroud)) * np.abs(free.theta)
    towards = (free.x[0] - free.x[1]) * np.sin(s.alpha) - (free.y[0] - free.y[1]) * np.cos(s.alpha)
    sheet = Sheet(
        coordinates=coordinates,
        drive=float(d.omega) / TURN,
        gap=float(s.gap),
        approach=float(abs(towards) / np.sin(s.alpha)),
        corner=_both(corner),
        inertia=_both(b.I / block),
        gamma=float(scene.k / b.k_x[0]),
        omega_max=stiffest(scene, 0)[0],
        steps=steps_for(scene, 0, "auto", RK4),
        doubts=(),
    )
    return Sheet(**{**vars(sheet), "doubts": tuple(_doubts(sheet, scene))})


def _coordinate(m: np.ndarray, c: np.ndarray, k: np.ndarray, load: np.ndarray, amplitude: np.ndarray) -> Coordinate:
    with np.errstate(divide="ignore", invalid="ignore"):
        resonant = np.where(load > 0, load / (c * np.sqrt(k / m)), 0.0)
    ratio = c / (2 * np.sqrt(k * m))
    return Coordinate(_both(np.sqrt(k / m) / TURN), _both(ratio), _both(load / k), _both(amplitude), _both(resonant))


def _both(pair: np.ndarray) -> tuple[float, float]:
    return float(pair[0]), float(pair[1])


def _doubts(sheet: Sheet, scene: Scene) -> Iterator[str]:
    """What is unlike a blade, or unlikely to be meant."""
    gap, touches = abs(sheet.gap), scene.parts.contact != "none"
    corner, inertia = max(sheet.corner), max(sheet.inertia, key=lambda ratio: abs(np.log(ratio)))
    if "theta" in sheet.coordinates and touches and gap and corner > MANY_GAPS * gap:
        turned = f"{corner * 1e3:.3g} mm, {corner / gap:.0f} gaps"
        yield f"M_0 turns a free block's corners by {turned}: check the unit of drive.M_0"
    if "theta" in sheet.coordinates and not 1 / HEAVY < inertia < HEAVY:
        ratio = f"{inertia:.3g} times that of a uniform block of its mass and sides"
        yield f'I is {ratio}; I = "block" in a file gives that'
    for name, one in sheet.coordinates.items():
        if name != "theta" and max(one.amplitude) > float(scene.shroud.l_oa):
            yield f"{NAMES[name]}: a free block moves by {max(one.amplitude) * 1e3:.3g} mm, more than its own side"
        elif name != "theta" and float(scene.shroud.l_oa) < max(one.resonant) < np.inf:
            swing = f"{max(one.resonant) * 1e3:.3g} mm at resonance"
            yield f"{NAMES[name]}: a free block moves by {swing}, more than its own side: check F_0 and the damping"
        if max(one.zeta) >= OVERDAMPED:
            yield f"{NAMES[name]} is overdamped, zeta = {max(one.zeta):.3g}: it creeps instead of ringing"
        if min(one.zeta) == 0:
            yield f"{NAMES[name]} has no damping: its transients never end"
    if touches and gap and sheet.approach > FAR * gap:
        yield f"the free blades approach each other by {sheet.approach / gap:.0f} gaps: check the unit of shroud.gap"
    if touches and sheet.gap > sheet.approach + sum(sheet.corner):
        yield "the free blades do not come near enough to touch: contact, if any, comes from the start alone"
