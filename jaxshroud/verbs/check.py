"""The data sheet of a scene: its numbers in an engineer's terms, natural frequencies, engine orders, and doubts."""

import math
from collections.abc import Sequence
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
from jaxshroud.model.linear_systems import touching_gradients
from jaxshroud.model.natural_modes import LinearContact, drive_loads, linear_contact
from jaxshroud.results.data_sheet import Coordinate, DataSheet, FlowMode, NaturalMode, crossings_between
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import engine_order_of
from jaxshroud.scene.typed import typed
from jaxshroud.signals.averages import half_diagonal
from jaxshroud.verbs.arguments import check_row, one_scene
from jaxshroud.verbs.campbell_lines import lines_of_speeds
from jaxshroud.verbs.doubts import LEAST_DRIVEN, advice_on, doubts_of
from jaxshroud.verbs.natural_frequencies import RAD_PER_CYCLE, flow_modes, modes_of
from jaxshroud.verbs.settled import has_settled_motion, settled_motion

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
        natural frequencies are those at the scene's own speed; where they depend on it, `over_speed` has them over the
        range, of blades in contact up to the speed at which their faces are no longer pressed together at rest, and of
        blades apart beyond. Of a row of blades there is
        a number for each blade and each interface; `gap` is the smallest, and what is told of the free faces is of the
        interface where they approach most. Its natural modes are those with all interfaces in one state of contact, of
        a ring by nodal diameters; in a tuned ring an engine order EO excites nodal diameter EO modulo N alone. Of a row
        in a flow, `flow_modes` are the damping ratios of free decays along x without contact.

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
    b, s = arrays.mistuned_blades, arrays.running_shroud
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
        settled=settled_motion(scene) if has_settled_motion(scene) else None,
        modes=modes,
        pressed=_floats(_displaced_by_interference(system, gaps, float(s.alpha))),
        **({} if scene.row is None else _at_interfaces(arrays, k, across / math.sin(s.alpha), along)),
        **({"flow_modes": _modes_in_flow(arrays, system)} if scene.aero.exists else {}),
        **_over_speed(scene, arrays, system, modes, engine_orders, (float(start), stop)),
    )
    return replace(sheet, doubts=tuple(doubts_of(sheet, scene)), advice=tuple(advice_on(sheet, scene)))


def _at_interfaces(arrays: Scene, k: np.ndarray, approach: np.ndarray, slide: np.ndarray) -> dict[str, Any]:
    """The fields of the data sheet on each interface of a row."""
    assert arrays.row is not None
    numbers = {"gaps": np.asarray(arrays.running_shroud.gap), "approaches": approach, "slides": slide}
    return {
        **{name: _floats(a) for name, a in numbers.items()},
        "gammas": _floats(k / arrays.blades.k_x[: len(k)]),
        "closed": arrays.row.closed,
    }


def _modes_in_flow(arrays: Scene, system: LinearContact) -> tuple[FlowMode, ...]:
    """The modes of a row in a flow."""
    assert arrays.row is not None  # which scenes with forces of the flow have
    row, aero = jax.tree.map(lambda a: a if a.dtype == bool else a.astype(float), system), arrays.aero
    count, omega = arrays.row.blades, float(arrays.drive.omega)
    after = np.eye(count, k=1) + (np.eye(count, k=1 - count) if arrays.row.closed else 0)
    parts = ((aero.L0_im, np.eye(count)), (aero.L1_im, after), (aero.L_1_im, after.T))
    flow = sum((float(L) / omega * to for L, to in parts if L is not None), np.zeros((count, count)))
    return flow_modes(row, flow, arrays.row.closed)


def _over_speed(
    scene: Scene,
    arrays: Scene,
    system: LinearContact,
    modes: Sequence[NaturalMode],
    given: Sequence[float | int] | None,
    ends: tuple[float, float | int | None],
) -> dict[str, Any]:
    """The fields of the data sheet on engine orders, from the arguments of `check`."""
    start, stop = ends
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
    lines = lines_of_speeds(arrays, system, modes, orders, (start, stop)) if scene.depends_on_speed else None
    return {
        **{"drive_order": drive_order, "is_own_order": own is not None, "engine_orders": orders},
        "harmonics": tuple(excited),
        **{"speed": speed, "start": float(start), "stop": stop},
        "crossings": crossings_between(modes, orders, speed, start, stop, scene.layout, lines),
        "over_speed": lines,
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

    def unbounded(a):
        return np.where(np.isnan(a), np.inf, np.abs(a))

    return unbounded(across), unbounded(along)


def _displaced_by_interference(system: LinearContact, gaps: np.ndarray, alpha: float) -> np.ndarray:
    """The displacement of each block where interference presses the faces together, at rest, (blades,) [m].

    The faces slide freely, and the blocks do not turn.
    """
    bends = system.moves & (np.arange(len(system.moves)) < 2 * len(system.moves) // 3)
    of_each = len(system.k) // len(gaps)  # one, or as many as a face has points
    depth = np.repeat(np.maximum(-gaps, 0.0), of_each) * math.sin(alpha)
    v_q, k = system.v_q[:, bends], np.where(depth > 0, system.k, 0.0)
    displacement = np.zeros(len(system.moves))
    stiffness = system.own_stiffness[np.ix_(bends, bends)] + v_q.T @ (k[:, None] * v_q)
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
