"""The motion of one value: history, portrait, spectrum, contact, forces, and the blocks as they move."""

from typing import Any

import numpy as np
import xarray as xr
from bokeh.models import CustomJS, Div, HoverTool, LinearColorMapper, LogScale, Slider, Toggle

from jaxshroud.explorer.styles import (
    Recolouring,
    above_each_other,
    beside,
    empty_source,
    file_text,
    key_html,
    new_plot,
    scaled_ticks,
    styled,
    wide,
)
from jaxshroud.plotting.animation import MILLIMETRES
from jaxshroud.plotting.frames import ContactFrames, fitting_factor, last_frames, stored_blocks
from jaxshroud.plotting.plot_blades import HARMONICS
from jaxshroud.plotting.plot_run import CASE_STYLES, MODE_STYLES
from jaxshroud.plotting.run_data import FEWEST_SAMPLES, RunData, contact_data, run_data
from jaxshroud.plotting.style import ORANGE
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.signals.waves import blade_spectrum

HISTORY_PERIODS = 10
PORTRAIT_PERIODS = 16  # the longest orbit that has a period number
CORNERS = 4
SPAN_NAMES = "left", "right", "bottom", "top", "color", "word"
NO_SPANS: dict[str, list[Any]] = {name: [] for name in SPAN_NAMES}
PlotColumns = dict[str, Any]


def prepared_run(ds: xr.Dataset) -> RunData | None:
    """A run for the figures; None where it ended before its second sample."""
    return run_data(ds, scale=MILLIMETRES)


def history_columns(run: RunData) -> PlotColumns:
    """The displacements of the first two blades [m] over the last periods, over time in drive periods."""
    last = run.t > run.t[-1] - HISTORY_PERIODS - 1e-9
    x = run.ds["x"].to_numpy()[last]
    return {"t": run.t[last], "x_1": x[:, 0], "x_2": x[:, 1]}


def portrait_columns(run: RunData) -> PlotColumns:
    """Velocity over displacement of the left blade over the last periods."""
    last = run.settled & (run.t > run.t[-1] - PORTRAIT_PERIODS - 1e-9)
    return {"x": run.ds["x"].to_numpy()[last, 0], "v": run.v[last]}


def poincare_columns(run: RunData) -> PlotColumns:
    """The points of the portrait at the ends of periods."""
    return {"x": run.ds["x"].to_numpy()[run.ends, 0], "v": run.v[run.ends]}


def spectrum_columns(run: RunData, most: float = 6.0) -> PlotColumns:
    """The amplitude spectrum of the left blade [m] up to a frequency in units of the drive's."""
    if run.spectrum is None:
        return {"f": np.zeros(0), "a": np.zeros(0), "foot": np.zeros(0)}
    f, a = run.spectrum
    a = a / run.scale.factor
    shown = (f > 0) & (f <= most)
    top = a[1:].max()
    return {"f": f[shown], "a": np.maximum(a[shown], 1e-6 * top), "foot": np.full(shown.sum(), 1e-6 * top)}


def contact_columns(run: RunData) -> tuple[PlotColumns, PlotColumns]:
    """Forces over the last periods, and the spans of contact state and case; both empty without contact."""
    if "N" not in run.ds or run.rate < FEWEST_SAMPLES:
        nothing = np.zeros(0)
        return dict.fromkeys(("t", "N", "F"), nothing), NO_SPANS
    contact = contact_data(run)
    spans = [*_spans(contact.t, contact.mode, MODE_STYLES, 1.0), *_spans(contact.t, contact.case, CASE_STYLES, 0.0)]
    columns: PlotColumns = dict(zip(SPAN_NAMES, map(list, zip(*spans, strict=True)), strict=True)) if spans else {}
    return {"t": contact.t, "N": contact.N, "F": contact.F}, columns or NO_SPANS


def _spans(t: np.ndarray, values: np.ndarray, styles: Any, bottom: float) -> list[tuple[Any, ...]]:
    """The spans of time in which a state holds that has a style."""
    first = np.flatnonzero(np.diff(values, prepend=-1))
    ends = np.append(t[first[1:]], t[-1])
    found = []
    for i, end in zip(first, ends, strict=True):
        if int(values[i]) in styles:
            word, colour = styles[int(values[i])]
            found.append((float(t[i]), float(end), bottom + 0.1, bottom + 0.9, colour, word))
    return found


