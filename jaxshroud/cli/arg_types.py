"""The types of arguments: functions that read a word of the command line."""

import argparse
import os
import re
from collections.abc import Callable
from pathlib import Path

from jaxshroud.scene.checks import MAX_AUTO_STEPS, MAX_COUNT, did_you_mean

LEAST_WIDTH, MOST_WIDTH = 40, 1000  # of a picture [mm]
MAX_INTEGER_DIGITS = 20  # of a number that is too large for anything


def count(least: int, most: int = MAX_COUNT) -> Callable[[str], int]:
    """A parser of whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        value = (int(text) if len(text) < MAX_INTEGER_DIGITS else most + 1) if text.isdecimal() else -1
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


def speed(text: str) -> float:
    """A speed of the rotor [rad/s], from one with its unit."""
    from jaxshroud.scene.units import to_si

    try:
        return to_si("rad/s", text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error}; give e.g. 1450rpm") from None


def shares(text: str) -> list[float]:
    """Positive numbers between commas."""
    return [positive(part) for part in text.split(",")]


def engine_orders(text: str) -> list[float]:
    """Positive numbers between commas, or A..B for all whole numbers from A to B."""
    if ends := re.fullmatch(r"(\d{1,3})\.\.(\d{1,3})", text):
        return [float(order) for order in range(int(ends[1]), int(ends[2]) + 1)]
    return shares(text)


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
    return text if text == "auto" else count(1, MAX_AUTO_STEPS)(text)


def accuracy(text: str) -> str:
    """The name or the number of an accuracy."""
    from jaxshroud.verbs.setting import NAMED, accuracy_level

    try:
        accuracy_level(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}{did_you_mean(text, [*NAMED])}") from None
    return text
