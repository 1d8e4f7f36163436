"""The data sheet of a scene: its numbers in an engineer's terms, natural frequencies, engine orders, and doubts."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxshroud.batch.xla import one_lane
from jaxshroud.cache.programs import kept
from jaxshroud.linear.held_contact import displaced_by_interference
from jaxshroud.linear.natural_modes import LinearContact, drive_loads, linear_contact
from jaxshroud.march.stability import steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import steady_amplitudes, waves_of
from jaxshroud.model.linear_system import flow_matrix
from jaxshroud.model.steady_numbers import steady_peak
from jaxshroud.results.data_sheet import Coordinate, DataSheet, FlowMode, NaturalMode, crossings_between
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.speed import engine_order_of
from jaxshroud.scene.typed import typed
from jaxshroud.signals.averages import half_diagonal
from jaxshroud.verbs.campbell_lines import lines_of_speeds
from jaxshroud.verbs.doubts import LEAST_DRIVEN, advice_on, doubts_of
from jaxshroud.verbs.lanes import check_row, one_scene
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
        engine_orders: Engine orders whose crossings with natural frequencies are given; by default the scene's own and
            1 to 6. Where the scene gives only the frequency of its drive, its own is the first one, by default 1. Those
            of all harmonics of the drive are among them.
        start: Where the range of speeds begins [rad/s].
        stop: Where it ends; by default beyond the scene's own speed and the lowest natural frequencies.

    Returns:
        The data sheet. Its amplitudes are those of the free blades, in closed form, which contact is to reduce. Its
        natural frequencies are those at the scene's own speed; where they depend on it, `over_speed` has them over the
        range, of blades in contact up to the speed at which their faces are no longer pressed together at rest, and of
        blades apart beyond. Of a row of blades there is
        a number for each blade and each interface; `gap` is the smallest, and what is given of the free faces is of the
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
    gaps = np.atleast_1d(s.gap) - (0.0 if free.closing is None else free.closing / math.sin(s.alpha))
    nearest = int(np.argmax(free.across))
    modes = modes_of(arrays, k, system, load)
    sheet = DataSheet(
        coordinates=_free_coordinates(arrays, free),
        drive=float(arrays.drive.omega) / RAD_PER_CYCLE,
        gap=float(np.min(s.gap)),
        **({} if free.closing is None else {"static_gaps": _floats(gaps)}),
        approach=float(free.across[nearest]) / math.sin(s.alpha),
        corner=_floats(lever * free.peaks["theta"]),
        inertia=_floats(b.I / (b.m * gyration_of_block)),
        gamma=float(k[0] / arrays.resting_blades.k_x[0]),
        omega_max=stiffest(scene, 0)[0],
        steps=steps_for(scene, 0, "auto", RK4),
        doubts=(),
        slide=float(free.along.max()),
        settled=settled_motion(scene) if has_settled_motion(scene) else None,
        modes=modes,
        pressed=_floats(displaced_by_interference(one_lane(without_given(scene)), gaps)),
        in_phase=float(free.in_phase) if scene.row is None else math.nan,
        **({} if scene.row is None else _at_interfaces(arrays, k, free.across / math.sin(s.alpha), free.along)),
        **({"flow_modes": _modes_in_flow(arrays, system)} if scene.aero.exists and system.shroud is None else {}),
        **_over_speed(scene, arrays, system, modes, engine_orders, (float(start), stop)),
    )
    return replace(sheet, doubts=tuple(doubts_of(sheet, scene)), advice=tuple(advice_on(sheet, scene)))


def _at_interfaces(arrays: Scene, k: np.ndarray, approach: np.ndarray, slide: np.ndarray) -> dict[str, Any]:
    """The fields of the data sheet on each interface of a row."""
    assert arrays.row is not None
    numbers = {"gaps": np.asarray(arrays.running_shroud.gap), "approaches": approach, "slides": slide}
    return {
        **{name: _floats(a) for name, a in numbers.items()},
        "gammas": _floats(k / arrays.resting_blades.k_x[: len(k)]),
        "closed": arrays.row.closed,
    }


def _modes_in_flow(arrays: Scene, system: LinearContact) -> tuple[FlowMode, ...]:
    """The modes of a row in a flow."""
    assert arrays.row is not None  # which scenes with forces of the flow have
    return flow_modes(system.free, flow_matrix(arrays, "c"), arrays.row.closed)


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
    own = engine_order_of(scene)
    omega = float(scene.drive.omega)
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


class FreeMotion(NamedTuple):
    """The steady motion of the blades without contact, under all harmonics of the drive."""

    peaks: dict[str, Any]  # (blades,) amplitude of x, y [m] and theta [rad] about its mean
    loads: dict[str, Any]  # (blades,) largest load on each [N or N m]
    strongest: dict[str, Any]  # (blades,) the largest amplitude of any harmonic of it
    across: Any  # (interfaces,) amplitude of the faces' motion across each other, without rotation [m]
    along: Any  # (interfaces,) of that along each other
    closing: Any  # (interfaces,) across each other under mean loads [m]; None without these
    in_phase: Any  # share of the mean square of x and y in which the first two blades move alike; NaN at rest


@kept()
def _free_and_touching(
    scene: Scene,
) -> tuple[FreeMotion, Float[Array, "..."], Scalar, Scalar, LinearContact, dict[int, Array]]:
    """The free motion, the stiffness of contact, a block's gyration, half its diagonal, a linear system.

    The system and the load on it are those of blades whose upper corners meet: there is no gap between them.
    """
    shroud = scene.shroud
    system = linear_contact(scene)
    return _motion_apart(scene), scene.k, gyration(shroud), half_diagonal(shroud), system, drive_loads(scene)


def _motion_apart(scene: Scene) -> FreeMotion:
    free = steady_amplitudes(scene)
    alpha, interfaces = scene.shroud.alpha, scene.layout.interfaces
    mean = free.get(0)
    sines = {n: one for n, one in scene.drive.harmonics().items() if n > 0}
    loads = {name: {n: lax.complex(*one.parts(name)) for n, one in sines.items()} for name in COORDINATES}
    shifts = {n: (x, y) for (n, x), y in zip(waves_of(free, "x").items(), waves_of(free, "y").values(), strict=True)}
    faces = {n: _motion_of_faces(x, y, alpha, interfaces) for n, (x, y) in shifts.items()}
    return FreeMotion(
        peaks={name: steady_peak(waves_of(free, name)) for name in COORDINATES},
        loads={name: steady_peak(load) for name, load in loads.items()},
        strongest={name: jnp.max(jnp.abs(jnp.stack([*load.values()])), axis=0) for name, load in loads.items()},
        across=steady_peak({n: across for n, (across, _) in faces.items()}),
        along=steady_peak({n: along for n, (_, along) in faces.items()}),
        closing=None if mean is None else _motion_of_faces(mean.x, mean.y, alpha, interfaces)[0].imag,
        in_phase=_share_in_phase([a[:2] for pair in shifts.values() for a in pair]),
    )


def _motion_of_faces(x: Any, y: Any, alpha: Scalar, interfaces: int) -> tuple[Any, Any]:
    """The complex amplitudes of the faces' motion across and along each other, of those of the blades."""
    x, y = ((a - jnp.roll(a, -1))[:interfaces] for a in (x, y))
    n, t = (jnp.sin(alpha), -jnp.cos(alpha)), (jnp.cos(alpha), jnp.sin(alpha))

    def along(direction):
        to_x, to_y = direction
        a = lax.complex(x.real * to_x + y.real * to_y, x.imag * to_x + y.imag * to_y)
        return jnp.where(jnp.isnan(a), jnp.inf, a)  # infinity minus infinity

    return along(n), along(t)


