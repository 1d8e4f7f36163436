"""Derived inputs of a scene file, in place: each replaced by the number of the scene that it gives."""

import copy
from collections.abc import Collection, Sequence
from functools import cache
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.checks import SceneError, fail, toml_text
from jaxshroud.scene.derived_inputs import BLOCK, DerivedInput, check_order, inputs_by_key, inputs_in
from jaxshroud.scene.engine_orders import resolve_orders
from jaxshroud.scene.keys import ALL_KEYS, KEYS, Key, key_in
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.messages import problem_text
from jaxshroud.scene.replacing import plain_numbers
from jaxshroud.scene.schema import numbers_type
from jaxshroud.scene.speed import ORDER, check_is_no_speed, depends_on_speed, keys_in

Document = dict[str, Any]
Values = tuple[float, ...]  # one per blade, or one for the scene
GivenValues = dict[str, Any]  # key -> a number in SI units, or one per blade; None for a word in place of a number


def resolve_derived_inputs(
    document: Document, name: str, overridden: Collection[tuple[str, str]] = (), layout: Layout = PAIR
) -> GivenValues:
    """Replace derived inputs by the numbers of the scene, in place.

    Args:
        document: The document of a scene file.
        name: The name of the file in messages.
        overridden: The tables and keys that were overridden, for which messages name `--set`.
        layout: The layout of the scene.

    Returns:
        The inputs that were given.

    Raises:
        SceneError: Two keys give one number, or a value is invalid.
    """
    given = _order_beside_frequency(document, name, overridden, layout)

    def is_set(keys):
        return any(key.parts in overridden for key in keys)

    for derived in inputs_in(layout):
        table, number = derived.number.parts
        rows = document.get(table)
        own = [key for key in derived.keys if inputs_by_key(layout)[key.name] is derived]
        if isinstance(rows, dict) and _is_given(derived, own, rows):
            values = _given_by(derived, own, rows, "--set" if is_set(derived.keys) else name, layout)
            needed = [_required_values(document, needs, layout) for needs in derived.needs]
            rows[number] = _scene_value(derived, values, needed)
            given |= plain_numbers(dict(zip(derived.marks, values or [None], strict=True)))
    drive = document.get("drive")
    if isinstance(drive, dict):
        check_is_no_speed(name, "drive.omega", drive.get("omega"), drive.get("engine_order"))
    check_order(given, "--set" if is_set([ALL_KEYS["drive.engine_order"], ALL_KEYS["drive.speed"]]) else name)
    for key in given:
        table, entry = key.split(".")
        if given[key] is not None:
            document[table].pop(entry, None)
    return given


def worked_out_numbers(document: Document, name: str, layout: Layout) -> Document:
    """The numbers of a document by their tables, those among them that its derived inputs give; none if it is wrong."""
    resolved = copy.deepcopy(document)
    try:
        resolve_orders(resolved, name)
        resolve_derived_inputs(resolved, name, layout=layout)
    except SceneError:  # an error of the file, which is reported later
        return {}
    return resolved


def _order_beside_frequency(
    document: Document, name: str, overridden: Collection[tuple[str, str]], layout: Layout
) -> GivenValues:
    """The engine order of a pair beside its frequency, which is only given where something depends on the speed."""
    drive = document.get("drive")
    key = ALL_KEYS[ORDER]
    if layout != PAIR or not isinstance(drive, dict) or not depends_on_speed(keys_in(document)):
        return {}
    if "engine_order" not in drive or "speed" in drive or not {"omega", "f"} & set(drive):
        return {}
    check_is_no_speed(name, "drive.omega", drive.get("omega"), drive["engine_order"])
    where = "--set" if key.parts in overridden else name
    return plain_numbers({ORDER: _given_values(where, key, drive.pop("engine_order"), layout)})


def _is_given(derived: DerivedInput, own: Collection[Key], rows: Document) -> bool:
    """Whether a table gives any of an input's `own` keys, or its word."""
    if derived.keys:
        return any(key.parts[1] in rows for key in own)
    word = rows.get(derived.number.parts[1])
    return isinstance(word, str) and word.strip() == BLOCK


def _given_by(derived: DerivedInput, own: Sequence[Key], rows: Document, where: str, layout: Layout) -> list[Values]:
    """The values of the keys of an input, of which its `own` give nothing else."""
    names = [key.parts[1] for key in derived.keys]
    table, number = derived.number.parts
    missing = [key for key in names if key not in rows]
    if missing:
        present = next(key.parts[1] for key in own if key.parts[1] in rows)
        fail(where, f"[{table}] lacks `{missing[0]}`, which `{present}` needs")
    if own and number in rows:
        fail(where, f"[{table}] gives both `{own[0].parts[1]}` and `{number}`; keep one of them")
    return [_given_values(where, key_in(key, layout), rows[key.parts[1]], layout) for key in derived.keys]


def _scene_value(derived: DerivedInput, values: list[Values], needed: list[Values | None]) -> Any:
    """The number as in a file; an example where a value is missing or invalid, which is reported later."""
    known = {key.name: v for key, v in zip(derived.needs, needed, strict=True) if v is not None}
    if len(known) < len(derived.needs):
        return derived.number.example
    given = {key.name: v for key, v in zip(derived.keys, values, strict=True)}

    def arrays(part):
        return {key: np.asarray(v if ALL_KEYS[key].pair else v[0]) for key, v in part.items()}

    return np.asarray(derived.value(arrays(known), arrays(given))).tolist()


@cache
def _adapter(key: Key, layout: Layout):
    return TypeAdapter(numbers_type(key, layout))


def _given_values(where: str, key: Key, value: Any, layout: Layout) -> Values:
    """The given value in SI units, one per blade."""
    try:
        values = _adapter(key, layout).validate_python(value)
    except ValidationError as error:
        table, name = key.parts
        about = f"e.g. {name} = {toml_text(key.example)} ({key.about})"
        fail(where, f"[{table}] {name} = {toml_text(value)} {problem_text(error.errors()[0])}, {about}")
    return values if isinstance(values, tuple) else (values,)


def _required_values(document: Document, key: Key, layout: Layout) -> Values | None:
    """A number on which others depend, one per blade; None where it is missing or invalid."""
    table, entry = key.parts
    rows = document.get(table)
    if entry == "m_y" and isinstance(rows, dict) and rows.get("m_y") is None:
        key = KEYS["blades.m"]
        entry = "m"
    try:
        values = _adapter(key, layout).validate_python(rows.get(entry) if isinstance(rows, dict) else None)
    except ValidationError:
        return None
    return values if isinstance(values, tuple) else (values,)
