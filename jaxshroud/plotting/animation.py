"""Animations of blocks, to scale except for their motion and the gaps, which are exaggerated by one factor."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxshroud.io.files import write
from jaxshroud.plotting.frames import Blocks, ContactFrames, fitting_factor, last_frames, stored_blocks
from jaxshroud.plotting.page import scale_of, title_of
from jaxshroud.plotting.plot_run import CASE_STYLES, MODE_STYLES, TIME_LABEL, legend_entries
from jaxshroud.plotting.run_data import FEWEST_SAMPLES, run_data
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DARK,
    GREY,
    INK,
    ORANGE,
    PER_MICRO,
    PER_MILLI,
    STYLE,
    TIGHT_LEGEND,
    PlotArray,
    Properties,
    as_is,
    new_figure,
)
from jaxshroud.scene.checks import InputError

PER_SECOND = 20
MILLIMETRES = scale_of(np.zeros(()))  # for rows too, whose gaps may differ
Writers = {".gif": PillowWriter, ".mp4": FFMpegWriter}
TALLEST = 4.2  # of the blocks [inch]
BELOW_HEIGHT = 1.35  # of the panel below them, with all labels [inch]
BESIDE = 0.6  # taken by the labels of that panel and a colour bar [inch]
FRAME_MARGIN = 0.02  # around what is shown, relative to its width
POINTS_ON_EDGE = 32  # of a block, which is bent where the row is rolled up
LEAST_MARK, LARGEST_MARK = 14.0, 64.0  # area of a mark without force, and with the largest [points^2]
MOST_NUMBERED = 36  # blades
NUMBER_PLACE = 0.8  # of a blade's number below the centre of its block, relative to the face
PAIR_FILLS = "#c9dfee", "#e3e3e3"  # of the left and the right block
DISPLACEMENT_COLOURS = mpl.colormaps["RdBu_r"]


def save_animation(
    ds: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    periods: int | None = None,
    factor: float | None = None,
    title: str | None = None,
    dpi: int = 150,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Write the last periods of a run as an animation.

    Args:
        ds: A stored run of a single scene.
        path: A name that ends in .gif, or in .mp4 where ffmpeg is installed.
        periods: Drive periods shown; by default those after which the motion repeats, or four.
        factor: The factor by which motion and gap are exaggerated; by default so that the motion is well visible.
        title: A title in place of that of the run.
        dpi: Dots per inch.
        progress: A function that is called with the number of finished frames and that of all frames.

    Returns:
        The factor.

    Raises:
        ValueError: The suffix is neither, ffmpeg is missing, or too little is stored.
        WriteError: The path cannot be written.
    """
    path = Path(path)
    if path.suffix not in Writers:
        raise InputError(f"{path}: a moving picture needs a name that ends in .gif or .mp4.")
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"{path}: mp4 needs ffmpeg, which is not installed; give a name that ends in .gif.")
    run = run_data(ds, scale=MILLIMETRES)
    if run is None or run.rate < FEWEST_SAMPLES:
        raise InputError(
            f"Fewer than {FEWEST_SAMPLES} samples of a period are stored, too few to show the motion; keep more."
        )
    frames = last_frames(run, periods)
    blocks = stored_blocks(ds)
    factor = factor or fitting_factor(frames, blocks)
    with mpl.rc_context(STYLE), tempfile.TemporaryDirectory() as folder:
        animation = Animation(frames, blocks, factor, title_of(ds) if title is None else as_is(title))
        animation.fix_layout()
        writer = Writers[path.suffix](fps=PER_SECOND)
        temporary = Path(folder, path.name)
        with writer.saving(animation.figure, str(temporary), dpi):
            for i in range(frames.sizes["time"]):
                animation.show(i)
                writer.grab_frame()
                if progress is not None:
                    progress(i + 1, frames.sizes["time"])
        write(path, temporary.read_bytes())
    return factor


class Surroundings(NamedTuple):
    """What is around the blocks of pairs, chains and rings: the width of the figure, and what is written where."""

    width: float  # of the figure [inch]
    room: float  # for words above the blocks [inches]
    first: tuple[int, int]  # of the first line from the upper left corner [points]
    second: tuple[int, int]  # of the second one
    va: str
    scale_text: str
    axes: str  # what x and y are in the picture
    most_numbered: int  # blades
    legend: Properties


