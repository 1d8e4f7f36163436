"""Pictures of branches of periodic orbits: stable ones solid, unstable ones dashed, over a sweep."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxshroud.model.modes import Status
from jaxshroud.results.axis import axis_of
from jaxshroud.results.drawing import BLUE, COLUMN, GREY, INK, PLAIN, Floats, Look, legend_below, new_figure
from jaxshroud.results.kinds import KINDS
from jaxshroud.results.look import on_axes, styled
from jaxshroud.results.panels import figure_of, panel_of, scale_of
from jaxshroud.scene.errors import InputError

# Special point -> marker, colour.
MARKERS = {
    "fold": ("s", "#D55E00"),
    "flip": ("D", "#009E73"),
    "Neimark-Sacker": ("*", "#CC79A7"),
    "branch point": ("P", INK),
    "corner": ("v", "#E69F00"),
    "jump": ("|", INK),
    "grazing": ("o", "white"),
}
SIZE, SMALL = 3.5, 2.2  # of markers
LINES = {True: "-", False: "--"}
TWIN: Any = {"lw": 0.9, "color": BLUE}


@styled
def branches(
    ds: xr.Dataset,
    ax: Axes | None = None,
    over: xr.Dataset | None = None,
    panel: str | None = None,
    *,
    look: Look = PLAIN,
) -> Figure:
    """Branches over the number followed.

    Args:
        ds: The branches.
        ax: Draw there, and only one panel.
        over: A sweep along the same number, drawn behind.
        panel: "samples" (the default), "multiplier" or "P_d".
        look: What is asked for otherwise; displacements and the number stay in their units.

    Raises:
        ValueError: There is no such panel, or the sweep is along another number.
    """
    if over is not None and str(over.attrs.get("axes")) != str(over["status"].dims[-1]):
        raise InputError("Argument `over` must be a sweep along one number.")
    values, label = _along(ds)
    if ax is not None:
        panel_of(PANELS, panel)(ax, ds, values, over)
        ax.set(xlabel=label)
        on_axes(ax, look)
        return figure_of(ax)
    figure = new_figure(str(ds.attrs.get("title", "")), COLUMN, 4.6, look)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[3, 1.1, 1.5])
    for one, draw in zip(panels, PANELS.values(), strict=True):
        draw(one, ds, values, over)
    shown = np.concatenate([values, [] if over is None else _sweep_values(over)])
    margin = 0.02 * float(np.ptp(shown)) or 1.0
    panels[-1].set(xlabel=label, xlim=(shown.min() - margin, shown.max() + margin))
    figure.align_ylabels(panels)
    legend_below(figure, _handles(ds, over))
    return figure


def _along(ds: xr.Dataset) -> tuple[Floats, str]:
    """Values of the number in the unit of pictures, and its label."""
    axis = axis_of(ds["value"])
    return axis.values, axis.label


def _sweep_values(over: xr.Dataset) -> Floats:
    return axis_of(over[str(over.attrs["axes"])]).values


def _stretches(ds: xr.Dataset) -> Iterator[tuple[bool, slice]]:
    """Runs of neighbouring points of one branch that are alike in stability, each up to the next one's first point."""
    branch, stable, kind = (ds[name].to_numpy() for name in ("branch", "stable", "kind"))
    first, size = 0, len(branch)
    for i in range(1, size + 1):
        cut = i == size or branch[i] != branch[first] or kind[i] == KINDS.index("jump")
        if cut or stable[i] != stable[i - 1]:
            yield bool(stable[i - 1]), slice(first, i if cut else i + 1)
            first = i


def _draw_lines(panel: Axes, ds: xr.Dataset, x: Floats, y: Floats) -> None:
    """Curves y (points, any) over x, and marks of the special points."""
    for stable, part in _stretches(ds):
        panel.plot(x[part], y[part], LINES[stable], **TWIN)
    kind = ds["kind"].to_numpy()
    for name, (marker, color) in MARKERS.items():
        at = kind == KINDS.index(name)
        edge = {"mec": INK, "mew": 0.5} if marker != "|" else {"mec": color, "mew": 0.6}
        size = SIZE if name != "grazing" else SMALL
        for column in y.T:
            panel.plot(x[at], column[at], marker, ms=size, mfc=color, zorder=3 if name != "grazing" else 2.5, **edge)


def _draw_samples(panel: Axes, ds: xr.Dataset, values: Floats, over: xr.Dataset | None) -> None:
    scale = scale_of(ds["gap"].to_numpy())
    if over is not None:
        alike = scale_of(over["gap"].to_numpy())
        x = (over["x"].transpose(over.attrs["axes"], "period", "blade").to_numpy()[:, :, 0].T * alike.factor).T
        x = np.where(over["status"].to_numpy()[:, None] == Status.OK, x, np.nan)
        lane = np.broadcast_to(_sweep_values(over)[:, None], x.shape)
        panel.plot(lane.ravel(), x.ravel(), ".", ms=1.2, mew=0, color=GREY, alpha=0.5, rasterized=True, zorder=1)
    y = (ds["samples"].to_numpy()[:, :, 0].T * scale.factor).T
    _draw_lines(panel, ds, values, y)
    panel.set(ylabel=scale.label("1"))


def _draw_multiplier(panel: Axes, ds: xr.Dataset, values: Floats, over: xr.Dataset | None) -> None:
    """The largest multiplier's magnitude, without that of a slider that stays wherever it starts."""
    multipliers = ds["multipliers_real"].to_numpy() + 1j * ds["multipliers_imag"].to_numpy()
    neutral = ds["slider_is_free"].to_numpy()[:, None] & (np.abs(multipliers - 1) < 1e-9)
    largest = np.where(neutral, 0, np.abs(multipliers)).max(axis=1)
    panel.axhline(1, color=GREY, lw=0.6)
    _draw_lines(panel, ds, values, largest[:, None])
    if largest.max() > 5:
        panel.set_yscale("log")
    panel.set(ylabel=r"largest $|\mu|$")


def _draw_power(panel: Axes, ds: xr.Dataset, values: Floats, over: xr.Dataset | None) -> None:
    if over is not None:
        P_d = np.where(over["status"].to_numpy() == Status.OK, over["P_d"].to_numpy(), np.nan)
        panel.plot(_sweep_values(over), P_d, ".", ms=2, mew=0, color=GREY, zorder=1)
    _draw_lines(panel, ds, values, ds["P_d"].to_numpy()[:, None])
    panel.set(ylabel="$P_d$ [%]")


PANELS: dict[str, Callable[[Axes, xr.Dataset, Floats, xr.Dataset | None], None]] = {
    "samples": _draw_samples,
    "multiplier": _draw_multiplier,
    "P_d": _draw_power,
}


def _handles(ds: xr.Dataset, over: xr.Dataset | None) -> list[Any]:
    """What the legend tells, of what is seen."""
    stable, kind = ds["stable"].to_numpy().astype(bool), ds["kind"].to_numpy()
    made = [
        Line2D([], [], ls=LINES[s], label="stable" if s else "unstable", **TWIN) for s in (True, False) if s in stable
    ]
    for name, (marker, color) in MARKERS.items():
        if (kind == KINDS.index(name)).any():
            style: Any = {"ls": "", "ms": SIZE if name != "grazing" else SMALL, "mfc": color, "mec": INK, "mew": 0.5}
            made.append(Line2D([], [], marker=marker, label=name, **style))
    if over is not None:
        made.append(Line2D([], [], ls="", marker=".", ms=3, mew=0, color=GREY, label="sweep"))
    return made
