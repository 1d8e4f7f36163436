"""Pictures of stored runs and sweeps, sized for a journal column; nothing here simulates."""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from jaxshroud.model.modes import Status
from jaxshroud.results.axis import Axis, axis_of
from jaxshroud.results.drawing import (
    BLUE,
    COLUMN,
    GREY,
    INK,
    ORANGE,
    PINK,
    PLAIN,
    SKY,
    Floats,
    Look,
    legend_below,
    new_figure,
    say,
)
from jaxshroud.results.look import on_axes, styled
from jaxshroud.results.panels import (
    LEAST,
    figure_of,
    interval,
    is_seen,
    legend_above,
    panel_of,
    scale_of,
    title_of,
    zoom_no_further,
)
from jaxshroud.results.status import named
from jaxshroud.scene.errors import InputError

MOTIONS = {
    "period 1": BLUE,
    "period 2": ORANGE,
    "period 3": "#009E73",
    "period 4": PINK,
    "periods 5–8": SKY,
    "periods 9–16": "#D55E00",
    "aperiodic": "#4d4d4d",
}
MOTION_OF = np.array([6, 0, 1, 2, 3, *[4] * 4, *[5] * 8])  # period number -> place in MOTIONS
EXPONENT = r"exponent $\lambda_1$ [1/T]"  # of Lyapunov, the largest
STOPPED: Any = {"facecolor": "#ededed", "edgecolor": "#9c9c9c", "hatch": "//////"}

Integers = NDArray[np.integer[Any]]
Booleans = NDArray[np.bool_]


def sweep(ds: xr.Dataset, ax: Axes | None = None, panel: str | None = None, **looks: Any) -> Figure:
    """A sweep along one axis or two.

    Args:
        ds: The sweep.
        ax: Draw there, and only one panel.
        panel: "samples" (the default) or "P_d" over one axis; "P_d" (the default) or "motions" over two;
            "lyapunov" over either, where exponents are stored.
        looks: As in `Look`: a title, an xlabel, a unit, a width and a style.

    Raises:
        ValueError: The sweep has more axes, or there is no such panel.
    """
    dims = str(ds.attrs["axes"]).split(",")
    if len(dims) == 1 and "direction" in ds.dims:
        from jaxshroud.results import plot_directions

        return plot_directions.directions(ds, ax, panel, look=Look(**looks))
    ds = ds.isel(direction=0) if "direction" in ds.dims else ds
    if len(dims) > 2:
        raise InputError(f"A sweep along {', '.join(dims)} has no picture; select some of its lanes, or draw them.")
    look = Look(**looks)
    if ax is None:
        return bifurcation(ds, look=look) if len(dims) == 1 else power_map(ds, look=look)
    samples = partial(_draw_samples, unit=look.unit)
    over_one = {**({"samples": samples} if "x" in ds else {}), "P_d": _draw_power}
    known = over_one if len(dims) == 1 else MAPS
    more = {"lyapunov": _draw_exponent if len(dims) == 1 else _draw_exponent_map} if "lyapunov" in ds else {}
    draw = panel_of({**known, **more}, panel)
    if len(dims) == 1:
        ds = _in_order(ds, dims)
        axis = axis_of(ds[dims[0]], look)
        draw(ax, ds, axis, _motion(ds))
        ax.set(xlabel=axis.label)
    else:
        ds = _in_order(ds, dims).transpose(dims[1], dims[0], ...)
        x, y = axis_of(ds[dims[0]], look), axis_of(ds[dims[1]], look)
        draw(ax, ds, x, y, _motion(ds))
        ax.set(xlabel=x.label, ylabel=y.label)
    on_axes(ax, look)
    return figure_of(ax)


@styled
def bifurcation(ds: xr.Dataset, *, look: Look = PLAIN) -> Figure:
    """Stroboscopic x_1, period number and P_d over the one key of a sweep (Figs. 9, 11, 13 and 16 to 18).

    Args:
        ds: A sweep along one axis. x_1, of which samples may have been kept, is drawn over the gap, or in mm where a
            gap is not positive. Lanes whose status is not OK are marked and never drawn as numbers.
        look: What is asked for otherwise.

    Raises:
        ValueError: The sweep has not exactly one axis.
    """
    (dim,) = _dims(ds, 1)
    ds = _in_order(ds, [dim])
    sampled, grows = "x" in ds, "lyapunov" in ds
    figure = new_figure(title_of(ds), COLUMN, 2.1 + 2.3 * sampled + 1.3 * grows, look)
    axis, motion = axis_of(ds[dim], look), _motion(ds)
    if not (motion >= 0).any():
        return say(figure, _nothing(ds))
    heights = [*([3] if sampled else []), 0.2, 1.7, *([1.5] if grows else [])]
    panels = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    samples = [panels.pop(0)] if sampled else []
    strip, power, *more = panels
    for panel in samples:
        _draw_samples(panel, ds, axis, motion, look.unit)
    _draw_motions(strip, axis.edges, np.array([0.0, 1.0]), motion[None])
    _draw_power(power, ds, axis, motion)
    strip.set(yticks=[])
    for panel in more:
        _draw_exponent(panel, ds, axis, motion)
    (power, *more)[-1].set(xlabel=axis.label, xlim=axis.edges[[0, -1]])
    shown = [*samples, power, *more]
    _mark_stopped(shown[0], ds, axis)
    figure.align_ylabels(shown)
    for panel in shown:
        legend_above(panel)
    legend_below(figure, _motion_handles(motion))
    return figure


