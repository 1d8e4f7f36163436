"""The command `simulate`."""

import argparse
import sys

from jaxshroud.batch.extent import STEP, memory_for
from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march, unmet
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import CommandError, blamed, free, print_table, progress_bar, warn_status
from jaxshroud.march.method import REFERENCE
from jaxshroud.march.tableau import LEAST_STEPS
from jaxshroud.model.modes import Status
from jaxshroud.results.earlier import Earlier, last_state
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.simulate import simulate


def simulate_verb(options: argparse.Namespace) -> None:
    """Integrate one scene and store its motion."""
    file = loaded(options)
    free(options.out, options.force)
    if options.out.suffix != ".nc":
        raise CommandError(f"{options.out}: a trajectory needs a name that ends in .nc")
    _fits(file, options)
    lanes = alone(file.scene)
    begin = Earlier(None, 0.0, 0.0, ()) if options.earlier is None else last_state(options.earlier, file)
    how = march(file, lanes, options, REFERENCE)
    if begin.differences:
        print(f"going on from another scene: {'; '.join(begin.differences)}", file=sys.stderr)
    with progress_bar("samples") as report, blamed(file.name):
        found = simulate(
            file.scene,
            begin.state,
            n_periods=file.run.periods,
            steps_per_period=how.steps,
            every=options.every,
            turns=begin.turns,
            t=begin.t,
            method=how.method,
            events=options.events,
            progress=report,
        )
    named(found, file).save(options.out)
    warn_status(found.status, found.chatter)
    unmet(lanes, how.choice)
    events = ", ".join(f"{n} {name}" for name, n in found.counters.items() if n) or "none"
    print_table(
        file.title or file.name,
        {
            "samples": len(found.t),
            "status": Status(found.status).name,
            "events": events,
            "energy residual": f"{found.energy_residual:.1e} of the drive's work",
            "energy dropped": f"{found.energy_dropped:.1e} of the drive's gross work, where flat contact began",
            "written": options.out,
        },
    )


def _fits(file: SceneFile, options: argparse.Namespace) -> None:
    """Refuse what would not fit into memory, before anything is compiled."""
    steps = file.run.steps_per_period
    least = LEAST_STEPS if steps is None or steps == "auto" or options.accuracy else steps
    with blamed(file.name):
        memory_for("what is stored of this run", file.run.periods * least // options.every * STEP)
