"""Numbers of a scene replaced, and with them those that are worked out from them: arrays of NumPy or JAX by their keys.

The numbers of a scene are worked out where NumPy computes them in the same order as for a file, in float64: what `vary`
gives for a value is, bit for bit, what an override gives.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxshroud.scene.checks import KeyNameError
from jaxshroud.scene.derived_inputs import (
    DERIVED_BY_KEY,
    Numbers,
    alternative_keys,
    check_known,
    in_tables,
    worked_out,
)
from jaxshroud.scene.keys import ALL_KEYS, KEYS, find_key

NO_WIDTH = "The scene's contact is not smooth: it has no width."
STIFFNESS_KEYS = {"contact.k": "contact.gamma", "contact.gamma": "contact.k"}  # each drops the other


def replace_numbers(
    numbers: Numbers, given: Numbers, values: Mapping[str, Any], lanes: tuple[int, ...] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The numbers and the inputs of a scene with some replaced.

    Args:
        numbers: Key -> array, (..., 2) for a number per blade.
        given: The inputs by which the scene is given; None for a word.
        values: Key -> array, which broadcasts with the number, or, for one blade, with the blade's.
        lanes: The shape of the leading axes.

    Raises:
        KeyNameError: There is no such number, or the scene lacks what a key needs.
    """
    numbers, given = renamed_numbers(numbers, given, values, lanes)
    return numbers | worked_out(numbers, given, {find_key(key)[0].name for key in values}), given


def renamed_numbers(
    numbers: Numbers, given: Numbers, values: Mapping[str, Any], lanes: tuple[int, ...] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The same without anything worked out: other names for what the scene has."""
    numbers, given = dict(numbers), dict(given)
    for key, value in values.items():
        row, blade = find_key(key)
        check_known(key, given)
        if row.name == "contact.width" and row.name not in numbers:
            raise KeyNameError(NO_WIDTH)
        is_input = row.name in DERIVED_BY_KEY
        holder, xp = given if is_input else numbers, value.__array_namespace__()
        if blade is not None:
            old = holder.get(row.name, numbers["blades.m"])  # for a mass in y that is not there
            value = xp.where(np.arange(2) == blade, value[..., None], old)
        for other in (*alternative_keys(row.name), *([] if is_input else [row.name])):
            given.pop(other, None)
        numbers.pop(STIFFNESS_KEYS.get(row.name, ""), None)
        shape = np.broadcast_shapes(value.shape, (*lanes, 2) if row.pair else lanes)
        holder[row.name] = xp.broadcast_to(value, shape)
    return numbers, given


def replaced_tables(
    tables: Mapping[str, Mapping[str, Any]], given: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """The tables of a scene, as it is given, with numbers replaced.

    Args:
        tables: Its numbers and words.
        given: The inputs from which numbers were worked out.
        values: Key -> number or pair in SI units.
    """
    entries = {f"{table}.{name}": value for table, row in tables.items() for name, value in row.items()}
    words = {key: value for key, value in entries.items() if key not in KEYS}
    numbers = {key: _as_array(key, value) for key, value in entries.items() if key in KEYS}
    inputs = {key: None if value is None else _as_array(key, value) for key, value in given.items()}
    numbers, inputs = replace_numbers(numbers, inputs, {key: np.asarray(v, float) for key, v in values.items()})
    return in_tables(words | plain_numbers(numbers), plain_numbers(inputs))


def _as_array(key: str, value: Any) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, float), 2 if ALL_KEYS[key].pair else ())


def plain_numbers(numbers: Numbers) -> dict[str, float | list[float] | None]:
    """Numbers of one scene as in a file: one for equal blades, and pairs of different ones."""
    lists = {key: None if v is None else np.ravel(np.asarray(v, float)).tolist() for key, v in numbers.items()}
    return {key: v and (v[0] if len(set(v)) == 1 else v) for key, v in lists.items()}
