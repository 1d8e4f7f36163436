"""Pictures of accuracy against cost."""

from functools import partial
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from jaxshroud.plotting.page import Page, Panel, Summary
from jaxshroud.plotting.style import COLOURS, COLUMN_WIDTH, INK, Appearance, fitting_title, legend_below

WORTHLESS = 10.0  # relative error of a derivative at which the axis ends
ERRORS = {
    "state_error": "error of the state\nafter {} periods",
    "P_d": "error of $P_d$\n[percentage points]",
    "gradient": "error of\nd(power)/d(gap)",
    "period": "share with\nright period",
}
VARIANTS = {"float32": "s:", "smooth": "^--", "bisection": "D-.", "not located": "X-."}  # mark and dashes


def trade_page(data: Summary, appearance: Appearance) -> Page[Summary]:
    """The errors against the cost of all settings, with the Pareto front of the state's error marked.

    Args:
        data: The measured settings as `trade.json` holds them.
        appearance: The requested appearance.
    """
    panels = [Panel(name, partial(_draw_error, name=name), 0.7 if name == "period" else 1.0) for name in ERRORS]
    return Page(
        data,
        panels,
        fitting_title(str(data["title"])),
        size=(COLUMN_WIDTH, 7.2),
        shared="x",
        finish=lambda figure, axes, _: legend_below(figure, axes["state_error"].get_legend_handles_labels()[0]),
    )


def _draw_error(panel: Axes, data: Summary, name: str) -> None:
    """One kind of error of all settings against their cost: a colour for each method, marks for each variant."""
    table: Any = pd.DataFrame(data["settings"])
    cost = table["cost"] * 1e6
    error = table[name].astype(float)
    error = error.where((error > 0) | (name == "period"))
    colours: dict[str, str] = {}
    for kind in table["kind"].unique():
        rows = table["kind"] == kind
        method, _, variant = kind.partition(", ")
        panel.plot(
            cost[rows],
            error[rows],
            VARIANTS.get(variant, "o-"),
            color=colours.setdefault(method, COLOURS[len(colours) % len(COLOURS)]),
            label=kind,
            ms=3,
            mew=0,
            lw=0.8,
        )
    panel.set(xscale="log", xlabel="µs per lane and period", ylabel=ERRORS[name].format(data["horizon"]))
    if error.isna().all():
        panel.text(0.5, 0.5, "nothing to compare", ha="center", transform=panel.transAxes)
    elif name != "period":
        panel.set(yscale="log")
    if name == "gradient" and error.max() > WORTHLESS:
        panel.set_ylim(top=WORTHLESS)
    if name == "state_error":
        front = cost[table["front"]].sort_values().index
        panel.plot(cost[front], error[front], color=INK, lw=4, alpha=0.15, label="best of all")
