"""The command `diagnose`."""

import argparse
from pathlib import Path

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march, unmet
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import blamed, directory, print_table, progress_bar, warn_status
from jaxshroud.march.method import FAST
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.store import write_json
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.diagnose import diagnose
from jaxshroud.version import __version__

NAMES = ("diagnosis.nc", "diagnosis.json", "diagnosis.png", "diagnosis.pdf")


def diagnose_verb(options: argparse.Namespace) -> None:
    """Say what kind of motion a scene settles on, and why, on one page."""
    file = loaded(options)
    directory(options.out, NAMES, options.force)
    lanes = alone(file.scene)
    how = march(file, lanes, options, FAST, derivatives=True)
    with progress_bar("periods") as report, blamed(file.name):
        found = diagnose(
            file.scene,
            transient=file.run.transient,
            steps_per_period=how.steps,
            method=how.method,
            progress=report,
        )
    unmet(lanes, how.choice)
    _write(named(found, file), file, options.out)
    warn_status(found.status, found.chatter)
    from jaxshroud.results.plot_diagnosis import told

    print_table(file.title or file.name, {**told(found), "evidence": found.evidence, "written": options.out})


def _write(found: Diagnosis, file: SceneFile, out: Path) -> None:
    """The samples, the summary and the page."""
    from jaxshroud.results import drawing

    found.save(out / NAMES[0])
    how = {"method": found.method, "steps_per_period": found.steps_per_period}
    about = {"title": file.title, "scene": file.text(), "source": file.name, "version": __version__}
    write_json({**found.summary, **how, **about}, out / NAMES[1])
    figure = found.plot()
    for name in NAMES[2:]:
        drawing.save(figure, out / name)
