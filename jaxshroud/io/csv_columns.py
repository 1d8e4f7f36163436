"""Tables of other programs: the columns of a CSV file as texts."""

import csv
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from jaxshroud.scene.checks import InputError

SEPARATORS = ",;\t"


class CsvTable(NamedTuple):
    """A CSV file: a row of heads, then rows of cells."""

    columns: dict[str, list[str]]  # head -> cells
    faults: dict[int, str]  # row, numbered from 0 -> why its cells do not fit the heads


def read_csv(path: Path) -> CsvTable:
    """The columns of a CSV file in UTF-8, separated by commas, semicolons or tabs.

    Between semicolons and tabs a decimal comma counts as a point. Blank lines are no rows. A row with too few or too
    many cells has a fault, and the cells that it has.

    Raises:
        InputError: The file cannot be read, is no text, or lacks a head or rows.
    """
    text = _text(path)
    first = text.lstrip("\r\n").partition("\n")[0]
    separator = max(SEPARATORS, key=first.count)
    try:
        lines = [row for row in csv.reader(StringIO(text, newline=""), delimiter=separator, strict=True) if row]
    except csv.Error as error:
        raise InputError(f"{path}: is no CSV ({error}); look for a quotation mark that is not closed") from None
    if len(lines) < 2:
        raise InputError(f"{path}: has no designs; it needs a line of heads, then a line for each")
    heads, rows = _heads(path, lines), lines[1:]
    faults = {i: _fault(row, heads, separator) for i, row in enumerate(rows) if len(row) != len(heads)}
    padded = [[*row, *[""] * (len(heads) - len(row))] for row in rows]
    columns = {head: [_with_point(row[j], separator) for row in padded] for j, head in enumerate(heads) if head}
    return CsvTable(columns, faults)


def _text(path: Path) -> str:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give a CSV file") from None
    except UnicodeDecodeError:
        raise InputError(f'{path}: is no text in UTF-8; save the table as "CSV UTF-8"') from None
    if "\0" in text:
        raise InputError(f'{path}: holds NUL bytes and is no CSV; save the table as "CSV UTF-8"')
    return text


def _heads(path: Path, lines: list[list[str]]) -> list[str]:
    """The heads; columns without one must be empty."""
    heads = [" ".join(head.split()) for head in lines[0]]
    for j, head in enumerate(heads):
        if not head and any(len(row) > j and row[j].strip() for row in lines[1:]):
            raise InputError(f"{path}: column {j + 1} has no head; name it, or remove it")
        if head and head in heads[:j]:
            raise InputError(f"{path}: two columns are called `{head}`; keep one, or rename it")
    return heads


def _fault(row: list[str], heads: list[str], separator: str) -> str:
    comma = "; write numbers with a point" if separator == "," and len(row) > len(heads) else ""
    return f"the row has {len(row)} cell{'s' * (len(row) != 1)}, but there are {len(heads)} columns{comma}"


def _with_point(cell: str, separator: str) -> str:
    """The cell; between semicolons or tabs, a number with a decimal point in place of a comma."""
    whole, comma, rest = cell.partition(",")
    is_decimal = separator != "," and comma and whole.strip().lstrip("+-").isdecimal() and rest[:1].isdecimal()
    return f"{whole}.{rest}" if is_decimal else cell
