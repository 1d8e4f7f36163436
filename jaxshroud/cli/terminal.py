"""What all commands share on a terminal: messages of one line, tables, progress, and what ends a command."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

from jaxshroud.cache.compiling import is_compiling
from jaxshroud.io import files
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError, NumericalError, StoreError
from jaxshroud_command import END_SIGNALS

MAX_MESSAGE_LENGTH = 600  # characters of a message
TABLE_DIGITS = 6  # of floats in tables
LINE_INTERVAL = 10.0  # seconds from line to line of a progress report
KNOWN_SHARE = 0.1  # of a run, after which it is told when it ends
HEARD_WITHIN = 2.0  # seconds from a signal to the exception in the main thread, if that does not compile
TOLD_TWICE = 1.0  # seconds within which SIGTERM or SIGHUP after a signal is the same one
REPEATED_SIGNAL = b"\0"  # written in place of a signal's number


class CommandError(InputError):
    """The command line is wrong; the message is one line that says where."""


def printable(text: str) -> str:
    """A text without what a terminal would obey: control characters become marks."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)


def one_line(error: Exception) -> str:
    """The message of an error as one line that can be read."""
    return shortened(" ".join(printable(str(error)).split()))


def shortened(text: str, most: int = MAX_MESSAGE_LENGTH) -> str:
    """A text of some `most` characters: of a longer one, its beginning and its end."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-(most // 2) :]}"


def is_numerical_failure(error: Exception) -> bool:
    """Whether the numbers failed, which is no fault of the input."""
    from numpy.linalg import LinAlgError

    return isinstance(error, NumericalError | LinAlgError | FloatingPointError)


@contextmanager
def input_errors_at(where: str):
    """Within, a KeyError or ValueError is wrong input, and its message begins with `where`."""
    try:
        yield
    except (KeyError, ValueError) as error:
        if isinstance(error, CommandError | StoreError) or is_numerical_failure(error):  # these name their own place
            raise
        message = error.args[0] if error.args else repr(error)
        raise CommandError(f"{where}: {message}") from None


def warn_status(status: Any, chatter: str | None = None) -> None:
    """Say on standard error how many runs stopped early, and what alternated where one had too many events."""
    import numpy as np

    statuses = np.ravel(status)
    for s in Status:
        count = int((statuses == s).sum())
        if s not in (Status.OK, Status.NOT_RUN) and count:
            cause = f": {chatter}" if s == Status.TOO_MANY_EVENTS and chatter else ""
            print(f"warning: {count} of {statuses.size} runs stopped with {s.name}{cause}", file=sys.stderr)


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse a path that exists, a broken link too, unless forced; if it appears later, it is kept."""
    if force:
        return
    if os.path.lexists(path):
        raise CommandError(f"{path}: exists and is kept; give --force to replace it")
    files.expect_free(path)


def require_free(path: Path, force: bool) -> None:
    """Refuse a path that exists, unless forced, or that cannot be written."""
    refuse_existing(path, force)
    if not path.parent.is_dir():
        raise CommandError(f"{path}: there is no directory {path.parent}; make it first or choose another --out")
    if not os.access(path.parent, os.W_OK):
        raise CommandError(f"{path}: {path.parent} is not writable; choose another --out")


def make_directory(path: Path, names: Sequence[str], force: bool) -> None:
    """Make a directory for results with these names, none of which may exist unless forced."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"{path}: cannot be made ({error.strerror}); choose another --out") from None
    for name in names:
        require_free(path / name, force)


class ProgressRate:
    """The rate of work, and the time that is left, from what was done since the first report of it.

    What comes before that is compilation, which is not repeated. Of work in several parts the latest counts.
    """

    def __init__(self, clock: Callable[[], float]):
        self.clock, self.done, self.total = clock, 0.0, 0
        self.first: tuple[float, float] | None = None  # the time [s] of the first report and what was done by then

    def __call__(self, done: float, total: int) -> None:
        """Report that `done` of `total` units are done; a total of 0 is not known."""
        if done and (self.first is None or done < self.done):
            self.first = self.clock(), done
        self.done, self.total = done, total

    @property
    def rate(self) -> float:
        """Units done in a second; 0 where that is not known."""
        if self.first is None or self.done <= self.first[1]:
            return 0.0
        return (self.done - self.first[1]) / max(self.clock() - self.first[0], 1e-9)

    def __str__(self) -> str:
        if not self.rate:
            return ""
        if not KNOWN_SHARE * self.total <= self.done < self.total:
            return f", {self.rate:.3g}/s"
        left = timedelta(seconds=round((self.total - self.done) / self.rate))
        return f", {self.rate:.3g}/s, {left} left"


class ProgressLines:
    """A progress report; while it is open, a thread writes a line on standard error every `LINE_INTERVAL` seconds."""

    def __init__(
        self, unit: str, clock: Callable[[], float] = time.monotonic, pause: Callable[[float], bool] | None = None
    ):
        """A report in `unit`.

        Args:
            unit: What is counted.
            clock: The time [s].
            pause: Waits for so many seconds; true where there are to be no more lines.
        """
        self.unit, self.clock, self.start, self.rate = unit, clock, clock(), ProgressRate(clock)
        self.ended = threading.Event()
        self.pause = pause or self.ended.wait
        self.writer = threading.Thread(target=self._write, daemon=True)

    def __call__(self, done: float, total: int) -> None:
        """Report that `done` of `total` units are done."""
        self.rate(done, total)

    def __str__(self) -> str:
        since, done = timedelta(seconds=round(self.clock() - self.start)), self.rate.done
        share = (f"{done} of {self.rate.total}" if self.rate.total else str(done)) if done else "none"
        return f"{self.unit}: {share} in {since}{self.rate}{_compiling_text()}"

    def __enter__(self) -> "ProgressLines":
        self.writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.writer.join()

    def _write(self) -> None:
        while not self.pause(LINE_INTERVAL):
            with suppress(OSError, ValueError):  # standard error is closed
                print(self, file=sys.stderr, flush=True)


def _compiling_text() -> str:
    """What a report says while programs are being compiled."""
    return " (compiling)" if is_compiling() else ""


@contextmanager
def progress_bar(unit: str):
    """A progress report with rate and time left on standard error: a bar on a terminal, else lines."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.text import Text

    rate = ProgressRate(time.monotonic)

    class Rate(TextColumn):
        def render(self, task):
            return Text(str(rate).removeprefix(", "))

    class Description(TextColumn):
        def render(self, task):
            return Text(f"{task.description}{_compiling_text()}")

    console = Console(stderr=True)
    if not console.is_terminal:
        with ProgressLines(unit) as report:
            yield report
        return
    columns = (Description(""), BarColumn(), MofNCompleteColumn(), Rate(""))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(unit, total=None)

        def report(done: float, total: int) -> None:
            rate(done, total)
            bar.update(task, completed=done, total=total or None)

        yield report


