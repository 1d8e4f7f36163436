"""The engine order of a drive: that which its phases have, and the orders of harmonics that follow it.

A scene whose file gives engine orders of harmonics keeps which of them these are: another engine order of the drive
gives them other orders, and they excite at the same multiples of the speed.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.checks import InputError, SceneError
from jaxshroud.scene.drive import Drive
from jaxshroud.scene.engine_orders import order_of
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import ORDER

PHASE_ROUNDING = 1e-9  # [rad] by which phases may miss those of an engine order


def entries_of_orders(drive: Drive, given: Mapping[str, Any]) -> dict[str, int]:
    """The entries of a table [drive] that give the orders of the harmonics of one scene."""
    entries: dict[str, int] = {}
    for i, one in enumerate(drive.harmonic or ()):
        follows = one.by_engine_order and ORDER in given
        entries |= _engine_order_entry(one.order, given[ORDER], i) if follows else {f"harmonic[{i}].order": one.order}
    return entries


def _engine_order_entry(order: int, base: Any, i: int) -> dict[str, int]:
    return {f"harmonic[{i}].engine_order": round(order * float(base))}


def check_continuous(key: str, scene: Scene) -> None:
    """Raise a SceneError for a number between whose values lies nothing, such as a ring's engine order."""
    number, _ = find_key(key, layout=scene.layout)
    of_harmonics = number.name == ORDER and _follows(scene.drive)
    if number.range.whole or of_harmonics:
        kind = "a divisor of the engine orders of its harmonics" if of_harmonics else "a whole number"
        raise SceneError(f"{key} is {kind} here, which nothing can follow or differentiate; name another one")


def _follows(drive: Drive) -> bool:
    """Whether any harmonic follows the engine order of its drive."""
    return any(one.by_engine_order for one in drive.harmonic or ())


def drive_at_order(drive: Drive, before: Any, after: Any) -> Drive:
    """A drive whose engine order has changed, with the orders of the harmonics that follow it.

    Args:
        drive: The drive of one scene, or of many.
        before: The engine order, one for each scene.
        after: The new one; None: the scene has none any more, and its harmonics keep their orders.

    Raises:
        SceneError: The engine order of a harmonic is no whole multiple, or scenes differ in the orders that result.
        InputError: The engine orders are traced.
    """
    if after is before or not _follows(drive):
        return drive
    if after is None or before is None:
        return drive.with_orders([one.order for one in drive.harmonic or ()], by_engine_order=False)
    if is_traced((before, after)):
        raise InputError(
            f"{ORDER} gives the harmonics of this scene their orders, which no compiled function can change: "
            "vary it outside of JAX's transformations."
        )
    pairs = np.unique(np.stack([np.ravel(a) for a in np.broadcast_arrays(before, after)]), axis=1).T
    found = {_orders_at(drive, old, float(new)): float(new) for old, new in pairs}
    if len(found) > 1:
        (one, a), (other, b) = list(found.items())[:2]
        raise SceneError(
            f"{ORDER} = {a:g} and {b:g} give harmonics of different orders, {[*one]} and {[*other]}, which do not run "
            f"together; give one of them by itself, as by --set {ORDER}={a:g}"
        )
    return drive.with_orders(next(iter(found)), by_engine_order=True)


def _orders_at(drive: Drive, before: int | float, after: int | float) -> tuple[int, ...]:
    listed = drive.harmonic or ()
    return tuple(
        order_of(round(one.order * before), after, i) if one.by_engine_order else one.order
        for i, one in enumerate(listed)
    )


def order_of_drive(drive: Drive) -> int | None:
    """The engine order modulo N of a row with this drive: harmonic n has n times its phases; None if there is none."""
    orders = {n: order_of_phases(np.asarray(one.phase)) for n, one in drive.harmonics().items()}
    N = np.shape(drive.phase)[-1]
    return next((e for e in range(N) if all(order == n * e % N for n, order in orders.items())), None)


def order_of_phases(phase: np.ndarray) -> int | None:
    """The engine order modulo N of a row with the phases (N,) of its drive; None where they are those of none."""
    N = len(phase)
    order = round(N * (phase[1] - phase[0]) / math.tau) % N
    miss = phase - phase[0] - math.tau * order * np.arange(N) / N
    return None if np.max(np.abs(miss - math.tau * np.round(miss / math.tau))) > phase_rounding(phase) else order


def phase_rounding(phase: np.ndarray) -> float:
    """How much phases in their precision may miss those of an engine order [rad]."""
    return max(PHASE_ROUNDING, 16 * float(np.finfo(phase.dtype).eps * np.max(np.abs(phase))))
