"""Tables of designs: a row for each, a key and a unit for each column, read cell by cell; wrong rows say why."""

import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import MAX_VALUES, SceneError, toml_text
from jaxshroud.scene.derived_inputs import check_known, same_quantity
from jaxshroud.scene.grids import columns_of, scenes_at
from jaxshroud.scene.keys import ALL_KEYS, Key, Motion, find_key, key_stem
from jaxshroud.scene.optional import require_number
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import check_is_no_speed
from jaxshroud.scene.typed import short_repr
from jaxshroud.scene.units import QUANTITY, to_si
from jaxshroud.scene.vary import fields_of, inputs_of

HEAD = re.compile(r"(?P<key>[^\s\[\]]+(?:\[\d+\](?:\.\w+(?:\[\d+\])?)?)?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")
KEY_LIKE = re.compile(r"[A-Za-z_]+\.\w+(\[\w*\])?(\.\w+(\[\w*\])?)?")
LAST_PARTS = {row.parts[1] for row in ALL_KEYS.values()}
NO_UNIT = ("", "1", "-")


class KeyColumn(NamedTuple):
    """A column that gives a number of the scene."""

    head: str
    key: str
    row: Key
    unit: str  # of cells that name none; empty: the SI unit
    decimal_comma: bool = False  # whether numbers may have one

    def value(self, cell: str, engine_order: Any) -> float:
        """The number of a cell in SI units.

        Raises:
            ValueError: It is none, has another unit, or is out of its range.
        """
        cell = with_point(cell.strip()) if self.decimal_comma else cell.strip()
        if not cell:
            raise ValueError("is empty")
        match = QUANTITY.fullmatch(cell)
        check_is_no_speed("this row", self.row.name, cell, engine_order)
        if match and not match[2] and self.unit:
            cell = f"{cell} {self.unit}"
        is_bare = match and not match[2] and not self.unit
        number = float(cell) if is_bare else float(to_si(self.row.unit, cell))
        if not self.row.range.holds(number):
            raise ValueError(self.row.range.fault(number))
        return number


def with_point(cell: str) -> str:
    """A cell with the decimal comma of a number as a point."""
    whole, comma, rest = cell.partition(",")
    is_decimal = comma and whole.strip().lstrip("+-").isdecimal() and rest[:1].isdecimal()
    return f"{whole}.{rest}" if is_decimal else cell


class Designs(NamedTuple):
    """The rows of a table of designs."""

    keys: tuple[str, ...]  # of the numbers that columns give
    values: np.ndarray  # (rows, keys) in SI units; NaN where a cell is wrong
    reasons: tuple[str, ...]  # why each row is wrong; empty: it is right
    heads: tuple[str, ...]  # of all columns
    cells: np.ndarray  # (rows, columns), texts as they were given, byte for byte

    @property
    def right(self) -> np.ndarray:
        """The numbers of the rows that are right, from 0."""
        return np.flatnonzero([not reason for reason in self.reasons])

    def scenes(self, base: Scene) -> Scene:
        """The scenes (leading axis) of the rows that are right."""
        return scenes_at(base, self.keys, self.values[self.right])

    def marked(self, rows: np.ndarray, reason: str) -> "Designs":
        """The same with further `rows`, numbered from 0, marked as wrong."""
        wrong = {*rows.tolist()}
        return self._replace(reasons=tuple(reason if i in wrong else old for i, old in enumerate(self.reasons)))


