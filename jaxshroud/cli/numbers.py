"""Numbers that options name: with bounds, values, limits, tolerances and spreads."""

import argparse

from jaxshroud.cli.terminal import CommandError
from jaxshroud.scene.axes import axis
from jaxshroud.scene.file import Axis, SceneFile


def bounds(file: SceneFile, text: str) -> Axis:
    """A number with its lower and upper bound, from KEY=LOW:HIGH."""
    key, _, ends = text.partition("=")
    if ends.count(":") != 1:
        raise CommandError(f"--over {text}: is not KEY=LOW:HIGH, e.g. --over shroud.gap=5um:200um")
    return axis(file, key.strip(), ends.split(":"), where=f"--over {key}")


def values_of(file: SceneFile, text: str) -> Axis:
    """An operating condition with its values, from KEY=A,B,C."""
    key, _, values = text.partition("=")
    if not values:
        raise CommandError(f"--range {text}: is not KEY=A,B,C, e.g. --range drive.F_0=20,40,60,80")
    return axis(file, key.strip(), values, where=f"--range {key}")


def limit_of(file: SceneFile, flag: str, key: str, text: str | None) -> float:
    """A limit with the unit of a key; infinity where none is given."""
    if text is None:
        return float("inf")
    value = float(axis(file, key, ["0", text], where=f"{flag} {text}").values[1])
    if not value > 0:
        raise CommandError(f"{flag} {text}: must be positive")
    return value


def tolerances(file: SceneFile, options: argparse.Namespace) -> dict[str, float]:
    """Half widths [SI] of numbers, from --tolerance KEY=WIDTH."""
    found = {}
    for text in options.tolerance:
        key, _, to = (part.strip() for part in text.partition("="))
        found[key] = abs(float(axis(file, key, ["0", to], where=f"--tolerance {text}").values[1]))
    return found


def spreads(options: argparse.Namespace) -> dict[str, float]:
    """Half widths of numbers as shares of them, from --spread KEY=PERCENT."""
    found = {}
    for text in options.spread:
        key, _, share = (part.strip() for part in text.partition("="))
        try:
            found[key] = float(share.removesuffix("%")) / 100
        except ValueError:
            raise CommandError(f"--spread {text}: is not KEY=PERCENT, e.g. --spread drive.F_0=20%") from None
    return found
