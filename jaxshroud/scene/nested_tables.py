"""The tables within tables of a file as entries and tables of their own.

[[drive.harmonic]] becomes entries of [drive], `harmonic[1].F`, and so does [[blades.modes]]; [row.coupling] and
[row.aero] become tables of their own, the latter with the parts of its influence coefficients.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxshroud.scene.checks import fail, toml_text
from jaxshroud.scene.keys import AERO_KEYS, HARMONIC_ENTRY, MODE_ENTRY, TABLES_IN_ROW
from jaxshroud.scene.optional import A_HARMONIC, A_MODE, split_list
from jaxshroud.scene.point_numbers import with_listed_places

FileDocument = dict[str, Any]


class TableList(NamedTuple):
    """A list of tables within a table of a file."""

    table: str
    name: str
    entry: re.Pattern  # of its entries
    example: str


LISTS = (
    TableList("drive", "harmonic", HARMONIC_ENTRY, A_HARMONIC),
    TableList("blades", "modes", MODE_ENTRY, A_MODE),
)
COEFFICIENTS = ("L0", "L1", "L_1")  # written as [real, imaginary] in a file
AN_EXAMPLE = 'e.g. L1 = ["-500 N/m", "-2e3 N/m"]'


def flattened(document: FileDocument, where: str) -> FileDocument:
    """The document of a file, changed in place, with lists of tables as entries; see `with_own_tables` too.

    Raises:
        SceneError: They are no tables, or there is none.
    """
    document = with_own_tables(document, where)
    for listed in LISTS:
        rows = document.get(listed.table)
        if not isinstance(rows, dict) or listed.name not in rows or isinstance(rows[listed.name], str):
            continue
        every = rows.pop(listed.name)
        if not isinstance(every, list) or not every or not all(isinstance(one, dict) and one for one in every):
            text = f"[{listed.table}] {listed.name} = {toml_text(every)}"
            fail(where, f"{text} must be a list of tables with keys, e.g. {listed.example}")
        rows |= list_entries(listed.name, every)
    return document


def list_entries(name: str, tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The tables of a list as entries of the table that they stand in."""
    return {f"{name}[{i}].{entry}": value for i, one in enumerate(tables) for entry, value in one.items()}


def nested(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a file as they stand there: lists of tables, places of points as a list, tables of [row]."""
    tables = dict(with_tables_in_row(tables))
    contact = tables.get("contact")
    if isinstance(contact, Mapping):
        tables["contact"] = with_listed_places(contact)
    for listed in LISTS:
        if isinstance(tables.get(listed.table), Mapping):
            plain, every = split_list(tables[listed.table], listed.entry)
            tables[listed.table] = {**plain, listed.name: every} if every else plain
    return tables


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
