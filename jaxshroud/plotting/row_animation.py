"""The moving picture of a row of blades: a ring rolled up, a chain as it is, and the displacements of all blades."""

from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from jaxshroud.model.modes import Mode
from jaxshroud.plotting.frames import FRAME_MARGIN, Animation, Blocks
from jaxshroud.plotting.plot_run import MODE_STYLES, TIME_LABEL
from jaxshroud.plotting.style import DARK, INK, PER_MICRO, TIGHT_LEGEND, PlotArray, Properties, new_figure

WIDTH = 4.8  # of the figure [inch]
TALLEST = 4.2  # of the blocks [inch]
MAP_HEIGHT = 1.35  # of the map below them, with all labels [inch]
BESIDE = 0.6  # taken by the labels of the map and its colour bar [inch]
POINTS_ON_EDGE = 32  # of a block, which is bent where the row is rolled up
LEAST_MARK, LARGEST_MARK = 14.0, 64.0  # area of a mark without force, and with the largest [points^2]
MOST_NUMBERED = 36  # blades
NUMBER_PLACE = 0.8  # of a blade's number below the centre of its block, relative to the face
DISPLACEMENT_COLOURS = "RdBu_r"


class Writing(NamedTuple):
    """What is written around the blocks, and where: below the corners beside a ring, above the end of a chain."""

    room: float  # for it above the blocks [inches]
    first: tuple[int, int]  # of the first line from the upper left corner [points]
    second: tuple[int, int]  # of the second one
    va: str
    scale_text: str
    axes: str  # what x and y are in the picture
    most_numbered: int  # blades
    legend: Properties


OF_RING = Writing(
    room=0.0,
    first=(0, 0),
    second=(0, -11),
    va="top",
    scale_text="motion and\ngaps × {:g}",
    axes="$x$ clockwise\n$y$ outwards",
    most_numbered=MOST_NUMBERED,
    legend={"loc": "upper right"},
)
OF_CHAIN = Writing(
    room=0.3,
    first=(0, 14),
    second=(0, 2),
    va="bottom",
    scale_text="motion and gaps × {:g}",
    axes="",
    most_numbered=0,
    legend={"loc": "lower right", "ncols": 3},
)