OF_RING = Surroundings(
    width=4.8,
    room=0.0,
    first=(0, 0),
    second=(0, -11),
    va="top",
    scale_text="motion and\ngaps × {:g}",
    axes="$x$ clockwise\n$y$ outwards",
    most_numbered=MOST_NUMBERED,
    legend={"loc": "upper right"},
)
OF_CHAIN = Surroundings(
    width=OF_RING.width,
    room=0.3,
    first=(0, 14),
    second=(0, 2),
    va="bottom",
    scale_text="motion and gaps × {:g}",
    axes="",
    most_numbered=0,
    legend={"loc": "lower right", "ncols": 3},
)
OF_PAIR = OF_CHAIN._replace(width=COLUMN_WIDTH, scale_text="motion and gap × {:g}")


class Animation:
    """A figure that shows one frame after the other: the blocks, with a mark wherever they touch, and a panel below.

    Marks have the colour of the contact mode, and an area that grows with the normal force. The blocks of a row are
    coloured by x, and the panel has that of all blades. A pair has arrows of the forces, and its panel has these, or
    without contact the displacements. A ring is rolled up by the conformal map that takes the row's x around a circle
    and its y outwards: it keeps angles, and what touches.
    """

    def __init__(self, frames: xr.Dataset, blocks: Blocks, factor: float, title: str):
        self.frames, self.blocks, self.factor = frames, blocks, factor
        self.is_pair = "interface" not in frames.dims
        self.closed = len(blocks.gaps) == frames.sizes["blade"]
        self.around = OF_PAIR if self.is_pair else OF_RING if self.closed else OF_CHAIN
        self.rests = blocks.rests(factor)
        corners = blocks.corners(frames, factor)
        self.outlines = self._drawn(_finer(corners))
        self.contact = ContactFrames(frames, blocks, corners)
        self.x = PER_MICRO * frames["x"].to_numpy()
        extent = float(np.abs(self.x).max()) or 1.0
        self.norm = Normalize(-extent, extent)
        left, right, low, high = self._limits
        width = self.around.width
        height = min((high - low) / (right - left) * (width - BESIDE), TALLEST)
        self.figure = new_figure(title, width, height + BELOW_HEIGHT + self.around.room)
        panel, below = self.figure.subplots(2, height_ratios=[height, BELOW_HEIGHT - 0.4])
        panel.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        panel.set_axis_off()
        self.shapes = panel.add_collection(PolyCollection(self.outlines[0], ec=INK, fc=PAIR_FILLS, lw=0.7))
        style: Properties = {
            "angles": "xy",
            "scale_units": "xy",
            "scale": 1,
            "width": 0.012,
            "zorder": 3,
            "visible": False,
        }
        self.arrows = panel.quiver(*np.zeros((4, 4)), color=[INK, INK, BLUE, BLUE], **style)
        self.marks = panel.scatter([], [], lw=0.6, zorder=4)
        self._label(panel)
        self.cursor = self._draw_curves(below) if self.is_pair else self._draw_map(below)

    def fix_layout(self) -> None:
        """Lay out the first frame, and keep the places for the others."""
        self.show(0)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def show(self, i: int) -> None:
        """Show frame `i`."""
        now = float(self.frames["periods"][i])
        caption = f"$t/T$ = {now:.2f}"
        self.shapes.set_verts(self.outlines[i])
        self._mark_contacts(i)
        if self.is_pair:
            self.arrows.set_visible(bool(self.contact.touching[i, 0]))
            self.arrows.set_offsets(np.tile(self.contact.middle[i], (4, 1)))
            self.arrows.set_UVC(*self.contact.forces[i, 0].T)
            caption += f"   {self._state_text(i)}"
        else:
            self.shapes.set_facecolor(DISPLACEMENT_COLOURS(self.norm(self.x[i])))
        self.caption.set_text(caption)
        self.cursor.set_xdata([now, now])

    def _state_text(self, i: int) -> str:
        """The contact of a pair in words; that of a row is in the legend of the marks."""
        if not self.contact.touching[i, 0]:
            return "apart"
        mode = MODE_STYLES[int(self.frames["mode"][i])][0]
        case = int(self.frames["case"][i])
        return mode if self.blocks.places is not None or case not in CASE_STYLES else f"{mode}, {CASE_STYLES[case][0]}"

    def _drawn(self, points: PlotArray) -> PlotArray:
        """Where points (..., 2) of the row are drawn; blade 0 of a ring is at the top, the others follow clockwise."""
        if not self.closed:
            return points
        radius = self.rests[-1] / (2 * np.pi)
        angle = points[..., 0] / radius
        distance = radius * np.exp(points[..., 1] / radius)
        return np.stack([distance * np.sin(angle), distance * np.cos(angle)], axis=-1)

    @property
    def _limits(self) -> tuple[float, float, float, float]:
        """The left, right, lower and upper end of what the blocks and the arrows reach in any frame, with a margin."""
        drawn = self.outlines.reshape(-1, 2)
        if self.is_pair:
            tips = self.contact.middle[:, :1] + self.contact.forces[:, 0]
            drawn = np.concatenate([drawn, tips[self.contact.touching[:, 0]].reshape(-1, 2)])
        left, low = drawn.min(axis=0)
        right, high = drawn.max(axis=0)
        margin = FRAME_MARGIN * (right - left)
        return left - margin, right + margin, low - margin, high + margin

    def _mark_contacts(self, i: int) -> None:
        """Mark the interfaces that touch, at their contact points; hollow where one of several points is apart."""
        touching = self.contact.touching[i]
        modes = self.contact.mode[i, touching].ravel()
        share = self.contact.N[i, touching].ravel() / (self.contact.largest or 1.0)
        self.marks.set_offsets(self._drawn(self.contact.points[i, touching].reshape(-1, 2)))
        self.marks.set_sizes(LEAST_MARK + (LARGEST_MARK - LEAST_MARK) * share)
        self.marks.set_facecolor([MODE_STYLES[mode][1] if mode in MODE_STYLES else "none" for mode in modes])
        self.marks.set_edgecolor(["white" if mode in MODE_STYLES else GREY for mode in modes])

    def _label(self, panel: Axes) -> None:
        """Write time and exaggeration; of a row the numbers of the blades, and what the marks mean, too."""
        style: Properties = {"xycoords": "axes fraction", "textcoords": "offset points"}
        around = self.around
        self.caption = panel.annotate("", (0, 1), around.first, va=around.va, **style)
        scale_text = around.scale_text.format(self.factor)
        panel.annotate(scale_text, (0, 1), around.second, va=around.va, color=DARK, **style)
        panel.annotate(around.axes, (0, 0), (0, 0), va="bottom", color=DARK, **style)
        blades = self.frames.sizes["blade"]
        if blades <= around.most_numbered:
            down = np.full(blades, -NUMBER_PLACE * self.blocks.l_ab)
            places = self._drawn(np.stack([self.rests[:blades], down], axis=-1))
            for blade, place in enumerate(places):
                panel.text(place[0], place[1], str(blade), ha="center", va="center", color=DARK, fontsize=7)
        dot: Properties = {"marker": "o", "ls": "", "ms": 5, "mec": "white", "mew": 0.6}
        present = legend_entries(MODE_STYLES, np.unique(self.contact.mode[self.contact.touching]))
        entries = [Line2D([], [], color=color, label=name, **dot) for name, color in present]
        if entries and not self.is_pair:
            heading: Properties = {"title": "area: $N$", "title_fontsize": 7}
            panel.legend(handles=entries, bbox_to_anchor=(1, 1), **heading, **around.legend, **TIGHT_LEGEND)

    def _draw_curves(self, panel: Axes) -> Line2D:
        """Draw the forces, or without contact the displacements, over the periods shown; the line of the present."""
        t = self.frames["periods"].to_numpy()
        if self.contact.largest:
            curves = {"$N$": (self.frames["N"], INK), "$F$": (self.frames["F"], BLUE)}
            label = "force [N]"
        else:
            x = PER_MILLI * self.frames["x"]
            curves = {"$x_1$": (x[:, 0], INK), "$x_2$": (x[:, 1], GREY)}
            label = "$x$ [mm]"
        for name, (values, color) in curves.items():
            panel.plot(t, values, color=color, lw=0.9, label=name)
        panel.set(xlabel=TIME_LABEL, ylabel=label, xlim=t[[0, -1]])
        panel.legend(loc="upper right", ncols=2)
        return panel.axvline(t[0], color=ORANGE, lw=1.2)

    def _draw_map(self, panel: Axes) -> Line2D:
        """Draw the displacements of all blades over the time shown; the line of the present."""
        t = self.frames["periods"].to_numpy()
        edges = np.arange(self.frames.sizes["blade"] + 1) - 0.5
        times = np.append(t, 2 * t[-1] - t[-2])
        panel.pcolormesh(times, edges, self.x.T, norm=self.norm, cmap=DISPLACEMENT_COLOURS)
        panel.set(xlabel=TIME_LABEL, ylabel="blade")
        panel.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
        colours = ScalarMappable(self.norm, DISPLACEMENT_COLOURS)
        self.figure.colorbar(colours, ax=panel, label="$x$ [μm]", pad=0.01)
        return panel.axvline(t[0], color=INK, lw=1.2)


def _finer(corners: PlotArray) -> PlotArray:
    """Points along the edges of polygons (..., n, 2)."""
    part = np.arange(POINTS_ON_EDGE)[:, None] / POINTS_ON_EDGE
    edges = np.roll(corners, -1, axis=-2) - corners
    return (corners[..., None, :] + part * edges[..., None, :]).reshape(*corners.shape[:-2], -1, 2)
