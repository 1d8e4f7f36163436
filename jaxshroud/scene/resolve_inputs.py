"""The derived inputs of a scene file: checked, and replaced by the numbers of the scene."""

from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.derived_inputs import BLOCK, DERIVED_INPUTS, DerivedInput
from jaxshroud.scene.keys import ALL_KEYS, KEYS, Key
from jaxshroud.scene.messages import fail, problem_text, toml_text
from jaxshroud.scene.replacing import plain_numbers
from jaxshroud.scene.schema import number_type

Document = dict[str, Any]
Values = tuple[float, ...]  # one per blade, or one for the scene
GivenValues = dict[str, Any]  # key -> a number in SI units, or a pair; None for a word in place of a number


def resolve_derived_inputs(document: Document, name: str, overridden: Collection[tuple[str, str]] = ()) -> GivenValues:
    """Replace derived inputs by the numbers of the scene, in place.

    Args:
        document: The document of a scene file.
        name: The name of the file in messages.
        overridden: The tables and keys that were overridden, for which messages name `--set`.

    Returns:
        The inputs that were given.

    Raises:
        SceneError: Two keys give one number, or a value is invalid.
    """
    given: GivenValues = {}
    for derived in DERIVED_INPUTS:
        table, number = derived.number.parts
        rows = document.get(table)
        if isinstance(rows, dict) and _is_given(derived, rows):
            where = "--set" if any((table, key.parts[1]) in overridden for key in derived.keys) else name
            values = _taken(derived, rows, where)
            needed = [_required_values(document, row) for row in derived.needs]
            rows[number] = _scene_value(derived, values, needed)
            given |= plain_numbers(dict(zip(derived.marks, values or [None], strict=True)))
    return given


def _is_given(derived: DerivedInput, rows: Document) -> bool:
    """Whether a table gives any key of an input, or its word."""
    if derived.keys:
        return any(key.parts[1] in rows for key in derived.keys)
    word = rows.get(derived.number.parts[1])
    return isinstance(word, str) and word.strip() == BLOCK


def _taken(derived: DerivedInput, rows: Document, where: str) -> list[Values]:
    """The values of the keys of an input, which are removed from their table."""
    names, (table, number) = [key.parts[1] for key in derived.keys], derived.number.parts
    missing = [key for key in names if key not in rows]
    if missing:
        present = next(key for key in names if key in rows)
        fail(where, f"[{table}] lacks `{missing[0]}`, which `{present}` needs")
    if names and number in rows:
        fail(where, f"[{table}] gives both `{names[0]}` and `{number}`; keep one of them")
    return [_given_values(where, key, rows.pop(key.parts[1])) for key in derived.keys]


def _scene_value(derived: DerivedInput, values: list[Values], needed: list[Values | None]) -> Any:
    """The number as in a file; an example where a value is missing or invalid, which is reported later."""
    known = {row.name: v for row, v in zip(derived.needs, needed, strict=True) if v is not None}
    if len(known) < len(derived.needs):
        return derived.number.example
    given = {row.name: v for row, v in zip(derived.keys, values, strict=True)}
    arrays = lambda part: {key: np.asarray(v if ALL_KEYS[key].pair else v[0]) for key, v in part.items()}
    return np.asarray(derived.value(arrays(known), arrays(given))).tolist()


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


def _required_values(document: Document, row: Key) -> Values | None:
    """A number on which others depend, one per blade; None where it is missing or invalid."""
    table, entry = row.parts
    rows = document.get(table)
    if entry == "m_y" and isinstance(rows, dict) and rows.get("m_y") is None:
        row, entry = KEYS["blades.m"], "m"
    try:
        values = _adapter(row).validate_python(rows.get(entry) if isinstance(rows, dict) else None)
    except ValidationError:
        return None
    return values if isinstance(values, tuple) else (values,)
