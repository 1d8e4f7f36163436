"""Pictures of coexisting motions and of their basins."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jaxshroud.results.axis import axis_of
from jaxshroud.results.drawing import (
    BLUE,
    COLUMN,
    ORANGE,
    PINK,
    PLAIN,
    QUANTITIES,
    SKY,
    Look,
    legend_below,
    new_figure,
    say,
)
from jaxshroud.results.look import on_axes, styled
from jaxshroud.results.panels import figure_of, panel_of, scale_of
from jaxshroud.results.plot import STOPPED

Attractors = Basins = Any  # those of `results`, which import this module

COLOURS = (BLUE, ORANGE, "#009E73", PINK, SKY, "#D55E00", "#4d4d4d", "#F0E442")
SHOWN = len(COLOURS)  # attractors with a colour of their own; the others share the last


def colour(attractor: int) -> str:
    """Of an attractor by its place."""
    return COLOURS[min(attractor, SHOWN - 1)]


@styled
def attractors(found: Attractors, ax: Axes | None = None, panel: str | None = None, *, look: Look = PLAIN) -> Figure:
    """Orbits, shares and P_d of coexisting motions."""
    if ax is not None:
        panel_of(PANELS, panel)(ax, found)
        on_axes(ax, look)
        return figure_of(ax)
    figure = new_figure(str(found.data.attrs.get("title", "")), COLUMN, 4.2, look)
    if not len(found.share):
        return say(figure, "no attractor was found")
    grid = figure.add_gridspec(2, 2, height_ratios=[2.3, 1])
    _draw_orbits(figure.add_subplot(grid[0, :]), found)
    left = figure.add_subplot(grid[1, 0])
    right = figure.add_subplot(grid[1, 1], sharey=left)
    right.tick_params(labelleft=False)
    _draw_shares(left, found)
    _draw_power(right, found)
    return figure


def _draw_orbits(panel: Axes, found: Attractors) -> None:
    """The left blade's path, and where it is at the strobe."""
    scale = scale_of(np.asarray(found.gap))
    for i in reversed(range(len(found.share))):
        thin: Any = {"lw": 0.5, "alpha": 0.6} if found.kind[i] == 2 else {"lw": 1.0}
        panel.plot(found.path_x[i] * scale.factor, found.path_v_x[i], color=colour(i), label=_name(found, i), **thin)
        panel.plot(
            found.motion.x[i, 0] * scale.factor,
            found.motion.v_x[i, 0],
            "o",
            ms=3,
            color=colour(i),
            mec="white",
            mew=0.4,
        )
    panel.set(xlabel=scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def _name(found: Attractors, i: int) -> str:
    return f"{chr(65 + i) if i < 26 else i}: {found.names[i]}"


def _rows(panel: Axes, found: Attractors) -> np.ndarray:
    """The attractors from above to below."""
    rows = np.arange(len(found.share))
    panel.set(yticks=rows, yticklabels=[_name(found, i) for i in rows.tolist()], ylim=(len(rows) - 0.5, -0.5))
    return rows


def _draw_shares(panel: Axes, found: Attractors) -> None:
    for i in _rows(panel, found).tolist():
        ends = [[found.share[i] - found.share_low[i]], [found.share_high[i] - found.share[i]]]
        panel.errorbar([found.share[i]], [i], xerr=ends, fmt="o", ms=3, color=colour(i), capsize=2, lw=0.8)
    panel.set(xlabel="share of starts", xlim=(0, 1))


def _draw_power(panel: Axes, found: Attractors) -> None:
    for i in _rows(panel, found).tolist():
        style: Any = {"color": colour(i), "lw": 0.8}
        least, most = found.P_d_least[i] - found.P_d_ci[i], found.P_d_most[i] + found.P_d_ci[i]
        panel.plot([least, most], [i, i], **style)
        panel.plot([found.P_d[i]], [i], "o", ms=3, mfc=colour(i) if i != found.worst else "white", **style)
    panel.margins(x=0.15)
    panel.set(xlabel="$P_d$ [%] (worst: hollow)")


PANELS = {"orbits": _draw_orbits, "shares": _draw_shares, "P_d": _draw_power}


@styled
def basins(found: Basins, ax: Axes | None = None, *, look: Look = PLAIN) -> Figure:
    """Which attractor each start of a plane ends on."""
    figure = new_figure(str(found.data.attrs.get("title", "")), COLUMN, 3.6, look) if ax is None else figure_of(ax)
    panel = figure.subplots() if ax is None else ax
    across, up = (axis_of(found.data[dim]) for dim in found.data["label"].dims)
    label = np.minimum(found.label.T, SHOWN - 1)
    cells = np.ma.masked_less(label, 0)
    colours = ListedColormap(list(COLOURS))
    panel.patch.set(**STOPPED)
    panel.pcolormesh(across.edges, up.edges, cells, cmap=colours, vmin=-0.5, vmax=SHOWN - 0.5, rasterized=True)
    for i, (x, y) in enumerate(found.at_strobe * _factors(found)):
        if across.edges[0] <= x <= across.edges[-1] and up.edges[0] <= y <= up.edges[-1]:
            panel.plot(x, y, "o", ms=3.5, mfc=colour(i), mec="white", mew=0.8)
    panel.set(xlabel=across.label, ylabel=up.label)
    if ax is None:
        handles: list[Any] = [
            Patch(color=colour(i), label=_name(found, i)) for i in range(min(len(found.share), SHOWN))
        ]
        if (found.label < 0).any():
            handles.append(Patch(label="undecided or stopped", **STOPPED))
        legend_below(figure, handles)
    return figure


def _factors(found: Basins) -> list[float]:
    """Units of the picture in one SI unit, of both axes."""
    return [QUANTITIES[key.split("[")[0]][3] for key in found.plane]
