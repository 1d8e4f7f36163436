"""The command line: its parser from the table of commands, and the command run to an exit status.

Exit status 0: done (a run that stopped early is a warning). 1: the machine or the numbers failed. 2: the input is
wrong, one line says where. 130: interrupted. 141: standard output is closed.
"""

import argparse
import logging
import os
import re
import sys
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from importlib import import_module
from typing import Any, NoReturn

import jaxshroud
from jaxshroud.cli.command_table import COMMANDS, GROUPS
from jaxshroud.cli.option_table import SHARED_OPTIONS, Option
from jaxshroud.cli.progress import CommandReport, lines_written, reported
from jaxshroud.cli.terminal import (
    INTERRUPTED,
    READER_GONE,
    CommandError,
    failed_pictures,
    interruptible,
    is_numerical_failure,
    one_line,
)
from jaxshroud.io import files
from jaxshroud.scene.checks import InputError, MachineError, hint
from jaxshroud.version import __version__

NOT_TEXT = re.compile("[\0\ud800-\udfff]")  # NUL, and what Python makes of bytes that are not UTF-8
OPTION_NAME = re.compile(r"--[\w-]+")  # an option without its value
NEGATIVE_NUMBER = re.compile(r"-\.?\d")  # the start of one


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and which knows what a misspelt word may have meant."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"cannot be {value!r}{hint(str(value), [*action.choices])}")

    def error(self, message: str) -> NoReturn:
        """Leave with status 2."""
        raise CommandError(f"{self.prog}: {message}; see {self.prog} --help")


def join_negative_values(arguments: Sequence[str]) -> list[str]:
    """The words of a command line, with a value such as `-2mm` joined to its option: argparse takes it for another.

    Raises:
        CommandError: A word is not text.
    """
    joined: list[str] = []
    for word in arguments:
        if NOT_TEXT.search(word):
            raise CommandError(f"{word[:60]!a}: holds a NUL or bytes that are no UTF-8; give text")
        if NEGATIVE_NUMBER.match(word) and joined and OPTION_NAME.fullmatch(joined[-1]):
            word = f"{joined.pop()}={word}"
        joined.append(word)
    return joined


