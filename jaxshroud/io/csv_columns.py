"""Tables of other programs: the columns of a CSV file as texts."""

import csv
from io import StringIO
from itertools import count, islice
from pathlib import Path
from typing import NamedTuple

from jaxshroud.scene.checks import InputError

SEPARATORS = ",;\t"


class CsvTable(NamedTuple):
    """A CSV file: a row of heads, then rows of cells."""

    columns: dict[str, list[str]]  # head -> cells, byte for byte
    faults: dict[int, str]  # row, numbered from 0 -> why its cells do not fit the heads
    decimal_comma: bool  # whether numbers may have a decimal comma: between semicolons and tabs


def read_csv(path: Path) -> CsvTable:
    """The columns of a CSV file in UTF-8, separated by commas, semicolons or tabs.

    Blank lines are no rows. A row with too few or too many cells has a fault, and the cells that it has: what exceeds
    the heads is in columns of its own, `surplus 1` and so on.

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
    heads = _with_surplus(heads, max(map(len, rows)))
    padded = [[*row, *[""] * (len(heads) - len(row))] for row in rows]
    columns = {head: [row[j] for row in padded] for j, head in enumerate(heads) if head.strip()}
    return CsvTable(columns, faults, separator != ",")


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
    heads = lines[0]
    plain = [" ".join(head.split()) for head in heads]
    for j, head in enumerate(plain):
        if not head and any(len(row) > j and row[j].strip() for row in lines[1:]):
            raise InputError(f"{path}: column {j + 1} has no head; name it, or remove it")
        if head and head in plain[:j]:
            raise InputError(f"{path}: two columns are called `{head}`; keep one, or rename it")
    return heads


def _with_surplus(heads: list[str], longest: int) -> list[str]:
    """The heads, with more of them where the longest row has more cells."""
    names = (name for i in count(1) if (name := f"surplus {i}") not in heads)
    return [*heads, *islice(names, longest - len(heads))] if longest > len(heads) else heads


def _fault(row: list[str], heads: list[str], separator: str) -> str:
    comma = "; write numbers with a point" if separator == "," and len(row) > len(heads) else ""
    return f"the row has {len(row)} cell{'s' * (len(row) != 1)}, but there are {len(heads)} columns{comma}"
