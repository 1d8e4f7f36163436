"""The data sheet of a scene: its numbers in an engineer's terms, natural frequencies, engine orders, and doubts."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.march.stability import contact_gradients, steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import corners, gyration
from jaxshroud.model.linear import Amplitudes, steady_amplitudes
from jaxshroud.motion.averages import half_diagonal
from jaxshroud.programs.kept import kept
from jaxshroud.results.campbell import NaturalMode, crossings_between
from jaxshroud.results.data_sheet import Coordinate, DataSheet
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.engine_order import engine_order_of
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.doubts import doubts_of
from jaxshroud.verbs.lanes import one_scene
from jaxshroud.verbs.natural_frequencies import RAD_PER_CYCLE, modes_of

UPPER_CORNERS = 1  # the case whose corners are looked at
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
            1 to 6. Where the scene tells only the frequency of its drive, its own is the first one, by default 1.
        start: Where the range of speeds begins [rad/s].
        stop: Where it ends; by default beyond the scene's own speed and the lowest natural frequencies.

    Returns:
        The data sheet. Its amplitudes are those of the free blades, in closed form, which contact is to reduce. Its
        natural frequencies do not depend on the speed: there is no centrifugal stiffening.

    Raises:
        ValueError: There are many scenes, or the engine orders or the range of speeds are none.

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
    arrays = jax.tree.map(np.asarray, scene)
    free, k, gyration_of_block, lever, gradients = jax.tree.map(np.asarray, _free_and_touching(scene))
    b, s = arrays.blades, arrays.shroud
    across, along = _relative_motion(free, float(s.alpha))
    modes = modes_of(arrays, float(k), gradients)
    sheet = DataSheet(
        coordinates=_free_coordinates(arrays, free),
        drive=float(arrays.drive.omega) / RAD_PER_CYCLE,
        gap=float(s.gap),
        approach=across / math.sin(s.alpha),
        corner=_float_pair(lever * np.abs(free.theta)),
        inertia=_float_pair(b.I / (b.m * gyration_of_block)),
        gamma=float(k / b.k_x[0]),
        omega_max=stiffest(scene, 0)[0],
        steps=steps_for(scene, 0, "auto", RK4),
        doubts=(),
        slide=along,
        modes=modes,
        **_over_speed(scene, modes, engine_orders, start, stop),
    )
    return replace(sheet, doubts=tuple(doubts_of(sheet, scene)))


def _over_speed(
    scene: Scene, modes: Sequence[NaturalMode], given: Sequence[float | int] | None, start: float, stop: float | None
) -> dict[str, Any]:
    """The fields of the data sheet on engine orders, from the arguments of `check`."""
    own, omega = engine_order_of(scene), float(scene.drive.omega)
    orders = _checked_orders(given, own)
    drive_order = own or orders[0]
    speed = omega / drive_order
    stop = _end_of_range(modes, omega, speed) if stop is None else float(stop)
    if not 0 <= start < stop < math.inf:
        raise InputError(f"The speeds from `start` to `stop` must be a range from 0 on, but are {start:g} to {stop:g}.")
    orders = tuple(sorted(orders))
    return {
        **{"drive_order": drive_order, "is_own_order": own is not None, "engine_orders": orders},
        **{"speed": speed, "start": float(start), "stop": stop},
        "crossings": crossings_between(modes, orders, speed, start, stop),
    }


@kept()
def _free_and_touching(scene: Scene) -> tuple[Amplitudes, Scalar, Scalar, Scalar, tuple[Float[Array, "6"], ...]]:
    """The amplitudes of the free blades, the contact's stiffness, a block's gyration, half its diagonal, and gradients.

    These are dv/dq and du/dq where the upper corners meet: there is no gap between them.
    """
    touching = corners(scene.shroud, scene.contact.reading)._replace(gap=jnp.zeros_like(scene.shroud.gap))
    gradients = contact_gradients(UPPER_CORNERS, touching, jnp.concatenate([scene.blades.m] * 3))
    return steady_amplitudes(scene), scene.k, gyration(scene.shroud), half_diagonal(scene.shroud), gradients


def _relative_motion(free: Amplitudes, alpha: float) -> tuple[float, float]:
    """The amplitudes of the free faces' motion across and along each other, without rotation [m]."""
    x, y = free.x[0] - free.x[1], free.y[0] - free.y[1]
    across, along = x * math.sin(alpha) - y * math.cos(alpha), x * math.cos(alpha) + y * math.sin(alpha)
    return float(abs(across)), float(abs(along))


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


def _free_coordinates(arrays: Scene, free: Amplitudes) -> dict[str, Coordinate]:
    b, d = arrays.blades, arrays.drive
    loads = {"x": d.F_0 * np.cos(d.beta), "y": d.F_0 * np.sin(d.beta), "theta": d.M_0}
    oscillators = {"x": (b.m, b.c_x, b.k_x), "y": (b.inertia_y, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    return {
        name: _coordinate(oscillators[name], np.abs(loads[name]), np.abs(getattr(free, name)))
        for name in arrays.parts.motion
    }


def _coordinate(oscillator: tuple[Any, Any, Any], load: np.ndarray, amplitude: np.ndarray) -> Coordinate:
    m, c, k = oscillator
    with np.errstate(divide="ignore", invalid="ignore"):
        resonant = np.where(load > 0, load / (c * np.sqrt(k / m)), 0.0)
    numbers = np.sqrt(k / m) / RAD_PER_CYCLE, c / (2 * np.sqrt(k * m)), load / k, amplitude, resonant
    return Coordinate(*map(_float_pair, numbers))


def _float_pair(pair: np.ndarray) -> tuple[float, float]:
    return float(pair[0]), float(pair[1])