def frame_columns(run: RunData) -> tuple[PlotColumns, float]:
    """The corners, the contact point and the ends of the arrows of every frame, and the factor of exaggeration."""
    frames = last_frames(run, None)
    blocks = stored_blocks(run.ds)
    factor = fitting_factor(frames, blocks)
    corners = blocks.corners(frames, factor)
    columns: PlotColumns = {"t": frames["periods"].to_numpy()}
    for blade in (0, 1):
        for k in range(CORNERS):
            columns |= {f"x{blade}{k}": corners[:, blade, k, 0], f"y{blade}{k}": corners[:, blade, k, 1]}
    return columns | _arrow_columns(ContactFrames(frames, blocks, corners), frames["mode"].to_numpy()), factor


def _arrow_columns(contact: ContactFrames, modes: np.ndarray) -> PlotColumns:
    """The contact point, and the ends of the normal and the friction force on the right block; NaN when apart."""
    touching = contact.touching[:, 0] & (contact.N[:, 0].sum(axis=-1) > 0)
    point = contact.middle[:, 0]
    ends = {"p": point, "n": point + contact.forces[:, 0, 1], "f": point + contact.forces[:, 0, 3]}
    columns = {
        f"{name}{axis}": np.where(touching, a[:, i], np.nan) for name, a in ends.items() for i, axis in enumerate("xy")
    }
    words = {-1: "apart", **{int(mode): word for mode, (word, _) in MODE_STYLES.items()}}
    state = [words.get(m, "contact") for m in np.where(touching, modes, -1).tolist()]
    return {**columns, "state": state}


def ring_columns(run: RunData) -> PlotColumns:
    """The amplitude of each blade of a row with contact and without, and where it is drawn."""
    ds = run.ds
    peak = ds["x_peak"].to_numpy()
    free = ds["x_free"].to_numpy()
    count = ds.sizes["blade"]
    angle = 2 * np.pi * np.arange(count) / count
    closed = ds.sizes["interface"] == count
    x, y = (np.sin(angle), np.cos(angle)) if closed else (np.linspace(-1, 1, count), np.zeros(count))
    names = {"name_x": (0.78 if closed else 1.0) * x, "name_y": 0.78 * y if closed else y - 0.25}
    place = {"x": x, "y": y, **names, "name": list(map(str, range(count)))}
    return {"blade": np.arange(count), "peak": peak, "free": free, **place}


def diameter_columns(run: RunData) -> PlotColumns:
    """The waves of the last period: the amplitude of each harmonic of the drive and nodal diameter."""
    try:
        spectrum = blade_spectrum(run.ds["x"].to_numpy(), float(run.rate), 1)
    except ValueError:
        return {"diameter": [], "harmonic": [], "decades": [], "amplitude": []}
    amplitude = spectrum.amplitude[1 : HARMONICS + 1]
    harmonic, diameter = np.meshgrid(np.arange(1, len(amplitude) + 1), spectrum.diameters, indexing="ij")
    decades = np.log10(np.maximum(amplitude / (amplitude.max() or 1.0), 1e-4))
    columns = {"diameter": diameter, "harmonic": harmonic, "decades": decades, "amplitude": amplitude}
    return {name: a.ravel() for name, a in columns.items()}


SOURCES = {
    "history": ("t", "x_1", "x_2"),
    "portrait": ("x", "v"),
    "poincare": ("x", "v"),
    "spectrum": ("f", "a", "foot"),
    "forces": ("t", "N", "F"),
    "spans": SPAN_NAMES,
    "frames": ("t",),
    "blocks": ("xs", "ys", "blade"),
    "arrows": ("x0", "y0", "x1", "y1"),
    "ring": ("blade", "peak", "free", "x", "y", "name_x", "name_y", "name"),
    "diameters": ("diameter", "harmonic", "decades", "amplitude"),
}
INTERVAL = 50  # from frame to frame [ms]
ARROW_HEAD = 9
OF_PAIRS = ("spans", "forces", "blocks")
GREYS = ["#f0f0f0", "#c6c6c6", "#969696", "#636363", "#252525"]


