"""The command line: one verb per question, each in the module of its name.

Exit status 0: done (a run that stopped early is a warning). 1: the machine or the numbers failed. 2: the input is
wrong, one line says where. 130: interrupted. 141: nobody reads what is printed.
"""

import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module

from jaxshroud.cli.keyboard import interruptible
from jaxshroud.cli.parser import parser
from jaxshroud.cli.terminal import numerical, one_line
from jaxshroud.cli.words import words
from jaxshroud.results import files
from jaxshroud.scene.errors import InputError, MachineError

SHOW_CURSOR = "\x1b[?25h"  # which the progress bar hides


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    files.written.clear()
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  until the end of the process
    try:
        options = parser().parse_args(words(sys.argv[1:] if arguments is None else arguments))
        verb = getattr(import_module(f"jaxshroud.cli.{options.verb}"), f"{options.verb}_verb")
        if "jax" in sys.modules:
            _set_up_jax()
    except Exception as error:
        return _failed(error)
    with interruptible(_leave):  # only now: what is imported does not bear an exception of Ctrl-C
        try:
            verb(options)
            sys.stdout.flush()
        except KeyboardInterrupt as stopped:
            print(_interrupted(*map(str, stopped.args)), file=sys.stderr)
            return 130
        except Exception as error:
            return _failed(error)
    return 0


def _set_up_jax() -> None:
    """Float64, and programs of all sizes kept on disk; lanes that stop are told by the commands themselves."""
    import jax

    from jaxshroud.batch.cache import cache_compilations
    from jaxshroud.results.status import LaneWarning

    warnings.filterwarnings("ignore", category=LaneWarning)

    jax.config.update("jax_enable_x64", True)
    cache_compilations()


def _failed(error: Exception) -> int:
    """Exit status of a failure, which is told in one line; one that nobody has foreseen is raised."""
    if isinstance(error, BrokenPipeError):  # nobody reads standard output
        _abandon_output()
        return 141
    if isinstance(error, MachineError):
        status, told = 1, str(error)
    elif isinstance(error, InputError):
        status, told = 2, one_line(error)
    elif numerical(error):
        status, told = 1, f"numerical failure: {one_line(error)}"
    elif isinstance(error, MemoryError | OSError) or _of_xla(error):
        status, told = 1, f"the machine failed: {one_line(error) or 'out of memory'}"
        _abandon_output()
    else:
        raise error
    print(told, file=sys.stderr)
    return status


def _abandon_output() -> None:
    """Where standard output cannot be written, keep Python's own flush from complaining."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _of_xla(error: Exception) -> bool:
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(error, jax.errors.JaxRuntimeError)


def _interrupted(told: str = "", more: str = "") -> str:
    """What an interrupted command says: what was written, and how to go on."""
    return f"interrupted; {told or ', '.join(map(str, files.written)) or 'nothing'} was written{more}"


def _leave() -> None:
    """End the process at once: the second Ctrl-C."""
    files.remove_parts()
    os.write(2, f"{SHOW_CURSOR if sys.stderr.isatty() else ''}{_interrupted()}\n".encode())
    os._exit(130)
