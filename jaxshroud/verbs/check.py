"""The data sheet of a scene: its numbers in an engineer's terms, natural frequencies, engine orders, and doubts.

Doubts are about numbers that are unlike those of a blade, or beyond what the model describes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.cache.programs import kept
from jaxshroud.march.stability import steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import Amplitudes, free_reach, steady_amplitudes
from jaxshroud.model.natural_modes import LinearContact, drive_loads, linear_contact
from jaxshroud.orbits.linear_response import touching_gradients
from jaxshroud.results.data_sheet import MOTION_NAMES, Coordinate, DataSheet, NaturalMode, crossings_between
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.engine_order import engine_order_of
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.signals.averages import half_diagonal
from jaxshroud.verbs.arguments import check_row, one_scene
from jaxshroud.verbs.natural_frequencies import RAD_PER_CYCLE, modes_of

MAX_CORNER_GAPS = 10.0  # displacement of a free block's corner by its moment alone, over the gap
MAX_APPROACH_GAPS = 100.0  # of the free faces: the gap is then 1 % of the motion, and contact lasts as without one
MAX_INERTIA_RATIO = 10.0  # inertia over that of a uniform block of the same mass
OVERDAMPED = 1.0  # damping ratio
# The blocks are rigid, shift on linear springs and touch with whole faces. A tenth of a side at the drive's frequency
# is a bend that blades with such blocks do not take; at resonance, which contact is there to prevent, half a side is.
MAX_AMPLITUDE_SIDES, MAX_RESONANT_SIDES = 0.1, 0.5
MAX_SLIDE_FACES = 0.5  # slide of the free faces over their length: corners then pass the other face's ends
MAX_PARALLEL = 0.1  # displacement of a corner by the free rotation, over the approach of the free faces
MAX_PRESSED = 0.1  # displacement of a block by interference alone, over its free amplitude
MAX_ANGLE = np.radians(10.0)  # of a free block; the springs of torsion are linear, and runs end at 45 degrees
MIN_MARGIN = (
    0.05  # of the drive from a natural frequency: computed frequencies of blades are seldom closer to true ones
)
SAME_FREQUENCY = 1e-6  # relative difference of frequencies below which a mode in contact is one of free blades
LEAST_DRIVEN = 1e-3  # share of the drive below which a mode is not excited


def doubts_of(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """The doubts, one line each, with their numbers and what they mean."""
    yield from _torsion_doubts(sheet, scene)
    yield from _amplitude_doubts(sheet, float(scene.shroud.l_oa))
    yield from _damping_doubts(sheet)
    yield from _resonance_doubts(sheet)
    if scene.parts.contact != "none":
        yield from _mean_load_doubts(sheet)
        yield from _interference_doubts(sheet)
        yield from _doubts_of_interfaces(sheet, float(scene.shroud.l_ab))


def _torsion_doubts(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    if "theta" not in sheet.coordinates:
        return
    gap, corner, angle = abs(sheet.gap), max(sheet.corner), max(sheet.coordinates["theta"].amplitude)
    inertia = max(sheet.inertia, key=lambda ratio: abs(np.log(ratio)))
    if scene.parts.contact != "none" and gap and corner > MAX_CORNER_GAPS * gap:
        turned = f"{corner * 1e3:.3g} mm, {corner / gap:.0f} gaps"
        yield f"M_0 turns a free block's corners by {turned}: check the unit of drive.M_0"
    if angle > MAX_ANGLE:
        yield f"M_0 turns a free block by {np.degrees(angle):.3g} degrees: its spring is hardly linear there"
    if not 1 / MAX_INERTIA_RATIO < inertia < MAX_INERTIA_RATIO:
        ratio = f"{inertia:.3g} times that of a uniform block of its mass and sides"
        yield f'I is {ratio}; I = "block" in a file gives that'


def advice_on(sheet: DataSheet, scene: Scene) -> Iterator[str]:
    """What may do better: points for nearly parallel faces of light blocks, where a corner switches from end to end."""
    touches_at_corner = scene.parts.contact == "spring" and scene.contact.points is None
    if not touches_at_corner or "theta" not in sheet.coordinates or max(sheet.inertia) > MAX_INERTIA_RATIO:
        return
    corner, approach = max(sheet.corner), max([sheet.approach, *sheet.approaches])
    if corner < MAX_PARALLEL * approach < np.inf:
        turned = f"M_0 turns corners by {corner * 1e3:.3g} mm where the free faces approach by {approach * 1e3:.3g} mm"
        cure = "[contact] points = 2, or more, lets them touch at both ends"
        yield f"the faces stay nearly parallel, and a single corner switches from end to end: {turned}; {cure}"


def _amplitude_doubts(sheet: DataSheet, side: float) -> Iterator[str]:
    for name, coordinate in sheet.coordinates.items():
        moved, resonant = max(coordinate.amplitude), max(coordinate.resonant)
        if np.isinf(moved):
            yield f"{MOTION_NAMES[name]}, free, is driven at resonance without damping: its amplitude is infinite"
            continue
        if name == "theta" or not (moved > MAX_AMPLITUDE_SIDES * side or MAX_RESONANT_SIDES * side < resonant < np.inf):
            continue
        at_resonance = f", {resonant * 1e3:.3g} mm at resonance" if resonant < np.inf else ""
        reach = f"{moved * 1e3:.3g} mm{at_resonance}, and its side is {side * 1e3:.3g} mm"
        yield f"{MOTION_NAMES[name]}: a free block moves by {reach}: check F_0 and the damping"


def _mean_load_doubts(sheet: DataSheet) -> Iterator[str]:
    """Mean loads that part the faces of every interface."""
    reach = sheet.approach + 2 * max(sheet.corner)
    if sheet.static_gaps and min(sheet.static_gaps) > reach:
        opened = f"{min(sheet.static_gaps) * 1e3:.3g} mm, and the free faces approach by {reach * 1e3:.3g} mm"
        yield f"under the mean loads every contact is open: the least gap is {opened}; check their signs"


def _interference_doubts(sheet: DataSheet) -> Iterator[str]:
    """Interference that displaces a block by more than a tenth of its free amplitude."""
    bent = [sheet.coordinates[name].amplitude for name in ("x", "y") if name in sheet.coordinates]
    free, pressed = np.sqrt(np.sum(np.square(bent), axis=0)), np.array(sheet.pressed)
    beyond = pressed > MAX_PRESSED * free
    if np.any(beyond):
        at = int(np.argmax(np.where(beyond, pressed, 0.0)))
        share = f"{100 * pressed[at] / free[at]:.3g} % of its free amplitude" if free[at] else "which nothing drives"
        yield (
            f"{'mean loads press' if sheet.static_gaps else 'interference alone displaces'} a block "
            f"{'aside ' if sheet.static_gaps else ''}by {pressed[at] * 1e3:.3g} mm, {share}: P_d counts that as "
            "vibration, P_d_vibration does not"
        )


def _damping_doubts(sheet: DataSheet) -> Iterator[str]:
    for name, coordinate in sheet.coordinates.items():
        if max(coordinate.zeta) >= OVERDAMPED:
            yield f"{MOTION_NAMES[name]} is overdamped, zeta = {max(coordinate.zeta):.3g}: it creeps instead of ringing"
        if min(coordinate.zeta) == 0:
            yield f"{MOTION_NAMES[name]} has no damping: its transients never end"


def _resonance_doubts(sheet: DataSheet) -> Iterator[str]:
    """The drive is next to a natural frequency of blades apart, or stuck, in a mode that it excites."""
    apart, stuck = (
        [mode for mode in sheet.modes if mode.contact == contact and mode.driven > LEAST_DRIVEN]
        for contact in ("apart", "stuck")
    )
    is_free = lambda mode: any(np.isclose(mode.frequency, other.frequency, SAME_FREQUENCY, 0) for other in apart)
    for modes in (apart, [mode for mode in stuck if not is_free(mode)]):
        for order in sheet.harmonics:
            name = "the drive" if order == 1 else f"harmonic {order} of the drive"
            yield from _resonance_doubt(name, order * sheet.drive, modes)


def _resonance_doubt(which: str, drive: float, modes: Sequence[NaturalMode]) -> Iterator[str]:
    nearest = min(modes, key=lambda mode: abs(np.log(drive / mode.frequency)), default=None)
    if nearest is None:
        return
    margin, name = drive / nearest.frequency - 1, f"{nearest.name}, {nearest.contact} ({nearest.frequency:.5g} Hz)"
    if abs(margin) <= nearest.zeta < OVERDAMPED:
        band = f"half-power band, {2 * nearest.zeta:.2g} of the frequency"
        limit = "damping alone limits" if nearest.zeta else "nothing but contact limits"
        yield f"{which} is at the resonance of {name}, within its {band}: {limit} the motion"
    elif abs(margin) < MIN_MARGIN:
        side = "above" if margin > 0 else "below"
        yield f"{which} is {100 * abs(margin):.2g} % {side} {name}: small changes of either decide the motion"


def _doubts_of_interfaces(sheet: DataSheet, face: float) -> Iterator[str]:
    """The doubts on contact: of a pair, or of each interface of a row, once where all have the same."""
    if not sheet.gaps:
        yield from _contact_doubts(sheet, face)
        return
    where: dict[str, list[str]] = {}
    for j, (gap, approach, slide) in enumerate(zip(sheet.gaps, sheet.approaches, sheet.slides, strict=True)):
        corner = sheet.corner[j], sheet.corner[(j + 1) % len(sheet.corner)]
        for text in _contact_doubts(replace(sheet, gap=gap, approach=approach, slide=slide, corner=corner), face):
            where.setdefault(text, []).append(str(j))
    for text, places in where.items():
        yield text if len(places) == len(sheet.gaps) else f"interface {', '.join(places)}: {text}"


def _contact_doubts(sheet: DataSheet, face: float) -> Iterator[str]:
    gap = abs(sheet.gap)
    if gap and MAX_APPROACH_GAPS * gap < sheet.approach < np.inf:
        meaning = "impacts are hard, and last as without a gap"
        yield f"the free faces approach by {sheet.approach / gap:.0f} gaps: {meaning}; check the unit of shroud.gap"
    if MAX_SLIDE_FACES * face < sheet.slide < np.inf:
        slid = f"{sheet.slide * 1e3:.3g} mm, {sheet.slide / face:.2g} of their length"
        yield f"the free faces slide by {slid}: they pass each other's ends, where contact is taken to go on"
    if sheet.static_gaps:
        return
    if sheet.gap > sheet.approach + sum(sheet.corner):
        yield "the free blades do not come near enough to touch: contact, if any, comes from the start alone"


USUAL_ORDERS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)  # that are shown beside the scene's own
MAX_ORDERS = 100
SPEED_RANGE = 1.5  # the end of the range of speeds over the scene's own speed
BEYOND_LOWEST = 1.1  # the least it is over the speed at which the drive meets the lowest mode, apart and in contact


@typed
def check(
    scene: Scene | SceneFile,
    *,
    engine_orders: Sequence[float | int] | None = None,
    start: float | int = 0.0,
    stop: float | int | None = None,
) -> DataSheet:
    """The data sheet of a scene: frequencies, ratios, amplitudes against the gap, engine orders, and doubts.

    Args:
        scene: One scene, or a scene file.
        engine_orders: Engine orders whose crossings with natural frequencies are told; by default the scene's own and
            1 to 6. Where the scene tells only the frequency of its drive, its own is the first one, by default 1. Those
            of all harmonics of the drive are among them.
        start: Where the range of speeds begins [rad/s].
        stop: Where it ends; by default beyond the scene's own speed and the lowest natural frequencies.

    Returns:
        The data sheet. Its amplitudes are those of the free blades, in closed form, which contact is to reduce. Its
        natural frequencies do not depend on the speed: there is no centrifugal stiffening. Of a row of blades there is
        a number for each blade and each interface; `gap` is the smallest, and what is told of the free faces is of the
        interface where they approach most. Its natural modes are those with all interfaces in one state of contact, of
        a ring by nodal diameters; in a tuned ring an engine order EO excites nodal diameter EO modulo N alone.

    Raises:
        ValueError: There are many scenes, a row without contact, or the engine orders or the range of speeds are none.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> sheet = js.check(js.load("table1"))
        >>> round(sheet.drive, 2), round(sheet.coordinates["x"].zeta[0], 4)
        (85.31, 0.02)
        >>> [(mode.name, round(mode.frequency, 2)) for mode in sheet.modes if mode.contact == "apart"][:2]
        [('torsion, either blade', 143.51), ('bending along x, either blade', 177.94)]
    """
    scene = one_scene("check", scene)
    check_row(scene)
    arrays = jax.tree.map(np.asarray, scene)
    free, k, gyration_of_block, lever, system, load = jax.tree.map(np.asarray, _free_and_touching(scene))
    b, s = arrays.mistuned_blades, arrays.shroud
    k = np.atleast_1d(k)
    gaps = np.atleast_1d(s.gap) - _closed_by_mean_loads(free, float(s.alpha), np.size(s.gap))
    across, along = _relative_motions(free, float(s.alpha), len(gaps))
    nearest = int(np.argmax(across))
    modes = modes_of(arrays, k, system, load)
    sheet = DataSheet(
        coordinates=_free_coordinates(arrays, free),
        drive=float(arrays.drive.omega) / RAD_PER_CYCLE,
        gap=float(np.min(s.gap)),
        **({"static_gaps": _floats(gaps)} if 0 in free else {}),
        approach=float(across[nearest]) / math.sin(s.alpha),
        corner=_floats(lever * free_reach(_without_mean(free), "theta")),
        inertia=_floats(b.I / (b.m * gyration_of_block)),
        gamma=float(k[0] / arrays.blades.k_x[0]),
        omega_max=stiffest(scene, 0)[0],
        steps=steps_for(scene, 0, "auto", RK4),
        doubts=(),
        slide=float(along.max()),
        modes=modes,
        pressed=_floats(_displaced_by_interference(system, gaps, float(s.alpha))),
        **({} if scene.row is None else _at_interfaces(arrays, k, across / math.sin(s.alpha), along)),
        **_over_speed(scene, modes, engine_orders, start, stop),
    )
    return replace(sheet, doubts=tuple(doubts_of(sheet, scene)), advice=tuple(advice_on(sheet, scene)))


def _at_interfaces(arrays: Scene, k: np.ndarray, approach: np.ndarray, slide: np.ndarray) -> dict[str, Any]:
    """The fields of the data sheet on each interface of a row."""
    assert arrays.row is not None
    numbers = {"gaps": arrays.shroud.gap, "approaches": approach, "slides": slide}
    return {
        **{name: _floats(a) for name, a in numbers.items()},
        "gammas": _floats(k / arrays.blades.k_x[: len(k)]),
        "closed": arrays.row.closed,
    }


def _over_speed(
    scene: Scene, modes: Sequence[NaturalMode], given: Sequence[float | int] | None, start: float, stop: float | None
) -> dict[str, Any]:
    """The fields of the data sheet on engine orders, from the arguments of `check`."""
    own, omega = engine_order_of(scene), float(scene.drive.omega)
    orders = _checked_orders(given, own)
    drive_order = own or orders[0]
    excited = [n for n in scene.drive.harmonics() if n > 0]
    if excited != [1]:
        orders = list(dict.fromkeys([*orders, *(n * drive_order for n in excited)]))
    speed = omega / drive_order
    reached = modes if scene.row is None else [mode for mode in modes if mode.driven > LEAST_DRIVEN] or modes
    stop = _end_of_range(reached, omega, speed) if stop is None else float(stop)
    if not 0 <= start < stop < math.inf:
        raise InputError(f"The speeds from `start` to `stop` must be a range from 0 on, but are {start:g} to {stop:g}.")
    orders = tuple(sorted(orders))
    return {
        **{"drive_order": drive_order, "is_own_order": own is not None, "engine_orders": orders},
        "harmonics": tuple(excited),
        **{"speed": speed, "start": float(start), "stop": stop},
        "crossings": crossings_between(modes, orders, speed, start, stop, scene.layout),
    }


@kept()
def _free_and_touching(
    scene: Scene,
) -> tuple[dict[int, Amplitudes], Float[Array, "..."], Scalar, Scalar, LinearContact, dict[int, tuple[Array, Array]]]:
    """The free blades' amplitudes, the stiffness of contact, a block's gyration, half its diagonal, a linear system.

    The system and the load on it are those of blades whose upper corners meet: there is no gap between them.
    """
    shroud = scene.shroud
    system = linear_contact(scene, touching_gradients(scene))
    return steady_amplitudes(scene), scene.k, gyration(shroud), half_diagonal(shroud), system, drive_loads(scene)


def _relative_motions(free: dict[int, Amplitudes], alpha: float, interfaces: int) -> tuple[np.ndarray, np.ndarray]:
    """The amplitudes of the free faces' motion across and along each other, without rotation [m], (interfaces,).

    Those of all harmonics of the drive are added.
    """
    sines = _without_mean(free).values()
    across, along = np.sum([_relative_amplitudes(one, alpha, interfaces) for one in sines], axis=0)
    return across, along


def _without_mean(free: dict[int, Amplitudes]) -> dict[int, Amplitudes]:
    """The amplitudes without the static displacement under mean loads."""
    return {n: one for n, one in free.items() if n > 0}


def _closed_by_mean_loads(free: dict[int, Amplitudes], alpha: float, interfaces: int) -> np.ndarray:
    """By how much mean loads reduce each gap without contact and rotation [m], (interfaces,)."""
    if 0 not in free:
        return np.zeros(interfaces)
    x, y = (np.imag(a) - np.roll(np.imag(a), -1) for a in (free[0].x, free[0].y))
    return np.asarray(x - y / math.tan(alpha))[:interfaces]


def _relative_amplitudes(free: Amplitudes, alpha: float, interfaces: int) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        x, y = ((a - np.roll(a, -1))[:interfaces] for a in (free.x, free.y))
        across, along = x * math.sin(alpha) - y * math.cos(alpha), x * math.cos(alpha) + y * math.sin(alpha)
    unbounded = lambda a: np.where(np.isnan(a), np.inf, np.abs(a))
    return unbounded(across), unbounded(along)


def _displaced_by_interference(system: LinearContact, gaps: np.ndarray, alpha: float) -> np.ndarray:
    """The displacement of each block where interference presses the faces together, at rest, (blades,) [m].

    The faces slide freely, and the blocks do not turn.
    """
    bends = system.moves & (np.arange(len(system.moves)) < 2 * len(system.moves) // 3)
    depth = np.maximum(-gaps, 0.0) * math.sin(alpha)
    v_q, k = system.v_q[:, bends], np.where(depth > 0, system.k, 0.0)
    displacement = np.zeros(len(system.moves))
    stiffness = np.diag(system.stiffness[bends]) + v_q.T @ (k[:, None] * v_q)
    displacement[bends] = np.linalg.solve(stiffness, -v_q.T @ (k * depth))
    x, y, _ = displacement.reshape(3, -1)
    return np.hypot(x, y)


def _checked_orders(given: Sequence[float | int] | None, own: float | None) -> list[float]:
    """The engine orders to show, each once; the scene's own is among them."""
    if given is None:
        given = (1.0,) if own is None else USUAL_ORDERS
    orders = list(dict.fromkeys(map(float, [*given, *([] if own is None else [own])])))
    if not orders or not all(0 < order < math.inf for order in orders):
        raise InputError(f"Argument `engine_orders` must be positive numbers, e.g. [1, 2, 4], but is {[*given]}.")
    if len(orders) > MAX_ORDERS:
        raise InputError(f"Argument `engine_orders` must be at most {MAX_ORDERS} numbers, but there are {len(orders)}.")
    return orders


