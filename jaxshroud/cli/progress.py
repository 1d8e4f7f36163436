"""Progress of commands on standard error: what is being done, how far it is, and when it ends."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

from jaxshroud.activity import Piece, innermost_piece, is_compiling, seconds_compiling

LINE_INTERVAL = 8.0  # seconds from line to line: nobody is to wait for ten
FIRST_LINE = 4.0  # until the first of them [s]
BAR_WIDTH = 20
KNOWN_SHARE = 0.1  # of a run, after which its end is estimated
TimeSource = Callable[[], float]  # [s]


class ProgressReport:
    """How far a piece of work in several parts is; of these the latest counts.

    Its rate is that from the first report to the latest one of a part, without the time of compilations, which are not
    repeated.
    """

    def __init__(self, unit: str, clock: TimeSource = time.monotonic, compiling: TimeSource = seconds_compiling):
        """A report.

        Args:
            unit: What is counted.
            clock: The time.
            compiling: How much of it programs were being compiled.
        """
        self.unit, self.clock, self.compiling = unit, clock, compiling
        self.start = clock()
        self.done = 0.0
        self.total = 0
        self.first = self.latest = (0.0, 0.0)  # working time, and what was done by then
        self.reported_within: Piece | None = None

    def _working_time(self) -> float:
        return self.clock() - self.start - self.compiling()

    def __call__(self, done: float, total: int) -> None:
        """Report that `done` of `total` units are done; a total of 0 is not known."""
        now = self._working_time(), done
        if not self.first[1] or done < self.done:
            self.first = now
        self.done = done
        self.total = total
        self.latest = now
        self.reported_within = innermost_piece()

    @property
    def rate(self) -> float:
        """Units done in a second; 0 where that is not known."""
        if not 0 < self.first[1] < self.latest[1]:
            return 0.0
        return (self.latest[1] - self.first[1]) / max(self.latest[0] - self.first[0], 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """How long what is left takes, by the rate so far; None where that is not known."""
        if is_compiling() or not self.rate or not KNOWN_SHARE * self.total <= self.done < self.total:
            return None
        left = (self.total - self.done) / self.rate - (self._working_time() - self.latest[0])
        return left if left > 0 else None

    @property
    def counts(self) -> str:
        """What is done, and of how much where that is known."""
        if not self.done:
            return "none"
        return f"{self.done} of {self.total}" if self.done <= self.total else str(self.done)

    @property
    def elapsed(self) -> timedelta:
        """The time since its start, in whole seconds."""
        return timedelta(seconds=round(self.clock() - self.start))

    @property
    def pace(self) -> str:
        """The rate, the time that is left, and what is being done meanwhile."""
        left = self.seconds_left
        parts = [f"{self.rate:.3g}/s"] if self.rate else []
        parts += [] if left is None else [f"{timedelta(seconds=round(left))} left"]
        return ", ".join(parts)

    @property
    def meanwhile(self) -> str:
        """What is being done that the report does not count."""
        piece = innermost_piece()
        if is_compiling():
            return " (compiling)"
        return "" if piece is None or piece is self.reported_within else f" ({piece})"

    def __str__(self) -> str:
        pace = f", {self.pace}" if self.pace else ""
        return f"{self.unit}: {self.counts} in {self.elapsed}{pace}{self.meanwhile}"


class CommandReport(ProgressReport):
    """That a command is at work, as long as no report of its own is open."""

    def __str__(self) -> str:
        return f"{self.unit}: at work for {self.elapsed}{self.meanwhile}"


class SilentReport(ProgressReport):
    """That what is being done is shown by other means."""

    def __str__(self) -> str:
        return ""


_open_reports: list[ProgressReport] = []  # the innermost last
_open_bars: list[Any] = []  # of which the innermost is shown


@contextmanager
def reported(report: ProgressReport) -> Iterator[None]:
    """Within, lines say what this report says."""
    _open_reports.append(report)
    try:
        yield
    finally:
        _open_reports.remove(report)


@contextmanager
def lines_written(pause: Callable[[float], bool] | None = None) -> Iterator[None]:
    """Within, a thread writes what the innermost report says on standard error, every few seconds.

    Args:
        pause: Waits for so many seconds; true where there are to be no more lines.
    """
    ended = threading.Event()
    writer = threading.Thread(target=_write_lines, args=(pause or ended.wait,), daemon=True)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()


def _write_lines(pause: Callable[[float], bool]) -> None:
    interval = FIRST_LINE
    while not pause(interval):
        interval = LINE_INTERVAL
        line = str(_open_reports[-1]) if _open_reports else ""
        with suppress(OSError, ValueError):  # standard error is closed
            if line:
                print(line, file=sys.stderr, flush=True)


@contextmanager
def progress_bar(unit: str) -> Iterator[Callable[[float, int], None]]:
    """A progress report with rate and time left on standard error: a bar on a terminal, else the lines of a command."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.text import Text

    report = ProgressReport(unit)
    console = Console(stderr=True)
    if not console.is_terminal:
        with reported(report):
            yield report
        return

    class Told(TextColumn):
        def render(self, task):
            return Text(str(report))

    outer = _open_bars[-1:]
    for bar in outer:
        bar.stop()
    with (
        reported(SilentReport(unit)),
        Progress(BarColumn(BAR_WIDTH), Told(""), console=console, transient=True) as bar,
    ):
        _open_bars.append(bar)
        task = bar.add_task(unit, total=None)

        def update(done: float, total: int) -> None:
            report(done, total)
            bar.update(task, completed=done, total=total or None)

        try:
            yield update
        finally:
            _open_bars.remove(bar)
    for bar in outer:
        bar.start()
