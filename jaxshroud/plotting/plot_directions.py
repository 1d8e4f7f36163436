"""The picture of sweeps in several directions: forward, backward and from rest, with jumps and coexisting motions."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxshroud.model.modes import Status
from jaxshroud.plotting.page import (
    Page,
    Panel,
    ParameterAxis,
    first_blade,
    gap_of_lanes,
    parameter_axis,
    scale_of,
    title_of,
)
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    AnyFigure,
    Appearance,
    Properties,
    legend_below,
)

DIRECTION_STYLES = {  # direction -> label, colour, marker, size
    "independent": ("from rest", GREY, "o", 3.2),
    "forward": ("forward", BLUE, "o", 2.0),
    "backward": ("backward", ORANGE, "o", 1.0),
}
SHADE = "#e8e8e8"
REDUCTIONS: Mapping[str, Properties] = {"P_d_worst": {"mfc": "white", "mew": 0.5}, "P_d": {"mew": 0}}


class Directions(NamedTuple):
    """A sweep in several directions, with ascending values."""

    ds: xr.Dataset
    axis: ParameterAxis
    unit: str | None  # of displacements


def directions_page(ds: xr.Dataset, appearance: Appearance) -> Page[Directions]:
    """Stroboscopic x_1 and P_d over the number, in all directions.

    Args:
        ds: A sweep along one axis with a dimension `direction`.
        appearance: The requested appearance.
    """
    ds = ds.sortby(str(ds.attrs["axes"]))
    content = Directions(ds, parameter_axis(ds[str(ds.attrs["axes"])], appearance), appearance.unit)
    sampled = "x" in ds
    title = title_of(ds, ("x_1", "P_d") if sampled else ("P_d",))
    height = 4.2 if sampled else 2.4
    panels = DIRECTION_PANELS[not sampled :]
    return Page(content, panels, title, (COLUMN_WIDTH, height), shared="x", finish=_finish_directions)


def _finish_directions(figure: AnyFigure, axes: Mapping[str, Axes], directions: Directions) -> None:
    """Add the legend and the limits of the common axis."""
    axes["P_d"].set(xlim=directions.axis.edges[[0, -1]])
    figure.align_ylabels([*axes.values()])
    legend_below(figure, _direction_handles(directions.ds))


def _mark_jumps(panel: Axes, directions: Directions) -> None:
    """Shade where motions coexist, and draw lines where they jump, once all directions have been run."""
    ds, edges = directions.ds, directions.axis.edges
    if "coexisting" not in ds:
        return
    for i in np.flatnonzero(ds["coexisting"].to_numpy()):
        panel.axvspan(edges[i], edges[i + 1], color=SHADE, lw=0, zorder=0)
    for direction, positions in (("forward", edges[:-1]), ("backward", edges[1:])):
        for x in positions[ds[_abrupt(ds)].sel(direction=direction).to_numpy() > 0]:
            panel.axvline(x, color=DIRECTION_STYLES[direction][1], lw=0.7, ls=":", zorder=1)


def _abrupt(ds: xr.Dataset) -> str:
    """What is known of places where the motion changes much: it jumps, or is steep where nobody has looked closer."""
    return "jump" if "jump" in ds else "steep"


def _draw_direction_samples(panel: Axes, directions: Directions) -> None:
    _mark_jumps(panel, directions)
    ds, (values, _, label), unit = directions
    scale = scale_of(gap_of_lanes(ds), unit)
    for direction, (_, color, marker, size) in DIRECTION_STYLES.items():
        lanes = ds.sel(direction=direction).transpose(str(ds.attrs["axes"]), "period", "blade", ...)
        x = (lanes["x"].to_numpy()[:, :, 0].T * scale.factor).T
        x = np.where(lanes["status"].to_numpy()[:, None] == Status.OK, x, np.nan)
        repeated = np.broadcast_to(values[:, None], x.shape)
        style = {"mew": 0, "rasterized": True}
        panel.plot(repeated.ravel(), x.ravel(), marker, ms=size, color=color, **style)
    panel.set(xlabel=label, ylabel=scale.label(first_blade(ds)))


def _reductions_in(ds: xr.Dataset) -> list[str]:
    """The reductions that a result has, P_d last."""
    return [name for name in REDUCTIONS if name in ds]


def _draw_direction_power(panel: Axes, directions: Directions) -> None:
    _mark_jumps(panel, directions)
    ds, (values, _, label), _ = directions
    for direction, (_label, color, marker, size) in DIRECTION_STYLES.items():
        lanes = ds.sel(direction=direction)
        style = {"ms": size + 0.5, "color": color}

        def power(name, of=lanes):
            return np.where(of["status"].to_numpy() == Status.OK, of[name].to_numpy(), np.nan)

        for name in _reductions_in(ds):
            panel.plot(values, power(name), marker, **style | REDUCTIONS[name])
    panel.set(xlabel=label, ylabel="$P_d$ [%]")


DIRECTION_PANELS = (Panel("samples", _draw_direction_samples, 2), Panel("P_d", _draw_direction_power))


def direction_entries() -> list[Artist]:
    """Legend entries of the directions."""
    return [
        Line2D([], [], ls="", marker=marker, ms=size + 1.5, mew=0, color=color, label=label)
        for label, color, marker, size in DIRECTION_STYLES.values()
    ]


def _direction_handles(ds: xr.Dataset) -> list[Artist]:
    handles = direction_entries()
    for appearance in (REDUCTIONS[name] for name in _reductions_in(ds)[:-1]):
        handles.append(Line2D([], [], ls="", marker="o", ms=3.7, color=INK, label="worst blade", **appearance))
    if "coexisting" not in ds:
        return handles
    if ds[_abrupt(ds)].to_numpy().any():
        handles.append(Line2D([], [], ls=":", lw=0.8, color=INK, label=_abrupt(ds)))
    if ds["coexisting"].to_numpy().any():
        handles.append(Patch(color=SHADE, label="motions coexist"))
    return handles
