"""The text of CSV files that people and other programs write: what cannot be read is named with its cure."""

import csv
from collections.abc import Iterable
from pathlib import Path

from jaxshroud.scene.checks import InputError
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
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give {example}") from None
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