def read_designs(
    table: object, scene: Scene, faults: Mapping[int, str] | None = None, decimal_comma: bool = False
) -> Designs:
    """The designs of a table, for a scene that has all other numbers.

    Args:
        table: A mapping of heads to columns (n,), a pandas DataFrame, a structured array or an xarray Dataset. A head
            is a key and, in brackets, a unit: "shroud.gap [mm]", "blades.m[0] [g]"; without a unit numbers are in SI
            units. A variable of a Dataset may have its unit as attribute `units`. Cells are numbers, or texts such as
            "22 um". Columns with other heads are carried along.
        scene: The scene.
        faults: Row, numbered from 0 -> what is wrong with it as a whole.
        decimal_comma: Whether the numbers in texts may have a decimal comma.

    Raises:
        SceneError: There is no row, or columns differ in length, name no number, or name one twice.
        KeyNameError: The scene lacks what a key needs.
    """
    columns = {_full_head(head, column): _texts(column) for head, column in columns_of(table).items()}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1 or lengths == {0}:
        raise SceneError("a table of designs needs a row for each below its heads, and columns of one length")
    if max(lengths) > MAX_VALUES:
        raise SceneError(f"a table may have at most {MAX_VALUES} rows")
    keyed = [column._replace(decimal_comma=decimal_comma) for column in _key_columns([*columns], scene)]
    values = np.full((*lengths, len(keyed)), np.nan)
    reasons = [(faults or {}).get(i, "") for i in range(*lengths)]
    engine_order = _engine_order(scene)
    for j, column in enumerate(keyed):
        for i, cell in enumerate(columns[column.head]):
            try:
                values[i, j] = column.value(cell, engine_order)
            except ValueError as error:
                text = f" = {toml_text(cell.strip())}" if cell.strip() else ""
                reasons[i] = reasons[i] or f"{column.key}{text} {error}"
    cells = np.array([*columns.values()], dtype=str).T
    return Designs(tuple(column.key for column in keyed), values, tuple(reasons), tuple(columns), cells)


def _engine_order(scene: Scene) -> Any:
    given = inputs_of(scene).get("drive.engine_order")
    return None if given is None else float(np.ravel(np.asarray(given))[0])


def _full_head(head: str, column: Any) -> str:
    """The head with the unit that a variable of xarray has as attribute, in place of none."""
    unit = getattr(column, "attrs", {}).get("units")
    match = HEAD.fullmatch(head)
    if not unit or match is None or match["unit"] is not None or key_stem(match["key"]) not in ALL_KEYS:
        return head
    key = ALL_KEYS[key_stem(match["key"])]
    return head if unit == key.netcdf else f"{head} [{unit}]"


def _texts(column: Any) -> list[str]:
    """The cells of a column as texts; what is missing is empty."""
    cells = column if isinstance(column, list | tuple) else np.asarray(column)
    if isinstance(cells, np.ndarray) and cells.ndim != 1:
        raise SceneError(f"a column of a table needs one value for each row, but one is {short_repr(column)}")
    return ["" if _is_missing(cell) else str(cell) for cell in cells]


def _is_missing(cell: Any) -> bool:
    """Whether it is None, NaN, or what pandas has in place of them."""
    return cell is None or (not isinstance(cell, str) and str(cell) in ("nan", "NaT", "<NA>"))


def _may_be_a_key(name: str) -> bool:
    """Whether a head is meant as a key: one with a table, or the last part of one that is no column of a run."""
    return bool(KEY_LIKE.match(name)) or name.partition("[")[0] in LAST_PARTS - {*Motion._fields}


def _key_columns(heads: Sequence[str], scene: Scene) -> list[KeyColumn]:
    """The columns that give numbers of the scene.

    Raises:
        SceneError: A head is close to a key, but none, or there is no key.
    """
    columns = [column for head in heads if (column := _key_column(head, scene)) is not None]
    if not columns:
        raise SceneError('no column names a number of the scene; a head is a key and its unit, e.g. "shroud.gap [mm]"')
    for a, b in combinations(columns, 2):
        if a.key == b.key or same_quantity(a.key, b.key, scene.layout):
            raise SceneError(f"columns `{a.head}` and `{b.head}` give one number; keep one of them")
    return columns


def _key_column(head: str, scene: Scene) -> KeyColumn | None:
    """The column of a key; None for one that is carried along."""
    match = HEAD.fullmatch(head.strip())
    name = match["key"] if match else head.strip()
    if not _may_be_a_key(name):
        return None
    where = f"column {toml_text(head)}"
    row, _ = find_key(name, where, scene.layout)
    require_number(row.name, fields_of(scene), where)
    check_known(name, inputs_of(scene), where, scene.layout)
    unit = (match["unit"] or "").strip() if match else ""
    if unit in NO_UNIT:
        return KeyColumn(head, name, row, "")
    check_is_no_speed(where, row.name, f"1 {unit}", _engine_order(scene))
    try:
        to_si(row.unit, f"1 {unit}")
    except ValueError as error:
        raise SceneError(f"{where}: {error}") from None
    return KeyColumn(head, name, row, unit)