class RunPanel:
    """The figures of one motion, and what they show."""

    def __init__(self, recolouring: Recolouring, row_of_blades: bool):
        self.row = row_of_blades
        self.ends = (0.0, 0.0)
        self.sources = {name: empty_source(names, name) for name, names in SOURCES.items()}
        self.heading = Div(text="", **wide(), name="motion")
        self.verdict = Div(text="", **wide(), name="verdict")
        own = self._row_plots(recolouring) if row_of_blades else self._contact_plots(recolouring)
        self.layout = above_each_other(
            self.heading,
            self.verdict,
            *own[:1],
            self._history(recolouring),
            beside(self._portrait(recolouring), self._spectrum(recolouring)),
            *own[1:],
        )

    def _history(self, recolouring: Recolouring) -> Any:
        plot = new_plot("time history", 180, "time t/T", "x [mm]", "history_plot")
        source = self.sources["history"]
        scaled_ticks(plot.yaxis[0], 1e3)
        recolouring.line(plot.line("t", "x_2", source=source, legend_label="x_2", line_dash="dashed"), "soft")
        recolouring.line(plot.line("t", "x_1", source=source, legend_label="x_1", line_width=1.5), "strong")
        plot.legend.orientation = "horizontal"
        return plot

    def _portrait(self, recolouring: Recolouring) -> Any:
        plot = new_plot("phase portrait, Poincaré points", 210, "x_1 [mm]", "v_x1 [m/s]", "portrait_plot", tools="")
        scaled_ticks(plot.xaxis[0], 1e3)
        plot.xaxis[0].ticker.desired_num_ticks = 4
        recolouring.line(plot.line("x", "v", source=self.sources["portrait"], line_width=0.7), "strong")
        dots = plot.scatter("x", "v", source=self.sources["poincare"], size=5, line_color="white", line_width=0.5)
        dots.glyph.fill_color = ORANGE
        return plot

    def _spectrum(self, recolouring: Recolouring) -> Any:
        plot = new_plot(
            "spectrum", 210, "frequency f/f_e", "amplitude of x_1 [m]", "spectrum_plot", y_axis_type="log", tools=""
        )
        assert isinstance(plot.y_scale, LogScale)
        lines = plot.segment("f", "foot", "f", "a", source=self.sources["spectrum"], line_width=1)
        recolouring.line(lines, "strong")
        return plot

    def _contact_plots(self, recolouring: Recolouring) -> list[Any]:
        tools = "xpan,reset"
        spans = self.sources["spans"]
        source = self.sources["forces"]
        ribbon = new_plot("contact: state above, case below", 110, "", "", "ribbon_plot", tools=tools, y_range=(0, 2))
        ribbon.yaxis.visible = ribbon.ygrid.visible = False
        bars = ribbon.quad("left", "right", "top", "bottom", source=spans, color="color", line_color=None)
        ribbon.add_tools(HoverTool(renderers=[bars], tooltips="@word"))
        shared = {"x_range": ribbon.x_range, "tools": tools}
        forces = new_plot("forces", 150, "time t/T", "force [N]", "forces_plot", **shared)
        recolouring.line(forces.line("t", "N", source=source, legend_label="N", line_width=1.5), "ink")
        recolouring.line(forces.line("t", "F", source=source, legend_label="F", line_dash="dashed"), "strong")
        forces.legend.orientation = "horizontal"
        words = Div(text=key_html([*MODE_STYLES.values(), *CASE_STYLES.values()]), **wide())
        return [self._animation(recolouring), ribbon, words, forces]

    def _animation(self, recolouring: Recolouring) -> Any:
        plot = new_plot("the blocks", 210, "", "", "animation_plot", match_aspect=True, tools="")
        plot.axis.visible = plot.grid.visible = False
        shapes = plot.patches("xs", "ys", source=self.sources["blocks"], fill_alpha=0.25, line_width=1.5)
        recolouring.line(shapes, "soft")
        arrows = plot.segment("x0", "y0", "x1", "y1", source=self.sources["arrows"], line_width=3, line_color=ORANGE)
        arrows.glyph.line_cap = "round"
        plot.scatter("x0", "y0", source=self.sources["arrows"], size=7, color=ORANGE, line_color=None)
        self.animation = plot
        self.frame = Slider(title="frame", start=0, end=1, value=0, step=1, **styled())
        shown = {name: self.sources[name] for name in ("frames", "blocks", "arrows")}
        draw = CustomJS(args={**shown, "title": plot.title, "frame": self.frame}, code=file_text("animation.js"))
        self.frame.js_on_change("value", draw)
        self.sources["frames"].js_on_change("data", draw)
        self.play = Toggle(label="move", width=80, name="play", **styled())
        code = file_text("play.js")
        self.play.js_on_change("active", CustomJS(args={"frame": self.frame, "interval": INTERVAL}, code=code))
        return above_each_other(plot, beside(self.play, self.frame))

    def _row_plots(self, recolouring: Recolouring) -> list[Any]:
        source = self.sources["ring"]
        mapper = LinearColorMapper(palette="Cividis256", low=0.0)
        square = {"match_aspect": True, "x_range": (-1.3, 1.3), "y_range": (-1.3, 1.3)}
        ring = new_plot("amplitude of x of each blade", 260, "", "", "ring_plot", tools="hover", **square)
        ring.axis.visible = ring.grid.visible = False
        colour = {"field": "peak", "transform": mapper}
        dots = ring.scatter("x", "y", source=source, size=30, color=colour, line_color=None)
        names = ring.text("name_x", "name_y", "name", source=source, text_align="center", text_baseline="middle")
        recolouring.text(names)
        bar = dots.construct_color_bar(width=8, title="[mm]")
        scaled_ticks(bar, 1e3)
        ring.add_layout(bar, "right")
        shown = {"blade": "@blade", "with contact": "@peak{0.000e+0} m", "without": "@free{0.000e+0} m"}
        ring.hover.tooltips = list(shown.items())
        waves = new_plot("waves of the last period", 200, "nodal diameter", "harmonic", "waves_plot", tools="hover")
        shade = LinearColorMapper(palette=GREYS, low=-4, high=0)
        tiles = waves.rect(
            "diameter",
            "harmonic",
            1,
            1,
            source=self.sources["diameters"],
            fill_color={"field": "decades", "transform": shade},
            line_color=None,
        )
        waves.add_layout(tiles.construct_color_bar(width=8, title="log10"), "right")
        waves.hover.tooltips = [("nodal diameter", "@diameter"), ("", "@amplitude{0.000e+0} m")]
        return [ring, waves]

    def show(self, result: Trajectory) -> None:
        """Show a run.

        Args:
            result: Of one scene.
        """
        for name, columns in run_columns(result, self.row).items():
            if name == "animation":
                self._fit_animation(columns)
            else:
                self.sources[name].data = columns
        if "frames" in self.sources and not self.row:
            self._show_first_frame()

    def _show_first_frame(self) -> None:
        """Show what the page itself would show of the first frame, for pages without a server."""
        frames = self.sources["frames"].data
        if len(frames["t"]):

            def corner(axis, blade):
                return [float(frames[f"{axis}{blade}{k}"][0]) for k in range(CORNERS)]

            xs, ys = ([corner(axis, blade) for blade in (0, 1)] for axis in "xy")
            self.sources["blocks"].data = {"xs": xs, "ys": ys, "blade": [0, 1]}
            self.sources["arrows"].data = arrow_columns(frames)

    def _fit_animation(self, animation: PlotColumns) -> None:
        """Give the animation room for all of its frames, and begin it anew."""
        self.animation.x_range.update(start=animation["left"], end=animation["right"])
        self.animation.y_range.update(start=animation["low"], end=animation["high"])
        self.animation.title.text = f"the blocks, motion and gap × {animation['factor']:g}"
        self.frame.update(end=max(animation["count"] - 1, 1), value=0)


