"""The data sheet of a scene: its numbers in an engineer's terms, and doubts about them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np

from jaxshroud.march.stability import steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import Amplitudes, steady_amplitudes
from jaxshroud.motion.averages import half_diagonal
from jaxshroud.programs.kept import kept
from jaxshroud.results.base import PlainResult
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.lanes import one_scene

RAD_PER_CYCLE = 2 * np.pi
# Beyond these values the numbers of a scene are doubtful.
MAX_CORNER_GAPS = 10.0  # displacement of a free block's corner by its moment alone, over the gap
MAX_APPROACH_GAPS = 200.0  # approach of the free blades, over the gap
MAX_INERTIA_RATIO = 10.0  # inertia over that of a uniform block of the same mass
OVERDAMPED = 1.0  # damping ratio
MOTION_NAMES = {"x": "bending along x", "y": "bending along y", "theta": "torsion"}


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the two free blades; pairs, left blade first."""

    frequency: tuple[float, float]  # natural, undamped [Hz]
    zeta: tuple[float, float]  # damping ratio
    static: tuple[float, float]  # displacement under the drive's amplitude as a static load [m or rad]
    amplitude: tuple[float, float]  # steady, at the drive's frequency [m or rad]
    resonant: tuple[float, float]  # steady, at the undamped natural frequency [m or rad]; inf without damping


@dataclass(frozen=True)
class DataSheet(PlainResult):
    """The numbers of a scene in an engineer's terms."""

    coordinates: dict[str, Coordinate]  # those of x, y and theta that the model has
    drive: float  # frequency [Hz]
    gap: float  # [m]
    approach: float  # displacement of the free blades' contact faces towards each other, without rotation [m]
    corner: tuple[float, float]  # displacement of the free blocks' corners by rotation [m]
    inertia: tuple[float, float]  # over that of a uniform block of that mass and size
    gamma: float  # k / k_x of the left blade
    omega_max: float  # largest frequency with contact and friction springs engaged [rad/s]
    steps: int  # per period, "auto", by RK4
    doubts: tuple[str, ...]  # numbers that should be checked


