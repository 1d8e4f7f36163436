"""The command `basins`."""

import argparse
import time
from collections.abc import Sequence

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.attractors import keep
from jaxshroud.cli.terminal import CommandError, blamed, directory, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.scene.axes import axis
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.basins import basins


def basins_verb(options: argparse.Namespace) -> None:
    """Draw which motion each start of a plane ends on."""
    file, began = loaded(options), time.perf_counter()
    directory(options.out, ("basins.nc", "basins.png", "summary.json"), options.force)
    plane = [name.strip() for name in options.plane.split(",")]
    ranges = _ranges(file, plane, options)
    how = march(file, alone(file.scene), options, FAST, derivatives=True)
    with progress_bar("lane-periods") as report, blamed(f"--plane {options.plane}"):
        found = basins(
            file.scene,
            plane,
            ranges=ranges,
            num=options.num,
            most_periods=options.most_periods,
            steps_per_period=how.steps,
            method=how.method,
            progress=report,
        )
    keep(found, "basins", file, options, time.perf_counter() - began)


def _ranges(file: SceneFile, plane: Sequence[str], options: argparse.Namespace) -> list[tuple[float, float]] | None:
    """The ranges asked for, two numbers each in --start and --stop."""
    if options.start is None and options.stop is None:
        return None
    ends = [[end.strip() for end in (text or "").split(",")] for text in (options.start, options.stop)]
    if any(len(end) != len(plane) or "" in end for end in ends):
        raise CommandError(f"--start and --stop need a value for each of {', '.join(plane)}, e.g. --start=-1mm,-0.5")
    made = [
        axis(file, f"initial.{name.removeprefix('initial.')}", start=a, stop=b, num=2).values
        for name, a, b in zip(plane, *ends, strict=True)
    ]
    return [(float(v.min()), float(v.max())) for v in made]
