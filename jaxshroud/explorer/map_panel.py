"""The map of the page: P_d or the period number over two keys."""

from collections.abc import Callable, Sequence

import numpy as np
from bokeh.events import Tap
from bokeh.models import Div, LinearColorMapper, RadioButtonGroup, Range1d, Scatter, Select

from jaxshroud.explorer.diagram import MAP_COARSE, Window
from jaxshroud.explorer.look import (
    LIGHT,
    Colours,
    Recolouring,
    above_each_other,
    axis_words,
    beside,
    empty_source,
    legend_html,
    new_plot,
    styled,
    wide,
)
from jaxshroud.io.lane_status import status_name
from jaxshroud.io.scene_numbers import dimension, layout_in
from jaxshroud.plotting.plot_sweep import MOTION_COLOURS, colour_indices
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.keys import parse_key

CELL_NAMES = "x", "y", "shown_x", "shown_y", "width", "height", "P_d", "motion", "period", "status"
QUANTITIES_OF_MAP = ["P_d [%]", "period number"]
STOPPED_COLOUR = "#ff00ff00"


class MapPanel:
    """The map, and what it shows."""

    def __init__(self, recolouring: Recolouring, keys: Sequence[str], chosen: Callable[[float, float], None]):
        """An empty map.

        Args:
            recolouring: Told of what follows light and dark.
            keys: Those that can be chosen for the vertical axis.
            chosen: Called with the values under a click, in SI units.
        """
        style = styled()
        self.chosen, self.factors = chosen, (1.0, 1.0)
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
