"""A page as data: the panels that show a result, their layout, scales, titles and legends."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxshroud.io.lane_status import status_name
from jaxshroud.io.scene_numbers import layout_in
from jaxshroud.model.modes import Status
from jaxshroud.plotting.style import (
    COLUMN_WIDTH,
    DEFAULT_APPEARANCE,
    LENGTHS,
    AnyFigure,
    Appearance,
    PlotArray,
    Properties,
    fitting_title,
    quantity,
)
from jaxshroud.scene.checks import InputError, word_argument

PANEL_HEIGHT = 2.5  # of a panel drawn alone [inch]
Summary = Mapping[str, Any]  # the plain values of a result by their names, as its `summary` gives them
Content = TypeVar("Content")  # of a page, prepared once for all its panels


class Panel(NamedTuple, Generic[Content]):
    """One panel of a page."""

    name: str  # by which users ask for it
    draw: Callable[[Axes, Content], None]  # draws the content of the page on the axes, with labels
    height: float = 1.0  # of its row, relative to the other rows
    columns: int = 1  # that it spans


def _add_nothing(figure: AnyFigure, axes: Mapping[str, Axes], content: object) -> None:
    """Add nothing."""


@dataclass(frozen=True)
class Page(Generic[Content]):
    """The picture of one result.

    On axes that a user gives, the first panel is drawn by default.
    """

    content: Content | None  # None only where there is nothing to draw
    panels: Sequence[Panel[Content]]
    title: str
    size: tuple[float, float]  # width and height [inch]
    columns: int = 1
    shared: str = ""  # axes that all panels have in common: "", "x" or "xy"
    finish: Callable[[AnyFigure, Mapping[str, Axes], Content], None] = _add_nothing  # adds legends and further marks
    nothing: str = ""  # the message that replaces the picture where there is nothing to draw
    below: "Page[Any] | None" = None  # a part with a layout of its own, which `size` includes
    single: Sequence[Panel[Content]] = ()  # the panels that can be drawn alone, where these are not `panels`
    set_ticks: bool = True  # at least three on every axis
    rc: Mapping[str, Any] = field(default_factory=dict)  # matplotlib's, over those of the package's style

    def panel(self, name: str | None) -> Panel[Content]:
        """The panel of that name, by default the first.

        Raises:
            ValueError: There is no such panel.
        """
        panels = {panel.name: panel for panel in self.single or self.panels}
        if name is not None:
            word_argument("panel", name, tuple(panels))
        return panels[name or next(iter(panels))]

    def only(self, name: str) -> "Page[Content]":
        """The page with a single panel.

        Raises:
            ValueError: There is no such panel.
        """
        size = self.size[0] if self.columns == 1 else COLUMN_WIDTH, PANEL_HEIGHT
        panel = self.panel(name)._replace(columns=1)
        return replace(self, panels=[panel], size=size, columns=1, finish=_add_nothing, below=None)

    @property
    def rows(self) -> list[list[str]]:
        """The names of the panels in rows of `columns`, with "" where there is no panel."""
        rows: list[list[str]] = [[]]
        for panel in self.panels:
            if len(rows[-1]) + panel.columns > self.columns:
                rows.append([])
            rows[-1] += [panel.name] * panel.columns
        return [row + [""] * (self.columns - len(row)) for row in rows]

    def draw_on(self, figure: AnyFigure) -> None:
        """Draw all panels."""
        if self.below is not None:
            heights = [self.size[1] - self.below.size[1], self.below.size[1]][-1 - bool(self.panels) :]
            parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).ravel()
            self.below.draw_on(parts[-1])
            figure = parts[0]
        if not self.panels:
            return
        assert self.content is not None
        heights = {panel.name: panel.height for panel in self.panels}
        axes = figure.subplot_mosaic(
            self.rows,  # type: ignore[arg-type]
            sharex="x" in self.shared,
            sharey="y" in self.shared,
            height_ratios=[heights[row[0]] for row in self.rows],
            empty_sentinel="",
        )
        for panel in self.panels:
            panel.draw(axes[panel.name], self.content)
        if self.shared:
            for ax in axes.values():
                ax.label_outer()
        self.finish(figure, axes, self.content)


LEAST_SPAN = 0.1  # percentage points on an axis of P_d: a shorter one would show the rounding errors of an orbit
DISPLACEMENT_SYMBOLS = {"x": "x", "y": "y", "theta": r"\theta"}
AMPLITUDE_KINDS = {"peak": "amplitude of", "rms": "RMS of", "mean": "mean of"}
VISIBLE_SHARE = 3e-3  # of an axis: narrower bands are invisible


class Scale(NamedTuple):
    """The scale of displacements: relative to the gap, or in mm where a gap is not positive or gaps differ."""

    factor: float | PlotArray  # by which x [m] is multiplied; one number, or one per lane
    symbol: str  # with {} for the blade
    unit: str

    def label(self, blade: str) -> str:
        """The axis label of a displacement."""
        return f"${self.symbol.format(blade)}${self.unit}"


def gap_of_lanes(ds: xr.Dataset) -> PlotArray:
    """The gap of each lane [m]; 0 in a row whose gaps differ, where there is no single one."""
    gap = ds["gap"]
    if "interface" in gap.dims:
        first = gap.isel(interface=0)
        gap = first.where((gap == first).all("interface"), 0.0)
    return gap.to_numpy()


def scale_of(gap: PlotArray, unit: str | None = None) -> Scale:
    """The scale of displacements for these gaps.

    Args:
        gap: The gap, or those of all lanes [m].
        unit: One of `LENGTHS`, or "gap"; by default "gap" where all gaps are equal and positive, else "mm".

    Raises:
        ValueError: A gap to divide by is not positive, or there is no such unit.
    """
    if unit in LENGTHS:
        return Scale(LENGTHS[unit][1], "x_{}", f" [{LENGTHS[unit][0]}]")
    if unit is not None:
        word_argument("unit", unit, (*LENGTHS, "gap"))
        if not (gap > 0).all():
            raise InputError("Displacements can be drawn over the gap only where it is positive; give another unit.")
    if unit == "gap" or ((gap > 0).all() and np.ptp(gap) == 0):
        return Scale(1 / gap, r"x_{}/\Delta", "")
    return Scale(1e3, "x_{}", " [mm]")


def first_blade(ds: xr.Dataset) -> str:
    """The index of the first blade of a sweep in symbols."""
    return layout_in(ds).indices[0]


def axis_limits(values: PlotArray, min_length: float = 0.0) -> tuple[float, float]:
    """The ends of an axis that shows `values` with a margin and is at least `min_length` long."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    half = max(0.55 * (high - low), min_length / 2) or 1.0
    return (low + high) / 2 - half, (low + high) / 2 + half


