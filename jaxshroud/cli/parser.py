"""The parser of the command line, from the table of commands."""

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.option_table import SHARED_OPTIONS, Option
from jaxshroud.cli.terminal import CommandError
from jaxshroud.scene.checks import hint
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
        description="Rub-impact dynamics of two shrouded blades under bending-torsion coupling.",
    )
    top.add_argument("--version", action="version", version=__version__)
    subparsers = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=OneLineParser)
    for name, command in COMMANDS.items():
        subparser = subparsers.add_parser(
            name,
            help=command.text,
            description=command.text,
            epilog=f"example:\n  {command.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_options(subparser, command.options)
    return top


def add_options(parser: argparse.ArgumentParser, options: Iterable[str | Option]) -> None:
    """Let a parser take options, those of the table by their names."""
    for option in options:
        (SHARED_OPTIONS[option] if isinstance(option, str) else option).add_to(parser)