def _end_of_range(modes: Sequence[NaturalMode], omega: float, speed: float) -> float:
    """The speed [rad/s] up to which crossings are told."""
    lowest = {mode.contact: mode.frequency for mode in reversed(modes)}
    return speed * max(SPEED_RANGE, BEYOND_LOWEST * RAD_PER_CYCLE * max(lowest.values()) / omega)


def _free_coordinates(arrays: Scene, free: dict[int, Amplitudes]) -> dict[str, Coordinate]:
    b, sines = arrays.mistuned_blades, [one for n, one in arrays.drive.harmonics().items() if n > 0]
    load, moving = lambda name: np.sum([abs(one.load(name)) for one in sines], axis=0), _without_mean(free)
    oscillators = {"x": (b.m, b.c_x, b.k_x), "y": (b.inertia_y, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    return {name: _coordinate(oscillators[name], load(name), free_reach(moving, name)) for name in arrays.parts.motion}


def _coordinate(oscillator: tuple[Any, Any, Any], load: np.ndarray, amplitude: np.ndarray) -> Coordinate:
    m, c, k = oscillator
    with np.errstate(divide="ignore", invalid="ignore"):
        resonant = np.where(load > 0, load / (c * np.sqrt(k / m)), 0.0)
    numbers = np.sqrt(k / m) / RAD_PER_CYCLE, c / (2 * np.sqrt(k * m)), load / k, amplitude, resonant
    return Coordinate(*map(_floats, numbers))


def _floats(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, numbers))
