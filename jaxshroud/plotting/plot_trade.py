"""Pictures of accuracy against cost."""

from collections.abc import Iterable, Mapping
from functools import partial

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from jaxshroud.plotting.page import Page, Panel, Summary
from jaxshroud.plotting.style import (
    COLOURS,
    COLUMN_WIDTH,
    INK,
    AnyFigure,
    Appearance,
    Properties,
    fitting_title,
    legend_below,
)

WORTHLESS = 10.0  # relative error of a derivative at which the axis ends
ERRORS = {
    "state_error": "error of the state\nafter {} periods",
    "P_d": "error of $P_d$\n[percentage points]",
    "gradient": "error of\nd(power)/d(gap)",
    "period": "share with the\nright period",
}
VARIANTS = {"float32": ("s", ":"), "smooth": ("^", "--"), "bisection": ("D", "-."), "not located": ("X", "-.")}


def trade_page(data: Summary, appearance: Appearance) -> Page[Summary]:
    """The errors against the cost of all settings, with the Pareto front of the state's error marked.

    Args:
        data: The measured settings as `trade.json` holds them.
        appearance: The appearance asked for.
    """
    panels = [Panel(name, partial(_draw_error, name=name), 0.7 if name == "period" else 1.0) for name in ERRORS]
    title = fitting_title(str(data["title"]))
    return Page(data, panels, title, (COLUMN_WIDTH, 7.2), shared="x", finish=_name_settings)


def _draw_error(panel: Axes, data: Summary, name: str) -> None:
    """One kind of error of all settings against their cost."""
    rows = [row for row in data["settings"] if row[name] is not None and (row[name] > 0 or name == "period")]
    for kind, style in _styles(row["kind"] for row in data["settings"]).items():
        rows_of_kind = [row for row in rows if row["kind"] == kind]
        cost, error = [row["cost"] * 1e6 for row in rows_of_kind], [row[name] for row in rows_of_kind]
        panel.plot(cost, error, label=kind, **style)
    panel.set(xscale="log", xlabel="µs per lane and period", ylabel=ERRORS[name].format(data["horizon"]))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.xaxis.set_minor_formatter(NullFormatter())
    if name != "period" and rows:
        panel.set(yscale="log")
        panel.margins(y=0.1)
    if name == "gradient" and max((row[name] for row in rows), default=0) > WORTHLESS:
        panel.set_ylim(top=WORTHLESS)
    if not rows:
        panel.text(0.5, 0.5, "nothing to compare", ha="center", transform=panel.transAxes)
    if name == "state_error":
        front = sorted((row for row in data["settings"] if row["front"]), key=lambda row: row["cost"])
        cost, error = [row["cost"] * 1e6 for row in front], [row[name] for row in front]
        panel.plot(cost, error, color=INK, lw=4, alpha=0.15, label="best of all")


def _styles(kinds: Iterable[str]) -> dict[str, Properties]:
    """The appearance of each kind of setting: a colour for each method, a mark and dashes for each variant."""
    styles: dict[str, Properties] = {}
    methods: dict[str, str] = {}
    for kind in dict.fromkeys(kinds):
        method, _, variant = kind.partition(", ")
        color = methods.setdefault(method, COLOURS[len(methods) % len(COLOURS)])
        marker, dashes = VARIANTS.get(variant, ("o", "-"))
        styles[kind] = {"color": color, "marker": marker, "ls": dashes, "ms": 3, "mew": 0, "lw": 0.8}
    return styles


def _name_settings(figure: AnyFigure, axes: Mapping[str, Axes], data: Summary) -> None:
    """Add the legend."""
    figure.align_ylabels([*axes.values()])
    legend_below(figure, axes["state_error"].get_legend_handles_labels()[0])
