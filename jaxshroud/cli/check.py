"""The command `check`."""

import argparse

from jaxshroud.cli.asked import loaded
from jaxshroud.cli.terminal import print_columns, print_table
from jaxshroud.verbs.check import check
from jaxshroud.verbs.sheet import lines_of, rows_of


def check_verb(options: argparse.Namespace) -> None:
    """Print the data sheet of a scene."""
    file = loaded(options)
    sheet = check(file.scene)
    print_columns(file.title or file.name, *rows_of(sheet))
    print_table("", lines_of(sheet))
