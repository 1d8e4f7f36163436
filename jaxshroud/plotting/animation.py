"""Animations of blocks, to scale except for their motion and the gaps, which are exaggerated by one factor."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from jaxshroud.io.files import write
from jaxshroud.model.modes import Mode
from jaxshroud.plotting.frames import FRAME_MARGIN, Animation, Blocks, fitting_factor, last_frames, stored_blocks
from jaxshroud.plotting.page import scale_of, title_of
from jaxshroud.plotting.plot_run import CASE_STYLES, MODE_STYLES, TIME_LABEL
from jaxshroud.plotting.row_animation import RowAnimation
from jaxshroud.plotting.run_data import FEWEST_SAMPLES, run_data
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DARK,
    GREY,
    INK,
    ORANGE,
    PER_MILLI,
    STYLE,
    PlotArray,
    Properties,
    as_is,
    new_figure,
)
from jaxshroud.scene.checks import InputError

PER_SECOND, DPI = 20, 150
POINT_AREA = 30.0  # of the mark of one of several points of contact [points^2]
ARROW = 0.8  # of the largest force, relative to the face
CURVES_HEIGHT = 1.3  # of the curves below the blocks, with all labels [inch]
BLOCK_FILLS = "#c9dfee", "#e3e3e3"  # of the left and the right block
MILLIMETRES = scale_of(np.zeros(()))  # of rows, whose gaps may differ
Writers = {".gif": PillowWriter, ".mp4": FFMpegWriter}


def save_animation(
    ds: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    periods: int | None = None,
    factor: float | None = None,
    title: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Write the last periods of a run as an animation.

    Args:
        ds: A stored run of a single scene.
        path: A name that ends in .gif, or in .mp4 where ffmpeg is installed.
        periods: Drive periods shown; by default those after which the motion repeats, or four.
        factor: The factor by which motion and gap are exaggerated; by default so that the motion is well visible.
        title: A title in place of that of the run.
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
    run = run_data(ds, scale=None if "gap" in ds.attrs else MILLIMETRES)
    if run is None or run.rate < FEWEST_SAMPLES:
        raise InputError(
            f"Fewer than {FEWEST_SAMPLES} samples of a period are stored, too few to show the motion; keep more."
        )
    frames = last_frames(run, periods)
    blocks = stored_blocks(ds)
    factor = factor or fitting_factor(frames, blocks)
    new_animation = RowAnimation if "interface" in ds.dims else PairAnimation
    with mpl.rc_context(STYLE), tempfile.TemporaryDirectory() as folder:
        animation = new_animation(frames, blocks, factor, title_of(ds) if title is None else as_is(title))
        animation.fix_layout()
        writer = Writers[path.suffix](fps=PER_SECOND)
        temporary = Path(folder, path.name)
        with writer.saving(animation.figure, str(temporary), DPI):
            for i in range(frames.sizes["time"]):
                animation.show(i)
                writer.grab_frame()
                if progress is not None:
                    progress(i + 1, frames.sizes["time"])
        write(path, temporary.read_bytes())
    return factor


class PairAnimation(Animation):
    """A figure that shows one frame after the other: the blocks, and below them the forces or displacements so far."""

    def __init__(self, frames: xr.Dataset, blocks: Blocks, factor: float, title: str):
        self.frames, self.blocks, self.factor = frames, blocks, factor
        left, right, low, high = self._limits
        height = (high - low) / (right - left) * COLUMN_WIDTH
        self.figure: Figure = new_figure(title, COLUMN_WIDTH, height + CURVES_HEIGHT)
        panel, curves = self.figure.subplots(2, height_ratios=[height, CURVES_HEIGHT - 0.4])
        self.shapes = [Polygon(blocks.outline, fc=fill, ec=INK, lw=0.8) for fill in BLOCK_FILLS]
        for shape in self.shapes:
            panel.add_patch(shape)
        (self.point,) = panel.plot([], [], "o", ms=6, mec="white", mew=0.5, zorder=4)
        self.points = panel.scatter([], [], s=POINT_AREA, ec="white", lw=0.5, zorder=5)  # of faces with several
        style: Properties = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.012, "zorder": 3}
        self.arrows = panel.quiver(*np.zeros((4, 4)), color=[INK, INK, BLUE, BLUE], **style)
        above: Properties = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
        panel.annotate(f"motion and gap × {factor:g}", (0, 1), (0, 2), color=DARK, **above)
        self.caption = panel.annotate("", (0, 1), (0, 14), **above)
        panel.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        panel.set_axis_off()
        self.cursor = self._draw_curves(curves)

    @property
    def _largest_force(self) -> float:
        return float(np.nanmax(np.abs(self.frames["N"]), initial=0.0)) if "N" in self.frames else 0.0

    @property
    def _limits(self) -> tuple[float, float, float, float]:
        """The left, right, lower and upper end of what the blocks and the arrows reach in any frame, with a margin."""
        points = []
        for i in range(self.frames.sizes["time"]):
            frame = self.frames.isel(time=i)
            points += [self._corners(frame, blade) for blade in (0, 1)]
            if self._touches(frame):
                place, forces = self._forces(frame)
                points.append(place + forces)
        (left, low), (right, high) = (end(np.concatenate(points), axis=0) for end in (np.min, np.max))
        margin = FRAME_MARGIN * (right - left)
        return left - margin, right + margin, low - margin, high + margin

    def _draw_curves(self, panel: Axes) -> Line2D:
        """Draw the forces, or without contact the displacements, over the periods shown; the line of the present."""
        t = self.frames["periods"].to_numpy()
        if self._largest_force:
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

    def show(self, i: int) -> None:
        """Show frame `i`."""
        frame = self.frames.isel(time=i)
        for blade, shape in enumerate(self.shapes):
            shape.set_xy(self._corners(frame, blade))
        touching = self._touches(frame)
        self._draw_forces(frame, touching)
        mode = MODE_STYLES[Mode(int(frame["mode"]))][0] if touching else "apart"
        has_case = touching and self.blocks.places is None and int(frame["case"]) in CASE_STYLES
        case = f", {CASE_STYLES[int(frame['case'])][0]}" if has_case else ""
        self.caption.set_text(f"$t/T$ = {float(frame['periods']):.2f}   {mode}{case}")
        self.cursor.set_xdata([float(frame["periods"])] * 2)

    def _touches(self, frame: xr.Dataset) -> bool:
        return int(frame["mode"]) != Mode.APART and self._largest_force > 0

    def _corners(self, frame: xr.Dataset, blade: int) -> PlotArray:
        """The corners of a block in a frame."""
        rest = np.array([blade * (self.blocks.l_oa + self.factor * self.blocks.gap), 0.0])
        return self.blocks.corners(frame, self.factor, rest, blade)

    def _forces(self, frame: xr.Dataset) -> tuple[PlotArray, PlotArray]:
        """The contact point on the left block's face, and the arrows (4, 2) of the forces on both blocks there."""
        place = float(frame["contact_point"]) if "contact_point" in frame else 0.0
        corners = self._corners(frame, 0)
        tangent = (corners[0] - corners[1]) / np.linalg.norm(corners[0] - corners[1])
        normal = np.array([tangent[1], -tangent[0]])
        scale = ARROW * self.blocks.l_ab / self._largest_force
        N, F = (scale * float(frame[name]) for name in ("N", "F"))
        return self.blocks.point_on_face(corners, place), np.array([-N * normal, N * normal, -F * tangent, F * tangent])

    def _draw_forces(self, frame: xr.Dataset, touching: bool) -> None:
        """Draw the forces on both blocks where they touch."""
        self.arrows.set_visible(touching)
        self.point.set_visible(touching and self.blocks.places is None)
        self.points.set_visible(touching and self.blocks.places is not None)
        if not touching:
            return
        point, forces = self._forces(frame)
        self.arrows.set_offsets(np.tile(point, (4, 1)))
        self.arrows.set_UVC(*forces.T)
        self.point.set_data(*[[v] for v in point])
        self.point.set_color(MODE_STYLES[Mode(int(frame["mode"]))][1])
        if self.blocks.places is not None:
            corners = self._corners(frame, 0)
            modes = frame["point_mode"].to_numpy()
            self.points.set_offsets([self.blocks.point_on_face(corners, place) for place in self.blocks.places])
            self.points.set_facecolor([MODE_STYLES[mode][1] if mode in MODE_STYLES else "none" for mode in modes])
            self.points.set_edgecolor(["white" if mode in MODE_STYLES else GREY for mode in modes])