def parser() -> OneLineParser:
    """The parser of all commands."""
    top = OneLineParser(
        prog="jaxshroud",
        description="How much do rubbing shrouds reduce the vibration of turbine blades, and which are best?",
        epilog=f"{_groups_text()}\n\nOptions: jaxshroud VERB --help; pages: docs/verbs/VERB.md",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=__version__)
    subparsers = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=OneLineParser)
    for name, command in COMMANDS.items():
        subparser = subparsers.add_parser(
            name,
            description=command.text,
            epilog=f"example:\n  {command.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_options(subparser, command.options)
    return top


def _groups_text() -> str:
    """The commands by the questions that they answer, with an example of each question."""
    groups = []
    for question, names in GROUPS.items():
        lines = [f"  {name:<10}  {COMMANDS[name].text}" for name in names]
        example = COMMANDS[names[0]].example.splitlines()[0]
        groups.append("\n".join([question, *lines, f"  e.g. {example}"]))
    return "\n\n".join(groups)


def add_options(parser: argparse.ArgumentParser, options: Iterable[str | Option]) -> None:
    """Let a parser take options, those of the table by their names."""
    for option in options:
        (SHARED_OPTIONS[option] if isinstance(option, str) else option).add_to(parser)


SHOW_CURSOR = "\x1b[?25h"  # which the progress bar hides


_printed_interruption: list[str] = []  # empty until Ctrl-C


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    _printed_interruption.clear()
    failed_pictures.clear()
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns where it cannot keep a cache of its own
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  until the end of the process
    words = sys.argv[1:] if arguments is None else arguments
    with lines_written(), reported(CommandReport(words[0] if words else "")), ExitStack() as at_end:
        return _run(words, at_end)


def _run(words: Sequence[str], at_end: ExitStack) -> int:
    """Run the command of these words and return its exit status."""
    try:
        options = parser().parse_args(join_negative_values(words))
        prefetching = _prefetch(options, at_end)
        command = _command(options.verb)
        if not prefetching and "jax" in sys.modules:
            set_up_jax()
    except Exception as error:
        return _exit_status(error)
    with interruptible(_leave) as reader_gone:  # only now: an import does not survive an exception of Ctrl-C
        try:
            with files.results_together():
                command(options)
            sys.stdout.flush()
            if prefetching:
                _keep_list()
        except KeyboardInterrupt as interrupt:
            _printed_interruption.append(_interruption_message(*map(str, interrupt.args)))
            with suppress(OSError):  # standard error may have had the same reader
                print(_printed_interruption[-1], file=sys.stderr)
            if not reader_gone.is_set():
                return INTERRUPTED
            _abandon_output()
            return READER_GONE
        except Exception as error:
            return _exit_status(error)
    for line in failed_pictures:
        print(line, file=sys.stderr)
    return _status_of_places() or int(bool(failed_pictures))


def _status_of_places() -> int:
    """0 where results are where they were to be; 1, and a line, where they are beside what has appeared meanwhile."""
    if not files.kept_files:
        return 0
    kept, places = (", ".join(map(str, paths)) for paths in (files.kept_files, files.written_files.values()))
    print(f"{kept}: has appeared during the run and is kept; the results are {places}", file=sys.stderr)
    return 1


def _prefetch(options: Namespace, at_end: ExitStack) -> bool:
    """Load the programs of a command about a scene while it is imported, until the end; False for other commands."""
    scene = getattr(options, "scene", None)
    if scene is None:
        return False
    set_up_jax()
    from jaxshroud.cache.programs import prefetch, stop_prefetch

    at_end.callback(stop_prefetch)
    prefetch(f"{options.verb} {scene}")
    return True


def _keep_list() -> None:
    from jaxshroud.cache.programs import keep_list

    keep_list()


def _command(name: str) -> Callable[[Namespace], None]:
    """The function of a command, with the modules that it needs imported."""
    getattr(jaxshroud, name, None)  # the verb, which imports JAX; some commands are not verbs
    return getattr(import_module(f"jaxshroud.cli.{COMMANDS[name].module}"), f"{name}_command")


def set_up_jax() -> None:
    """Float64, and programs of all sizes kept on disk; commands print themselves which lanes stopped."""
    import jax

    from jaxshroud.batch.compilation_cache import cache_compilations
    from jaxshroud.io.lane_status import AccuracyWarning, LaneWarning

    for category in (LaneWarning, AccuracyWarning):
        warnings.filterwarnings("ignore", category=category)
    jax.config.update("jax_enable_x64", True)
    try:
        cache_compilations()
    except OSError as error:
        print(f"note: {error}; programs are compiled anew in every process", file=sys.stderr)


def _exit_status(error: Exception) -> int:
    """Exit status of an error, whose message is printed as one line; an unforeseen one is raised."""
    if isinstance(error, BrokenPipeError):  # standard output is closed
        _abandon_output()
        return READER_GONE
    if isinstance(error, MachineError):
        status = 1
        message = str(error)
    elif isinstance(error, InputError):
        status = 2
        message = one_line(error)
    elif is_numerical_failure(error):
        status = 1
        message = f"numerical failure: {one_line(error)}"
    elif isinstance(error, RuntimeError | AssertionError) and _lacks_device():
        platforms = os.environ.get("JAX_PLATFORMS", "")
        status = 1
        message = f"JAX_PLATFORMS={platforms}: JAX has no such device here; unset it, or set it to cpu"
    elif isinstance(error, MemoryError | OSError) or _is_xla_failure(error):
        status = 1
        message = f"the machine failed: {one_line(error) or 'out of memory'}"
        _abandon_output()
    else:
        raise error
    print(message, file=sys.stderr)
    return status


def _abandon_output() -> None:
    """Where standard output cannot be written, keep Python's own flush from complaining."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _lacks_device() -> bool:
    """Whether JAX is to use a device that is not here, on which it fails in several ways, and each time."""
    if "jax" not in sys.modules or not os.environ.get("JAX_PLATFORMS"):
        return False
    try:
        sys.modules["jax"].devices()
    except (RuntimeError, AssertionError):
        return True
    return False


def _is_xla_failure(error: Exception) -> bool:
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(error, jax.errors.JaxRuntimeError)


def _interruption_message(written: str = "", advice: str = "") -> str:
    """The message of an interrupted command: what was written, and how to go on."""
    return (
        f"interrupted; {written or ', '.join(map(str, files.written_files.values())) or 'nothing'} was written{advice}"
    )


def _leave(status: int) -> None:
    """End the process at once: the second Ctrl-C."""
    files.leave_files()
    message = "" if _printed_interruption else f"{_interruption_message()}\n"
    with suppress(OSError):  # nobody reads it
        os.write(2, f"{SHOW_CURSOR if sys.stderr.isatty() else ''}{message}".encode())
    os._exit(status)
