"""The tables [row.coupling] and [row.aero] of a file as tables of their own, with influence coefficients as pairs."""

from collections.abc import Mapping
from typing import Any

from jaxshroud.scene.checks import fail, toml_text
from jaxshroud.scene.keys import AERO_KEYS, TABLES_IN_ROW

COEFFICIENTS = ("L0", "L1", "L_1")  # written as [real, imaginary] in a file
AN_EXAMPLE = 'e.g. L1 = ["-500 N/m", "-2e3 N/m"]'


def with_own_tables(document: dict[str, Any], where: str) -> dict[str, Any]:
    """The document of a file, changed in place, with what stands in its [row] in tables of their own.

    Raises:
        SceneError: A table is given twice, or an influence coefficient is no pair.
    """
    row = document.get("row")
    for table in TABLES_IN_ROW:
        if isinstance(row, dict) and table in row:
            if table in document:
                fail(where, f"gives both [row.{table}] and [{table}]; keep one of them")
            document[table] = row.pop(table)
    aero = document.get("aero")
    if isinstance(aero, dict):
        for name in [name for name in COEFFICIENTS if name in aero]:
            aero |= parts_of_coefficient(name, aero.pop(name), where)
    return document


def parts_of_coefficient(name: str, value: Any, where: str) -> dict[str, Any]:
    """The real and the imaginary part of an influence coefficient as entries of [aero].

    Raises:
        SceneError: It is no pair.
    """
    if not isinstance(value, list | tuple) or len(value) != 2:
        fail(where, f"[row.aero] {name} = {toml_text(value)} must be a pair [real, imaginary], {AN_EXAMPLE}")
    return {f"{name}_re": value[0], f"{name}_im": value[1]}


def with_tables_in_row(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a file as `with_own_tables` reads them: those of a row stand in its table."""
    if "row" not in tables:
        return {name: table for name, table in tables.items() if name not in TABLES_IN_ROW or table}
    within = {name: _with_pairs(tables[name]) for name in TABLES_IN_ROW if tables.get(name)}
    outside = {name: table for name, table in tables.items() if name not in TABLES_IN_ROW}
    return {**outside, "row": {**tables["row"], **within}}


def _with_pairs(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table with its influence coefficients as pairs."""
    parts = {key.parts[1] for key in AERO_KEYS}
    named = [name for name in COEFFICIENTS if {f"{name}_re", f"{name}_im"} & set(table)]
    pairs = {name: [table.get(f"{name}_re", 0.0), table.get(f"{name}_im", 0.0)] for name in named}
    return {**{name: value for name, value in table.items() if name not in parts}, **pairs}
