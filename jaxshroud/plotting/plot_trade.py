"""Pictures of accuracy against cost."""

from collections.abc import Mapping
from functools import partial

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from jaxshroud.plotting.page import Page, Panel, Summary
from jaxshroud.plotting.style import PAGE_WIDTH, AnyFigure, Look, fitting_title, legend_below

WORTHLESS = 10.0  # relative error of a derivative at which the axis ends
ERRORS = {
    "state_error": "state after {} periods",
    "P_d": "$P_d$ [percentage points]",
    "gradient": "d(power)/d(gap), relative",
    "period": "share with the right period",
}


def trade_page(data: Summary, look: Look) -> Page[Summary]:
    """The errors against the cost of all settings, with the Pareto front of the state's error marked.

    Args:
        data: The measured settings as `trade.json` holds them.
        look: The appearance asked for.
    """
    panels = [Panel(name, partial(_draw_error, name=name)) for name in ERRORS]
    size = PAGE_WIDTH, PAGE_WIDTH * 0.9
    return Page(data, panels, fitting_title(str(data["title"])), size, columns=2, finish=_name_settings)


def _draw_error(panel: Axes, data: Summary, name: str) -> None:
    """One kind of error of all settings against their cost."""
    rows = [row for row in data["settings"] if row[name] is not None and (row[name] > 0 or name == "period")]
    for i, kind in enumerate(dict.fromkeys(row["kind"] for row in data["settings"])):
        rows_of_kind = [row for row in rows if row["kind"] == kind]
        cost, error = [row["cost"] * 1e6 for row in rows_of_kind], [row[name] for row in rows_of_kind]
        dashes = {"float32": ":", "smooth": "--"}.get(kind.split(", ")[-1], "-")
        panel.plot(cost, error, dashes, marker="osv^DPX*"[i % 8], ms=3, lw=0.8, color=f"C{i}", label=kind)
    panel.set(xscale="log", xlabel="µs per lane and period", ylabel=ERRORS[name].format(data["horizon"]))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.xaxis.set_minor_formatter(NullFormatter())
    if name != "period" and rows:
        panel.set(yscale="log")
    if name == "gradient" and max((row[name] for row in rows), default=0) > WORTHLESS:
        panel.set_ylim(top=WORTHLESS)
    if not rows:
        panel.text(0.5, 0.5, "nothing to compare", ha="center", transform=panel.transAxes)
    if name == "state_error":
        front = sorted((row for row in data["settings"] if row["front"]), key=lambda row: row["cost"])
        cost, error = [row["cost"] * 1e6 for row in front], [row[name] for row in front]
        panel.plot(cost, error, color="k", lw=4, alpha=0.15)


def _name_settings(figure: AnyFigure, axes: Mapping[str, Axes], data: Summary) -> None:
    """Add the legend, and label the cost only below the lower panels."""
    for name in ("state_error", "P_d"):
        axes[name].set_xlabel("")
    legend_below(figure, axes["state_error"].get_legend_handles_labels()[0])
