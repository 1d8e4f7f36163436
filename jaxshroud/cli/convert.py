"""The command `convert`."""

import argparse

from jaxshroud.cli.terminal import CommandError, free
from jaxshroud.results.convert import convert
from jaxshroud.results.store import read
from jaxshroud.scene.errors import StoreError


def convert_verb(options: argparse.Namespace) -> None:
    """Write a stored result for other programs."""
    if options.source.suffix == ".json":
        raise CommandError(f"{options.source}: other programs read it as it is; give a .nc")
    data = read(options.source)
    if "version" not in data.attrs:
        raise StoreError(f"{options.source}: not a result of jaxshroud; give a .nc that it has written")
    free(options.out, options.force)
    convert(data, options.out, options.rows)
    print(options.out)
