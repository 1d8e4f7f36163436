"""CSV files that people and other programs write: their columns as texts, errors with their cure."""

import csv
import math
import re
from collections.abc import Iterable, Mapping
from io import StringIO
from itertools import count, islice
from pathlib import Path
from typing import NamedTuple

from jaxshroud.scene.checks import InputError, fail
from jaxshroud.scene.units import to_si
from jaxshroud.whole_file import open_regular

AS_UTF8 = 'save the table as "CSV UTF-8"'
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def read_csv_text(path: Path, example: str) -> str:
    """The text of a file.

    Raises:
        InputError: It cannot be read, is no regular file, or no text in UTF-8; `example` says what to give.
    """
    try:
        with open_regular(path) as file:
            content = file.read()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give {example}") from None
    except (OSError, ValueError) as error:  # ValueError: the path holds a NUL byte
        name = str(path).replace("\0", "\\0")
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{name}: cannot be read ({reason}); give {example}") from None
    if content.startswith(UTF16_MARKS):
        raise InputError(f"{path}: is text in UTF-16; {AS_UTF8}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: line {line} is no text in UTF-8, but perhaps in Latin-1; {AS_UTF8}") from None
    if "\0" in text:
        raise InputError(f"{path}: line {text[: text.index(chr(0))].count(chr(10)) + 1} holds NUL bytes; {AS_UTF8}")
    return text


def csv_rows(path: Path, lines: Iterable[tuple[int, str]], separator: str) -> list[tuple[int, list[str]]]:
    """The rows of cells of numbered lines, each with the number of its last line; blank lines are none.

    Raises:
        InputError: A cell is too long, or a quotation mark is not closed.
    """
    number = 0

    def counted() -> Iterable[str]:
        nonlocal number
        for number, line in lines:  # noqa: B007
            yield line

    try:
        return [(number, row) for row in csv.reader(counted(), delimiter=separator, strict=True) if row]
    except csv.Error as error:
        if "field larger" in str(error):
            most = f"{csv.field_size_limit():,}"
            raise InputError(f"{path}: line {number}: a cell has more than {most} characters; shorten it") from None
        cure = "look for a quotation mark that is not closed"
        raise InputError(f"{path}: line {number}: is no CSV ({error}); {cure}") from None


HEAD_OF_NUMBERS = re.compile(r"\s*(?P<name>\w+)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")
SEPARATORS = ",;\t"
COLUMN_LIMIT = 16_384  # those of spreadsheets


class Head(NamedTuple):
    """The head of a column of numbers."""

    name: str
    unit: str  # empty where there is none
    factor: float  # the SI value of the unit


def number_head(cell: str, units: Mapping[str, str], example: str, path: Path) -> Head:
    """A head such as "angle [deg]", by the SI units of the names that are known.

    Raises:
        SceneError: It is none; the `example` says what a head is.
    """
    match = HEAD_OF_NUMBERS.fullmatch(cell)
    if match is None or match["name"] not in units:
        fail(str(path), f"column {cell.strip()!r} is unknown; the head is of {example}")
    unit = (match["unit"] or "").strip()
    try:
        factor = float(to_si(units[match["name"]], f"1 {unit}")) if unit else 1.0
    except ValueError as error:
        fail(str(path), f"column {cell.strip()}: its unit {error}")
    return Head(match["name"], unit, factor)


def number_in_cell(cell: str, name: str, row: str, path: Path) -> float:
    """The number of a cell.

    Raises:
        SceneError: It is no finite number.
    """
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        fail(str(path), f"{row}: {name} = {cell.strip()} must be a finite number")
    return number


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
    text = read_csv_text(path, "a CSV file")
    first = text.lstrip("\r\n").partition("\n")[0]
    separator = max(SEPARATORS, key=first.count)
    lines = [row for _, row in csv_rows(path, enumerate(StringIO(text, newline=""), 1), separator)]
    if len(lines) < 2:
        raise InputError(f"{path}: has no designs; it needs a line of heads, then a line for each")
    if (columns := max(map(len, lines))) > COLUMN_LIMIT:
        raise InputError(f"{path}: has {columns} columns; a table may have at most {COLUMN_LIMIT}")
    heads = _heads(path, lines)
    rows = lines[1:]
    faults = {i: _fault(row, heads, separator) for i, row in enumerate(rows) if len(row) != len(heads)}
    heads = _with_surplus(heads, max(map(len, rows)))
    padded = [[*row, *[""] * (len(heads) - len(row))] for row in rows]
    columns = {head: [row[j] for row in padded] for j, head in enumerate(heads) if head.strip()}
    return CsvTable(columns, faults, separator != ",")


def _heads(path: Path, lines: list[list[str]]) -> list[str]:
    """The heads; columns without one must be empty."""
    heads = lines[0]
    before: set[str] = set()
    for j, head in enumerate(" ".join(head.split()) for head in heads):
        if not head and any(len(row) > j and row[j].strip() for row in lines[1:]):
            raise InputError(f"{path}: column {j + 1} has no head; name it, or remove it")
        if head and head in before:
            raise InputError(f"{path}: two columns are called `{head}`; keep one, or rename it")
        before.add(head)
    return heads


def _with_surplus(heads: list[str], longest: int) -> list[str]:
    """The heads, with more of them where the longest row has more cells."""
    known = {*heads}
    names = (name for i in count(1) if (name := f"surplus {i}") not in known)
    return [*heads, *islice(names, longest - len(heads))] if longest > len(heads) else heads


def _fault(row: list[str], heads: list[str], separator: str) -> str:
    comma = "; write numbers with a point" if separator == "," and len(row) > len(heads) else ""
    return f"the row has {len(row)} cell{'s' * (len(row) != 1)}, but there are {len(heads)} columns{comma}"
