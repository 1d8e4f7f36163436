"""The command `power`."""

import argparse
import sys

from jaxshroud.batch.extent import fits
from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march, unmet
from jaxshroud.cli.plot import draw_json
from jaxshroud.cli.store import named, power_json
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_table, progress_bar, warn_status
from jaxshroud.march.method import FAST_WITH_LEDGER
from jaxshroud.results.store import read_json, write_json
from jaxshroud.verbs.power import power


def power_verb(options: argparse.Namespace) -> None:
    """Average P_d of one scene until it is stable."""
    file = loaded(options)
    if not options.tolerance > 0:
        raise CommandError(f"--tolerance must be positive, but is {options.tolerance}")
    directory(options.out, ("power.json", "power.nc", "power.png"), options.force)
    lanes = alone(file.scene)
    with blamed(file.name):
        fits(1, file.run.transient, file.run.periods)
    how = march(file, lanes, options, FAST_WITH_LEDGER)
    with progress_bar("periods") as report, blamed(file.name):
        result = power(
            file.scene,
            n_periods=file.run.periods,
            transient=file.run.transient,
            steps_per_period=how.steps,
            tolerance=options.tolerance,
            method=how.method,
            progress=report,
        )
    named(result, file).save(options.out / "power.nc")
    data = power_json(result, file)
    write_json(data, options.out / "power.json")
    draw_json(options.out / "power.json", read_json(options.out / "power.json"), options.out / "power.png")
    final = result.final
    unmet(lanes, how.choice)
    warn_status(final["status"], final["chatter"])
    if not final["stable"]:
        print(
            f"warning: P_d is not stable after {final['n']} periods; give more with --periods",
            file=sys.stderr,
        )
    print_table(
        file.title or file.name,
        {
            "P_d": f"{final['P_d']:.6g} +- {final['ci']:.2g} %",
            "periods": final["n"],
            "stable": final["stable"],
            "period number": final["period_number"] or "aperiodic",
            "written": options.out,
        },
    )
