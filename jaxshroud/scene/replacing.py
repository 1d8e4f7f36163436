"""Numbers of a scene replaced, and with them those that are worked out from them: arrays of NumPy or JAX by their keys.

The numbers of a scene are worked out where NumPy computes them in the same order as for a file, in float64: the
scene that `vary` makes of a value is, bit for bit, that of an override.
"""

from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from jaxshroud.scene.checks import KeyNameError
from jaxshroud.scene.derived_inputs import (
    DERIVED_BY_KEY,
    Numbers,
    alternative_keys,
    check_known,
    in_tables,
    inputs_that_count,
    worked_out,
)
from jaxshroud.scene.engine_orders import with_plain_entries
from jaxshroud.scene.keys import ALL_KEYS, Key, find_key, number_shape
from jaxshroud.scene.layout import PAIR, Layout, row_layout
from jaxshroud.scene.optional import require_number, standing_for
from jaxshroud.scene.speed import ORDER, replaced_by, require_phases_of_order

STIFFNESS_KEYS = {"contact.k": "contact.gamma", "contact.gamma": "contact.k"}  # each drops the other


def replace_numbers(
    numbers: Numbers,
    given: Numbers,
    values: Mapping[str, Any],
    lanes: tuple[int, ...] = (),
    layout: Layout = PAIR,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The numbers and the inputs of a scene with some replaced.

    Args:
        numbers: Key -> array, (..., 2) for a number per blade.
        given: The inputs by which the scene is given; None for a word.
        values: Key -> array, which broadcasts with the number, or, for one blade, with the blade's.
        lanes: The shape of the leading axes.
        layout: The layout of the scene.

    Raises:
        KeyNameError: There is no such number, or the scene lacks what a key needs.
    """
    numbers, given = renamed_numbers(numbers, given, values, lanes, layout)
    changed = {find_key(key, layout=layout)[0].name for key in values}
    return numbers | worked_out(numbers, given, changed, layout), given


def renamed_numbers(
    numbers: Numbers,
    given: Numbers,
    values: Mapping[str, Any],
    lanes: tuple[int, ...] = (),
    layout: Layout = PAIR,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The same without anything worked out: other names for what the scene has."""
    numbers, given = dict(numbers), dict(given)
    for key, value in values.items():
        number, index = find_key(key, layout=layout)
        require_number(number.name, numbers)
        check_known(key, given, layout=layout)
        is_input = number.name in DERIVED_BY_KEY
        holder = given if is_input else numbers
        xp = value.__array_namespace__()
        own = number_shape(number, layout)
        if index is not None:
            value = xp.where(np.arange(*own) == index, value[..., None], _all_of(number, index, holder, numbers))
        others = alternative_keys(number.name, layout)
        require_phases_of_order(number.name, others, numbers)
        others = replaced_by(number.name, others, numbers)
        for other in (*others, *([] if is_input else [number.name])):
            given.pop(other, None)
        numbers.pop(STIFFNESS_KEYS.get(number.name, ""), None)
        holder[number.name] = xp.broadcast_to(value, np.broadcast_shapes(value.shape, (*lanes, *own)))
    return numbers, inputs_that_count(given, layout, numbers)


def _all_of(number: Key, index: int, holder: Numbers, numbers: Numbers) -> Any:
    """A number of all blades or interfaces, of which one is to be replaced."""
    require_own_stiffness(number.name, index, holder)
    return holder[number.name] if number.name in holder else standing_for(number.name, numbers)


def require_own_stiffness(name: str, index: int, present: Container[str], where: str = "") -> None:
    """Raise a KeyNameError for the stiffness of one interface where all are given by the other key, k or gamma."""
    other = STIFFNESS_KEYS.get(name)
    if other is not None and name not in present:
        cure = f"name {name} for all interfaces, or {other}[{index}]"
        raise KeyNameError(f"{where + ': ' if where else ''}the scene is given by {other}; {cure}")


def replaced_tables(
    tables: Mapping[str, Mapping[str, Any]], given: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """The tables of a scene, as it is given, with numbers replaced.

    Args:
        tables: Its numbers and words.
        given: The inputs from which numbers were worked out.
        values: Key -> number or pair in SI units.
    """
    layout = layout_of(tables)
    entries = _entries_of(tables)
    numbers = {key: _as_array(key, value, layout) for key, value in entries.items() if key in ALL_KEYS}
    inputs = {key: None if value is None else _as_array(key, value, layout) for key, value in given.items()}
    arrays = {key: np.asarray(v, float) for key, v in values.items()}
    numbers, inputs = replace_numbers(numbers, inputs, arrays, layout=layout)
    if ORDER in given and ORDER not in inputs:  # harmonics that followed it keep their orders
        entries = _entries_of({**tables, "drive": with_plain_entries(tables["drive"], given[ORDER])})
    words = {key: value for key, value in entries.items() if key not in ALL_KEYS}
    return in_tables(words | plain_numbers(numbers), plain_numbers(inputs), layout)


def _entries_of(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{table}.{name}": value for table, part in tables.items() for name, value in part.items()}


def layout_of(tables: Mapping[str, Any]) -> Layout:
    """The layout of a scene, from its tables: that of its row, or the pair."""
    return row_layout(tables["row"]["blades"], tables["row"]["closed"]) if "row" in tables else PAIR


def _as_array(key: str, value: Any, layout: Layout) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, float), number_shape(ALL_KEYS[key], layout))


def plain_numbers(numbers: Numbers) -> dict[str, float | list[float] | None]:
    """Numbers of one scene as in a file: one for equal blades, and pairs of different ones."""
    lists = {key: None if v is None else np.ravel(np.asarray(v, float)).tolist() for key, v in numbers.items()}
    return {key: v and (v[0] if len(set(v)) == 1 else v) for key, v in lists.items()}
