"""Pictures of branches of periodic orbits, with unstable orbits dashed and a sweep behind them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxshroud.model.modes import BIFURCATION_KINDS, Status
from jaxshroud.plotting.page import (
    LEAST_SPAN,
    Page,
    Panel,
    ParameterAxis,
    amplitude_unit,
    limit_zoom,
    parameter_axis,
    scale_of,
    title_of,
)
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DEFAULT_APPEARANCE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PINK,
    RED,
    SKY,
    AnyFigure,
    Appearance,
    BoolArray,
    PlotArray,
    Properties,
    legend_below,
)
from jaxshroud.scene.checks import InputError

NEAR_PATH = 0.01  # relative to the size of the branch: an orbit farther from the line of earlier points is another one
OWN_STARTS = 0.25  # relative to the distance between the starts of one orbit, for orbits whose starts are nearer


def retraced(ds: xr.Dataset) -> BoolArray:
    """Points (n,) of branches whose orbit is an earlier one of the same branch, except the first of successive ones."""
    is_retraced = np.zeros(ds.sizes["point"], bool)
    branch = ds["branch"].to_numpy()
    value = ds["value"].to_numpy()
    x = ds["samples"].to_numpy()[:, :, 0]
    for number in np.unique(branch):
        points = np.flatnonzero(branch == number)
        is_retraced[points] = _retraced_on_branch(value[points], x[points, : int(ds["q"][points[0]])])
    is_retraced[1:] &= is_retraced[:-1].copy()
    return is_retraced


def _retraced_on_branch(value: PlotArray, x: PlotArray) -> BoolArray:
    """Retraced points of one branch, from the values of its number (n,) and the samples of its orbits (n, q)."""
    is_retraced = np.zeros(len(value), bool)
    size = np.array([np.ptp(value), *[np.ptp(x)] * x.shape[1]])
    size[size == 0] = 1.0
    path = np.column_stack([value, x]) / size
    for turns in range(1, x.shape[1]):
        later = np.column_stack([value, np.roll(x, turns, axis=1)]) / size
        reach = np.minimum(NEAR_PATH, OWN_STARTS * np.linalg.norm(later - path, axis=1))
        for i in range(2, len(value)):
            is_retraced[i] |= _distance(later[i], path[:i]) < reach[i]
    return is_retraced


def _distance(point: PlotArray, line: PlotArray) -> float:
    """The distance from a point to a polygonal line."""
    segments = np.diff(line, axis=0)
    offsets = point - line[:-1]
    share = np.clip((offsets * segments).sum(axis=1) / np.maximum((segments * segments).sum(axis=1), 1e-300), 0, 1)
    return float(np.linalg.norm(offsets - share[:, None] * segments, axis=1).min())


# The kind of a special point -> marker, colour.
MARKERS = {
    "fold": ("s", RED),
    "flip": ("D", GREEN),
    "Neimark-Sacker": ("*", PINK),
    "branch point": ("P", INK),
    "corner": ("v", ORANGE),
    "jump": ("|", INK),
    "grazing": ("o", "white"),
    "localisation": ("X", RED),
}
MARKER_SIZE, SMALL_SIZE = 3.5, 2.2
LINE_STYLES = {True: "-", False: "--"}
LINE_STYLE: Properties = {"lw": 0.9, "color": BLUE}
SWEEP_STYLE: Properties = {"ms": 2, "mew": 0, "color": GREY, "zorder": 1}


class BranchData(NamedTuple):
    """Branches in the unit of the picture."""

    ds: xr.Dataset  # with `retraced`
    axis: ParameterAxis
    sweep: xr.Dataset | None  # along the same number, drawn behind the branches


def branch_page(ds: xr.Dataset, appearance: Appearance, *, over: xr.Dataset | None = None) -> Page[BranchData]:
    """Branches over the number along which they were followed.

    Args:
        ds: The branches.
        appearance: The requested appearance; displacements and the number keep their units.
        over: A sweep along the same number, which is drawn behind the branches.

    Raises:
        ValueError: The sweep is along another number.
    """
    panels, replaced = (ROW_BRANCH_PANELS, ()) if "interface" in ds.dims else (PAIR_BRANCH_PANELS, ("x_1", "P_d"))
    size = COLUMN_WIDTH, 4.6
    return Page(_branch_data(ds, over), panels, title_of(ds, replaced), size, shared="x", finish=_finish_branch)


def _branch_data(ds: xr.Dataset, over: xr.Dataset | None) -> BranchData:
    """The content of a page of branches.

    Raises:
        ValueError: The sweep is along another number.
    """
    if over is not None and str(over.attrs.get("axes")) != str(over["status"].dims[-1]):
        raise InputError("Argument `over` must be a sweep along one number.")
    return BranchData(ds.assign(retraced=("point", retraced(ds))), parameter_axis(ds["value"]), over)


def _finish_branch(figure: AnyFigure, axes: Mapping[str, Axes], branches: BranchData) -> None:
    """Add the legend and the limits of the common axis."""
    sweep = branches.sweep
    shown = np.concatenate([branches.axis.values, [] if sweep is None else _sweep_values(sweep)])
    margin = 0.02 * float(np.ptp(shown)) or 1.0
    axes["P_d"].set(xlim=(shown.min() - margin, shown.max() + margin))
    figure.align_ylabels([*axes.values()])
    legend_below(figure, _branch_handles(branches.ds, sweep))


def _sweep_values(sweep: xr.Dataset) -> PlotArray:
    """The values of the number along which a sweep was made, in the unit of pictures."""
    return parameter_axis(sweep[str(sweep.attrs["axes"])]).values


def stability_runs(ds: xr.Dataset) -> Iterator[tuple[bool, slice]]:
    """Runs of neighbouring points of one branch with the same stability, each up to the first point of the next run."""
    branch, stable, kind = (ds[name].to_numpy() for name in ("branch", "stable", "kind"))
    first = 0
    size = len(branch)
    for i in range(1, size + 1):
        is_end = i == size or branch[i] != branch[first] or kind[i] == BIFURCATION_KINDS.index("jump")
        if is_end or stable[i] != stable[i - 1]:
            yield bool(stable[i - 1]), slice(first, i if is_end else i + 1)
            first = i


def _draw_branch_lines(panel: Axes, ds: xr.Dataset, x: PlotArray, y: PlotArray) -> None:
    """Draw the curves y (points, any) over x, each orbit once, and mark the special points."""
    y = np.where(ds["retraced"].to_numpy()[:, None], np.nan, y)
    for stable, part in stability_runs(ds):
        panel.plot(x[part], y[part], LINE_STYLES[stable], **LINE_STYLE)
    kind = ds["kind"].to_numpy()
    for name, (marker, color) in MARKERS.items():
        points = kind == BIFURCATION_KINDS.index(name)
        edge = {"mec": INK, "mew": 0.5} if marker != "|" else {"mec": color, "mew": 0.6}
        size = MARKER_SIZE if name != "grazing" else SMALL_SIZE
        for column in y.T:
            panel.plot(
                x[points], column[points], marker, ms=size, mfc=color, zorder=3 if name != "grazing" else 2.5, **edge
            )


def _draw_branch_samples(panel: Axes, branches: BranchData) -> None:
    ds, (values, _, label), sweep = branches
    gaps = [one["gap"].to_numpy() for one in (ds, sweep) if one is not None]
    unit = "mm" if np.ptp(np.concatenate([np.ravel(gap) for gap in gaps])) else None  # common to both
    scale = scale_of(gaps[0], unit)
    if sweep is not None:
        sweep_scale = scale_of(gaps[1], unit)
        x = (sweep["x"].transpose(sweep.attrs["axes"], "period", "blade").to_numpy()[:, :, 0].T * sweep_scale.factor).T
        x = np.where(sweep["status"].to_numpy()[:, None] == Status.OK, x, np.nan)
        repeated = np.broadcast_to(_sweep_values(sweep)[:, None], x.shape)
        panel.plot(repeated.ravel(), x.ravel(), ".", ms=1.2, mew=0, color=GREY, alpha=0.5, rasterized=True, zorder=1)
    y = (ds["samples"].to_numpy()[:, :, 0].T * scale.factor).T
    _draw_branch_lines(panel, ds, values, y)
    panel.set(xlabel=label, ylabel=scale.label("1"))


def _draw_multiplier(panel: Axes, branches: BranchData) -> None:
    """The magnitude of the largest multiplier, without that of a free slider."""
    ds, (values, _, label), _ = branches
    multipliers = ds["multipliers_real"].to_numpy() + 1j * ds["multipliers_imag"].to_numpy()
    neutral = ds["slider_is_free"].to_numpy()[:, None] & (np.abs(multipliers - 1) < 1e-9)
    largest = np.where(neutral, 0, np.abs(multipliers)).max(axis=1)
    panel.axhline(1, color=GREY, lw=0.6)
    _draw_branch_lines(panel, ds, values, largest[:, None])
    if largest.max() > 5:
        panel.set_yscale("log")
    panel.set(xlabel=label, ylabel="largest\nmultiplier")


def _draw_branch_power(panel: Axes, branches: BranchData) -> None:
    ds, (values, _, label), sweep = branches
    if sweep is not None:
        _draw_sweep(panel, sweep, sweep["P_d"].to_numpy()[:, None])
    _draw_branch_lines(panel, ds, values, ds["P_d"].to_numpy()[:, None])
    panel.set(xlabel=label, ylabel="$P_d$ [%]")


def _draw_blades(panel: Axes, branches: BranchData) -> None:
    """The amplitude of each blade: one line where all are alike."""
    ds, (values, _, label), sweep = branches
    levels = ds["x_peak"].to_numpy()
    unit = amplitude_unit("x_peak", float(levels.max()), DEFAULT_APPEARANCE, blade=None)
    if sweep is not None and "x_peak" in sweep:
        _draw_sweep(panel, sweep, unit.factor * sweep["x_peak"].transpose(..., "blade").to_numpy())
    _draw_branch_lines(panel, ds, values, unit.factor * levels)
    panel.set(xlabel=label, ylabel=unit.label)


def _draw_sweep(panel: Axes, sweep: xr.Dataset, levels: np.ndarray) -> None:
    """The values (lanes, any) of a sweep whose lanes are OK."""
    ok = sweep["status"].to_numpy() == Status.OK
    panel.plot(_sweep_values(sweep), np.where(ok[:, None], levels, np.nan), ".", **SWEEP_STYLE)


def _draw_reductions(panel: Axes, branches: BranchData) -> None:
    """P_d of the row, and in pale that of the worst blade where it differs."""
    ds, (values, _, label), sweep = branches
    row = ds["P_d"].to_numpy()
    worst = ds["P_d_worst"].to_numpy()
    if sweep is not None:
        _draw_sweep(panel, sweep, sweep["P_d"].to_numpy()[:, None])
    if np.max(row - worst) > LEAST_SPAN:
        hidden = ds["retraced"].to_numpy() | (row - worst < 0.01 * LEAST_SPAN)
        panel.plot(values, np.where(hidden, np.nan, worst), ".", ms=2, color=SKY, label="worst blade")
        panel.legend(loc="best", frameon=False)
    _draw_branch_lines(panel, ds, values, row[:, None])
    limit_zoom(panel, np.concatenate([row, worst]), LEAST_SPAN)
    panel.set(xlabel=label, ylabel="$P_d$ [%]")


PAIR_BRANCH_PANELS = (
    Panel("samples", _draw_branch_samples, 3),
    Panel("multiplier", _draw_multiplier, 1.1),
    Panel("P_d", _draw_branch_power, 1.5),
)
ROW_BRANCH_PANELS = (
    Panel("amplitude", _draw_blades, 3),
    Panel("multiplier", _draw_multiplier, 1.1),
    Panel("P_d", _draw_reductions, 1.5),
)


def _branch_handles(ds: xr.Dataset, sweep: xr.Dataset | None) -> Sequence[Artist]:
    """Legend entries of what is visible."""
    visible = ~ds["retraced"].to_numpy()
    stable = ds["stable"].to_numpy()[visible].astype(bool)
    kind = ds["kind"].to_numpy()[visible]
    handles = [
        Line2D([], [], ls=LINE_STYLES[s], label="stable" if s else "unstable", **LINE_STYLE)
        for s in (True, False)
        if s in stable
    ]
    for name, (marker, color) in MARKERS.items():
        if (kind == BIFURCATION_KINDS.index(name)).any():
            style: Properties = {
                "ls": "",
                "ms": MARKER_SIZE if name != "grazing" else SMALL_SIZE,
                "mfc": color,
                "mec": INK,
                "mew": 0.5,
            }
            handles.append(Line2D([], [], marker=marker, label=name, **style))
    if sweep is not None:
        handles.append(Line2D([], [], ls="", marker=".", ms=3, mew=0, color=GREY, label="sweep"))
    return handles