@styled
def power_map(ds: xr.Dataset, *, look: Look = PLAIN) -> Figure:
    """P_d and the period number over the two keys of a sweep.

    Args:
        ds: A sweep along two axes, the first of which is drawn to the right. Lanes whose status is not OK
            are hatched. The lowest twentieth of the P_d values share a colour, so that a few outliers do not
            flatten the rest.
        look: What is asked for otherwise.

    Raises:
        ValueError: The sweep has not exactly two axes.
    """
    across, up = _dims(ds, 2)
    ds = _in_order(ds, [across, up]).transpose(up, across, ...)
    grows = "lyapunov" in ds
    figure, motion = new_figure(title_of(ds), COLUMN, 7.6 if grows else 5.2, look), _motion(ds)
    if not (motion >= 0).any():
        return say(figure, _nothing(ds))
    x, y = axis_of(ds[across], look), axis_of(ds[up], look)
    power, motions, *more = figure.subplots(3 if grows else 2, 1, sharex=True, sharey=True)
    _draw_map(power, ds, x, y, motion)
    _draw_motions(motions, x.edges, y.edges, motion)
    for panel in more:
        _draw_exponent_map(panel, ds, x, y, motion)
    for panel in (power, motions, *more):
        panel.set(ylabel=y.label)
    (motions, *more)[-1].set(xlabel=x.label)
    if (motion < 0).any():
        power.add_patch(Rectangle((0, 0), 0, 0, label="stopped: " + ",\n".join(_stopped(ds)), **STOPPED))
    legend_above(power)
    legend_below(figure, _motion_handles(motion))
    return figure


def _draw_map(panel: Axes, ds: xr.Dataset, x: Axis, y: Axis, motion: Integers) -> None:
    """P_d as colours, with their bar."""
    P_d = np.ma.masked_invalid(np.where(motion >= 0, ds["P_d"].to_numpy(), np.nan))
    floor = np.percentile(P_d.compressed(), 5, method="higher") if P_d.count() else 0.0
    mesh = panel.pcolormesh(x.edges, y.edges, P_d.clip(min=floor), rasterized=True)
    panel.patch.set(**STOPPED)
    bar = figure_of(panel).colorbar(mesh, ax=panel, extend="min" if (P_d < floor).any() else "neither", pad=0.02)
    bar.set_label("power reduction $P_d$ [%]")


def _draw_exponent_map(panel: Axes, ds: xr.Dataset, x: Axis, y: Axis, motion: Integers) -> None:
    """The largest exponent as colours, white at 0: stable blue, chaotic red."""
    exponent = np.ma.masked_invalid(np.where(motion >= 0, ds["lyapunov"].to_numpy(), np.nan))
    reach = max(float(np.percentile(np.abs(exponent.compressed()), 95)) if exponent.count() else 0.0, 1e-3)
    colors: Any = {"cmap": "RdBu_r", "vmin": -reach, "vmax": reach, "rasterized": True}
    mesh = panel.pcolormesh(x.edges, y.edges, exponent, **colors)
    panel.patch.set(**STOPPED)
    figure_of(panel).colorbar(mesh, ax=panel, extend="both", pad=0.02).set_label(EXPONENT)


def _draw_motion_map(panel: Axes, ds: xr.Dataset, x: Axis, y: Axis, motion: Integers) -> None:
    _draw_motions(panel, x.edges, y.edges, motion)


MAPS = {"P_d": _draw_map, "motions": _draw_motion_map}


def _in_order(ds: xr.Dataset, dims: list[str]) -> xr.Dataset:
    """A sweep with its axes first, and their values rising."""
    return ds.sortby(dims).transpose(*dims, "period", "blade", ...)


def _dims(ds: xr.Dataset, count: int) -> list[str]:
    dims = [dim.strip() for dim in str(ds.attrs["axes"]).split(",")]
    if len(dims) != count:
        raise InputError(f"This picture needs a sweep along {count} key(s), but got {', '.join(dims)}.")
    return dims


