"""What all commands share on a terminal: messages of one line, tables, and what ends a command."""

import errno
import os
import select
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxshroud.io import files
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError, NumericalError, StoreError
from jaxshroud_command import END_SIGNALS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_MESSAGE_LENGTH = 600  # characters of a message
TABLE_DIGITS = 6  # of floats in tables
HEARD_WITHIN = 2.0  # seconds from a signal to the exception in the main thread, if that does not compile
TOLD_TWICE = 1.0  # seconds within which SIGTERM or SIGHUP after a signal is the same one
REPEATED_SIGNAL = b"\0"  # written in place of a signal's number
STDOUT = 1  # its handle
ENDS_WITHIN = 300  # milliseconds after its reader has gone, a command that is about to end
INTERRUPTED, READER_GONE = 130, 141  # exit statuses


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


def claim_directory(path: Path, names: Sequence[str], force: bool) -> None:
    """Refuse a directory for results with these names, one of which exists, unless forced, or that cannot be made.

    It is made with the first file that is written there: a command that writes nothing leaves none.
    """
    if why := _why_not_made(path):
        raise CommandError(f"{path}: cannot be made ({why}); choose another --out")
    for name in names:
        if path.is_dir():
            require_free(path / name, force)
        else:
            refuse_existing(path / name, force)
    files.expect_folder(path)


def _why_not_made(path: Path) -> str:
    """Why a directory is not there and cannot be made; empty if it can."""
    try:
        return "" if stat.S_ISDIR(path.stat().st_mode) else os.strerror(errno.EEXIST)
    except FileNotFoundError:
        pass
    except OSError as error:
        return error.strerror or str(error)
    if path.is_symlink():  # that leads nowhere
        return os.strerror(errno.EEXIST)
    nearest = next(parent for parent in path.absolute().parents if parent.exists())
    return "" if os.access(nearest, os.W_OK | os.X_OK) else os.strerror(errno.EACCES)


def files_written() -> str:
    """The files that the command has written, which are put in place now, and their folder."""
    files.put_in_place()
    places = [*files.written_files.values()]
    return f"{', '.join(path.name for path in places)} in {places[0].parent}" if places else ""


failed_pictures: list[str] = []  # of this command, with the reasons


def draw(figure: Callable[[], "Figure"], *paths: Path, dpi: int) -> None:
    """Write the picture that `figure` draws, with `dpi` dots per inch; a failure is said at the end of the command."""
    from jaxshroud.plotting.style import save_figure

    try:
        save_figure(figure(), *paths, dpi=dpi)
    except Exception as error:
        names = ", ".join(map(str, paths))
        failed_pictures.append(f"{names}: cannot be drawn ({one_line(error) or type(error).__name__})")


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

    console = Console(width=None if sys.stdout.isatty() else 160)
    if title:
        console.print(plain(title), style="italic")
    table = Table(show_header=heads_shown, box=None, padding=(0, 2, 0, 0))
    for i, head in enumerate(heads):
        table.add_column(plain(head), justify="right" if i and heads_shown else "left")
    for row in rows:
        table.add_row(*map(plain, row))
    console.print(table)


@contextmanager
def interruptible(leave: Callable[[int], None]) -> Iterator[threading.Event]:
    """Within, Ctrl-C raises KeyboardInterrupt, and a second one calls `leave`, which must end the process.

    `leave` is called with its exit status. Where standard output is a pipe, as in `| head`, and its reader goes, that
    is an interruption too, and the event that is yielded is set.

    SIGTERM and SIGHUP are the same as Ctrl-C; those that follow a signal within a second are the same one sent twice,
    as by a shell that ends with its terminal. Python itself hears signals only between operations of its main thread,
    and a compilation is one operation: `leave` is called from a thread of its own, and after the first signal too where
    the main thread has not heard it in time. Where Python must ignore the exception, as in callbacks of its garbage
    collector, it is raised again. Outside the main thread nothing changes, nor for a signal that is ignored (`nohup`).
    """
    heeded = [number for number in END_SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    reader_gone = threading.Event()
    if threading.current_thread() is not threading.main_thread() or not heeded:
        yield reader_gone
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    outer_hook = sys.unraisablehook
    terminals = [stream for stream in (1, 2) if os.isatty(stream)]
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
    listener = threading.Thread(target=_listen, args=(reader, heeded, is_raised, reader_gone, leave), daemon=True)
    listener.start()
    try:
        yield reader_gone
    finally:
        sys.unraisablehook = outer_hook
        signal.set_wakeup_fd(outer_fd)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(writer)
        listener.join()
        os.close(reader)


def _listen(
    reader: int,
    heeded: Sequence[signal.Signals],
    is_raised: threading.Event,
    reader_gone: threading.Event,
    leave: Callable[[int], None],
) -> None:
    presses = 0
    since = 0.0
    poll = select.poll()
    poll.register(reader, select.POLLIN)
    if _is_pipe(STDOUT):
        poll.register(STDOUT, 0)  # an error, which is always reported, means that nobody reads it any more

    def end() -> None:
        leave(READER_GONE if reader_gone.is_set() else INTERRUPTED)

    deaf = threading.Timer(HEARD_WITHIN, lambda: is_raised.is_set() or end())
    deaf.daemon = True
    while True:
        if STDOUT in dict(poll.poll()):
            poll.unregister(STDOUT)
            if not presses and not poll.poll(ENDS_WITHIN):  # nor does it end by itself, as one that writes just then
                reader_gone.set()
                signal.pthread_kill(threading.main_thread().ident or 0, heeded[0])
            continue
        number = os.read(reader, 1)
        if not number:
            break
        if number == REPEATED_SIGNAL:
            presses -= 1  # the repetition is no press of its own
            time.sleep(0.02)  # main thread out of the callback by then
            signal.pthread_kill(threading.main_thread().ident or 0, heeded[0])
        told_twice = presses and number[0] != signal.SIGINT and time.monotonic() < since + TOLD_TWICE
        if number[0] in heeded and not told_twice:
            presses = presses + 1
            since = time.monotonic()
            if deaf.ident is None:
                deaf.start()
        if presses == 2:
            end()
    deaf.cancel()


def _is_pipe(stream: int) -> bool:
    try:
        return stat.S_ISFIFO(os.fstat(stream).st_mode)
    except OSError:  # it is closed
        return False


def _let_go_of_closed(terminals: Sequence[int]) -> None:
    """Lead streams nowhere that led to a terminal which is gone: writing to it would be an error of its own."""
    for stream in terminals:
        if not os.isatty(stream):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream)
            os.close(nowhere)