def _share_in_phase(waves: Sequence[Any]) -> Scalar:
    """The share of the mean square of complex amplitudes (2,) in which both are one; NaN where all are 0 or inf."""
    parts = jnp.stack([part for wave in waves for part in (wave.real, wave.imag)])
    return jnp.sum(jnp.square(jnp.sum(parts, axis=-1))) / (2 * jnp.sum(jnp.square(parts)))


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
    """The speed [rad/s] up to which crossings are given."""
    lowest = {mode.contact: mode.frequency for mode in reversed(modes)}
    return speed * max(SPEED_RANGE, BEYOND_LOWEST * RAD_PER_CYCLE * max(lowest.values()) / omega)


def _free_coordinates(arrays: Scene, free: FreeMotion) -> dict[str, Coordinate]:
    modes = arrays.mode_numbers
    own = arrays.mistuned_blades.oscillators if modes is None else modes.main_oscillators
    return {name: _coordinate(own[name], free, name) for name in arrays.parts.motion}


def _coordinate(oscillator: tuple[Any, Any, Any], free: FreeMotion, name: str) -> Coordinate:
    m, c, k = oscillator
    strongest = free.strongest[name]
    with np.errstate(divide="ignore", invalid="ignore"):
        resonant = np.where(strongest > 0, strongest / (c * np.sqrt(k / m)), 0.0)
    return Coordinate(
        frequency=_floats(np.sqrt(k / m) / RAD_PER_CYCLE),
        zeta=_floats(c / (2 * np.sqrt(k * m))),
        static=_floats(free.loads[name] / k),
        amplitude=_floats(free.peaks[name]),
        resonant=_floats(resonant),
    )


def _floats(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, numbers))
