"""The sector of a ring: the blades after which all of it repeats, forces too, so that a smaller ring moves alike.

A ring of N alike blades under excitations whose orders have the greatest common divisor g with N is g equal rings of
N / g blades: blade i + N / g moves as blade i. This holds of motions that start so, and of no others.
"""

import math
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.drive import Drive
from jaxshroud.scene.drive_orders import order_of_drive, phase_rounding
from jaxshroud.scene.keys import ALL_KEYS, MIN_BLADES, number_shape
from jaxshroud.scene.scene import Row, Scene
from jaxshroud.scene.vary import field_of, fields_of

ASKED = '`row.sector` = "auto"'


def require_sector(scene: Scene) -> None:
    """Raise an InputError where a scene, or many, asks for its sector and has none."""
    if not asks_for_sector(scene):
        return
    if not _is_built_in(scene):
        raise InputError(f"{ASKED} does not know your own drives and laws; drop it.")
    if (key := _unlike(scene)) is not None:
        raise InputError(f"{ASKED} needs alike blades and interfaces, but {key} differs along the row; drop it.")
    if sector_blades(scene) == scene.layout.blades:
        raise InputError(f"{ASKED} {_why_none(scene)}; drop it.")


def asks_for_sector(scene: Scene) -> bool:
    """Whether a scene is to be marched by its sector."""
    return scene.row is not None and scene.row.sector == "auto"


def sector_blades(scene: Scene) -> int:
    """The fewest blades of a ring that moves as a scene, or as each of many, does; all where there is none smaller."""
    blades = scene.layout.blades
    if not scene.layout.closed or not _is_built_in(scene) or _unlike(scene) is not None:
        return blades
    sizes = (n for n in range(MIN_BLADES, blades) if blades % n == 0)
    return next((n for n in sizes if _phases_repeat(scene.drive, n)), blades)


def smaller_ring(scene: Scene, blades: int) -> Scene:
    """The ring of the first blades of a scene, or of many, which is marched whole; its speed is that of the scene."""
    keys = [key for key, _ in _along_row(scene) if key != "row.mistuning"]

    def places(s):
        return [field_of(s, key) for key in keys]

    fewer = eqx.tree_at(places, scene, [a[..., :blades] for a in places(scene)])
    assert scene.row is not None  # of which it is the sector
    return _with_row(fewer, Row(blades, True), scene.row.mistuning[..., :blades])


def smallest_ring(scene: Scene) -> tuple[Scene, int]:
    """The smallest ring that moves as a scene, or as each of many, does, and how many copies of it make the whole one.

    It is for motions that depend on no start: those in closed form.
    """
    blades = scene.layout.blades
    n = sector_blades(scene)
    return (whole_ring(scene), 1) if n == blades else (smaller_ring(scene, n), blades // n)


def has_period_of_blades(scene: Scene, blades: int) -> bool:
    """Whether all numbers along the row, phases too, repeat after so many blades."""
    numbers = (np.asarray(value) for _, value in _along_row(scene))
    return all(np.array_equal(a, np.roll(a, -blades, axis=-1)) for a in numbers)


def whole_ring(scene: Scene) -> Scene:
    """The same scene, or many, marched whole."""
    row = scene.row
    return scene if row is None else _with_row(scene, Row(row.blades, row.closed), row.mistuning)


def _with_row(scene: Scene, row: Row, mistuning: Any) -> Scene:
    row = eqx.tree_at(lambda row: row.mistuning, row, mistuning)
    return eqx.tree_at(lambda s: s.row, scene, row, is_leaf=lambda part: isinstance(part, Row))


def _is_built_in(scene: Scene) -> bool:
    """Whether all numbers of a scene are known, and which of them are along its row."""
    return scene.laws is None and type(scene.drive) is Drive


def _along_row(scene: Scene) -> Iterator[tuple[str, Any]]:
    """The numbers of a scene, or of many, that have an axis of blades or interfaces, by their keys."""
    for key, value in fields_of(scene).items():
        if number_shape(ALL_KEYS[key], scene.layout):
            yield key, value


def _unlike(scene: Scene) -> str | None:
    """The key of a number that is not alike at all blades or interfaces, phases left out; None if all are."""
    for key, value in _along_row(scene):
        numbers = np.asarray(value)
        if key != "drive.phase" and np.any(numbers != numbers[..., :1]):
            return key
    return None


def _phases_repeat(drive: Drive, blades: int) -> bool:
    """Whether the phases of all harmonics repeat after so many blades, in whole turns."""
    for one in drive.harmonics().values():
        phase = np.asarray(one.phase)
        turns = (np.roll(phase, -blades, axis=-1) - phase).astype(float) / math.tau
        rounding = phase_rounding(phase)
        if np.max(np.abs(turns - np.round(turns))) > rounding:
            return False
    return True


def _why_none(scene: Scene) -> str:
    """Why a ring of alike blades has no sector."""
    if not np.ndim(scene.drive.omega) and order_of_drive(scene.drive) is None:
        return "needs an engine order, but the phases of this drive are those of none"
    return f"gains nothing: no smaller ring of at least {MIN_BLADES} blades repeats in one of {scene.layout.blades}"