def arrow_columns(frames: PlotColumns) -> PlotColumns:
    """The arrows of the first frame; none where the blocks are apart."""
    ends = {"x0": ("px", "px"), "y0": ("py", "py"), "x1": ("nx", "fx"), "y1": ("ny", "fy")}
    columns = {name: [float(frames[of][0]) for of in pair] for name, pair in ends.items()}
    return columns if np.isfinite(columns["x0"]).all() else {name: [] for name in ends}


def run_columns(result: Trajectory, row_of_blades: bool) -> dict[str, PlotColumns]:
    """The columns of all sources that a run changes."""
    run = prepared_run(result.data)
    if run is None:
        return {name: {n: [] for n in names} for name, names in SOURCES.items()}
    columns = {
        "history": history_columns(run),
        "portrait": portrait_columns(run),
        "poincare": poincare_columns(run),
        "spectrum": spectrum_columns(run),
    }
    if row_of_blades:
        return {**columns, "ring": ring_columns(run), "diameters": diameter_columns(run)}
    forces, spans = contact_columns(run)
    frames, factor = frame_columns(run)
    x = np.array([frames[f"x{b}{k}"] for b in (0, 1) for k in range(4)])
    y = np.array([frames[f"y{b}{k}"] for b in (0, 1) for k in range(4)])
    margin = 0.04 * float(np.ptp(x))
    ends = {"left": x.min() - margin, "right": x.max() + margin, "low": y.min() - margin, "high": y.max() + margin}
    animation = {**{name: float(v) for name, v in ends.items()}, "factor": factor, "count": len(frames["t"])}
    return {**columns, "forces": forces, "spans": spans, "animation": animation, "frames": frames}
