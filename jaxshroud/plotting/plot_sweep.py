"""Pictures of sweeps, sized for a journal column."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch, Rectangle

from jaxshroud.io.lane_status import status_name
from jaxshroud.model.modes import Status
from jaxshroud.plotting.page import (
    LEAST_SPAN,
    Page,
    Panel,
    ParameterAxis,
    first_blade,
    gap_of_lanes,
    interval_ends,
    is_visible,
    legend_above,
    limit_zoom,
    parameter_axis,
    scale_of,
    title_of,
)
from jaxshroud.plotting.plot_amplitude import NOT_OVER, amplitude_page
from jaxshroud.plotting.plot_directions import directions_page
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DARK,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PINK,
    RED,
    SKY,
    STOPPED_STYLE,
    AnyFigure,
    Appearance,
    BoolArray,
    IntegerArray,
    PlotArray,
    Properties,
    legend_below,
)
from jaxshroud.scene.checks import InputError

MOTION_COLOURS = {
    "period 1": BLUE,
    "period 2": ORANGE,
    "period 3": GREEN,
    "period 4": PINK,
    "periods 5–8": SKY,
    "periods 9–16": RED,
    "aperiodic": DARK,
    NOT_OVER: PALE,
}
UNSETTLED_COLOUR = list(MOTION_COLOURS).index(NOT_OVER)  # of lanes without a period number, whose transient may last
COLOUR_OF_PERIOD = np.array([6, 0, 1, 2, 3, *[4] * 4, *[5] * 8])  # period number -> index in MOTION_COLOURS
EXPONENT_LABEL = r"exponent $\lambda_1$ [1/T]"  # the largest Lyapunov exponent


class Curve(NamedTuple):
    """A sweep along one axis, with ascending values."""

    ds: xr.Dataset
    axis: ParameterAxis
    motion: IntegerArray  # index of each lane's colour in `MOTION_COLOURS`; -1: stopped
    unit: str | None  # of displacements


class Map(NamedTuple):
    """A sweep along two axes, of which the first is horizontal in the picture."""

    ds: xr.Dataset
    x: ParameterAxis
    y: ParameterAxis
    motion: IntegerArray  # as for `Curve`


def sweep_page(ds: xr.Dataset, appearance: Appearance, *, kind: Literal["amplitude"] | None = None) -> Page[Any]:
    """The page of a sweep along one axis or two, or of its amplitudes.

    Raises:
        ValueError: The sweep has more axes, or no amplitudes.
    """
    if kind is not None:
        return amplitude_page(ds, appearance)
    dims = [dim.strip() for dim in str(ds.attrs["axes"]).split(",")]
    if len(dims) == 1 and "direction" in ds.dims:
        return directions_page(ds, appearance)
    ds = ds.isel(direction=0) if "direction" in ds.dims else ds
    if len(dims) > 2:
        raise InputError(f"A sweep along {', '.join(dims)} has no picture; select some of its lanes, or draw them.")
    ds = ds.sortby(dims).transpose(*dims, "period", "blade", ...)
    return curve_page(ds, dims[0], appearance) if len(dims) == 1 else map_page(ds, dims, appearance)


def curve_page(ds: xr.Dataset, dim: str, appearance: Appearance) -> Page[Curve]:
    """Stroboscopic x_1, period number and P_d over the one key of a sweep (Figs. 9, 11, 13 and 16 to 18).

    x_1, if its samples were kept, is drawn relative to the gap, or in mm where gaps differ or one is not positive.
    Lanes whose status is not OK are marked and never drawn as numbers.
    """
    content = Curve(ds, parameter_axis(ds[dim], appearance), colour_indices(ds), appearance.unit)
    sampled, grows = "x" in ds, "lyapunov" in ds
    panels = CURVE_PANELS[not sampled : len(CURVE_PANELS) - (not grows)]
    title = title_of(ds, ("x_1", "P_d") if sampled else ("P_d",))
    size = COLUMN_WIDTH, 2.1 + 2.3 * sampled + 1.3 * grows
    nothing = "" if (content.motion >= 0).any() else _no_lane_message(ds)
    single = [panel for panel in panels if panel.name != "motions"]
    return Page(content, panels, title, size, shared="x", finish=_finish_curve, nothing=nothing, single=single)


def _finish_curve(figure: AnyFigure, axes: Mapping[str, Axes], curve: Curve) -> None:
    """Add marks of stopped lanes, legends and the limits of the common axis."""
    axes["P_d"].set(xlim=curve.axis.edges[[0, -1]])
    labelled = [panel for name, panel in axes.items() if name != "motions"]
    _mark_stopped_lanes(labelled[0], curve.ds, curve.axis)
    figure.align_ylabels(labelled)
    for panel in labelled:
        legend_above(panel)
    legend_below(figure, _motion_handles(curve.motion))


def map_page(ds: xr.Dataset, dims: list[str], appearance: Appearance) -> Page[Map]:
    """P_d and the period number over the two keys of a sweep, of which the first is horizontal.

    Lanes whose status is not OK are hatched. The lowest twentieth of the P_d values share a colour, so that a few
    outliers do not flatten the rest.
    """
    across, up = dims
    ds = ds.transpose(up, across, ...)
    content = Map(ds, parameter_axis(ds[across], appearance), parameter_axis(ds[up], appearance), colour_indices(ds))
    panels = MAP_PANELS[: 3 if "lyapunov" in ds else 2]
    size = COLUMN_WIDTH, 7.6 if len(panels) == 3 else 5.2
    nothing = "" if (content.motion >= 0).any() else _no_lane_message(ds)
    return Page(content, panels, title_of(ds), size, shared="xy", finish=_finish_map, nothing=nothing)


def _finish_map(figure: AnyFigure, axes: Mapping[str, Axes], sweep_map: Map) -> None:
    """Add the legends."""
    if (sweep_map.motion < 0).any():
        stopped = "stopped: " + ",\n".join(_stopped_lanes(sweep_map.ds))
        axes["P_d"].add_patch(Rectangle((0, 0), 0, 0, label=stopped, **STOPPED_STYLE))
    legend_above(axes["P_d"])
    legend_below(figure, _motion_handles(sweep_map.motion))


def _draw_power_map(panel: Axes, sweep_map: Map) -> None:
    """P_d as colours, with a colour bar."""
    ds, x, y, motion = sweep_map
    P_d = np.ma.masked_invalid(np.where(motion >= 0, ds["P_d"].to_numpy(), np.nan))
    floor = np.percentile(P_d.compressed(), 5, method="higher") if P_d.count() else 0.0
    mesh = panel.pcolormesh(x.edges, y.edges, P_d.clip(min=floor), rasterized=True)
    panel.patch.set(**STOPPED_STYLE)
    bar = panel.figure.colorbar(mesh, ax=panel, extend="min" if (P_d < floor).any() else "neither", pad=0.02)
    bar.set_label("power reduction $P_d$ [%]")
    panel.set(xlabel=x.label, ylabel=y.label)


def _draw_exponent_map(panel: Axes, sweep_map: Map) -> None:
    """The largest Lyapunov exponent as colours: stable blue, 0 white, chaotic red."""
    ds, x, y, motion = sweep_map
    exponent = np.ma.masked_invalid(np.where(motion >= 0, ds["lyapunov"].to_numpy(), np.nan))
    reach = max(float(np.percentile(np.abs(exponent.compressed()), 95)) if exponent.count() else 0.0, 1e-3)
    colors: Properties = {"cmap": "RdBu_r", "vmin": -reach, "vmax": reach, "rasterized": True}
    mesh = panel.pcolormesh(x.edges, y.edges, exponent, **colors)
    panel.patch.set(**STOPPED_STYLE)
    panel.figure.colorbar(mesh, ax=panel, extend="both", pad=0.02).set_label(EXPONENT_LABEL)
    panel.set(xlabel=x.label, ylabel=y.label)


def _draw_motion_map(panel: Axes, sweep_map: Map) -> None:
    """The period number as colours."""
    _draw_motion_cells(panel, sweep_map.x.edges, sweep_map.y.edges, sweep_map.motion)
    panel.set(xlabel=sweep_map.x.label, ylabel=sweep_map.y.label)


MAP_PANELS = (
    Panel("P_d", _draw_power_map),
    Panel("motions", _draw_motion_map),
    Panel("lyapunov", _draw_exponent_map),
)


def _stopped_lanes(ds: xr.Dataset) -> dict[str, BoolArray]:
    """The name of each status but OK that occurs -> the lanes that have it."""
    status = ds["status"].to_numpy()
    return {status_name(int(code)): status == code for code in np.unique(status) if code != Status.OK}


def _no_lane_message(ds: xr.Dataset) -> str:
    counts = [f"{lanes.sum()} × {name}" for name, lanes in _stopped_lanes(ds).items()]
    return "\n".join(["no lane finished:", *counts]) if counts else "the sweep is empty"


def colour_indices(ds: xr.Dataset) -> IntegerArray:
    """The index of each lane's motion in `MOTION_COLOURS`, or -1 where the lane was stopped."""
    number = np.nan_to_num(ds["period_number"].to_numpy()).astype(int)
    indices = COLOUR_OF_PERIOD[np.clip(number, 0, 16)]
    indices = np.where((number == 0) & (ds["settled"].to_numpy() != 1), UNSETTLED_COLOUR, indices)
    return np.where(ds["status"].to_numpy() == Status.OK, indices, -1)


