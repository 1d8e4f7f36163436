"""The natural frequencies of a scene over its speed, where stiffnesses or the gap depend on that."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from jaxshroud.linear.held_contact import pressed_speeds
from jaxshroud.linear.natural_modes import (
    Growth,
    LinearContact,
    NaturalContact,
    order_crossings,
    speed_curves,
)
from jaxshroud.results.data_sheet import NaturalMode, SpeedLines
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.modes import ModalBlades
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import ORDER, check_speed
from jaxshroud.scene.typed import FloatArray
from jaxshroud.scene.vary import numbers_of
from jaxshroud.verbs.natural_frequencies import RAD_PER_CYCLE, modes_in, system_in_float64, words_for

SHOWN_SPEEDS = 49  # of a range, at which frequencies are given


def lines_of_speeds(
    arrays: Scene,
    system: LinearContact,
    modes: Sequence[NaturalMode],
    orders: Sequence[float],
    ends: tuple[float, float],
) -> SpeedLines:
    """The natural frequencies of modes over a range of speeds, and where engine orders meet them.

    Args:
        arrays: The scene, its numbers as NumPy arrays.
        system: Its blades and their contact at its own speed.
        modes: The modes that are given.
        orders: The engine orders.
        ends: The ends of the range [rad/s].

    Raises:
        InputError: A stiffness is negative at the end of the range.
    """
    blades = system_in_float64(system)
    growth = growth_of(arrays)
    _check_end(arrays, ends[1])
    pressed = [] if all(mode.contact == "apart" for mode in modes) else pressed_speeds(arrays, ends)
    changes = np.array([end for one in pressed for end in one])
    speeds = np.unique(np.concatenate([np.linspace(*ends, SHOWN_SPEEDS), changes, np.nextafter(changes, ends[1])]))
    frequencies, crossings = np.empty((len(modes), len(speeds))), np.empty((len(modes), len(orders)))
    for contact in cast(list[NaturalContact], list(dict.fromkeys(mode.contact for mode in modes))):
        chosen = [i for i, mode in enumerate(modes) if mode.contact == contact]
        every = modes_in(blades, contact, [0 * blades.free.mass], words_for(arrays))
        places = [_place_among(modes[i], every) for i in chosen]
        frequencies[chosen] = speed_curves(blades, contact, growth, speeds**2)[places] / RAD_PER_CYCLE
        crossings[chosen] = order_crossings(blades, contact, growth, orders)[places]
    for values, at in ((frequencies, np.broadcast_to(speeds, frequencies.shape)), (crossings, crossings)):
        values[_excluded(modes, at, pressed)] = np.nan

    def listed(a):
        return tuple(tuple(map(float, row)) for row in a)

    return SpeedLines(tuple(map(float, speeds)), listed(frequencies), listed(crossings), tuple(pressed))


def _place_among(mode: NaturalMode, every: Sequence[NaturalMode]) -> int:
    """The place of a mode that is given among all of its contact, of which it may stand for several."""
    alike = [i for i, other in enumerate(every) if (other.motion, other.frequency) == (mode.motion, mode.frequency)]
    return next((i for i in alike if every[i].blades == mode.blades), alike[0])


def growth_of(arrays: Scene) -> Growth:
    """How the stiffnesses of the blades of a scene grow, from NumPy arrays."""
    square = float(arrays.drive.omega / arrays.given[ORDER]) ** 2
    b = arrays.blades
    if isinstance(b, ModalBlades):
        own = [0 * mode.f if mode.B is None else mode.B for mode in b.modes]
        return Growth(np.concatenate(own).astype(float), square)
    pairs = ((b.B_x, b.m), (b.B_y, b.inertia_y), (b.B_T, b.I))
    by_square = np.concatenate([np.zeros_like(mass) if B is None else B * mass for B, mass in pairs]).astype(float)
    return Growth(by_square, square)


def _excluded(modes: Sequence[NaturalMode], speeds: FloatArray, pressed: Sequence[tuple[float, float]]) -> Any:
    """Where modes (modes, ...) are not in their state of contact; nowhere if the faces are pressed at no speed."""
    if not pressed:
        return np.zeros(speeds.shape, bool)
    together = np.any([(speeds >= start) & (speeds <= stop) for start, stop in pressed], axis=0)
    apart = np.array([mode.contact == "apart" for mode in modes])[:, None]
    return together == apart


def _check_end(arrays: Scene, stop: float) -> None:
    """Raise an InputError if a stiffness is negative at the highest speed of a range."""
    numbers = numbers_of(arrays) | {"drive.omega": np.asarray(stop * abs(arrays.given[ORDER]))}
    try:
        check_speed(numbers, arrays.given, arrays.layout.blades)
    except ValueError as error:
        raise InputError(f"{error}: let the range of speeds `stop` before.") from None
