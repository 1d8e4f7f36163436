"""The options that several commands have in common, and the types of arguments. Nothing here is slow to import."""

import argparse
import math
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, get_args

from jaxshroud.march.method_names import METHODS, Locate
from jaxshroud.scene.checks import MAX_AUTO_STEPS, MAX_COUNT, Precision, did_you_mean
from jaxshroud.scene.quantities import QUANTITY_WORDS

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


def vector(text: str) -> list[float]:
    """Three numbers between commas."""
    numbers = [number(part) for part in text.split(",")]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"must be three numbers between commas, but is {text!r}")
    return numbers


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
    from jaxshroud.verbs.accuracy import NAMED, accuracy_level

    try:
        accuracy_level(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}{did_you_mean(text, [*NAMED])}") from None
    return text


MAX_SEED = 10**18


class Option(NamedTuple):
    """An option or a positional argument, with the keywords of `argparse`; None leaves argparse's own default."""

    name: str  # a flag, or the name of a positional argument
    help: str | None = None
    type: Callable[[str], Any] | None = None
    default: Any = None
    metavar: str | None = None
    choices: Iterable[str] | None = None
    required: bool | None = None
    action: str | Callable[..., argparse.Action] | None = None
    dest: str | None = None

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Let a parser take the option."""
        keywords = {key: value for key, value in self._asdict().items() if key != "name" and value is not None}
        if isinstance(self.default, str | int | float) and "default" not in (self.help or ""):
            default = self.default if isinstance(self.default, str) else f"{self.default:g}"
            keywords["help"] = f"{self.help}; {default} by default"
        parser.add_argument(self.name, **keywords)


@dataclass
class Along:
    """One axis of a sweep, as the command line describes it."""

    key: str | None = None  # None: that of the scene
    values: str | None = None
    start: str | None = None
    stop: str | None = None
    num: str | None = None


class NewAxis(argparse.Action):
    """The option that begins a new axis."""

    def __call__(self, parser, namespace, values, option_string=None):
        """Begin it."""
        if namespace.along and namespace.along[0].key is None:
            parser.error(f"{option_string} {values} comes after what describes it; give it first")
        namespace.along = [*(namespace.along or []), Along(str(values))]


class AxisPart(argparse.Action):
    """An option that describes the latest axis, or the scene's own."""

    def __call__(self, parser, namespace, values, option_string=None):
        """Set a field of the axis."""
        if namespace.along is None:
            namespace.along = [Along()]
        setattr(namespace.along[-1], self.dest.removeprefix("axis_"), str(values))


SHARED_OPTIONS = {
    option.name: option
    for option in (
        # Scene and run.
        Option("scene", "a TOML file or the name of a shipped scene", metavar="SCENE"),
        Option(
            "--set",
            "change a number of the scene, e.g. shroud.gap=20um",
            default=[],
            metavar="K=V",
            action="append",
        ),
        Option("--periods", "drive periods that are kept", count(1), metavar="N"),
        Option("--transient", "drive periods that are discarded first", count(0), metavar="N"),
        # Method of the march.
        Option(
            "--accuracy",
            "fast (1e-3), balanced (1e-6), reference (1e-10) or a number: the error after three periods; it chooses "
            "the method and its steps; by default as the scene says, else balanced",
            accuracy,
            metavar="A",
        ),
        Option("--steps-per-period", 'integration steps in a drive period, or "auto"', steps, metavar="N"),
        Option(
            "--tableau",
            "Runge-Kutta method, or taylor: power series; by default --accuracy chooses it, or rk4 if only steps are "
            "given",
            choices=METHODS,
        ),
        Option("--order", "order of the power series of --tableau taylor", count(1), metavar="N"),
        Option("--step-tolerance", "relative tolerance of a step of --tableau taylor", number, metavar="R"),
        Option("--locate", "how events are located; by default as suits the method", choices=get_args(Locate)),
        Option("--precision", "precision of all numbers; float64 by default", choices=get_args(Precision)),
        Option("--linear", "let contact stay in this state, and take the closed form", choices=("apart", "stuck")),
        Option("--forces", "keep contact forces, slip, wear and impacts", action="store_true"),
        Option("--amplitudes", "keep amplitudes of x, y and theta: mean, RMS and peak", action="store_true"),
        # Design and scatter.
        Option(
            "--over",
            "number and its bounds, e.g. shroud.gap=5um:60um",
            default=[],
            metavar="K=LO:HI",
            action="append",
        ),
        Option(
            "--range",
            "operating condition, e.g. drive.F_0=20,40",
            default=[],
            metavar="K=A,B,C",
            action="append",
        ),
        Option(
            "--tolerance",
            "number and its half width, e.g. shroud.gap=10um",
            default=[],
            metavar="K=D",
            action="append",
        ),
        Option(
            "--spread",
            "number and its half width, e.g. drive.F_0=20%%",
            default=[],
            metavar="K=P%",
            action="append",
        ),
        Option("--most-penetration", "largest penetration that is allowed, e.g. 0.2mm", metavar="LENGTH"),
        Option("--most-force", "largest normal force that is allowed, e.g. 500N", metavar="FORCE"),
        Option(
            "--of",
            "reduction of power, power or amplitude; by default P_d, of preloaded scenes P_d_vibration",
            choices=QUANTITY_WORDS,
        ),
        Option("--at-least", "P_d [%%] whose probability is computed", number, metavar="P_d"),
        # Random numbers, and counts.
        Option("--samples", "draws of the numbers that scatter", count(2), metavar="N"),
        Option("--starts", "random starts", count(1), metavar="N"),
        Option("--seed", "seed of the random numbers", count(0, MAX_SEED), 0, metavar="N"),
        Option("--most-periods", "periods after which a motion counts as aperiodic", count(64), metavar="N"),
        # Results.
        Option("--title", "title of the picture", metavar="TEXT"),
        Option("--dpi", "dots per inch of pictures", count(30, 2400), 200, metavar="N"),
        Option("--out", "folder of the results, made if it is not there", path, metavar="DIR", required=True),
        Option("--force", "replace existing results", action="store_true"),
    )
}
SCENE_FLAGS = ("scene", "--set", "--periods")
METHOD_FLAGS = (
    *("--accuracy", "--steps-per-period", "--tableau", "--order", "--step-tolerance", "--locate", "--precision"),
)
SCATTER_FLAGS = ("--over", "--tolerance", "--spread")


def shared_option(name: str, **changes: Any) -> Option:
    """One of the shared options, changed for a command."""
    return SHARED_OPTIONS[name]._replace(**changes)
