"""The words of a command line, read."""

import argparse
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from jaxshroud.cli.terminal import CommandError
from jaxshroud.scene.checks import MOST_COUNT, hint, meant
from jaxshroud.scene.limits import MOST_AUTO

NOT_TEXT = re.compile("[\0\ud800-\udfff]")  # NUL, and what Python makes of bytes that are no UTF-8
LONG = re.compile(r"--[\w-]+")  # an option without its value
NEGATIVE = re.compile(r"-\.?\d")  # the start of a value below zero
LEAST_WIDTH, MOST_WIDTH = 40, 1000  # of a picture [mm]
DIGITS = 20  # of a number that is too large for anything


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and which knows what a misspelt word may have meant."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"cannot be {value!r}{hint(str(value), [*action.choices])}")

    def error(self, message: str) -> NoReturn:
        """Leave with status 2."""
        raise CommandError(f"{self.prog}: {message}; see {self.prog} --help")


def words(arguments: Sequence[str]) -> list[str]:
    """The words of a command line, with a value such as `-2mm` joined to its option: argparse takes it for another.

    Raises:
        CommandError: A word is no text.
    """
    joined: list[str] = []
    for word in arguments:
        if NOT_TEXT.search(word):
            raise CommandError(f"{word[:60]!a}: holds a NUL or bytes that are no UTF-8; give text")
        if NEGATIVE.match(word) and joined and LONG.fullmatch(joined[-1]):
            word = f"{joined.pop()}={word}"
        joined.append(word)
    return joined


def count(least: int, most: int = MOST_COUNT) -> Callable[[str], int]:
    """A parser of whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        value = (int(text) if len(text) < DIGITS else most + 1) if text.isdecimal() else -1
        if value < least:
            raise argparse.ArgumentTypeError(f"must be a whole number of at least {least}, but is {text!r}")
        if value > most:
            raise argparse.ArgumentTypeError(f"must be at most {most}, but is {text!r}")
        return value

    return parse


def number(text: str) -> float:
    """A number, or a message that says what was given."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, but is {text!r}") from None


def positive(text: str) -> float:
    """A number above zero."""
    value = number(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a number above zero, but is {text!r}")
    return value


def width(text: str) -> float:
    """A width of a picture [mm], from a length with its unit."""
    from jaxshroud.scene.units import to_si

    try:
        value = 1e3 * to_si("m", text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error}; give e.g. 90mm") from None
    if not LEAST_WIDTH <= value <= MOST_WIDTH:
        raise argparse.ArgumentTypeError(f"must be from {LEAST_WIDTH} to {MOST_WIDTH} mm, but is {text!r}")
    return value


def path(text: str) -> Path:
    """A path that can be looked up, whether or not something is there."""
    if not text:
        raise argparse.ArgumentTypeError("must name a place, but is empty")
    try:
        os.stat(text)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be looked up ({error.strerror})") from None
    return Path(text)


def steps(text: str) -> int | str:
    """Steps per period, or "auto"."""
    return text if text == "auto" else count(1, MOST_AUTO)(text)


def accuracy(text: str) -> str:
    """The name or the number of an accuracy."""
    from jaxshroud.verbs.accuracy import NAMED, level

    try:
        level(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}{meant(text, [*NAMED])}") from None
    return text