@typed
def check(scene: Scene | SceneFile) -> DataSheet:
    """The data sheet of a scene: frequencies, ratios, amplitudes against the gap, and doubts.

    Args:
        scene: One scene, or a scene file.

    Returns:
        The data sheet. Its amplitudes are those of the free blades, in closed form, which contact is to reduce.

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
    arrays = jax.tree.map(np.asarray, scene)
    b, d, s = arrays.blades, arrays.drive, arrays.shroud
    free, k, gyration_of_block, lever = jax.tree.map(np.asarray, _free_blades(scene))
    loads = {"x": d.F_0 * np.cos(d.beta), "y": d.F_0 * np.sin(d.beta), "theta": d.M_0}
    oscillators = {"x": (b.m, b.c_x, b.k_x), "y": (b.inertia_y, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    coordinates = {
        name: _coordinate(*oscillators[name], np.abs(loads[name]), np.abs(getattr(free, name)))
        for name in scene.parts.motion
    }
    corner = lever * np.abs(free.theta)
    towards = (free.x[0] - free.x[1]) * np.sin(s.alpha) - (free.y[0] - free.y[1]) * np.cos(s.alpha)
    sheet = DataSheet(
        coordinates=coordinates,
        drive=float(d.omega) / RAD_PER_CYCLE,
        gap=float(s.gap),
        approach=float(abs(towards) / np.sin(s.alpha)),
        corner=_float_pair(corner),
        inertia=_float_pair(b.I / (b.m * gyration_of_block)),
        gamma=float(k / b.k_x[0]),
        omega_max=stiffest(scene, 0)[0],
        steps=steps_for(scene, 0, "auto", RK4),
        doubts=(),
    )
    return replace(sheet, doubts=tuple(_sheet_doubts(sheet, scene)))


@kept()
def _free_blades(scene: Scene) -> tuple[Amplitudes, Scalar, Scalar, Scalar]:
    """The amplitudes of the free blades, the contact's stiffness, a block's gyration and half its diagonal."""
    return steady_amplitudes(scene), scene.k, gyration(scene.shroud), half_diagonal(scene.shroud)


def _coordinate(m: np.ndarray, c: np.ndarray, k: np.ndarray, load: np.ndarray, amplitude: np.ndarray) -> Coordinate:
    with np.errstate(divide="ignore", invalid="ignore"):
        resonant = np.where(load > 0, load / (c * np.sqrt(k / m)), 0.0)
    numbers = np.sqrt(k / m) / RAD_PER_CYCLE, c / (2 * np.sqrt(k * m)), load / k, amplitude, resonant
    return Coordinate(*map(_float_pair, numbers))


def _float_pair(pair: np.ndarray) -> tuple[float, float]:
    return float(pair[0]), float(pair[1])


def _sheet_doubts(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """The numbers that are unlike those of a blade, or unlikely to be intended."""
    gap, touches = abs(sheet.gap), scene.parts.contact != "none"
    corner, inertia = max(sheet.corner), max(sheet.inertia, key=lambda ratio: abs(np.log(ratio)))
    if "theta" in sheet.coordinates and touches and gap and corner > MAX_CORNER_GAPS * gap:
        turned = f"{corner * 1e3:.3g} mm, {corner / gap:.0f} gaps"
        yield f"M_0 turns a free block's corners by {turned}: check the unit of drive.M_0"
    if "theta" in sheet.coordinates and not 1 / MAX_INERTIA_RATIO < inertia < MAX_INERTIA_RATIO:
        ratio = f"{inertia:.3g} times that of a uniform block of its mass and sides"
        yield f'I is {ratio}; I = "block" in a file gives that'
    for name, coordinate in sheet.coordinates.items():
        if name != "theta" and max(coordinate.amplitude) > float(scene.shroud.l_oa):
            reach = f"{max(coordinate.amplitude) * 1e3:.3g} mm"
            yield f"{MOTION_NAMES[name]}: a free block moves by {reach}, more than its own side"
        elif name != "theta" and float(scene.shroud.l_oa) < max(coordinate.resonant) < np.inf:
            swing = f"{max(coordinate.resonant) * 1e3:.3g} mm at resonance"
            text = f"a free block moves by {swing}, more than its own side: check F_0 and the damping"
            yield f"{MOTION_NAMES[name]}: {text}"
        if max(coordinate.zeta) >= OVERDAMPED:
            yield f"{MOTION_NAMES[name]} is overdamped, zeta = {max(coordinate.zeta):.3g}: it creeps instead of ringing"
        if min(coordinate.zeta) == 0:
            yield f"{MOTION_NAMES[name]} has no damping: its transients never end"
    if touches and gap and sheet.approach > MAX_APPROACH_GAPS * gap:
        yield f"the free blades approach each other by {sheet.approach / gap:.0f} gaps: check the unit of shroud.gap"
    if touches and sheet.gap > sheet.approach + sum(sheet.corner):
        yield "the free blades do not come near enough to touch: contact, if any, comes from the start alone"


HEADS = ["", "natural [Hz]", "over the drive's", "zeta", "static", "free at drive", "at resonance", "free over gap"]


def rows_of(sheet: DataSheet) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of all coordinates of both free blades."""
    return HEADS, [
        [f"{MOTION_NAMES[name]}, {side}", *_table_row(sheet, name, coordinate, i)]
        for name, coordinate in sheet.coordinates.items()
        for i, side in enumerate(("left", "right"))
    ]


def lines_of(sheet: DataSheet) -> dict[str, str]:
    """All other lines of the data sheet, by name."""
    approach = (
        f"{sheet.approach * 1e3:.4g} mm by translation, {_pair_text(sheet.corner, 1e3)} mm by rotation at corners"
    )
    lines = {
        "drive": f"{sheet.drive:.5g} Hz",
        "gap": f"{sheet.gap * 1e3:.4g} mm; the free blades approach by {approach}",
        "inertia": f"{_pair_text(sheet.inertia)} times that of a uniform block",
        "contact": f"gamma = k / k_x = {sheet.gamma:.4g}",
        "stiffest motion": f"{sheet.omega_max / math.tau:.5g} Hz; {sheet.steps} steps a period (auto, rk4)",
        **{f"doubtful {i}": text for i, text in enumerate(sheet.doubts, 1)},
    }
    return lines if sheet.doubts else {**lines, "doubtful": "nothing"}


def _table_row(sheet: DataSheet, name: str, coordinate: Coordinate, i: int) -> list[str]:
    unit, scale = ("deg", math.degrees(1)) if name == "theta" else ("mm", 1e3)
    lengths = [
        f"{values[i] * scale:.4g} {unit}" for values in (coordinate.static, coordinate.amplitude, coordinate.resonant)
    ]
    displacement = sheet.corner[i] if name == "theta" else coordinate.amplitude[i]
    gaps = f"{displacement / abs(sheet.gap):.3g}" if sheet.gap else "-"
    return [
        f"{coordinate.frequency[i]:.5g}",
        f"{coordinate.frequency[i] / sheet.drive:.4g}",
        f"{coordinate.zeta[i]:.4g}",
        *lengths,
        gaps,
    ]


def _pair_text(values: tuple[float, float], scale: float = 1.0) -> str:
    left, right = (f"{value * scale:.3g}" for value in values)
    return left if left == right else f"{left} and {right}"
