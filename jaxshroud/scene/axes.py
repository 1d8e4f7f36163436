"""The axes of a sweep: keys with their values."""

from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from jaxshroud.scene.checks import MAX_VALUES
from jaxshroud.scene.derived_inputs import DERIVED_BY_KEY, check_known
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.keys import ANY, Key, find_key
from jaxshroud.scene.messages import fail, problem_text, toml_text
from jaxshroud.scene.optional import require_number
from jaxshroud.scene.overrides import check_is_no_speed, literal
from jaxshroud.scene.schema import SweepTable, number_type


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
    if row.name == "contact.width" and scene_file.tables["parts"]["contact"] != "smooth":
        fail(where, 'the scene\'s contact is not smooth and has no width; add [parts] contact = "smooth"')
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
    check_known(key, scene_file.given, where, scene_file.layout)
    if row.name not in (*DERIVED_BY_KEY, "contact.width"):  # whose cure is to add both of its words
        present = [f"{table}.{name}" for table, part in scene_file.tables.items() for name in part]
        require_number(row.name, present, where)
    return row


def _values_in_range(where: str, scene_file: SceneFile, row: Key, given: list[Any]) -> list[float]:
    """The given values in SI units, checked against the range of a number."""
    for value in given:
        check_is_no_speed(where, row.name, value, scene_file.given.get("drive.engine_order"))
    values = [literal(v) if isinstance(v, str) else v for v in given]
    if any(isinstance(v, list | dict) or v is None for v in values):
        fail(where, f"{toml_text(values)} must be one number per value")
    adapter, points = TypeAdapter(number_type(row)), []
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
