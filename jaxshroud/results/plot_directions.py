"""The picture of sweeps in several directions: forward, backward and from rest, with jumps and coexisting motions."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxshroud.model.modes import Status
from jaxshroud.results.axis import axis_of
from jaxshroud.results.drawing import (
    BLUE,
    COLUMN,
    GREY,
    INK,
    ORANGE,
    PLAIN,
    Floats,
    Look,
    legend_below,
    new_figure,
)
from jaxshroud.results.look import on_axes, styled
from jaxshroud.results.panels import figure_of, panel_of, scale_of, title_of

WAYS = {  # direction -> words, colour, marker, size
    "independent": ("from rest", GREY, "o", 3.2),
    "forward": ("forward", BLUE, "o", 2.0),
    "backward": ("backward", ORANGE, "o", 1.0),
}
SHADE = "#e8e8e8"


@styled
def directions(ds: xr.Dataset, ax: Axes | None = None, panel: str | None = None, *, look: Look = PLAIN) -> Figure:
    """Stroboscopic x_1 and P_d over the number, in all directions.

    Args:
        ds: A sweep along one axis with a dimension `direction`.
        ax: Draw there, and only one panel.
        panel: "samples" (the default) or "P_d".
        look: What is asked for otherwise.

    Raises:
        ValueError: There is no such panel.
    """
    ds = ds.sortby(str(ds.attrs["axes"]))
    axis = axis_of(ds[str(ds.attrs["axes"])], look)
    known = {name: draw for name, draw in PANELS.items() if name != "samples" or "x" in ds}
    if ax is not None:
        _shade(ax, ds, axis.edges)
        panel_of(known, panel)(ax, ds, axis.values, look)
        ax.set(xlabel=axis.label)
        on_axes(ax, look)
        return figure_of(ax)
    drawn = known.values()
    figure = new_figure(title_of(ds), COLUMN, 4.2 if "x" in ds else 2.4, look)
    panels = figure.subplots(len(drawn), 1, sharex=True, height_ratios=[2, 1][-len(drawn) :], squeeze=False)[:, 0]
    for one, draw in zip(panels, drawn, strict=True):
        _shade(one, ds, axis.edges)
        draw(one, ds, axis.values, look)
    panels[-1].set(xlabel=axis.label, xlim=axis.edges[[0, -1]])
    figure.align_ylabels(panels)
    legend_below(figure, _handles(ds))
    return figure


def _shade(panel: Axes, ds: xr.Dataset, edges: Floats) -> None:
    """Grounds where motions coexist, and lines where they jump: known once all have been run."""
    if "jump" not in ds:
        return
    for i in np.flatnonzero(ds["coexisting"].to_numpy()):
        panel.axvspan(edges[i], edges[i + 1], color=SHADE, lw=0, zorder=0)
    for way, places in (("forward", edges[:-1]), ("backward", edges[1:])):
        for x in places[ds["jump"].sel(direction=way).to_numpy() > 0]:
            panel.axvline(x, color=WAYS[way][1], lw=0.7, ls=":", zorder=1)


def _draw_samples(panel: Axes, ds: xr.Dataset, values: Floats, look: Look) -> None:
    scale = scale_of(ds["gap"].to_numpy(), look.unit)
    for way, (_, color, marker, size) in WAYS.items():
        one = ds.sel(direction=way).transpose(str(ds.attrs["axes"]), "period", "blade", ...)
        x = (one["x"].to_numpy()[:, :, 0].T * scale.factor).T
        x = np.where(one["status"].to_numpy()[:, None] == Status.OK, x, np.nan)
        lane, style = np.broadcast_to(values[:, None], x.shape), {"mew": 0, "rasterized": True}
        panel.plot(lane.ravel(), x.ravel(), marker, ms=size, color=color, **style)
    panel.set(ylabel=scale.label("1"))


def _draw_power(panel: Axes, ds: xr.Dataset, values: Floats, _: Look) -> None:
    for way, (_words, color, marker, size) in WAYS.items():
        one = ds.sel(direction=way)
        P_d = np.where(one["status"].to_numpy() == Status.OK, one["P_d"].to_numpy(), np.nan)
        panel.plot(values, P_d, marker, ms=size + 0.5, mew=0, color=color)
    panel.set(ylabel="$P_d$ [%]")


PANELS = {"samples": _draw_samples, "P_d": _draw_power}


def _handles(ds: xr.Dataset) -> list[Any]:
    made: list[Any] = [
        Line2D([], [], ls="", marker=marker, ms=size + 1.5, mew=0, color=color, label=words)
        for words, color, marker, size in WAYS.values()
    ]
    if "jump" not in ds:
        return made
    if ds["jump"].to_numpy().any():
        made.append(Line2D([], [], ls=":", lw=0.8, color=INK, label="jump"))
    if ds["coexisting"].to_numpy().any():
        made.append(Patch(color=SHADE, label="motions coexist"))
    return made
