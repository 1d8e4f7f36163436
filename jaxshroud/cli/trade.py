"""The command `trade`."""

import argparse

from jaxshroud.cli.asked import loaded
from jaxshroud.cli.store import trade_json
from jaxshroud.cli.terminal import blamed, directory, print_columns, progress_bar
from jaxshroud.results import drawing, plot_design
from jaxshroud.results.store import write_json
from jaxshroud.verbs.setting import LEVELS
from jaxshroud.verbs.trade import cheapest, error_of, trade


def run(options: argparse.Namespace) -> None:
    """Measure accuracy against cost on scenes around one."""
    file = loaded(options)
    directory(options.out, ("trade.json", "trade.png"), options.force)
    with progress_bar("settings") as report, blamed(file.name):
        found = trade(
            file.scene,
            lanes=options.lanes,
            transient=file.run.transient,
            n_periods=file.run.periods,
            seed=options.seed,
            progress=report,
        )
    data = trade_json(found, file)
    write_json(data, options.out / "trade.json")
    drawing.save(plot_design.trade(data), options.out / "trade.png")
    heads = (
        "accuracy of the state",
        "cheapest setting",
        "steps",
        "us / lane / period",
        "error",
        "P_d [%]",
    )
    rows = []
    for level in LEVELS:
        best = cheapest(found, level)
        told = ("none reaches it", "", "", "", "")
        if best is not None:
            numbers = (f"{best.steps}", f"{best.cost * 1e6:.3g}", f"{error_of(best):.1e}", f"{best.P_d:.1e}")
            told = (str(best.setting), *numbers)
        rows.append((f"{level:.0e}", *told))
    print_columns(f"{file.title or file.name}: {options.lanes} scenes around it", heads, rows)
    print(options.out)
