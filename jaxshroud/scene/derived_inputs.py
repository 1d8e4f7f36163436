"""Derived inputs: frequencies, damping ratios and speeds, converted to the numbers of a scene.

| a file gives            | instead of     | by                                              |
|-------------------------|----------------|-------------------------------------------------|
| `blades.f_x`, `f_y`     | `k_x`, `k_y`   | k = m (2 pi f)^2                                |
| `blades.f_T`            | `k_T`          | k_T = I (2 pi f_T)^2                            |
| `blades.zeta_x`, `_y`   | `c_x`, `c_y`   | c = 2 zeta sqrt(k m)                            |
| `blades.zeta_T`         | `c_T`          | c_T = 2 zeta_T sqrt(k_T I)                      |
| `blades.I = "block"`    | a number       | I = m (l_oa^2 + l_ab^2) / 12, that of the block |
| `drive.f`               | `omega`        | omega = 2 pi f                                  |
| `drive.engine_order` and `drive.speed` | `omega` | omega = order times speed               |

Two keys for one quantity are an error, as with `gamma` and `k`. Sweeps and results only have the numbers of the scene.
"""

import math
from collections.abc import Callable, Collection
from functools import cache
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.keys import INPUT_KEYS, KEYS, Key
from jaxshroud.scene.messages import fail, problem_text, toml_text
from jaxshroud.scene.schema import number_type

Document = dict[str, Any]
Values = tuple[float, ...]  # one per blade, or one for the scene


class DerivedInput(NamedTuple):
    """An alternative way to give a number of a scene."""

    keys: tuple[Key, ...]  # the keys of a file, all of which are needed
    number: Key  # the number of the scene
    needs: tuple[str, ...]  # further numbers of the scene
    formula: Callable[..., float]  # a function of the keys and then of the further numbers


def _stiffness_from_frequency(f: float, mass: float) -> float:
    return mass * (math.tau * f) ** 2


def _damping_from_ratio(zeta: float, k: float, mass: float) -> float:
    return 2 * zeta * math.sqrt(k * mass)


def _modal_inputs(name: str, mass: str) -> tuple[DerivedInput, DerivedInput]:
    k, c = f"blades.k_{name}", f"blades.c_{name}"
    return _derived_input([f"blades.f_{name}"], k, (mass,), _stiffness_from_frequency), _derived_input(
        [f"blades.zeta_{name}"], c, (k, mass), _damping_from_ratio
    )


def _derived_input(keys: list[str], number: str, needs: tuple[str, ...], formula: Callable[..., float]) -> DerivedInput:
    return DerivedInput(tuple(row for row in INPUT_KEYS if row.name in keys), KEYS[number], needs, formula)


DERIVED_INPUTS = (  # in the order of their evaluation
    *_modal_inputs("x", "blades.m"),
    *_modal_inputs("y", "blades.m_y"),
    *_modal_inputs("T", "blades.I"),
    _derived_input(["drive.f"], "drive.omega", (), lambda f: math.tau * f),
    _derived_input(["drive.engine_order", "drive.speed"], "drive.omega", (), lambda order, speed: order * speed),
)
DERIVED_BY_KEY = {key.name: derived for derived in DERIVED_INPUTS for key in derived.keys}


def alternative_keys(key: str) -> list[str]:
    """The keys that give the same quantity as `key`."""
    derived = DERIVED_BY_KEY.get(key)
    number = key if derived is None else derived.number.name
    if number not in {derived.number.name for derived in DERIVED_INPUTS}:
        return []
    inputs = [derived for derived in DERIVED_INPUTS if derived.number.name == number]
    groups = [[number], *([row.name for row in derived.keys] for derived in inputs)]
    return [name for names in groups if key not in names for name in names]


def resolve_derived_inputs(document: Document, name: str, overridden: Collection[tuple[str, str]] = ()) -> None:
    """Replace derived inputs by the numbers of the scene, in place.

    Args:
        document: The document of a scene file.
        name: The name of the file in messages.
        overridden: The tables and keys that were overridden, for which messages name `--set`.

    Raises:
        SceneError: Two keys give one number, or a value is invalid.
    """
    _resolve_block_inertia(document)
    for derived in DERIVED_INPUTS:
        names = [key.parts[1] for key in derived.keys]
        table, number = derived.number.parts
        rows = document.get(table)
        if not isinstance(rows, dict) or not any(key in rows for key in names):
            continue
        where = "--set" if any((table, key) in overridden for key in names) else name
        missing = [key for key in names if key not in rows]
        if missing:
            fail(
                where,
                f"[{table}] lacks `{missing[0]}`, which `{names[0] if missing[0] != names[0] else names[1]}` needs",
            )
        if number in rows:
            fail(where, f"[{table}] gives both `{names[0]}` and `{number}`; keep one of them")
        given = [_given_values(where, key, rows[key.parts[1]]) for key in derived.keys]
        needed = [_required_values(document, name) for name in derived.needs]
        for key in names:
            del rows[key]
        rows[number] = _scene_value(derived, [*given, *needed])


def _scene_value(derived: DerivedInput, values: list[Values | None]) -> Any:
    """The number as in a file; an example where a value is missing or invalid, which is reported later."""
    if any(v is None for v in values):
        return derived.number.example
    given = [v for v in values if v is not None]
    blades = range(max(map(len, given)))
    numbers = [derived.formula(*(v[min(i, len(v) - 1)] for v in given)) for i in blades]
    return numbers if derived.number.pair else numbers[0]


@cache
def _adapter(key: Key):
    return TypeAdapter(number_type(key, key.pair))


def _given_values(where: str, key: Key, value: Any) -> Values:
    """The given value in SI units, one per blade."""
    try:
        values = _adapter(key).validate_python(value)
    except ValidationError as error:
        table, name = key.parts
        about = f"e.g. {name} = {toml_text(key.example)} ({key.about})"
        fail(where, f"[{table}] {name} = {toml_text(value)} {problem_text(error.errors()[0])}, {about}")
    return values if isinstance(values, tuple) else (values,)


def _required_values(document: Document, name: str) -> Values | None:
    """A number on which others depend, one per blade; None where it is missing or invalid."""
    key = KEYS[name]
    table, entry = key.parts
    rows = document.get(table)
    if entry == "m_y" and isinstance(rows, dict) and rows.get("m_y") is None:
        key, entry = KEYS["blades.m"], "m"
    try:
        values = _adapter(key).validate_python(rows.get(entry) if isinstance(rows, dict) else None)
    except ValidationError:
        return None
    return values if isinstance(values, tuple) else (values,)


def _resolve_block_inertia(document: Document) -> None:
    """Replace `I = "block"` by the moment of inertia of the block."""
    rows = document.get("blades")
    if not isinstance(rows, dict) or not isinstance(rows.get("I"), str) or rows["I"].strip() != "block":
        return
    m, sides = (
        _required_values(document, "blades.m"),
        [_required_values(document, f"shroud.{side}") for side in ("l_oa", "l_ab")],
    )
    lengths = [side[0] for side in sides if side is not None]
    if m is None or len(lengths) < len(sides):
        rows["I"] = KEYS["blades.I"].example  # missing or invalid values are reported later
    else:
        rows["I"] = [mass * sum(side**2 for side in lengths) / 12 for mass in m]
