"""Pictures of designs and of accuracy against cost; nothing here simulates."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import LogLocator, NullFormatter

from jaxshroud.results.dimension import words
from jaxshroud.results.drawing import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PINK,
    PLAIN,
    SKY,
    WIDE,
    Floats,
    Look,
    legend_below,
    new_figure,
    quantity,
)
from jaxshroud.results.look import styled
from jaxshroud.results.plot_robust import draw_robust, rows_of_panels
from jaxshroud.results.words import fitting

WORTHLESS = 10.0  # relative error of a derivative: lines beyond leave the picture


@styled
def tuning(data: Mapping[str, Any], *, look: Look = PLAIN) -> Figure:
    """Paths of a tuning over the map of its objective, or key by key where it has no map, and the paths' scores.

    Where it has `robust`: below, how far each number may go, shaded, and how P_d scatters.

    Args:
        data: A tuning as `tune.json` holds it.
        look: What is asked for otherwise.
    """
    title = ": ".join(filter(None, (fitting(str(data["title"]), data["over"]), f"{data['goal']} of $P_d$")))
    robust = data.get("robust")
    rows = 0 if robust is None else rows_of_panels(robust)
    figure = new_figure(title, WIDE, WIDE * (0.5 + 0.3 * rows), look)
    above: FigureBase = figure
    if rows:
        above, below = np.ravel(np.array(figure.subfigures(2, 1, height_ratios=[0.5, 0.3 * rows])))
        draw_robust(below, data)
    left, right = above.subplots(1, 2)
    points, scores = np.array(data["points"]), np.array(data["scores"], float)
    best = int(np.nanargmax(scores[-1]))
    if data["map"] is None:
        _draw_keys(left, data, points, best)
    else:
        _draw_paths(above, left, data, points, best)
    for i in range(scores.shape[1]):
        right.plot(scores[:, i], color=BLUE if i == best else GREY, lw=1.2 if i == best else 0.6)
    right.set(xlabel="update", ylabel="objective less penalties [%]", title="each start; the best in blue")
    return figure


@styled
def trade(data: Mapping[str, Any], *, look: Look = PLAIN) -> Figure:
    """Errors against cost for every setting, the front in the errors of the state marked.

    Args:
        data: Measured settings as `trade.json` holds them.
        look: What is asked for otherwise.
    """
    figure = new_figure(data["title"], WIDE, WIDE * 0.9, look)
    rows = data["settings"]
    wanted = {
        "state_error": f"state after {data['horizon']} periods",
        "P_d": "$P_d$ [percentage points]",
        "gradient": "d(power)/d(gap), relative",
        "period": "share with the right period",
    }
    kinds = list(dict.fromkeys(r["kind"] for r in rows))
    panels = figure.subplots(2, 2).ravel()
    for panel, (name, title) in zip(panels, wanted.items(), strict=True):
        drawn = [r for r in rows if r[name] is not None and (r[name] > 0 or name == "period")]
        for i, kind in enumerate(kinds):
            mine = [r for r in drawn if r["kind"] == kind]
            cost, error = [r["cost"] * 1e6 for r in mine], [r[name] for r in mine]
            dashes = {"float32": ":", "smooth": "--"}.get(kind.split(", ")[-1], "-")
            panel.plot(cost, error, dashes, marker="osv^DPX*"[i % 8], ms=3, lw=0.8, color=f"C{i}", label=kind)
        panel.set(xscale="log", ylabel=title)
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_minor_formatter(NullFormatter())
        if name != "period" and drawn:
            panel.set(yscale="log")
        if name == "gradient" and max((r[name] for r in drawn), default=0) > WORTHLESS:
            panel.set_ylim(top=WORTHLESS)
        if not drawn:
            panel.text(0.5, 0.5, "nothing to compare", ha="center", transform=panel.transAxes)
    for panel in panels[2:]:
        panel.set(xlabel="µs per lane and period")
    best = sorted((r for r in rows if r["front"]), key=lambda r: r["cost"])
    panels[0].plot([r["cost"] * 1e6 for r in best], [r["state_error"] for r in best], color="k", lw=4, alpha=0.15)
    legend_below(figure, panels[0].get_legend_handles_labels()[0])
    return figure


def _draw_paths(figure: FigureBase, panel: Axes, data: Mapping[str, Any], points: Floats, best: int) -> None:
    (x_key, x_ends), (y_key, y_ends) = data["over"].items()
    (x_label, x_unit), (y_label, y_unit) = quantity(x_key), quantity(y_key)
    x, y = np.array(data["map"]["first"]) * x_unit, np.array(data["map"]["second"]) * y_unit
    drawn = panel.pcolormesh(
        x, y, np.array(data["map"]["objective"], float).T, cmap="viridis", shading="nearest", rasterized=True
    )
    figure.colorbar(drawn, ax=panel, label="objective [%]")
    for i in range(points.shape[1]):
        path = points[:, i] * [x_unit, y_unit]
        width, size = (1.4, 3.5) if i == best else (0.7, 2.0)
        panel.plot(*path.T, color="white", lw=width + 1.2)
        panel.plot(*path.T, color=INK, lw=width)
        panel.plot(*path[0], "o", color="white", mec=INK, mew=0.6, ms=size)
    end = np.array(list(data["design"].values())) * [x_unit, y_unit]
    panel.plot(*end, "*", color=ORANGE, mec=INK, mew=0.5, ms=9, label="tuned design", clip_on=False)
    panel.set(xlabel=x_label, ylabel=y_label, xlim=x[[0, -1]], ylim=y[[0, -1]])
    panel.set_xscale("log" if x_ends[0] > 0 else "linear")
    panel.set_yscale("log" if y_ends[0] > 0 else "linear")
    panel.set_title("paths from their starts (circles)")


def _draw_keys(panel: Axes, data: Mapping[str, Any], points: Floats, best: int) -> None:
    """The best path, every key from its lower to its upper bound."""
    colors = [BLUE, ORANGE, PINK, SKY, INK, GREY]
    for i, (key, (low, high)) in enumerate(data["over"].items()):
        value = points[:, best, i]
        share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
        panel.plot(share, color=colors[i % len(colors)], ls="-" if i < len(colors) else "--", label=words(key))
    panel.set(xlabel="update", ylabel="place between the bounds", ylim=(-0.02, 1.02), title="the best path")
    panel.legend(loc="best")
