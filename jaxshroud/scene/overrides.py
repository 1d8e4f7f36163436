"""Overrides of a scene file, `table.key=value`, and the axes of a sweep: keys with their values."""

import re
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.checks import MAX_VALUES, fail, toml_text
from jaxshroud.scene.derived_inputs import BLOCK, alternative_keys, check_known
from jaxshroud.scene.document import worked_out_numbers
from jaxshroud.scene.engine_orders import set_orders
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.keys import (
    ALL_KEYS,
    ANY,
    HARMONIC_ENTRY,
    KEYS,
    MODE_ENTRY,
    POINT_ENTRY,
    Key,
    find_key,
    number_shape,
    without_row,
)
from jaxshroud.scene.layout import Layout, layout_with
from jaxshroud.scene.messages import problem_text
from jaxshroud.scene.nested_tables import COEFFICIENTS, parts_of_coefficient
from jaxshroud.scene.optional import WITHOUT_EFFECT, require_number
from jaxshroud.scene.point_numbers import no_place
from jaxshroud.scene.replacing import require_own_stiffness
from jaxshroud.scene.schema import ROW_TYPE, TABLE_MODELS, RowTable, SweepTable, number_type
from jaxshroud.scene.speed import ORDER, check_is_no_speed, keys_in, replaced_by, require_phases_of_order

OVERRIDE = re.compile(
    r"\s*([a-z]+)\.(\w+|(?:harmonic|modes|point)\[\d+\]\.\w+)(?:\[(0|[1-9]\d{0,3})\])?\s*=\s*(\S.*?)\s*"
)
WORDS = re.compile(r"[a-zA-Z_][\w.]*(\s*,\s*[a-zA-Z_][\w.]*)+")
BRACKETS = re.compile(r"\[[^\[\]\"'{}]+\]")
# Setting the left key drops the right ones, which say the same.
EXCLUSIVE_KEYS = {
    ("contact", "k"): [("contact", "gamma")],
    ("contact", "gamma"): [("contact", "k")],
    ("run", "periods"): [("sweep", "keep")],
    ("run", "steps_per_period"): [("run", "accuracy")],
    ("run", "accuracy"): [("run", "steps_per_period")],
    ("sweep", "values"): [("sweep", "start"), ("sweep", "stop"), ("sweep", "num")],
    **{("sweep", key): [("sweep", "values")] for key in ("start", "stop", "num")},
}


def literal(text: str, real: Callable[[str], Any] = float) -> Any:
    """A value that is written on a command line or a page: a number, TOML, a list in brackets, or else a string.

    In brackets stand numbers, with units or not, or words; words alone are a list without brackets too, as no number
    is meant by their commas.

    Args:
        text: What is written.
        real: Reads numbers that are not whole.
    """
    for parse in (int, real, lambda t: _toml_value(t, real)):
        try:
            return parse(text)
        except (ValueError, ArithmeticError, RecursionError):
            continue
    inside = text if WORDS.fullmatch(text) else text[1:-1] if BRACKETS.fullmatch(text) else None
    return text if inside is None else [literal(part.strip(), real) for part in inside.split(",")]


def _toml_value(text: str, real: Callable[[str], Any]) -> Any:
    """The value that is written in TOML; ValueError unless it is one, with nothing behind it."""
    document = tomllib.loads(f"v = [{text}]", parse_float=real)  # a comment would hide the bracket
    if list(document) != ["v"] or len(document["v"]) != 1 or text.rstrip().endswith(","):
        raise ValueError(text)
    return document["v"][0]


def row_table_of(document: dict[str, Any]) -> RowTable | None:
    """The row of a file; None for the pair, and where it is invalid."""
    try:
        return ROW_TYPE.validate_python(document).row
    except ValidationError:
        return None


