"""The command `report`."""

import argparse
import json
import shlex
import sys
from typing import Any

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.numbers import limit_of, values_of
from jaxshroud.cli.scatter import scattering
from jaxshroud.cli.terminal import CommandError, blamed, free, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.vary import value_of
from jaxshroud.verbs.report import report


def report_verb(options: argparse.Namespace) -> None:
    """All that is known of a design, as one document."""
    tuned = None if options.tune is None else Tuned.load(options.tune / "tune.nc")
    best = {} if tuned is None else tuned.design
    file = loaded(options, *(f"{key}={value!r}" for key, value in best.items()))
    if options.out.suffix not in (".html", ".pdf"):
        raise CommandError(f"{options.out}: a report is .html or .pdf")
    free(options.out, options.force)
    limits: dict[str, Any] = {
        "most_penetration": limit_of(file, "--most-penetration", "shroud.gap", options.most_penetration),
        "most_force": limit_of(file, "--most-force", "drive.F_0", options.most_force),
    }
    conditions = {a.key: a.values.tolist() for a in (values_of(file, text) for text in options.range)}
    scatters, at_least = scattering(file, options), options.at_least
    if tuned is not None:
        scatters = tuned.ends_of_scatter({key: value_of(file.scene, key) for key in tuned.scatters}) | scatters
        at_least = tuned.at_least if at_least is None else at_least
        conditions = json.loads(tuned.conditions_asked) | conditions
        limits = {name: min(value, getattr(tuned, name)) for name, value in limits.items()}
    how = march(file, alone(file.scene), options, FAST, derivatives=True)
    with progress_bar("parts") as tell, blamed(file.name):
        found = report(
            file,
            scatters=scatters,
            conditions=conditions,
            at_least=at_least,
            **limits,
            samples=options.samples,
            starts=options.starts,
            seed=options.seed,
            steps_per_period=how.steps,
            method=how.method,
            tuned=tuned,
            command=f"jaxshroud {shlex.join(sys.argv[1:])}",
            progress=tell,
        )
    found.save(options.out)
    reasons = {f"because {i}": reason for i, reason in enumerate(found.reasons, 1)}
    print_table(found.title, {"verdict": found.verdict, **reasons, "written": options.out})
