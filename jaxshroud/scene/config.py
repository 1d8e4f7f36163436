"""Scene files: from TOML, with derived inputs replaced, to a checked scene with its run and sweep."""

import copy
import os
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.checks import SceneError, did_you_mean, fail, hint, toml_text
from jaxshroud.scene.derived_inputs import BLOCK, DerivedInput, check_order, inputs_by_key, inputs_in
from jaxshroud.scene.file import Axis, SceneFile, table_values
from jaxshroud.scene.keys import ALL_KEYS, KEYS, Key, key_in
from jaxshroud.scene.layout import PAIR, Layout, layout_with
from jaxshroud.scene.load_table import resolve_table
from jaxshroud.scene.messages import first_problem, problem_text
from jaxshroud.scene.nested_tables import flattened, resolve_orders
from jaxshroud.scene.overrides import axes, axis, check_is_no_speed, override
from jaxshroud.scene.point_numbers import with_place_entries
from jaxshroud.scene.replacing import plain_numbers
from jaxshroud.scene.schema import PHYSICS_TABLES, ROW_TYPE, TABLE_MODELS, numbers_type, scene_file_type
from jaxshroud.scene.shipped import aliases, shipped, shipped_paths
from jaxshroud.scene.speed import GROWTHS, ORDER, SPEED_KEYS, UNTWIST, check_speed, depends_on_speed, keys_in
from jaxshroud.scene.title import retitled
from jaxshroud.scene.typed import typed

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
        rows, own = document.get(table), [key for key in derived.keys if inputs_by_key(layout)[key.name] is derived]
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


def _order_beside_frequency(
    document: Document, name: str, overridden: Collection[tuple[str, str]], layout: Layout
) -> GivenValues:
    """The engine order of a pair beside its frequency, which is only given where something depends on the speed."""
    drive, key = document.get("drive"), ALL_KEYS[ORDER]
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
    names, (table, number) = [key.parts[1] for key in derived.keys], derived.number.parts
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
        key, entry = KEYS["blades.m"], "m"
    try:
        values = _adapter(key, layout).validate_python(rows.get(entry) if isinstance(rows, dict) else None)
    except ValidationError:
        return None
    return values if isinstance(values, tuple) else (values,)


__all__ = ["Axis", "SceneError", "SceneFile", "axis", "load", "parse", "shipped"]
MAX_NAME_LENGTH = 200  # characters of a missing file's name in messages


@typed
def load(source: str | os.PathLike, overrides: Sequence[str] = ()) -> SceneFile:
    """Read a scene file.

    Args:
        source: A path, or the name of a shipped scene such as "fig09".
        overrides: `table.key=value` each, in order; `contact.gamma` replaces `contact.k` and vice versa.

    Raises:
        SceneError: The file or an override is invalid; the message is one line with the place and the cure.
    """
    path, name = Path(source), os.fspath(source)
    if not os.path.isfile(path):
        paths, alias_names, stem = shipped_paths(), aliases(), name.removesuffix(".toml")
        if alias_names.get(stem, stem) not in paths:
            stem_given = path.name.removesuffix(".toml")
            cure = did_you_mean(stem_given, [*paths, *alias_names]) or hint(stem_given, [*paths])
            fail(
                name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}...",
                f"no such file or shipped scene{cure}; `jaxshroud scenes` lists the shipped ones",
            )
        path = paths[alias_names.get(stem, stem)]
        name = path.name
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        fail(name, f"cannot be read as UTF-8 text: {error}")
    return _scene_file(_document(text, name), name, overrides, path.parent)


def parse(text: str, name: str, overrides: Sequence[str] = ()) -> SceneFile:
    """The scene in TOML `text`; messages call it `name`. See `load`."""
    return _scene_file(_document(text, name), name, overrides)


def _document(text: str, name: str) -> dict[str, Any]:
    try:
        return flattened(tomllib.loads(text), name)
    except SceneError:
        raise
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: a number of 5,000 digits
        fail(name, f"not valid TOML: {error}")


def _scene_file(document: dict[str, Any], name: str, overrides: Sequence[str], folder: Path | None = None) -> SceneFile:
    """The scene file of a TOML document, which is changed in place; tables of loads are looked for in a folder."""
    if isinstance(document.get("initial"), str):
        document["initial"] = {"start": document["initial"]}
    original = copy.deepcopy(document) if len(overrides) else {}
    overridden = {override(document, text) for text in sorted(overrides, key=_precedence)}
    row = _validated(ROW_TYPE, document, name, overridden).row
    layout = layout_with(row)
    told = resolve_table(document, folder or Path(), name, overridden)
    harmonics = resolve_orders(document, name, overridden)
    given = resolve_derived_inputs(document, name, overridden, layout)
    file = _validated(scene_file_type(layout, harmonics), document, name, overridden)
    physics = {table: getattr(file, table) for table in ("row", "aero", *PHYSICS_TABLES)}
    tables = {table: table_values(of_file) for table, of_file in physics.items() if of_file is not None}
    tables["contact"] = with_place_entries(tables["contact"])
    numbers = {f"{table}.{entry}": value for table, part in tables.items() for entry, value in part.items()}
    speed_is_set = any(f"{table}.{entry}" in (*GROWTHS, *UNTWIST) for table, entry in overridden)
    check_speed(numbers, given, layout.blades, "--set" if speed_is_set else name)
    loaded = SceneFile(name, file.title, tables, file.run, given=given, told={"load table": told} if told else {})
    if len(overrides):
        title = file.title or Path(name).name
        loaded = replace(
            loaded, title=retitled(title, loaded.given_tables, _physics_of(original, name, folder), overridden)
        )
    if file.sweep is None:
        return loaded
    place = f"{'--set' if 'sweep' in dict(overridden) else name}: [sweep]"
    return replace(loaded, axes=axes(loaded, file.sweep, place), direction=file.sweep.direction, keep=file.sweep.keep)


def _precedence(text: str) -> int:
    """The place of an override: first those of the row, which size lists, then what makes an engine order needed."""
    text = text.lstrip()
    return 0 if text.startswith("row.") else 1 if text.startswith(SPEED_KEYS) else 2


def _validated(kind: Any, document: dict[str, Any], name: str, overridden: set[tuple[str, str]]) -> Any:
    """The document as a pydantic type has it.

    Raises:
        SceneError: It is invalid; the message names `--set` where an override is, else the file.
    """
    try:
        return kind.validate_python(document)
    except ValidationError as error:
        table, key, message, error_kind = first_problem(error, document)
        by_override = (table, key) in overridden or (table not in TABLE_MODELS and table in dict(overridden))
        fail("--set" if by_override else name, message, error_kind)


def _physics_of(document: dict[str, Any], name: str, folder: Path | None) -> dict[str, Any] | None:
    """The physics of a TOML document as it is given; None if it is not a valid scene."""
    try:
        return _scene_file(document, name, (), folder).given_tables
    except SceneError:
        return None