def override(document: dict[str, Any], text: str, file: str) -> tuple[str, str]:
    """Set one key of the `document` of a `file` in place; its table and name are returned."""
    match = OVERRIDE.fullmatch(without_row(text))
    row = row_table_of(document)
    if match is None:
        fail("--set", f"{toml_text(text)} is not table.key=value, e.g. --set contact.gamma=3")
    table = match[1]
    name = match[2]
    value = literal(match[4])
    rows = document.setdefault(table, {})
    if not isinstance(rows, dict):
        return "", ""  # an error of the file, which is reported later
    if (table, name) == ("drive", "harmonic"):
        fail(
            "--set",
            "drive.harmonic is a list of tables of a file; set one of its numbers, e.g. drive.harmonic[0].F=20",
        )
    if HARMONIC_ENTRY.fullmatch(name) or (table == "blades" and name != "modes"):
        require_number(f"{table}.{name}", [f"{table}.{other}" for other in rows], "--set")
    if match[3] is not None:
        value = _list_with(document, f"{table}.{name}", int(match[3]), value, row, file)
        if value is None:
            return "", ""  # likewise
    check_is_no_speed("--set", f"{table}.{name}", value, rows.get("engine_order"))
    if (point := POINT_ENTRY.fullmatch(name)) and table == "contact":
        _set_place(rows, int(point["index"]), value)
        return table, "points"
    others = alternative_keys(f"{table}.{name}", layout_with(row))
    present = keys_in(document)
    require_phases_of_order(f"{table}.{name}", others, present, "--set")
    others = replaced_by(f"{table}.{name}", others, present)
    if ORDER in others:
        _keep_what_order_gives(document, name, file, layout_with(row))
    rows |= parts_of_coefficient(name, value, "--set") if table == "aero" and name in COEFFICIENTS else {name: value}
    alternatives = [tuple(key.split(".")) for key in others]
    for rival_table, rival_key in [*EXCLUSIVE_KEYS.get((table, name), []), *_other_order(table, name), *alternatives]:
        if isinstance(document.get(rival_table), dict):
            document[rival_table].pop(rival_key, None)
    return table, name


def _set_place(contact: dict[str, Any], m: int, place: Any) -> None:
    """Set the place of one point of contact in the list of a table [contact], in place."""
    given = contact.get("points")
    points = given if isinstance(given, list) else []
    if m >= len(points):
        fail("--set", no_place(m, len(points)))
    contact["points"] = [place if i == m else other for i, other in enumerate(points)]


def _other_order(table: str, name: str) -> list[tuple[str, str]]:
    """The other way to give the order of a harmonic."""
    stem, _, last = name.rpartition(".")
    other = {"order": "engine_order", "engine_order": "order"}.get(last) if stem else None
    return [(table, f"{stem}.{other}")] if other else []


def _list_with(
    document: dict[str, Any], key: str, index: int, value: Any, row: RowTable | None, file: str
) -> list[Any] | None:
    """The list of a key with the value of one blade or interface replaced; None where the file has an error."""
    layout = layout_with(row)
    present = keys_in(document)
    size = _list_length(key, index, layout)
    old = _old_value(document, key, row, file)
    if old is None and key in ALL_KEYS:
        check_known(f"{key}[{index}]", present, "--set", layout)
        require_own_stiffness(key, index, present, "--set")
        require_number(key, present, "--set")
    numbers = old if isinstance(old, list) else [old] * size
    if old is None or len(numbers) != size:
        return None
    return [value if i == index else v for i, v in enumerate(numbers)]


def _list_length(key: str, index: int, layout: Layout) -> int:
    """The number of values of a key, one of which is that with the `index`."""
    if key in ALL_KEYS:
        find_key(f"{key}[{index}]", "--set", layout)
        return number_shape(ALL_KEYS[key], layout)[0]
    table, _, name = key.partition(".")
    if table in TABLE_MODELS and name in TABLE_MODELS[table].model_fields:
        fail("--set", f"[{table}] {name} is not one per blade; drop the [{index}]")
    return 2  # of an unknown key, which is reported later


def _old_value(document: dict[str, Any], key: str, row: RowTable | None, file: str) -> Any:
    """What a file gives for a key, or what stands for it; None where there is nothing."""
    table, _, name = key.partition(".")
    rows = document[table]
    if row is not None and key == "row.mistuning":
        return list(row.mistuning)
    if name in rows and rows[name] != BLOCK:
        return rows[name]
    is_zero = table == "initial" or HARMONIC_ENTRY.fullmatch(name) or MODE_ENTRY.fullmatch(name)
    standing = rows.get("m") if name == "m_y" else 0.0 if is_zero else WITHOUT_EFFECT.get(key)
    if standing is not None or key not in KEYS:
        return standing
    return worked_out_numbers(document, file, layout_with(row)).get(table, {}).get(name)


def _keep_what_order_gives(document: dict[str, Any], name: str, file: str, layout: Layout) -> None:
    """Give as numbers what the engine order of a drive gives beside the number that takes its place, in place."""
    drive = document["drive"]
    numbers = worked_out_numbers(document, file, layout)
    if name == "phase" and "speed" in drive and numbers:
        drive["omega"] = numbers["drive"]["omega"]
        del drive["speed"]
    if "engine_order" in drive:
        set_orders(drive, file)


