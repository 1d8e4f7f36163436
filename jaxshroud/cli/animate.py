"""The command `animate`."""

import argparse

from jaxshroud.cli.terminal import CommandError, free, progress_bar
from jaxshroud.results.store import read


def animate_verb(options: argparse.Namespace) -> None:
    """Write a stored run as a moving picture."""
    from jaxshroud.results.animation import save_animation

    free(options.out, options.force)
    ds = read(options.source)
    if "end_turns" not in ds.attrs:
        raise CommandError(f"{options.source}: not a run; give a file written by `jaxshroud simulate`")
    with progress_bar("frames") as report:
        factor = save_animation(
            ds, options.out, periods=options.periods, factor=options.factor, title=options.title, progress=report
        )
    print(f"{options.out} (motion and gap exaggerated {factor:g}-fold)")