def files_written() -> str:
    """The files that the command has written, which are put in place now, and their folder."""
    files.put_in_place()
    places = [*files.written_files.values()]
    return f"{', '.join(path.name for path in places)} in {places[0].parent}" if places else ""


def print_table(title: str, rows: dict[str, Any]) -> None:
    """A table of two columns."""
    print_columns(title, ("", ""), [(name, _cell_text(value)) for name, value in rows.items()], heads_shown=False)


def _cell_text(value: Any) -> str:
    """A value of a table, floats with the digits that one reads."""
    if isinstance(value, float):
        return f"{value:.{TABLE_DIGITS}g}"
    if isinstance(value, dict):
        return ", ".join(f"{name}: {_cell_text(one)}" for name, one in value.items())
    if isinstance(value, list):
        return (
            ", ".join(f"({_cell_text(one)})" if isinstance(one, list) else _cell_text(one) for one in value) or "none"
        )
    return "none" if value is None else str(value)


def print_columns(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], heads_shown: bool = True) -> None:
    """A table with a head, numbers to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    def plain(text):
        return Text(printable(text))  # no markup: titles and folders may hold anything

    style: Any = {"title_justify": "left", "box": None, "padding": (0, 2, 0, 0)}
    table = Table(title=plain(title) if title else None, show_header=heads_shown, **style)
    for i, head in enumerate(heads):
        table.add_column(plain(head), justify="right" if i and heads_shown else "left")
    for row in rows:
        table.add_row(*map(plain, row))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


@contextmanager
def interruptible(leave: Callable[[], None]) -> Iterator[None]:
    """Within, Ctrl-C raises KeyboardInterrupt, and a second one calls `leave`, which must end the process.

    SIGTERM and SIGHUP are the same as Ctrl-C; those that follow a signal within a second are the same one told twice,
    as by a shell that ends with its terminal. Python itself hears signals only between operations of its main thread,
    and a compilation is one operation: `leave` is called from a thread of its own, and after the first signal too where
    the main thread has not heard it in time. Where Python must ignore the exception, as in callbacks of its garbage
    collector, it is raised again. Outside the main thread nothing changes, nor for a signal that is ignored (`nohup`).
    """
    heeded = [number for number in END_SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread() or not heeded:
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    outer_hook, terminals = sys.unraisablehook, [stream for stream in (1, 2) if os.isatty(stream)]
    is_raised = threading.Event()

    def interrupt(number: int, _: object) -> None:
        if number == signal.SIGHUP:
            _let_go_of_closed(terminals)
        if not is_raised.is_set():
            is_raised.set()
            raise KeyboardInterrupt

    def repeat_ignored(unraisable) -> None:
        if unraisable.exc_type is KeyboardInterrupt:
            is_raised.clear()
            os.write(writer, REPEATED_SIGNAL)
        else:
            outer_hook(unraisable)

    handlers = {number: signal.signal(number, interrupt) for number in heeded}
    outer_fd = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    sys.unraisablehook = repeat_ignored
    listener = threading.Thread(target=_listen, args=(reader, heeded, is_raised, leave), daemon=True)
    listener.start()
    try:
        yield
    finally:
        sys.unraisablehook = outer_hook
        signal.set_wakeup_fd(outer_fd)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(writer)
        listener.join()
        os.close(reader)


def _listen(
    reader: int, heeded: Sequence[signal.Signals], is_raised: threading.Event, leave: Callable[[], None]
) -> None:
    presses, since = 0, 0.0
    deaf = threading.Timer(HEARD_WITHIN, lambda: is_raised.is_set() or leave())
    deaf.daemon = True
    while number := os.read(reader, 1):
        if number == REPEATED_SIGNAL:
            presses -= 1  # the repetition is no press of its own
            time.sleep(0.02)  # main thread out of the callback by then
            signal.pthread_kill(threading.main_thread().ident or 0, heeded[0])
        told_twice = presses and number[0] != signal.SIGINT and time.monotonic() < since + TOLD_TWICE
        if number[0] in heeded and not told_twice:
            presses, since = presses + 1, time.monotonic()
            if deaf.ident is None:
                deaf.start()
        if presses == 2:
            leave()
    deaf.cancel()


def _let_go_of_closed(terminals: Sequence[int]) -> None:
    """Lead streams nowhere that led to a terminal which is gone: writing to it would be an error of its own."""
    for stream in terminals:
        if not os.isatty(stream):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream)
            os.close(nowhere)