def axis(
    scene_file: SceneFile,
    key: str,
    values: Any = None,
    *,
    start: Any = None,
    stop: Any = None,
    num: int | None = None,
    where: str = "",
) -> Axis:
    """An axis of a sweep: one key and its values, checked against the scene.

    Args:
        scene_file: The scene that is swept.
        key: `table.name`, or `table.name[i]` for one blade or interface only.
        values: Numbers in SI or strings with units (a list, an array or "a,b,c"); or else `start`,
            `stop` and `num` for equally spaced ones.
        start: First value.
        stop: Last value.
        num: Number of values.
        where: The place that error messages name first; by default the option `--along`.

    Raises:
        KeyNameError: The scene has no such number.
        SceneError: A value is out of its range, or fewer than two differ.
    """
    where = where or f"--along {key}"
    row = _known_row(scene_file, key, where)
    ends = [start, stop, num]
    if (values is None and None in ends) or (values is not None and ends != [None] * 3):
        fail(where, "needs either values, or start, stop and num")
    given = [start, stop] if values is None else _value_list(values)
    if len(given) > 1 and "" in map(str, given):
        fail(where, f"value {given.index('') + 1} of {len(given)} is empty; give values between single commas")
    _same_units(where, given)
    points = _values_in_range(where, scene_file, row, given)
    size = len(points) if num is None else num
    if size < 2 or len(set(points)) < 2:
        count = max(0, min(size, len(set(points))))
        fail(where, f"{count} different value{'s' * (count != 1)} given; a sweep needs at least two, e.g. num = 100")
    if size > MAX_VALUES:
        fail(where, f"num must be at most {MAX_VALUES}")
    grid = points if values is not None else np.linspace(points[0], points[1], size)
    return Axis(key, np.asarray(grid, np.float64))


def size_in_si(scene_file: SceneFile, key: str, text: str, where: str) -> float:
    """A size in the unit of a key, such as the half width of its scatter: as for `axis`, but in any range."""
    (size,) = _values_in_range(where, scene_file, _known_row(scene_file, key, where)._replace(range=ANY), [text])
    return size


def axes(scene_file: SceneFile, sweep: SweepTable, where: str) -> tuple[Axis, ...]:
    """All axes of a [sweep] table; messages begin with `where` it is."""
    columns = {name: getattr(sweep, name) for name in ("values", "start", "stop", "num")}
    return tuple(
        axis(scene_file, key, where=f"{where} {key}", **{n: c and c[i] for n, c in columns.items()})
        for i, key in enumerate(sweep.along)
    )


def _known_row(scene_file: SceneFile, key: str, where: str) -> Key:
    """The row of a key, which the scene has."""
    row, _ = find_key(key, where, scene_file.layout)
    present = [f"{table}.{name}" for table, part in scene_file.tables.items() for name in part]
    require_number(row.name, present, where)
    check_known(key, scene_file.given, where, scene_file.layout)
    return row


def _values_in_range(where: str, scene_file: SceneFile, row: Key, given: list[Any]) -> list[float]:
    """The given values in SI units, checked against the range of a number."""
    for value in given:
        check_is_no_speed(where, row.name, value, scene_file.given.get("drive.engine_order"))
    values = [literal(v) if isinstance(v, str) else v for v in given]
    if any(isinstance(v, list | dict) or v is None for v in values):
        fail(where, f"{toml_text(values)} must be one number per value")
    adapter = TypeAdapter(number_type(row))
    points = []
    for value in values:
        try:
            points.append(adapter.validate_python(value))
        except ValidationError as error:
            fail(
                where,
                f"{toml_text(value)} {problem_text(error.errors()[0])}, e.g. {toml_text(row.example)} ({row.about})",
            )
    return points


def _same_units(where: str, values: list[Any]) -> None:
    """Refuse a number without a unit after one with a unit, as in `1mm,2`: two metres are hardly meant."""
    texts = [v for v in values if isinstance(v, str)]
    bare = [isinstance(literal(v), int | float) for v in texts]
    for i, text in enumerate(texts):
        if bare[i] and not all(bare[:i]):
            fail(
                where,
                f"{toml_text(text)} has no unit, but {toml_text(texts[bare.index(False)])} before it has; add one",
            )


def _value_list(values: Any) -> list[Any]:
    """The values as a list; a text that is not TOML is split at its commas."""
    if isinstance(values, str):
        values = literal(values) if values.lstrip().startswith("[") else [v.strip() for v in values.split(",")]
    values = values.tolist() if hasattr(values, "tolist") else values
    return list(values) if isinstance(values, list | tuple) else [values]