def _motion_handles(motion: IntegerArray) -> list[Artist]:
    return [Patch(color=c, label=name) for i, (name, c) in enumerate(MOTION_COLOURS.items()) if i in motion]


def _mark_stopped_lanes(panel: Axes, ds: xr.Dataset, axis: ParameterAxis) -> None:
    """Mark each stopped lane at the foot of the panel, with one shape per status."""
    style: Properties = {"transform": panel.get_xaxis_transform(), "ms": 3, "mew": 0.6, "color": INK}
    for marker, (name, lanes) in zip("xv^dsP*", _stopped_lanes(ds).items(), strict=False):
        foot = np.full(lanes.sum(), 0.02)
        panel.plot(axis.values[lanes], foot, marker, label=f"stopped: {name}", **style)


def _draw_curve_samples(panel: Axes, curve: Curve) -> None:
    """The samples of all lanes, coloured by the period number."""
    ds, axis, motion, unit = curve
    scale = scale_of(gap_of_lanes(ds), unit)
    x = (ds["x"].to_numpy()[:, :, 0].T * scale.factor).T
    values = np.broadcast_to(axis.values[:, None], x.shape)
    style: Properties = {"ms": 1.5 if motion.size > 100 else 2.5, "mew": 0, "rasterized": True}
    for i, color in enumerate(MOTION_COLOURS.values()):
        lanes = motion == i
        alpha = float(np.clip(5e4 / max(x.size, 1), 0.2, 1))
        panel.plot(values[lanes].ravel(), x[lanes].ravel(), ".", color=color, alpha=alpha, **style)
    panel.set(xlabel=axis.label, ylabel=scale.label(first_blade(ds)))
    drawn = x[motion >= 0]
    limit_zoom(panel, drawn, 0.02 * float(np.nanmax(np.abs(drawn), initial=0.0)))