def _stopped(ds: xr.Dataset) -> dict[str, Booleans]:
    """Name of each status but OK that occurs -> the lanes that have it."""
    status = ds["status"].to_numpy()
    return {named(int(code)): status == code for code in np.unique(status) if code != Status.OK}


def _nothing(ds: xr.Dataset) -> str:
    counts = [f"{lanes.sum()} × {name}" for name, lanes in _stopped(ds).items()]
    return "\n".join(["no lane finished:", *counts]) if counts else "the sweep is empty"


def _motion(ds: xr.Dataset) -> Integers:
    """Place of each lane's period number in MOTIONS, or -1 where the lane was stopped."""
    number = np.nan_to_num(ds["period_number"].to_numpy()).astype(int)
    return np.where(ds["status"].to_numpy() == Status.OK, MOTION_OF[np.clip(number, 0, 16)], -1)


def _motion_handles(motion: Integers) -> list[Any]:
    return [Patch(color=c, label=name) for i, (name, c) in enumerate(MOTIONS.items()) if i in motion]


def _mark_stopped(panel: Axes, ds: xr.Dataset, axis: Axis) -> None:
    """A mark at the foot of `panel` for each lane that was stopped, one shape per status."""
    style: Any = {"transform": panel.get_xaxis_transform(), "ms": 3, "mew": 0.6, "color": INK}
    for marker, (name, lanes) in zip("xv^dsP*", _stopped(ds).items(), strict=False):
        foot = np.full(lanes.sum(), 0.02)
        panel.plot(axis.values[lanes], foot, marker, label=f"stopped: {name}", **style)


def _draw_samples(panel: Axes, ds: xr.Dataset, axis: Axis, motion: Integers, unit: str | None = None) -> None:
    scale = scale_of(ds["gap"].to_numpy(), unit)
    x = (ds["x"].to_numpy()[:, :, 0].T * scale.factor).T
    lane = np.broadcast_to(axis.values[:, None], x.shape)
    style: Any = {"ms": 1.5 if motion.size > 100 else 2.5, "mew": 0, "rasterized": True}
    for i, color in enumerate(MOTIONS.values()):
        here, alpha = motion == i, float(np.clip(5e4 / max(x.size, 1), 0.2, 1))
        panel.plot(lane[here].ravel(), x[here].ravel(), ".", color=color, alpha=alpha, **style)
    panel.set(ylabel=scale.label("1"))
    shown = x[motion >= 0]
    zoom_no_further(panel, shown, 0.02 * float(np.nanmax(np.abs(shown), initial=0.0)))


def _draw_motions(panel: Axes, x_edges: Floats, y_edges: Floats, motion: Integers) -> None:
    """Cells coloured by period number; lanes that were stopped show the hatched ground."""
    panel.patch.set(**STOPPED)
    cells, colors = np.ma.masked_less(motion, 0), ListedColormap(list(MOTIONS.values()))
    panel.pcolormesh(x_edges, y_edges, cells, cmap=colors, vmin=-0.5, vmax=6.5, rasterized=True)


def _draw_exponent(panel: Axes, ds: xr.Dataset, axis: Axis, motion: Integers) -> None:
    """The largest exponent with its interval; above 0 neighbours part."""
    mean, ci = (np.where(motion >= 0, ds[key].to_numpy(), np.nan) for key in ("lyapunov", "lyapunov_ci"))
    mean = np.where(np.isfinite(mean), mean, np.nan)
    panel.axhline(0, color=GREY, lw=0.6)
    panel.fill_between(axis.values, *interval(mean, ci), color=PINK, alpha=0.35, lw=0, label="95 % interval")
    panel.plot(axis.values, mean, color=PINK, lw=0.8, marker="" if motion.size > 100 else ".", ms=3)
    panel.set(ylabel=EXPONENT)


def _draw_power(panel: Axes, ds: xr.Dataset, axis: Axis, motion: Integers) -> None:
    P_d, ci = (np.where(motion >= 0, ds[key].to_numpy(), np.nan) for key in ("P_d", "P_d_ci"))
    sure = (ds["P_d_settled"] == 1) & (ds["settled"] == 1) & (ds["period_number"] > 0)
    hollow, many = ~sure.to_numpy() & (motion >= 0), motion.size > 100
    band = "95 % interval" if is_seen(ci, P_d) else None
    panel.fill_between(axis.values, *interval(P_d, ci), color=BLUE, alpha=0.25, lw=0, label=band)
    panel.plot(axis.values, P_d, color=BLUE, lw=0.8, marker="" if many else ".", ms=3)
    if hollow.any():
        style: Any = {"ms": 1.8 if many else 2.5, "mfc": "white", "mec": BLUE, "mew": 0.5}
        panel.plot(axis.values[hollow], P_d[hollow], "o", label="aperiodic or unsettled", **style)
    panel.set(ylabel="$P_d$ [%]")
    zoom_no_further(panel, P_d, LEAST)
