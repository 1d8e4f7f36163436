"""Pictures of amplitudes: of sweeps, and of responses with their branches and peaks."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxshroud.io.scene_numbers import layout_in
from jaxshroud.model.modes import BIFURCATION_KINDS, WAVE_RESIDUAL, Status
from jaxshroud.plotting.page import (
    DISPLACEMENT_SYMBOLS,
    AmplitudeUnit,
    Page,
    Panel,
    ParameterAxis,
    amplitude_unit,
    parameter_axis,
    title_of,
)
from jaxshroud.plotting.plot_branch import LINE_STYLES, MARKER_SIZE, MARKERS, retraced, stability_runs
from jaxshroud.plotting.plot_directions import DIRECTION_STYLES, direction_entries
from jaxshroud.plotting.run_data import points_of_member
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DARK,
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
from jaxshroud.scene.quantities import free_name, quantity_symbol
from jaxshroud.signals.period import NOT_SETTLED

NOT_OVER = "transient not over"
UNSETTLED_STYLE: Properties = {"marker": "x", "ms": 3.5, "mew": 0.7, "mec": RED, "ls": ""}
FREE_STYLE: Properties = {"color": GREY, "lw": 0.8, "ls": (0, (1.2, 1.2))}
MEMBER_COLOURS = (BLUE, ORANGE, GREEN, PINK, RED, SKY)
BROKEN_STYLE: Properties = {"color": RED, "lw": 0.9}  # of waves whose shift is broken
LOCALISATION_STYLE: Properties = {
    **{"marker": MARKERS["localisation"][0], "mfc": MARKERS["localisation"][1], "ls": ""},
    **{"ms": MARKER_SIZE, "mec": INK, "mew": 0.5},
}
MAX_IN_LEGEND = 8  # members of a family
ROOM_FOR_MARK, MARK_FOOT = 1.3, 0.86  # of a panel: its height over the amplitudes, and where an arrow at its top begins
MARK_ARROW: Properties = {
    "arrowstyle": "-|>",
    "color": DARK,
    "lw": 0.8,
    "mutation_scale": 6,
    "shrinkA": 0,
    "shrinkB": 0,
}
MARK_TEXT: Properties = {"color": DARK, "fontsize": 7, "zorder": 5}
MARK_TEXT |= {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.8}}  # on which lines do not show through
DRAWN = "amplitude drawn"  # a name that no key has


def _unit_in(ds: xr.Dataset, of: str, largest: float, appearance: Appearance) -> AmplitudeUnit:
    """The unit of the amplitude that counts in a dataset."""
    if layout_in(ds).counted == 1:
        return amplitude_unit(of, largest, appearance)
    unit = amplitude_unit(of, largest, appearance, blade=None)
    return unit._replace(label=f"largest {unit.label}")


def _levels_of(ds: xr.Dataset, name: str) -> xr.DataArray:
    """The amplitude that counts, without the dimension `blade`."""
    levels = ds[name].transpose(..., "blade")
    return levels.isel(blade=0).copy(data=levels.to_numpy()[..., layout_in(ds).counting].max(axis=-1))


class AmplitudeContent(NamedTuple):
    """The amplitudes of a sweep along one number."""

    ds: xr.Dataset
    axis: ParameterAxis
    appearance: Appearance


def amplitude_page(ds: xr.Dataset, appearance: Appearance) -> Page[AmplitudeContent]:
    """The amplitudes of x, y and theta over the number of a sweep, with the free ones dashed.

    They are those of the left blade, of a row those of the blade that swings most.

    Raises:
        ValueError: The sweep has no amplitudes, or more than one axis.
    """
    if "x_peak" not in ds:
        raise InputError("This sweep has no amplitudes; run it again with --amplitudes.")
    dim = str(ds.attrs["axes"])
    if "," in dim:
        raise InputError("Amplitudes are drawn over one number; this sweep is along two.")
    ds = ds.sortby(dim)
    names = [name for name in DISPLACEMENT_SYMBOLS if float(np.nanmax(ds[f"{name}_peak"].to_numpy(), initial=0.0)) > 0]
    panels = [Panel(name, lambda panel, shown, name=name: _draw_amplitude(panel, shown, name)) for name in names or "x"]
    content = AmplitudeContent(ds, parameter_axis(ds[dim], appearance), appearance)
    size = COLUMN_WIDTH, 0.7 + (1.6 if layout_in(ds).counted == 1 else 2.0) * len(panels)
    return Page(content, panels, title_of(ds), size, shared="x", finish=_finish_amplitudes)


def _draw_amplitude(panel: Axes, shown: AmplitudeContent, name: str) -> None:
    ds, axis, appearance = shown
    counted = _levels_of(ds, f"{name}_peak")
    levels = counted.to_numpy()
    unit = _unit_in(ds, f"{name}_peak", float(np.nanmax(levels, initial=0.0)), appearance)
    lanes = counted.to_dataset(name=DRAWN).assign(status=ds["status"], settling=ds["settling"])
    _draw_directions(panel, lanes, axis.values, unit)
    free = _levels_of(ds, f"{name}_free")
    free = (free.isel(direction=0) if "direction" in free.dims else free).to_numpy() * unit.factor
    panel.plot(axis.values, free, **FREE_STYLE)
    panel.set(xlabel=axis.label, ylabel=unit.label, ylim=_amplitude_limits(levels * unit.factor, free))
    _mark_free_beyond(panel, axis, axis.values, free, unit)


def _amplitude_limits(levels: PlotArray, free: PlotArray) -> tuple[float, float]:
    """An axis from 0 that shows all amplitudes, and of the free ones those that are not many times larger."""
    top, most = float(np.nanmax(levels, initial=0.0)), float(np.nanmax(free, initial=0.0))
    least = float(np.nanmin(free, initial=np.inf))
    some = 1.6 * top if least < 1.6 * top else ROOM_FOR_MARK * top
    return 0.0, 1.06 * (max(top, most) if most < 4 * top else some) or 1.0


def _mark_free_beyond(
    panel: Axes, axis: ParameterAxis, places: PlotArray, levels: PlotArray, unit: AmplitudeUnit
) -> None:
    """An arrow where the largest of amplitudes without contact is above the panel, with its number and place."""
    at = int(np.argmax(np.nan_to_num(levels, nan=-np.inf, posinf=np.inf)))
    level, place = levels[at], places[at]
    if not level > panel.get_ylim()[1]:
        return
    text = f"{level:.3g}{_unit_in_label(unit.label)}" if np.isfinite(level) else "without bound"
    text += f"\nat {place:.4g}{_unit_in_label(axis.label)}"
    aside, side = (4, "left") if place < axis.edges[[0, -1]].mean() else (-4, "right")
    across = panel.get_xaxis_transform()  # places on the axis, and shares of the height
    panel.annotate("", (place, 1.0), (place, MARK_FOOT), across, across, arrowprops=MARK_ARROW, zorder=5)
    panel.annotate(text, (place, 1.0), (aside, -2), across, "offset points", ha=side, va="top", **MARK_TEXT)


def _unit_in_label(label: str) -> str:
    """The unit that a label of an axis ends with, after a space; empty for none."""
    return f" {label.rpartition(' [')[2][:-1]}" if label.endswith("]") else ""


def _draw_directions(panel: Axes, ds: xr.Dataset, values: PlotArray, unit: AmplitudeUnit) -> None:
    """The amplitude `DRAWN` of each lane in all directions, not joined where the transient is not over."""
    ways = list(DIRECTION_STYLES) if "direction" in ds.dims else [None]
    for way in ways:
        lanes = ds if way is None else ds.sel(direction=way)
        level = np.where(lanes["status"].to_numpy() == Status.OK, lanes[DRAWN].to_numpy(), np.nan) * unit.factor
        _, color, marker, size = DIRECTION_STYLES[way] if way else ("", BLUE, "o", 2.0)
        line: Properties = {"lw": 0.8, "ls": "-"} if way is None else {"lw": 0, "ls": ""}
        unsettled = lanes["settling"].to_numpy() == NOT_SETTLED
        panel.plot(values, level, marker=marker, ms=size, mew=0, color=color, ls="")
        panel.plot(values, np.where(unsettled, np.nan, level), color=color, **line)
        if way is None:
            panel.plot(values[unsettled], level[unsettled], **UNSETTLED_STYLE)


def _finish_amplitudes(figure: AnyFigure, axes: Mapping[str, Axes], shown: AmplitudeContent) -> None:
    _finish_panels(figure, axes, shown.axis, _contact_entries(shown.ds))


def _contact_entries(ds: xr.Dataset) -> list[Artist]:
    """Legend entries of the motion with contact."""
    if "direction" in ds.dims:
        return direction_entries()
    unsettled = [Line2D([], [], label=NOT_OVER, **UNSETTLED_STYLE)] if (ds["settling"] == NOT_SETTLED).any() else []
    return [Line2D([], [], color=BLUE, lw=0.8, marker="o", ms=2, label="with contact"), *unsettled]


def _finish_panels(figure: AnyFigure, axes: Mapping[str, Axes], axis: ParameterAxis, handles: Sequence[Artist]) -> None:
    """Fit the panels to the axis, and add a legend, which names the motion without contact if it is shown."""
    panels = [*axes.values()]
    panels[-1].set(xlim=axis.edges[[0, -1]])
    figure.align_ylabels(panels)
    free = [Line2D([], [], label="without contact", **FREE_STYLE)] if set(axes) != {"P_d"} else []
    legend_below(figure, [*handles, *free])


class ResponseContent(NamedTuple):
    """A response: sweeps of all members, the points of their branches, and the peaks."""

    ds: xr.Dataset
    axis: ParameterAxis
    points: list[xr.Dataset | None]  # of each member's branches
    of: str
    unit: AmplitudeUnit
    labels: list[str]  # of members; empty where there is only one


def response_page(ds: xr.Dataset, appearance: Appearance) -> Page[ResponseContent]:
    """An amplitude and P_d over the number of a response."""
    of = str(ds.attrs["of"])
    points = [points_of_member(ds, i) for i in range(ds.sizes["member"])]
    largest = float(np.nanmax(_levels_of(ds, of).to_numpy(), initial=0.0))
    labels = []
    if ds.attrs.get("over"):
        coordinate = next(a for a in ds.coords.values() if a.attrs.get("key") == ds.attrs["over"])
        member_axis = parameter_axis(coordinate, appearance)
        labels = [f"{member_axis.label.partition(' [')[0].rpartition(' ')[2]} = {v:.4g}" for v in member_axis.values]
    content = ResponseContent(
        ds,
        parameter_axis(ds[_dim_of(ds, of)], appearance),
        [None if one is None else one.assign(retraced=("point", retraced(one)), broken=_broken(one)) for one in points],
        of,
        _unit_in(ds, of, largest, appearance),
        labels,
    )
    size = COLUMN_WIDTH, 4.6
    return Page(content, RESPONSE_PANELS, title_of(ds), size, shared="x", finish=_finish_response)


def _broken_style(whole: Properties, several: bool) -> Properties:
    """The appearance of a broken branch: in a family it has the colour of the whole one, and is thinner."""
    return {**whole, "lw": 0.5} if several else BROKEN_STYLE


def _broken(points: xr.Dataset) -> tuple[str, BoolArray]:
    """Whether each point is on a branch on which the shift of travelling waves is broken, as xarray takes it."""
    begun = [b for b, ends in enumerate(str(points.attrs["ends"]).split("; ")) if "localisation" in ends]
    broken = np.isin(points["branch"].to_numpy(), begun)
    if "wave_residual" in points:
        broken |= points["wave_residual"].to_numpy() > WAVE_RESIDUAL
    return "point", broken


def _draw_response(panel: Axes, shown: ResponseContent) -> None:
    ds, axis, factor = shown.ds, shown.axis, shown.unit.factor
    levels = []
    free = _free_levels(shown)
    for i, points in enumerate(shown.points):
        member = ds.isel(member=i)
        counted = _levels_of(member, shown.of) * factor
        levels.append(counted.to_numpy().ravel())
        along_branch = None if points is None else _levels_of(points, shown.of).to_numpy() * factor
        _draw_member(panel, shown, i, counted, points, along_branch)
        panel.plot(axis.values, free[i], zorder=1, **FREE_STYLE)
    scale = axis.values / ds[_dim_of(ds, shown.of)].to_numpy()
    ratio = float(np.nanmedian(scale)) if np.isfinite(scale).any() else 1.0
    places, tops = ds["peak_value"].to_numpy() * ratio, ds["peak_amplitude"].to_numpy() * factor
    if shown.labels and len(places) > 1:
        order = np.argsort(ds["peak_member"].to_numpy(), kind="stable")
        panel.plot(places[order], tops[order], ":", color=INK, lw=0.7, zorder=2)
    panel.plot(places, tops, "^", ms=3.5, mfc="white", mec=INK, mew=0.6, zorder=4)
    every = np.concatenate([*levels, tops])
    free_tops = ds["free_value"].to_numpy() * ratio, ds["free_amplitude"].to_numpy() * factor
    panel.set(xlabel=axis.label, ylabel=shown.unit.label, ylim=_amplitude_limits(every, free))
    _mark_free_beyond(panel, axis, *free_tops, shown.unit)


def _free_levels(shown: ResponseContent) -> PlotArray:
    """The amplitude without contact (members, values)."""
    free = _levels_of(shown.ds, free_name(shown.of)).isel(direction=0).transpose("member", ...)
    return free.to_numpy() * shown.unit.factor


def _dim_of(ds: xr.Dataset, of: str) -> str:
    return next(str(d) for d in ds[of].dims if d not in ("member", "direction", "blade"))


def _draw_member(
    panel: Axes,
    shown: ResponseContent,
    i: int,
    levels: xr.DataArray,
    points: xr.Dataset | None,
    along_branch: PlotArray | None,
) -> None:
    """The sweeps of a member as points, and its branches as lines."""
    values = shown.axis.values
    several = bool(shown.labels)
    status = shown.ds["status"].isel(member=i)
    for way, (_, color, marker, size) in DIRECTION_STYLES.items():
        ok = np.where(status.sel(direction=way).to_numpy() == Status.OK, levels.sel(direction=way).to_numpy(), np.nan)
        color = MEMBER_COLOURS[i % len(MEMBER_COLOURS)] if several else color
        panel.plot(values, ok, marker, ms=size, mew=0, color=color, alpha=0.6, zorder=2, rasterized=True)
    if points is None or along_branch is None:
        return
    at = parameter_axis(points["value"].assign_attrs(key=shown.ds.attrs["along"])).values
    y = np.where(points["retraced"].to_numpy(), np.nan, along_branch)
    whole: Properties = {"lw": 0.9, "color": MEMBER_COLOURS[i % len(MEMBER_COLOURS)] if several else INK}
    broken = points["broken"].to_numpy()
    for stable, part in stability_runs(points):
        appearance = _broken_style(whole, several) if broken[part].all() else whole
        panel.plot(at[part], y[part], LINE_STYLES[stable], zorder=3, **appearance)
    marked = points["kind"].to_numpy() == BIFURCATION_KINDS.index("localisation")
    panel.plot(at[marked], y[marked], zorder=5, **LOCALISATION_STYLE)


def _draw_response_power(panel: Axes, shown: ResponseContent) -> None:
    name = str(shown.ds.attrs["reduction"])
    for i, points in enumerate(shown.points):
        reduction = shown.ds[name].isel(member=i)
        _draw_member(panel, shown, i, reduction, points, None if points is None else points[name].to_numpy())
    panel.set(xlabel=shown.axis.label, ylabel=f"{quantity_symbol(name)} [%]")


RESPONSE_PANELS = (Panel("amplitude", _draw_response, 2.2), Panel("P_d", _draw_response_power, 1.2))


def _finish_response(figure: AnyFigure, axes: Mapping[str, Axes], shown: ResponseContent) -> None:
    _finish_panels(figure, axes, shown.axis, _response_handles(shown))


def _response_handles(shown: ResponseContent) -> list[Artist]:
    """Legend entries of what is visible."""
    handles: list[Artist] = []
    if shown.labels:
        shades = [MEMBER_COLOURS[i % len(MEMBER_COLOURS)] for i in range(len(shown.labels))]
        rows = list(zip(shown.labels, shades, strict=True))[:MAX_IN_LEGEND]
        handles += [Line2D([], [], color=color, lw=0.9, label=label) for label, color in rows]
    else:
        handles += _contact_entries(shown.ds)
    every = [p for p in shown.points if p is not None]
    stable = np.concatenate([[True], *(p["stable"].to_numpy() for p in every)])
    color = INK
    if every:
        handles += [Line2D([], [], ls="-", lw=0.9, color=color, label="stable orbit")]
    if not stable.all():
        handles += [Line2D([], [], ls="--", lw=0.9, color=color, label="unstable")]
    if any(p["broken"].any() for p in every):
        handles += [Line2D([], [], label="broken branch", **_broken_style({"color": INK}, bool(shown.labels)))]
    if any((p["kind"] == BIFURCATION_KINDS.index("localisation")).any() for p in every):
        handles += [Line2D([], [], label="localisation", **LOCALISATION_STYLE)]
    if shown.ds.sizes.get("peak", 0):
        handles += [Line2D([], [], ls="", marker="^", ms=3.5, mfc="white", mec=INK, mew=0.6, label="peak")]
    return handles