def _draw_motion_cells(panel: Axes, x_edges: PlotArray, y_edges: PlotArray, motion: IntegerArray) -> None:
    """Cells coloured by period number; at stopped lanes the hatched background shows."""
    panel.patch.set(**STOPPED_STYLE)
    cells = np.ma.masked_less(motion, 0)
    colors = ListedColormap(list(MOTION_COLOURS.values()))
    panel.pcolormesh(x_edges, y_edges, cells, cmap=colors, vmin=-0.5, vmax=len(MOTION_COLOURS) - 0.5, rasterized=True)


def _draw_motion_strip(panel: Axes, curve: Curve) -> None:
    """The period number of each lane as a strip of colours."""
    _draw_motion_cells(panel, curve.axis.edges, np.array([0.0, 1.0]), curve.motion[None])
    panel.set(yticks=[])


def _draw_exponent(panel: Axes, curve: Curve) -> None:
    """The largest Lyapunov exponent with its interval; above 0 neighbouring motions separate."""
    panel.axhline(0, color=GREY, lw=0.6)
    _draw_with_interval(panel, curve, "lyapunov", PINK, 0.35)
    panel.set(ylabel=EXPONENT_LABEL)


def _draw_with_interval(panel: Axes, curve: Curve, of: str, color: str, alpha: float) -> PlotArray:
    """Draw a number of all lanes with its interval, and return it; it is NaN where a lane stopped."""
    x = curve.axis.values
    level, ci = (np.where(curve.motion >= 0, curve.ds[key].to_numpy(), np.nan) for key in (of, f"{of}_ci"))
    level = np.where(np.isfinite(level), level, np.nan)
    label = None if of == "P_d" and not is_visible(ci, level) else "95 % interval"
    panel.fill_between(x, *interval_ends(level, ci), color=color, alpha=alpha, lw=0, label=label)
    panel.plot(x, level, color=color, lw=0.8, marker="" if curve.motion.size > 100 else ".", ms=3)
    panel.set(xlabel=curve.axis.label)
    return level


def _draw_curve_power(panel: Axes, curve: Curve) -> None:
    """P_d with its interval; circles where the motion is aperiodic, crosses where anything is not settled."""
    ds, axis, motion, _ = curve
    P_d = _draw_with_interval(panel, curve, "P_d", BLUE, 0.25)
    settled = ((ds["P_d_settled"] == 1) & (ds["settled"] == 1)).to_numpy()
    aperiodic = settled & (ds["period_number"] == 0).to_numpy()
    style: Properties = {"ms": 2.2 if motion.size > 100 else 3.0, "mfc": "white", "mew": 0.6}
    for name, marker, colour, lanes in (("aperiodic", "o", DARK, aperiodic), (NOT_OVER, "x", RED, ~settled)):
        marked = lanes & (motion >= 0)
        if marked.any():
            panel.plot(axis.values[marked], P_d[marked], marker, label=name, mec=colour, **style)
    panel.set(ylabel="$P_d$ [%]")
    limit_zoom(panel, P_d, LEAST_SPAN)


CURVE_PANELS = (
    Panel("samples", _draw_curve_samples, 3),
    Panel("motions", _draw_motion_strip, 0.2),
    Panel("P_d", _draw_curve_power, 1.7),
    Panel("lyapunov", _draw_exponent, 1.5),
)
