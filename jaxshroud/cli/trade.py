"""The command `trade`."""

import argparse

from jaxshroud.cli.store import trade_json
from jaxshroud.cli.terminal import (
    SEEDS,
    OneLineParser,
    blamed,
    count,
    directory,
    loaded,
    path,
    print_columns,
    progress_bar,
    scene_options,
)
from jaxshroud.results.store import write_json


def trade_options(made: OneLineParser) -> None:
    """Options of `jaxshroud trade`."""
    scene_options(made, method=False)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded before P_d is averaged")
    made.add_argument("--lanes", type=count(8), default=64, metavar="N", help="scenes scattered around the scene")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N", help="of the scattering")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def trade_verb(options: argparse.Namespace) -> None:
    """`jaxshroud trade`."""
    from jaxshroud.results import drawing, plot_design
    from jaxshroud.verbs.setting import LEVELS
    from jaxshroud.verbs.trade import cheapest, error_of, trade

    file = loaded(options)
    directory(options.out, ("trade.json", "trade.png"), options.force)
    run = file.run
    with progress_bar("settings") as report, blamed(file.name):
        found = trade(
            file.scene,
            lanes=options.lanes,
            transient=run.transient,
            n_periods=run.periods,
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
