"""Data as engineers have them, turned into the numbers of a scene: frequencies, damping ratios, speeds.

| a file gives            | instead of     | by                                              |
|-------------------------|----------------|-------------------------------------------------|
| `blades.f_x`, `f_y`     | `k_x`, `k_y`   | k = m (2 pi f)^2                                |
| `blades.f_T`            | `k_T`          | k_T = I (2 pi f_T)^2                            |
| `blades.zeta_x`, `_y`   | `c_x`, `c_y`   | c = 2 zeta sqrt(k m)                            |
| `blades.zeta_T`         | `c_T`          | c_T = 2 zeta_T sqrt(k_T I)                      |
| `blades.I = "block"`    | a number       | I = m (l_oa^2 + l_ab^2) / 12, that of the block |
| `drive.f`               | `omega`        | omega = 2 pi f                                  |
| `drive.engine_order` and `drive.speed` | `omega` | omega = order times speed               |

Two keys for one quantity are an error, as with `gamma` and `k`. Sweeps and results know the numbers of the scene only.
"""

import math
from collections.abc import Callable, Collection
from functools import cache
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.keys import KEYS, OTHERS, Key
from jaxshroud.scene.messages import fail, shown, told
from jaxshroud.scene.schema import number

Document = dict[str, Any]
Values = tuple[float, ...]  # one per blade, or one of the whole


class Way(NamedTuple):
    """Another way to give a number."""

    keys: tuple[Key, ...]  # all of which are given
    number: Key  # of the scene
    needs: tuple[str, ...]  # other numbers
    formula: Callable[..., float]  # of the keys and then of what it needs


def _stiffness(f: float, mass: float) -> float:
    return mass * (math.tau * f) ** 2


def _damping(zeta: float, k: float, mass: float) -> float:
    return 2 * zeta * math.sqrt(k * mass)


def _ways(name: str, mass: str) -> tuple[Way, Way]:
    k, c = f"blades.k_{name}", f"blades.c_{name}"
    return _way([f"blades.f_{name}"], k, (mass,), _stiffness), _way([f"blades.zeta_{name}"], c, (k, mass), _damping)


def _way(keys: list[str], number: str, needs: tuple[str, ...], formula: Callable[..., float]) -> Way:
    return Way(tuple(row for row in OTHERS if row.name in keys), KEYS[number], needs, formula)


WAYS = (  # in the order in which they are worked out
    *_ways("x", "blades.m"),
    *_ways("y", "blades.m_y"),
    *_ways("T", "blades.I"),
    _way(["drive.f"], "drive.omega", (), lambda f: math.tau * f),
    _way(["drive.engine_order", "drive.speed"], "drive.omega", (), lambda order, speed: order * speed),
)
GIVEN = {key.name: way for way in WAYS for key in way.keys}


def instead_of(key: str) -> list[str]:
    """Keys that say what `key` says another way."""
    way = GIVEN.get(key)
    number = key if way is None else way.number.name
    if number not in {way.number.name for way in WAYS}:
        return []
    ways = [[number], *([one.name for one in way.keys] for way in WAYS if way.number.name == number)]
    return [name for names in ways if key not in names for name in names]


def work_out(document: Document, name: str, overridden: Collection[tuple[str, str]] = ()) -> None:
    """Put the numbers of a scene in the place of the other ways to give them, in a document, in place.

    Args:
        document: Of the scene file that messages call `name`.
        name: Of the file.
        overridden: Tables and keys that were set from outside, which messages say.

    Raises:
        SceneError: Two keys give one number, or a value is wrong.
    """
    _of_block(document)
    for way in WAYS:
        names = [key.parts[1] for key in way.keys]
        table, number = way.number.parts
        rows = document.get(table)
        if not isinstance(rows, dict) or not any(key in rows for key in names):
            continue
        where = "--set" if any((table, key) in overridden for key in names) else name
        lacks = [key for key in names if key not in rows]
        if lacks:
            fail(where, f"[{table}] lacks `{lacks[0]}`, which `{names[0] if lacks[0] != names[0] else names[1]}` needs")
        if number in rows:
            fail(where, f"[{table}] gives both `{names[0]}` and `{number}`; keep one of them")
        given = [_read(where, key, rows[key.parts[1]]) for key in way.keys]
        needed = [_needed(document, name) for name in way.needs]
        for key in names:
            del rows[key]
        rows[number] = _plain(way, [*given, *needed])


def _plain(way: Way, values: list[Values | None]) -> Any:
    """The number as a file would have it; an example where what it needs is missing or wrong, which is told later."""
    if any(v is None for v in values):
        return way.number.example
    known = [v for v in values if v is not None]
    blades = range(max(map(len, known)))
    found = [way.formula(*(v[min(i, len(v) - 1)] for v in known)) for i in blades]
    return found if way.number.pair else found[0]


@cache
def _adapter(key: Key):
    return TypeAdapter(number(key, key.pair))


def _read(where: str, key: Key, value: Any) -> Values:
    """A value as given in SI units, one per blade."""
    try:
        found = _adapter(key).validate_python(value)
    except ValidationError as error:
        table, name = key.parts
        about = f"e.g. {name} = {shown(key.example)} ({key.about})"
        fail(where, f"[{table}] {name} = {shown(value)} {told(error.errors()[0])}, {about}")
    return found if isinstance(found, tuple) else (found,)


def _needed(document: Document, name: str) -> Values | None:
    """A number that others follow from; None where it is missing or wrong."""
    key = KEYS[name]
    table, entry = key.parts
    rows = document.get(table)
    if entry == "m_y" and isinstance(rows, dict) and rows.get("m_y") is None:
        key, entry = KEYS["blades.m"], "m"
    try:
        found = _adapter(key).validate_python(rows.get(entry) if isinstance(rows, dict) else None)
    except ValidationError:
        return None
    return found if isinstance(found, tuple) else (found,)


def _of_block(document: Document) -> None:
    """The moment of inertia of the block itself, where a file says so."""
    rows = document.get("blades")
    if not isinstance(rows, dict) or not isinstance(rows.get("I"), str) or rows["I"].strip() != "block":
        return
    m, sides = _needed(document, "blades.m"), [_needed(document, f"shroud.{side}") for side in ("l_oa", "l_ab")]
    known = [side[0] for side in sides if side is not None]
    if m is None or len(known) < len(sides):
        rows["I"] = KEYS["blades.I"].example  # what is missing or wrong is told later
    else:
        rows["I"] = [mass * sum(side**2 for side in known) / 12 for mass in m]
