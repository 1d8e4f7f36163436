"""The diagrams of the page: the bifurcation diagram with P_d and the amplitude, and the map over two keys."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bokeh.events import RangesUpdate, Reset, Tap
from bokeh.models import Div, HoverTool, LinearColorMapper, RadioButtonGroup, Range1d, Scatter, Select, Span

from jaxshroud.explorer.diagram import DIAGRAM_LEVELS, MAP_COARSE, Window
from jaxshroud.explorer.styles import (
    LIGHT,
    Colours,
    Recolouring,
    above_each_other,
    axis_words,
    beside,
    empty_source,
    legend_html,
    new_plot,
    scaled_ticks,
    styled,
    wide,
)
from jaxshroud.io.lane_status import status_name
from jaxshroud.io.scene_numbers import dimension, layout_in
from jaxshroud.plotting.plot_sweep import MOTION_COLOURS, colour_indices
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.keys import parse_key

SAMPLE_NAMES = "value", "shown", "x", "motion"
LANE_NAMES = "value", "shown", "P_d", "low", "high", "ci", "peak", "period", "motion", "status", "foot"
WAY_MARKERS = {"independent": "dot", "forward": "triangle", "backward": "inverted_triangle"}
SIZES = {"independent": 7, "forward": 4, "backward": 4}
PERIODS = {0: "aperiodic", -1: "none"}
STOPPED_LINE = "#d55e00"
Zoomed = Callable[[float, float], None]


class DiagramPanel:
    """The figures of the diagram, and what they show."""

    def __init__(
        self, recolouring: Recolouring, zoomed: Callable[[float, float], None], chosen: Callable[[float], None]
    ):
        """An empty diagram.

        Args:
            recolouring: Notified of what follows light and dark.
            zoomed: Called with the ends that are shown, in SI units, once they change.
            chosen: Called with the value under a click, in SI units.
        """
        self.zoomed = zoomed
        self.chosen = chosen
        self.factor = 1.0
        self.key = ""
        self.mapper = LinearColorMapper(low=-0.5, high=len(MOTION_COLOURS) - 0.5, palette=list(LIGHT.motions))
        recolouring.listeners.append(self._recolour)
        self.range = Range1d(start=0, end=1)
        self.samples = [empty_source(SAMPLE_NAMES, f"samples{i}") for i in range(DIAGRAM_LEVELS)]
        self.ways = {way: empty_source(SAMPLE_NAMES, way) for way in ("forward", "backward")}
        self.lanes = empty_source(LANE_NAMES, "lanes")
        self.stopped = empty_source(("shown", "words"), "stopped")
        self.cursors: list[Any] = [
            Span(dimension="height", line_dash="dashed", line_width=1.5, visible=False) for _ in range(3)
        ]
        self.legend = Div(text="", **wide())
        self.top = self._samples_plot()
        self.power = self._curve_plot("P_d", "P_d [%]", recolouring, 150)
        self.amplitude = self._curve_plot("peak", "amplitude [mm]", recolouring, 160)
        scaled_ticks(self.amplitude.yaxis[0], 1e3)
        plots = [self.top, self.power, self.amplitude]
        for plot, cursor in zip(plots, self.cursors, strict=True):
            plot.add_layout(cursor)
            plot.on_event(Tap, lambda event: self.chosen(self._in_si(event.x)))
            plot.on_event(RangesUpdate, self._ranges_changed)
        self.layout = above_each_other(self.top, self.power, self.amplitude, self.legend)

    def on_reset(self, call: Callable[[], None]) -> None:
        """Call this when the reset tool is used."""
        for plot in (self.top, self.power, self.amplitude):
            plot.on_event(Reset, lambda event: call())

    def _recolour(self, colours: Colours) -> None:
        self.mapper.palette = list(colours.motions)
        for cursor in self.cursors:
            cursor.line_color = colours.ink

    def _samples_plot(self) -> Any:
        plot = new_plot("", 300, "", "x_1 at the drive phase 0 [mm]", "samples", x_range=self.range)
        scaled_ticks(plot.yaxis[0], 1e3)
        plot.xaxis.visible = False
        colour = {"field": "motion", "transform": self.mapper}
        style: dict[str, Any] = {"x": "shown", "y": "x", "color": colour}
        for source in self.samples:
            plot.scatter(source=source, marker="dot", size=7, **style)
        for way, source in self.ways.items():
            plot.scatter(source=source, marker=WAY_MARKERS[way], size=SIZES[way], fill_alpha=0.0, **style)
        plot.vspan(x="shown", source=self.stopped, line_color=STOPPED_LINE, line_alpha=0.35, name="stopped lanes")
        return plot

    def _curve_plot(self, name: str, label: str, recolouring: Recolouring, height: int) -> Any:
        plot = new_plot("", height, "", label, name, x_range=self.range)
        plot.xaxis.visible = name == "peak"
        if name == "P_d":
            band = plot.varea(x="shown", y1="low", y2="high", source=self.lanes, fill_alpha=0.3)
            recolouring.line(band, "strong")
        recolouring.line(plot.line(x="shown", y=name, source=self.lanes, line_width=1), "soft")
        colour = {"field": "motion", "transform": self.mapper}
        dots = plot.scatter(x="shown", y=name, source=self.lanes, size=4, color=colour, line_color=None)
        words = [("value", "@shown"), ("P_d", "@P_d{0.00} ± @ci{0.00} %"), ("period", "@period"), ("", "@status")]
        plot.add_tools(HoverTool(renderers=[dots], tooltips=words, mode="vline", attachment="horizontal"))
        plot.vspan(x="shown", source=self.stopped, line_color=STOPPED_LINE, line_alpha=0.35)
        return plot

    def _in_si(self, shown: float) -> float:
        return shown / self.factor

    def _ranges_changed(self, event: RangesUpdate) -> None:
        if event.x0 is not None and event.x1 is not None:
            self.zoomed(self._in_si(event.x0), self._in_si(event.x1))

    def show_window(self, window: Window) -> None:
        """Show the axis of a window, without values."""
        row = parse_key(window.key)[0]
        self.factor = float(row.shown[1])
        self.key = window.key
        self.range.update(start=window.start * self.factor, end=window.stop * self.factor)
        self.amplitude.xaxis.axis_label = axis_words(row)

    def show_level(self, level: int, added: SweepResult, all_levels: SweepResult) -> None:
        """Show what a level adds, and P_d and the amplitude of all levels."""
        if level == 0:
            self._clear()
        self.samples[level].data = self._sample_columns(added.data)
        self._show_lanes(all_levels)

    def show_directions(self, result: SweepResult, direction: str) -> None:
        """Show a sweep in other directions than from rest, or in all."""
        self._clear()
        parts = {direction: result.data}
        if direction == "both":
            parts = {str(way): result.data.sel(direction=way) for way in result.data["direction"].to_numpy()}
        for way, data in parts.items():
            (self.samples[0] if way == "independent" else self.ways[way]).data = self._sample_columns(data)
        self._show_lanes(SweepResult(parts.get("independent", next(iter(parts.values())))))

    def _clear(self) -> None:
        for source in (*self.samples, *self.ways.values()):
            source.data = {name: [] for name in SAMPLE_NAMES}

    def _sample_columns(self, data: Any) -> dict[str, np.ndarray]:
        (dim,) = data["status"].dims
        data = data.transpose(dim, "period", "blade", ...)
        x = data["x"].to_numpy()[:, :, 0]
        motion = colour_indices(data)
        value = np.broadcast_to(data[dim].to_numpy()[:, None], x.shape)
        shown = np.broadcast_to(motion[:, None], x.shape)
        kept = (np.isfinite(x) & (shown >= 0)).ravel()
        columns = {"value": value, "shown": value * self.factor, "x": x, "motion": shown}
        return {name: np.ascontiguousarray(a.ravel()[kept]) for name, a in columns.items()}

    def _show_lanes(self, result: SweepResult) -> None:
        data = result.data
        ok = result.status == 0
        (dim,) = data["status"].dims
        value = data[dim].to_numpy()
        motion = colour_indices(data)

        def nan(a):
            return np.where(ok, np.asarray(a, float), np.nan)

        P_d, ci, peak = nan(result.P_d), nan(result.P_d_ci), nan(result.x_peak[:, 0])
        half = np.nan_to_num(ci)
        self.lanes.data = {
            **{"value": value, "shown": value * self.factor, "P_d": P_d, "ci": ci, "peak": peak},
            **{"low": P_d - half, "high": P_d + half, "motion": motion, "foot": np.zeros(len(value))},
            "period": [PERIODS.get(n, str(n)) for n in np.where(ok, result.period_number, -1).astype(int).tolist()],
            "status": [status_name(int(code)) for code in result.status],
        }
        words = [status_name(int(code)) for code in result.status[~ok]]
        self.stopped.data = {"shown": value[~ok] * self.factor, "words": words}
        stopped = f'<span class="wrong">{(~ok).sum()} lanes stopped: {", ".join(sorted(set(words)))} (lines)</span>'
        self.legend.text = legend_html(set(motion.tolist())) + (stopped if words else "")

    def show_cursor(self, value: float | None) -> None:
        """Mark the value whose motion is shown."""
        for cursor in self.cursors:
            cursor.update(location=None if value is None else value * self.factor, visible=value is not None)


CELL_NAMES = "x", "y", "shown_x", "shown_y", "width", "height", "P_d", "motion", "period", "status"
QUANTITIES_OF_MAP = ["P_d [%]", "period number"]
STOPPED_COLOUR = "#ff00ff00"


class MapPanel:
    """The map, and what it shows."""

    def __init__(self, recolouring: Recolouring, keys: Sequence[str], chosen: Callable[[float, float], None]):
        """An empty map.

        Args:
            recolouring: Notified of what follows light and dark.
            keys: Those that can be chosen for the vertical axis.
            chosen: Called with the values under a click, in SI units.
        """
        style = styled()
        self.chosen = chosen
        self.factors = (1.0, 1.0)
        self.cells = empty_source(CELL_NAMES, "cells")
        self.mark = empty_source("xy")
        self.up = Select(title="second key", value=keys[0], options=list(keys), name="map_key", **style)
        self.of = RadioButtonGroup(labels=QUANTITIES_OF_MAP, active=0, name="map_of", **style)
        self.power = LinearColorMapper(palette="Cividis256", low=0.0, high=1.0, nan_color=STOPPED_COLOUR)
        self.motions = LinearColorMapper(low=-0.5, high=len(MOTION_COLOURS) - 0.5, palette=list(LIGHT.motions))
        recolouring.listeners.append(self._recolour)
        self.ranges = Range1d(start=0, end=1), Range1d(start=0, end=1)
        self.plot = new_plot(
            "", 460, "", "", "map_plot", x_range=self.ranges[0], y_range=self.ranges[1], tools="hover,save"
        )
        self.tiles = self.plot.rect(
            *("shown_x", "shown_y", "width", "height"),
            source=self.cells,
            color={"field": "P_d", "transform": self.power},
        )
        self.bar = self.tiles.construct_color_bar(width=10, title="P_d [%]")
        self.plot.add_layout(self.bar, "right")
        ring = Scatter(x="x", y="y", size=14, marker="circle_cross", fill_alpha=0.0, line_width=2, line_color="#ffffff")
        self.plot.add_glyph(self.mark, ring)
        self.plot.hover.renderers = [self.tiles]
        self.plot.hover.tooltips = [
            ("", "@shown_x, @shown_y"),
            ("P_d", "@P_d{0.00} %"),
            ("period", "@period"),
            ("", "@status"),
        ]
        self.plot.on_event(Tap, lambda event: chosen(event.x / self.factors[0], event.y / self.factors[1]))
        self.of.on_change("active", lambda attr, old, new: self._recoloured())
        self.legend = Div(text="", visible=False, **wide())  # of period numbers
        choices = beside(self.up, self.of)
        self.layout = above_each_other(choices, self.plot, self.legend, visible=False)

    def _recolour(self, colours: Colours) -> None:
        self.motions.palette = list(colours.motions)

    def _recoloured(self) -> None:
        """Take the colours of the quantity that is chosen."""
        of_power = self.of.active == 0
        field, mapper = ("P_d", self.power) if of_power else ("motion", self.motions)
        colour = {"field": field, "transform": mapper}
        self.tiles.glyph.update(fill_color=colour, line_color=colour)
        self.bar.visible = of_power
        self.legend.visible = not of_power

    def show_windows(self, across: Window, up: Window) -> None:
        """Show the axes, without cells."""
        rows = [parse_key(window.key)[0] for window in (across, up)]
        self.factors = rows[0].shown[1], rows[1].shown[1]
        for window, factor, key, span, axis in zip(
            (across, up), self.factors, rows, self.ranges, (self.plot.xaxis[0], self.plot.yaxis[0]), strict=True
        ):
            half = (window.stop - window.start) / (2 * (MAP_COARSE - 1))
            span.update(start=(window.start - half) * factor, end=(window.stop + half) * factor)
            axis.axis_label = axis_words(key)
        self.cells.data = {name: [] for name in CELL_NAMES}
        self.mark.data = {"x": [], "y": []}

    def show_cells(self, result: SweepResult, across: Window, up: Window, level: int) -> None:
        """Show the lanes of a level as cells."""
        data = self._cell_columns(result, across, up, level)
        finite = data["P_d"][np.isfinite(data["P_d"])]
        if finite.size:
            low, high = np.percentile(finite, [5, 100])
            self.power.update(low=float(low), high=float(max(high, low + 0.1)))
        self.cells.data = data
        self.legend.text = legend_html(set(data["motion"].tolist()))

    def _cell_columns(self, piece: SweepResult, across: Window, up: Window, level: int) -> dict[str, np.ndarray]:
        dims = [dimension(window.key, layout_in(piece.data).names) for window in (across, up)]
        data = piece.data.transpose(*dims, ...)
        x, y = np.meshgrid(*(data[dim].to_numpy() for dim in dims), indexing="ij")
        sizes = [
            abs(window.stop - window.start) / ((MAP_COARSE - 1) * 2**level) * factor
            for window, factor in zip((across, up), self.factors, strict=True)
        ]
        status = data["status"].to_numpy()
        P_d = np.where(status == 0, data["P_d"].to_numpy(), np.nan)
        columns: dict[str, np.ndarray] = {
            **{"x": x, "y": y, "shown_x": x * self.factors[0], "shown_y": y * self.factors[1], "P_d": P_d},
            **{"width": np.full(x.shape, sizes[0]), "height": np.full(x.shape, sizes[1])},
            **{"motion": colour_indices(data), "period": data["period_number"].to_numpy()},
            "status": np.vectorize(status_name, otypes=[object])(status),
        }
        return {name: np.asarray(a).ravel() for name, a in columns.items()}

    def show_mark(self, x: float, y: float) -> None:
        """Mark the values whose motion is shown, in SI units."""
        self.mark.data = {"x": [x * self.factors[0]], "y": [y * self.factors[1]]}
