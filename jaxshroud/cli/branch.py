"""The command `branch`."""

import argparse
import sys
import time
from typing import Any

import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_columns, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.results import drawing
from jaxshroud.results.kinds import KINDS
from jaxshroud.results.store import write_json
from jaxshroud.scene.axes import axis
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.verbs.branch import branch
from jaxshroud.verbs.sweep import sweep
from jaxshroud.version import __version__


def branch_verb(options: argparse.Namespace) -> None:
    """Follow a periodic orbit along a number of a scene, over a sweep."""
    at = [] if options.at is None else [f"{options.along}={options.at}"]
    file, key = loaded(options, *at), options.along
    values = _values(file, options)
    names = ("branch.nc", "branch.png", "summary.json") + (("sweep.nc",) if options.num else ())
    directory(options.out, names, options.force)
    began = time.perf_counter()
    ends = scenes_at(file.scene, [key], np.array([[values.min()], [values.max()]]))
    how, over = march(file, ends, options, FAST, derivatives=True), None
    with progress_bar("drive periods") as report, blamed(file.name):
        result = branch(
            file.scene,
            key,
            float(values.min()),
            float(values.max()),
            most_points=options.most_points,
            doublings=options.doublings,
            steps_per_period=how.steps,
            method=how.method,
            progress=report,
        )
    named(result, file).save(options.out / "branch.nc")
    if options.num:
        run = file.sweep_run
        with progress_bar("lane-periods") as report, blamed(file.name):
            fits(values.size, run.transient, run.periods)
            over = sweep(
                file.scene,
                {key: values},
                n_periods=run.periods,
                transient=run.transient,
                steps_per_period=how.steps,
                method=how.method,
                progress=report,
            )
        named(over, file).save(options.out / "sweep.nc")
    drawing.save(result.plot(over=over), options.out / "branch.png")
    _told(result, file, options, time.perf_counter() - began)


def _values(file: SceneFile, options: argparse.Namespace) -> np.ndarray:
    """The values of the sweep behind, from end to end of the range."""
    own = next((a.values for a in file.axes if a.key == options.along), None)
    ends = [options.start, options.stop]
    if own is not None:
        ends = [pick(own) if end is None else end for end, pick in zip(ends, (np.min, np.max), strict=True)]
    if None in ends:
        raise CommandError(f"--along {options.along}: {file.name} has no range of it; give --start and --stop")
    return axis(file, options.along, start=ends[0], stop=ends[1], num=max(options.num, 2)).values


def _told(result, file: SceneFile, options: argparse.Namespace, seconds: float) -> None:
    """The summary, as a file and as tables."""
    special = result.special
    summary: dict[str, Any] = {
        "points": len(result.value),
        "unstable": int((~result.stable).sum()),
        "branches": len(result.ends),
        **{kind: n for kind in KINDS[1:] if (n := sum(s.kind == kind for s in special))},
        "closed to": float(result.residual.max()),
        "method": f"{result.method}, {result.steps_per_period} steps a period",
        "seconds": round(seconds, 2),
    }
    rows = [
        {
            "kind": s.kind,
            "value": s.value,
            "period": s.q,
            "branch": s.branch,
            "multiplier": [s.multiplier.real, s.multiplier.imag],
        }
        for s in special
    ]
    about = {"along": options.along, "special": rows, "ends": result.ends, "scene": file.name, "version": __version__}
    write_json(summary | about, options.out / "summary.json")
    for line in result.messages:
        print(line, file=sys.stderr)
    if special:
        lines = [(s.kind, f"{s.value:.9g}", s.q, s.branch, f"{s.multiplier:.6g}") for s in special]
        print_columns(
            "", ("kind", options.along, "period", "branch", "multiplier"), [[str(c) for c in r] for r in lines]
        )
    print_table(file.title or file.name, {**summary, "written": options.out})
