"""What all commands share: options, checks, progress and tables."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, get_args

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from jaxshroud.march.locate import Locate
from jaxshroud.march.tableau import TABLEAUS, tableau
from jaxshroud.model.modes import Status
from jaxshroud.scene import errors
from jaxshroud.scene.checks import MOST_COUNT, NumericalError, Precision, hint, meant
from jaxshroud.scene.config import SceneFile, load
from jaxshroud.scene.limits import MOST_AUTO

NUMERICAL = (NumericalError, np.linalg.LinAlgError, FloatingPointError)  # no fault of the input
NOT_TEXT = re.compile("[\0\ud800-\udfff]")  # NUL, and what Python makes of bytes that are no UTF-8
LONG = re.compile(r"--[\w-]+")  # an option without its value
NEGATIVE = re.compile(r"-\.?\d")  # the start of a value below zero
LINE = 600  # characters of a message
SEEDS = 10**18
DIGITS = 20  # of a number that is too large for anything


class InputError(errors.InputError):
    """The command line is wrong; the message is one line."""


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and which knows what a misspelt word may have meant."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"cannot be {value!r}{hint(str(value), [*action.choices])}")

    def error(self, message: str) -> NoReturn:
        """Leave with status 2."""
        raise InputError(f"{self.prog}: {message}; see {self.prog} --help")


def one_line(error: Exception) -> str:
    """The message of an error as one line that can be read."""
    text = " ".join(str(error).split())
    return text if len(text) <= LINE else f"{text[: LINE // 2]} ... {text[-LINE // 2 :]}"


def words(arguments: Sequence[str]) -> list[str]:
    """The words of a command line, with a value such as `-2mm` joined to its option: argparse takes it for another.

    Raises:
        InputError: A word is no text.
    """
    joined: list[str] = []
    for word in arguments:
        if NOT_TEXT.search(word):
            raise InputError(f"{word[:60]!a}: holds a NUL or bytes that are no UTF-8; give text")
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


def path(text: str) -> Path:
    """A path that can be looked up, whether or not something is there."""
    try:
        os.stat(text)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be looked up ({error.strerror})") from None
    return Path(text)


def _steps(text: str) -> int | str:
    return text if text == "auto" else count(1, MOST_AUTO)(text)


def _accuracy(text: str) -> str:
    from jaxshroud.verbs.accuracy import NAMED, level

    try:
        level(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}{meant(text, [*NAMED])}") from None
    return text


def scene_options(made: argparse.ArgumentParser, method: bool = True) -> None:
    """Options of every command that simulates a scene; those of the march only if it has a `method` to choose."""
    made.add_argument("scene", metavar="SCENE", help="a TOML file or the name of a shipped scene")
    made.add_argument("--set", action="append", default=[], metavar="K=V", help="override table.key=value")
    made.add_argument("--periods", type=count(1), metavar="N", help="periods kept")
    made.set_defaults(steps_per_period=None, choice=None)
    if method:
        made.add_argument(
            "--accuracy", type=_accuracy, metavar="A", help="fast, balanced, reference or a number: chooses all below"
        )
        made.add_argument("--steps-per-period", type=_steps, metavar="N", help='or "auto"')
        made.add_argument("--tableau", choices=TABLEAUS, help="Runge-Kutta method; rk4 by default")
        made.add_argument("--locate", choices=get_args(Locate), help="how events are located")
        made.add_argument("--precision", choices=get_args(Precision), help="float64 by default")
    made.add_argument("--force", action="store_true", help="replace existing results")


def loaded(options: argparse.Namespace, *more: str) -> SceneFile:
    """The scene file asked for, with its overrides and `more` of them."""
    flags = {"periods": options.periods, "steps_per_period": options.steps_per_period}
    flags["transient"] = getattr(options, "transient", None)
    overrides = [f"run.{name}={value}" for name, value in flags.items() if value is not None]
    return load(options.scene, [*options.set, *overrides, *more])


def chosen_method(options: argparse.Namespace, locate: Locate = "cubic"):
    """The static choices of the march asked for."""
    from jaxshroud.march.method import Choices

    ledger = getattr(options, "ledger", True)
    if options.choice is not None:
        return options.choice.method._replace(ledger=ledger)
    precision = options.precision or "float64"
    return Choices(tableau(options.tableau or "rk4"), options.locate or locate, ledger, precision)


def check_step(file: SceneFile, scenes: Any, options: argparse.Namespace) -> int:
    """Steps per period of scenes (leading axis): refuse what is unstable for some, warn of what is inaccurate."""
    from jaxshroud.march.stability import step_report, steps_for, stiffest

    method = tableau(options.tableau or "rk4")
    choose_accuracy(file, scenes, options)
    if options.choice is not None:
        return options.choice.steps
    asked, free = file.run.steps_per_period, file.scene.parts.contact == "none"
    try:
        steps = steps_for(scenes, 1, asked, None if free else method)
    except ValueError as error:
        raise InputError(f"{file.name}: [run] {error}") from None
    if asked == "auto" and not free:
        print(f"steps_per_period = {steps}, by the stiffness of the scene", file=sys.stderr)
    elif not free and (report := step_report(*stiffest(scenes, 1), steps, method)):
        print(f"warning: {file.name}: [run] {report}", file=sys.stderr)
    return steps


def choose_accuracy(file: SceneFile, scenes: Any, options: argparse.Namespace) -> None:
    """Keep in the options how to march scenes (leading axis) for the accuracy asked for, if any is."""
    from jaxshroud.verbs.accuracy import choose

    if options.accuracy is None:
        return
    for name in ("steps_per_period", "tableau", "locate", "precision"):
        if getattr(options, name) is not None:
            raise InputError(f"--accuracy chooses --{name.replace('_', '-')} itself; give one of them")
    contact = file.scene.parts.contact
    if contact == "smooth":
        raise InputError("--accuracy knows located contact, not smooth contact; give --steps-per-period instead")
    if contact == "none":
        print(f"{file.name}: without contact the motion is in closed form; --accuracy has no choice", file=sys.stderr)
        return
    options.choice = choose(scenes, 1, options.accuracy)
    print(f"{file.name}: {options.choice}", file=sys.stderr)


def unmet(scenes: Any, options: argparse.Namespace) -> np.ndarray | None:
    """Which lanes (leading axis) seem to miss the accuracy asked for, with a warning; None if none was asked for."""
    from jaxshroud.verbs.accuracy import broken

    if options.choice is None:
        return None
    missed = broken(scenes, options.choice)
    if missed.any():
        accuracy = f"the accuracy of {options.choice.accuracy:.0e}"
        print(f"warning: {missed.sum()} of {missed.size} runs miss {accuracy} within three periods", file=sys.stderr)
    return missed


def warn_status(status: np.ndarray, chatter: str | None = None) -> None:
    """Say on standard error how many runs stopped early, and what alternated where one had too many events."""
    for s in Status:
        count = int((status == s).sum())
        if s not in (Status.OK, Status.NOT_RUN) and count:
            about = f": {chatter}" if s == Status.TOO_MANY_EVENTS and chatter else ""
            print(f"warning: {count} of {status.size} runs stopped with {s.name}{about}", file=sys.stderr)


def free(path: Path, force: bool) -> None:
    """Refuse a path that exists, unless forced, or that cannot be written."""
    if path.exists() and not force:
        raise InputError(f"{path}: exists and is kept; give --force to replace it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}; make it first or choose another --out")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: {path.parent} is not writable; choose another --out")


def directory(path: Path, names: Sequence[str], force: bool) -> None:
    """Make a directory for results with these names, all of them free."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); choose another --out") from None
    for name in names:
        free(path / name, force)


@contextmanager
def blamed(where: str):
    """Arguments that turn out to be wrong are wrong input, for which `where` is to blame."""
    try:
        yield
    except (*NUMERICAL, InputError):
        raise
    except (KeyError, ValueError) as error:
        raise InputError(f"{where}: {error.args[0] if error.args else error!r}") from None


@contextmanager
def progress_bar(unit: str):
    """A progress report; the bar appears on a terminal's standard error."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"{unit} (compiling)", total=None)
        yield lambda done, total: bar.update(task, description=unit, completed=done, total=total)


def print_table(title: str, rows: dict[str, Any]) -> None:
    """A table of two columns."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in rows.items():
        text = ", ".join(f"{k}: {v}" for k, v in value.items()) if isinstance(value, dict) else str(value)
        table.add_row(name, text)
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def print_columns(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table with a head, numbers to the right."""
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for i, head in enumerate(heads):
        table.add_column(head, justify="right" if i else "left")
    for row in rows:
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 160).print(table)
