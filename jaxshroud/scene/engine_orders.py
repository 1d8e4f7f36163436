"""Engine orders of harmonics in files, in place of their orders: whole multiples of the engine order of the drive."""

import math
from collections.abc import Collection, Mapping
from typing import Any

from jaxshroud.scene.checks import SceneError, fail, toml_text
from jaxshroud.scene.key import ANY
from jaxshroud.scene.keys import MAX_ORDER, SINGLE_LOADS
from jaxshroud.scene.optional import HarmonicForm, harmonic_count, harmonic_forms, require_number
from jaxshroud.scene.speed import depends_on_speed, keys_in
from jaxshroud.scene.typed import is_number
from jaxshroud.scene.units import to_si

DriveTable = dict[str, Any]


def resolve_orders(
    document: dict[str, Any], name: str, overridden: Collection[tuple[str, str]] = ()
) -> tuple[HarmonicForm, ...]:
    """Check engine orders of harmonics, in place; how each harmonic is given, see `harmonic_forms`.

    Where [drive] has no engine order, the greatest common divisor of those of the harmonics becomes it, in rows without
    phases, beside a speed, and where the stiffness or the gap depends on that. Elsewhere orders take the place of
    engine orders.

    Raises:
        SceneError: An order is no multiple of that of the drive, or two harmonics have one order.
    """
    drive = document.get("drive")
    if not isinstance(drive, dict) or not (count := harmonic_count(drive)):
        return ()
    for entry in SINGLE_LOADS:
        if entry in drive:
            others = [f"drive.{other}" for other in drive if other != entry]
            require_number(f"drive.{entry}", others, "--set" if ("drive", entry) in overridden else name)
    of = [_own_engine_order(drive, i, name) for i in range(count)]
    if any(order is not None for order in of):
        tells = "speed" in drive or ("row" in document and "phase" not in drive) or depends_on_speed(keys_in(document))
        if "engine_order" not in drive and tells:
            drive["engine_order"] = _divisor(of, name)
        where = "--set" if ("drive", "engine_order") in overridden else name
        orders = _orders_of(drive, of, name, where)
        drive |= {f"harmonic[{i}].engine_order": order for i, order in enumerate(of) if order is not None}
        if "engine_order" not in drive:
            _set_orders(drive, orders)
    else:
        orders = {i: drive.get(f"harmonic[{i}].order") for i in range(count)}
    first: dict[Any, int] = {}
    for i, order in orders.items():
        if not isinstance(order, int | float):  # which is reported later
            continue
        if order in first:
            fail(name, f"[[drive.harmonic]] {first[order]} and {i} both have order {order}; make one of them")
        first[order] = i
    return harmonic_forms(drive)


def set_orders(drive: DriveTable, name: str) -> None:
    """Replace engine orders of the harmonics of a table [drive] by their orders, in place."""
    of = [_own_engine_order(drive, i, name) for i in range(harmonic_count(drive))]
    if any(order is not None for order in of):
        _set_orders(drive, _orders_of(drive, of, name, name))


def with_plain_entries(drive: Mapping[str, Any], engine_order: int | float) -> DriveTable:
    """The entries of a [drive] with that engine order, without engine orders of harmonics."""
    entries = {**drive, "engine_order": engine_order}
    set_orders(entries, "")
    return {name: value for name, value in entries.items() if name != "engine_order"}


def _set_orders(drive: DriveTable, orders: Mapping[int, Any]) -> None:
    for i, order in orders.items():
        if drive.pop(f"harmonic[{i}].engine_order", None) is not None:
            drive[f"harmonic[{i}].order"] = order


def _orders_of(drive: DriveTable, of: Collection[int | None], name: str, where: str) -> dict[int, Any]:
    """The order of each harmonic, given or by its engine order; none where that of the drive is no number."""
    base = _plain_number(drive["engine_order"]) if "engine_order" in drive else _divisor(of, name)
    orders = {i: drive.get(f"harmonic[{i}].order") for i in range(len(of))}
    if base is None:
        return {}
    return orders | {i: order_of(own, base, i, where) for i, own in enumerate(of) if own is not None}


def _plain_number(value: Any) -> int | float | None:
    """The number that a file gives; None for what is none, which is reported later."""
    try:
        number = to_si("", value)
    except ValueError:
        return None
    return number if is_number(number) and ANY.holds(number) else None


def _own_engine_order(drive: DriveTable, i: int, where: str) -> int | None:
    """The engine order of a harmonic; None where its order is given."""
    order = drive.get(f"harmonic[{i}].engine_order")
    if order is None:
        return None
    if f"harmonic[{i}].order" in drive:
        fail(where, f"[[drive.harmonic]] {i} gives both `order` and `engine_order`; keep one of them")
    if not is_number(order) or not ANY.holds(order) or order == 0 or order % 1:
        fail(where, f"[[drive.harmonic]] {i}: engine_order = {toml_text(order)} must be a whole number but 0, e.g. 8")
    return int(order)


def _divisor(orders: Collection[int | None], where: str) -> int:
    """The engine order of a drive whose harmonics have these."""
    given = [order for order in orders if order is not None]
    if len(given) < len(orders):
        fail(where, "[[drive.harmonic]]: some have an order and some an engine order; give drive.engine_order too")
    return math.gcd(*given) * (-1 if max(given) < 0 else 1)


def order_of(engine_order: int, base: int | float, i: int, where: str = "") -> int:
    """The order of harmonic i, from its engine order and that of the drive.

    Raises:
        SceneError: It is no whole multiple, or a too large one; the message begins with `where`, if it is given.
    """
    multiple = engine_order / base if base else 0.0
    if 1 <= multiple <= MAX_ORDER and not multiple % 1:
        return int(multiple)
    what = f"{where + ': ' if where else ''}[[drive.harmonic]] {i}: engine_order = {engine_order} is"
    if multiple > MAX_ORDER:
        raise SceneError(f"{what} more than {MAX_ORDER} times drive.engine_order = {base:g}; give a larger divisor")
    raise SceneError(
        f"{what} no whole multiple of drive.engine_order = {base:g}; "
        "leave drive.engine_order out, or give a divisor of all"
    )
