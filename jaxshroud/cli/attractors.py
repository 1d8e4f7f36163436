"""The command `attractors`."""

import argparse
import time
from typing import Any

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import blamed, directory, print_columns, print_table, progress_bar, warn_status
from jaxshroud.march.method import FAST
from jaxshroud.results import drawing
from jaxshroud.results.store import write_json
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.attractors import attractors
from jaxshroud.version import __version__


def attractors_verb(options: argparse.Namespace) -> None:
    """Find the motions that coexist in a scene."""
    file, began = loaded(options), time.perf_counter()
    directory(options.out, ("attractors.nc", "attractors.png", "summary.json"), options.force)
    how = march(file, alone(file.scene), options, FAST, derivatives=True)
    with progress_bar("lane-periods") as report, blamed(file.name):
        found = attractors(
            file.scene,
            options.starts,
            spread=options.spread,
            seed=options.seed,
            most_periods=options.most_periods,
            steps_per_period=how.steps,
            method=how.method,
            progress=report,
        )
    keep(found, "attractors", file, options, time.perf_counter() - began)


def keep(found: Any, name: str, file: SceneFile, options: argparse.Namespace, seconds: float) -> None:
    """Attractors as files of that name, with their picture, and their summary as a file and as tables."""
    named(found, file).save(options.out / f"{name}.nc")
    drawing.save(found.plot(), options.out / f"{name}.png")
    rows = [
        {
            "attractor": name,
            "share": float(found.share[i]),
            "share_95": [float(found.share_low[i]), float(found.share_high[i])],
            "P_d": float(found.P_d[i]),
            "P_d_ci": float(found.P_d_ci[i]),
            "P_d_range": [float(found.P_d_least[i]), float(found.P_d_most[i])],
            "distance": float(found.distance[i]),
        }
        for i, name in enumerate(found.names)
    ]
    worst = None if found.worst is None else {"attractor": found.worst, "P_d": float(found.P_d_least[found.worst])}
    summary = {
        "starts": int(found.label.size),
        "undecided or stopped": found.undecided,
        "worst": worst,
        "method": f"{found.method}, {found.steps_per_period} steps a period",
        "seconds": round(seconds, 2),
    }
    write_json(
        {**summary, "attractors": rows, "scene": file.name, "version": __version__}, options.out / "summary.json"
    )
    warn_status(found.status)
    heads = ("attractor", "share", "95 %", "P_d [%]", "distance")
    lines = [
        (
            r["attractor"],
            f"{r['share']:.4g}",
            "{:.4g} to {:.4g}".format(*r["share_95"]),
            f"{r['P_d']:.5g}",
            f"{r['distance']:.3g}",
        )
        for r in rows
    ]
    print_columns("", heads, lines)
    print_table(file.title or file.name, {**summary, "written": options.out})
