"""What all commands share: checks of places, one-line messages, progress and tables."""

import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxshroud.model.modes import Status
from jaxshroud.scene.errors import InputError, NumericalError, StoreError

LINE = 600  # characters of a message


class CommandError(InputError):
    """The command line is wrong; the message is one line that says where."""


def printable(text: str) -> str:
    """A text without what a terminal would obey: control characters become marks."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)


def one_line(error: Exception) -> str:
    """The message of an error as one line that can be read."""
    text = " ".join(printable(str(error)).split())
    return text if len(text) <= LINE else f"{text[: LINE // 2]} ... {text[-LINE // 2 :]}"


def numerical(error: Exception) -> bool:
    """Whether the numbers failed, which is no fault of the input."""
    from numpy.linalg import LinAlgError

    return isinstance(error, NumericalError | LinAlgError | FloatingPointError)


@contextmanager
def blamed(where: str):
    """Arguments that turn out to be wrong are wrong input, for which `where` is to blame."""
    try:
        yield
    except (KeyError, ValueError) as error:
        if isinstance(error, CommandError | StoreError) or numerical(error):  # these name their own place
            raise
        told = error.args[0] if error.args else repr(error)
        raise CommandError(f"{where}: {told}") from None


def warn_status(status: Any, chatter: str | None = None) -> None:
    """Say on standard error how many runs stopped early, and what alternated where one had too many events."""
    import numpy as np

    ended = np.ravel(status)
    for s in Status:
        count = int((ended == s).sum())
        if s not in (Status.OK, Status.NOT_RUN) and count:
            about = f": {chatter}" if s == Status.TOO_MANY_EVENTS and chatter else ""
            print(f"warning: {count} of {ended.size} runs stopped with {s.name}{about}", file=sys.stderr)


def free(path: Path, force: bool) -> None:
    """Refuse a path that exists, unless forced, or that cannot be written."""
    if path.exists() and not force:
        raise CommandError(f"{path}: exists and is kept; give --force to replace it")
    if not path.parent.is_dir():
        raise CommandError(f"{path}: there is no directory {path.parent}; make it first or choose another --out")
    if not os.access(path.parent, os.W_OK):
        raise CommandError(f"{path}: {path.parent} is not writable; choose another --out")


def directory(path: Path, names: Sequence[str], force: bool) -> None:
    """Make a directory for results with these names, all of them free."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"{path}: cannot be made ({error.strerror}); choose another --out") from None
    for name in names:
        free(path / name, force)


@contextmanager
def progress_bar(unit: str):
    """A progress report with rate and time left; the bar appears on a terminal's standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(TextColumn):
        def render(self, task):
            return Text(f"{task.speed:.3g}/s" if task.speed else "")

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(""), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"{unit} (compiling)", total=None)
        yield lambda done, total: bar.update(task, description=unit, completed=done, total=total)


def print_table(title: str, rows: dict[str, Any]) -> None:
    """A table of two columns."""
    told = {
        name: ", ".join(f"{k}: {v}" for k, v in v.items()) if isinstance(v, dict) else v for name, v in rows.items()
    }
    print_columns(title, ("", ""), [(name, str(value)) for name, value in told.items()], heads_shown=False)


def print_columns(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], heads_shown: bool = True) -> None:
    """A table with a head, numbers to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    told = lambda text: Text(printable(text))  # no markup: titles and folders are anything  # noqa: E731
    look: Any = {"title_justify": "left", "box": None, "padding": (0, 2, 0, 0)}
    table = Table(title=told(title) if title else None, show_header=heads_shown, **look)
    for i, head in enumerate(heads):
        table.add_column(told(head), justify="right" if i and heads_shown else "left")
    for row in rows:
        table.add_row(*map(told, row))
    Console(width=None if sys.stdout.isatty() else 160).print(table)