def limit_zoom(panel: Axes, values: PlotArray, min_length: float) -> None:
    """Make the vertical axis at least `min_length` long, so that settled values do not show their last digits."""
    values = values[np.isfinite(values)]
    if values.size and np.ptp(values) < min_length:
        panel.set_ylim(axis_limits(values, min_length))


def interval_ends(P_d: PlotArray, ci: PlotArray) -> tuple[PlotArray, PlotArray]:
    """The ends of the interval; NaN where it is unknown."""
    half = np.where(np.isfinite(ci), ci, np.nan)
    return P_d - half, P_d + half


def is_visible(half_widths: PlotArray, values: PlotArray) -> bool:
    """Whether a band of these half widths around values of P_d is wide enough to be visible on their axis."""
    band, finite = half_widths[np.isfinite(half_widths)], values[np.isfinite(values)]
    if not band.size or not finite.size:
        return False
    return float(band.max()) > VISIBLE_SHARE * max(float(np.ptp(finite)), LEAST_SPAN)


def title_of(ds: xr.Dataset, shows: Collection[str] = ()) -> str:
    """The part of a result's title that holds for a picture that `shows` quantities, with the status unless OK."""
    status = int(ds.attrs.get("status", Status.OK))
    varied = [str(a.attrs["key"]) for a in ds.variables.values() if "key" in a.attrs]
    stopped = f"(stopped: {status_name(status)})" if status else ""
    return " ".join(filter(None, (fitting_title(str(ds.attrs.get("title", "")), varied, shows), stopped)))


def legend_above(panel: Axes) -> None:
    """Add a legend above a panel, if it has entries."""
    handles = panel.get_legend_handles_labels()[0]
    style: Properties = {"bbox_to_anchor": (0, 1), "borderpad": 0.2, "borderaxespad": 0}
    for columns in range(min(len(handles), 3), 0, -1):
        legend = panel.legend(handles=handles, loc="lower left", ncols=columns, **style)
        if legend.get_window_extent().width <= panel.get_window_extent().width:
            return


def figure_of(ax: Axes) -> Figure:
    """The figure that the axes belong to."""
    figure = ax.get_figure(root=True)
    assert figure is not None  # nobody can draw on axes that were removed
    return figure


class ParameterAxis(NamedTuple):
    """A number of the scene that was varied, in the unit of the picture."""

    values: PlotArray
    edges: PlotArray  # of the cells around the values
    label: str


def parameter_axis(coordinate: xr.DataArray, appearance: Appearance = DEFAULT_APPEARANCE) -> ParameterAxis:
    """The values of a number of the scene in the unit of pictures, with the label of their axis."""
    key = str(coordinate.attrs.get("key", coordinate.name))
    words = str(coordinate.attrs.get("long_name", "")) if coordinate.name in coordinate.dims else ""
    unit = str(coordinate.attrs.get("units", "1")).removeprefix("1")
    label, factor = quantity(key, appearance, unit, words=words)
    values = coordinate.to_numpy().astype(float) * factor
    return ParameterAxis(values, _cell_edges(values), label)


def _cell_edges(values: PlotArray) -> PlotArray:
    if values.size < 2:
        return values.sum() + np.array([-0.5, 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.array([2 * values[0] - middle[0], *middle, 2 * values[-1] - middle[-1]])


class AmplitudeUnit(NamedTuple):
    """The unit of an amplitude in a picture."""

    factor: float
    label: str


def amplitude_unit(of: str, largest: float, appearance: Appearance, blade: int | None = 1) -> AmplitudeUnit:
    """The unit for an amplitude such as "x_peak", by its largest value or as was asked; `blade` None: of all."""
    name, kind = of.split("_")
    subscript = "" if blade is None else f"_{blade}"
    label = f"{AMPLITUDE_KINDS[kind]} ${DISPLACEMENT_SYMBOLS[name]}{subscript}$"
    if name == "theta":
        return AmplitudeUnit(180 / np.pi, f"{label} [°]")
    unit = appearance.unit if appearance.unit in LENGTHS else "mm" if largest >= 1e-4 else "um"
    text, factor = LENGTHS[unit]
    return AmplitudeUnit(factor, f"{label} [{text}]")