class RowAnimation(Animation):
    """The blocks of a row at one instant after the other, coloured by x, with a mark wherever two touch.

    A ring is rolled up by the conformal map that takes the row's x around a circle and its y outwards: it keeps angles,
    and what touches. Marks have the colour of the contact mode, and an area that grows with the normal force.
    """

    def __init__(self, frames: xr.Dataset, blocks: Blocks, factor: float, title: str):
        self.frames, self.blocks, self.factor = frames, blocks, factor
        self.closed = frames.sizes["interface"] == frames.sizes["blade"]
        self.writing = OF_RING if self.closed else OF_CHAIN
        gaps = np.broadcast_to(blocks.gap, frames.sizes["interface"])
        self.places = np.arange(frames.sizes["blade"] + 1) * blocks.l_oa
        self.places[1 : len(gaps) + 1] += factor * np.cumsum(gaps)
        self.largest_force = float(np.nanmax(frames["N"], initial=0.0)) if "N" in frames else 0.0
        extent = PER_MICRO * float(np.abs(frames["x"]).max()) or 1.0
        self.norm = Normalize(-extent, extent)
        self.colours = mpl.colormaps[DISPLACEMENT_COLOURS]
        left, right, low, high = self._limits
        height = min((high - low) / (right - left) * (WIDTH - BESIDE), TALLEST)
        self.figure = new_figure(title, WIDTH, height + MAP_HEIGHT + self.writing.room)
        panel, below = self.figure.subplots(2, height_ratios=[height, MAP_HEIGHT - 0.4])
        panel.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        panel.set_axis_off()
        self.shapes = [Polygon(np.zeros((1, 2)), ec=INK, lw=0.7) for _ in range(frames.sizes["blade"])]
        for shape in self.shapes:
            panel.add_patch(shape)
        self.marks = panel.scatter([], [], ec="white", lw=0.6, zorder=4)
        self._label(panel)
        self.cursor = self._draw_map(below)

    def show(self, i: int) -> None:
        """Show frame `i`."""
        frame = self.frames.isel(time=i)
        corners = [self._corners(frame, blade) for blade in range(len(self.shapes))]
        for blade, shape in enumerate(self.shapes):
            shape.set_xy(self._drawn(_finer(corners[blade])))
            shape.set_facecolor(self.colours(self.norm(PER_MICRO * float(frame["x"][blade]))))
        self._mark_contacts(frame, corners)
        self.caption.set_text(f"$t/T$ = {float(frame['periods']):.2f}")
        self.cursor.set_xdata([float(frame["periods"])] * 2)

    @property
    def _radius(self) -> float:
        return self.places[-1] / (2 * np.pi)

    def _drawn(self, points: PlotArray) -> PlotArray:
        """Where points (..., 2) of the row are drawn; blade 0 of a ring is at the top, the others follow clockwise."""
        if not self.closed:
            return points
        angle = points[..., 0] / self._radius
        distance = self._radius * np.exp(points[..., 1] / self._radius)
        return np.stack([distance * np.sin(angle), distance * np.cos(angle)], axis=-1)

    def _corners(self, frame: xr.Dataset, blade: int) -> PlotArray:
        return self.blocks.corners(frame, self.factor, np.array([self.places[blade], 0.0]), blade)

    @property
    def _limits(self) -> tuple[float, float, float, float]:
        """The left, right, lower and upper end of what the blocks reach in any frame, with a margin."""
        frames = [self.frames.isel(time=i) for i in range(self.frames.sizes["time"])]
        points = [_finer(self._corners(frame, blade)) for frame in frames for blade in range(frame.sizes["blade"])]
        drawn = self._drawn(np.concatenate(points))
        left, low = drawn.min(axis=0)
        right, high = drawn.max(axis=0)
        margin = FRAME_MARGIN * (right - left)
        return left - margin, right + margin, low - margin, high + margin

    def _mark_contacts(self, frame: xr.Dataset, corners: list[PlotArray]) -> None:
        """Mark the interfaces that touch, each at its contact point, or at each of its points that touch."""
        touching = self._touching(frame)
        N, mode = ("N", "mode")
        if self.blocks.places is not None:
            touching = np.asarray(frame["point_mode"] != Mode.APART)
            N, mode = ("point_N", "point_mode")
            points = np.broadcast_to(self.blocks.places, touching.shape)
        else:
            interfaces = frame.sizes["interface"]
            points = frame["contact_point"].to_numpy() if "contact_point" in frame else np.zeros(interfaces)
        touched = np.nonzero(touching)
        on_faces = zip(touched[0], points[touched].tolist(), strict=True)
        at = [self.blocks.point_on_face(corners[j], place) for j, place in on_faces]
        self.marks.set_offsets(self._drawn(np.reshape(at, (-1, 2))))
        share = frame[N].to_numpy()[touching] / (self.largest_force or 1.0) if len(at) else np.zeros(0)
        self.marks.set_sizes(LEAST_MARK + (LARGEST_MARK - LEAST_MARK) * share)
        modes = frame[mode].to_numpy()[touching] if len(at) else ()
        self.marks.set_facecolor([to_rgba(MODE_STYLES[Mode(int(mode))][1]) for mode in modes])

    def _touching(self, frames: xr.Dataset) -> Any:
        """Which interfaces touch; smooth contact has one mode, also without penetration."""
        if "v" not in frames:
            return np.zeros(frames["mode"].shape if "mode" in frames else frames.sizes["interface"], bool)
        return np.asarray((frames["mode"] != Mode.APART) & ((frames["mode"] != Mode.SMOOTH) | (frames["v"] > 0)))

    def _label(self, panel: Axes) -> None:
        """Write time and exaggeration, the numbers of the blades, and what the marks mean."""
        style: Properties = {"xycoords": "axes fraction", "textcoords": "offset points"}
        writing = self.writing
        self.caption = panel.annotate("", (0, 1), writing.first, va=writing.va, **style)
        scale_text = writing.scale_text.format(self.factor)
        panel.annotate(scale_text, (0, 1), writing.second, va=writing.va, color=DARK, **style)
        panel.annotate(writing.axes, (0, 0), (0, 0), va="bottom", color=DARK, **style)
        blades = np.arange(len(self.shapes))
        down = np.full(len(blades), -NUMBER_PLACE * self.blocks.l_ab)
        places = self._drawn(np.stack([self.places[:-1], down], axis=-1))
        if len(blades) <= writing.most_numbered:
            for blade, place in zip(blades, places, strict=True):
                panel.text(place[0], place[1], str(blade), ha="center", va="center", color=DARK, fontsize=7)
        present = set(np.unique(self.frames["mode"].to_numpy()[self._touching(self.frames)]))
        if self.blocks.places is not None:
            present = set(np.unique(self.frames["point_mode"]))
        dot: Properties = {"marker": "o", "ls": "", "ms": 5, "mec": "white", "mew": 0.6}
        styles = [style for mode, style in MODE_STYLES.items() if mode in present]
        entries = [Line2D([], [], color=color, label=name, **dot) for name, color in styles]
        if entries:
            heading: Properties = {"title": "area: $N$", "title_fontsize": 7}
            panel.legend(handles=entries, bbox_to_anchor=(1, 1), **heading, **writing.legend, **TIGHT_LEGEND)

    def _draw_map(self, panel: Axes) -> Line2D:
        """Draw the displacements of all blades over the time shown; the line of the present."""
        t = self.frames["periods"].to_numpy()
        x = PER_MICRO * self.frames["x"].to_numpy().T
        edges = np.arange(len(x) + 1) - 0.5
        panel.pcolormesh(np.append(t, 2 * t[-1] - t[-2]), edges, x, norm=self.norm, cmap=self.colours)
        panel.set(xlabel=TIME_LABEL, ylabel="blade")
        panel.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
        self.figure.colorbar(ScalarMappable(self.norm, self.colours), ax=panel, label="$x$ [μm]", pad=0.01)
        return panel.axvline(t[0], color=INK, lw=1.2)


def _finer(corners: PlotArray) -> PlotArray:
    """Points along the edges of a polygon (n, 2)."""
    part = np.arange(POINTS_ON_EDGE)[:, None] / POINTS_ON_EDGE
    return np.concatenate([a + part * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
