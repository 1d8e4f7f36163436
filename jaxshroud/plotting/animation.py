"""Animations of both blocks, to scale except for their motion and the gap, which are exaggerated by one factor."""

import math
import os
import shutil
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

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
from jaxshroud.plotting.plot_run import CASE_STYLES, MODE_STYLES, PER_MILLI, TIME_LABEL
from jaxshroud.plotting.run_data import FEWEST_SAMPLES, RunData, run_data
from jaxshroud.plotting.scales import title_of
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    DARK,
    GREY,
    INK,
    ORANGE,
    STYLE,
    PlotArray,
    Properties,
    new_figure,
)
from jaxshroud.scene.checks import InputError

FRAMES_PER_PERIOD = 60  # of a period
PER_SECOND, DPI = 20, 150
SWING, ARROW = 0.15, 0.8  # lengths relative to the face: the largest motion, and the arrow of the largest force
FRAME_MARGIN = 0.02  # around what is shown, relative to its width
CURVES_HEIGHT = 1.3  # of the curves below the blocks, with all labels [inch]
BLOCK_FILLS = "#c9dfee", "#e3e3e3"  # of the left and the right block
NICE_FACTORS = (1, 2, 5)
Writers = {".gif": PillowWriter, ".mp4": FFMpegWriter}


class Blocks(NamedTuple):
    """The shape of the blocks, with lengths in m."""

    l_oa: float
    l_ab: float
    alpha: float
    gap: float

    @property
    def outline(self) -> PlotArray:
        """The corners relative to the centre (4, 2): a, b and their opposites."""
        lean, h = self.l_ab * math.cos(self.alpha) / 2, self.l_ab * math.sin(self.alpha) / 2
        a, b = np.array([self.l_oa / 2 + lean, h]), np.array([self.l_oa / 2 - lean, -h])
        return np.array([a, b, -a, -b])


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
    run = run_data(ds)
    if run is None or run.rate < FEWEST_SAMPLES:
        raise InputError(
            f"Fewer than {FEWEST_SAMPLES} samples of a period are stored, too few to show the motion; keep more."
        )
    frames, blocks = _last_frames(run, periods), _block_shape(ds)
    factor = factor or _fitting_factor(frames, blocks)
    with mpl.rc_context(STYLE), tempfile.TemporaryDirectory() as folder:
        film = _Film(frames, blocks, factor, title_of(ds) if title is None else title)
        film.fix_layout()
        writer, temporary = Writers[path.suffix](fps=PER_SECOND), Path(folder, path.name)
        with writer.saving(film.figure, str(temporary), DPI):
            for i in range(frames.sizes["time"]):
                film.show(i)
                writer.grab_frame()
                if progress is not None:
                    progress(i + 1, frames.sizes["time"])
        write(path, temporary.read_bytes())
    return factor


def _last_frames(run: RunData, periods: int | None) -> xr.Dataset:
    """The samples nearest to the frames of the last periods."""
    shown = min(periods or run.repeats or 4, run.t[-1] - run.t[0])
    times = np.linspace(run.t[-1] - shown, run.t[-1], max(round(shown * FRAMES_PER_PERIOD), 2), endpoint=False)
    samples = np.clip(np.searchsorted(run.t, times), 0, len(run.t) - 1)
    return run.ds.isel(time=samples).assign(periods=("time", run.t[samples]))


def _block_shape(ds: xr.Dataset) -> Blocks:
    shroud = tomllib.loads(str(ds.attrs.get("scene", ""))).get("shroud", {})
    if not {"l_oa", "l_ab", "alpha"} <= set(shroud):
        raise InputError("This run does not tell the shape of its blocks; simulate it again.")
    return Blocks(shroud["l_oa"], shroud["l_ab"], shroud["alpha"], float(ds.attrs["gap"]))


def _fitting_factor(frames: xr.Dataset, blocks: Blocks) -> float:
    """The largest round factor with which the largest motion of a corner stays within `SWING`."""
    reach = math.hypot(blocks.l_oa, blocks.l_ab) / 2
    motion = max(float(np.abs(frames[name]).max()) * arm for name, arm in (("x", 1), ("y", 1), ("theta", reach)))
    limit = SWING * blocks.l_ab / motion if motion > 0 else 1.0
    power = 10.0 ** math.floor(math.log10(limit))
    return max(n * power for n in NICE_FACTORS if n * power <= limit)


class _Film:
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

    def fix_layout(self) -> None:
        """Lay out the first frame, and keep the places for the others."""
        self.show(0)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def show(self, i: int) -> None:
        """Show frame `i`."""
        frame = self.frames.isel(time=i)
        for blade, shape in enumerate(self.shapes):
            shape.set_xy(self._corners(frame, blade))
        touching = self._touches(frame)
        self._draw_forces(frame, touching)
        mode = MODE_STYLES[Mode(int(frame["mode"]))][0] if touching else "apart"
        case = f", {CASE_STYLES[int(frame['case'])][0]}" if touching and int(frame["case"]) in CASE_STYLES else ""
        self.caption.set_text(f"$t/T$ = {float(frame['periods']):.2f}   {mode}{case}")
        self.cursor.set_xdata([float(frame["periods"])] * 2)

    def _touches(self, frame: xr.Dataset) -> bool:
        return int(frame["mode"]) != Mode.APART and self._largest_force > 0

    def _corners(self, frame: xr.Dataset, blade: int) -> PlotArray:
        """The corners of a block in a frame."""
        angle = self.factor * float(frame["theta"][blade])
        s, c = math.sin(angle), math.cos(angle)
        shift = self.factor * np.array([float(frame["x"][blade]), float(frame["y"][blade])])
        rest = [blade * (self.blocks.l_oa + self.factor * self.blocks.gap), 0.0]
        return self.blocks.outline @ np.array([[c, -s], [s, c]]) + shift + rest

    def _forces(self, frame: xr.Dataset) -> tuple[PlotArray, PlotArray]:
        """The contact point on the left block's face, and the arrows (4, 2) of the forces on both blocks there."""
        place = float(frame["contact_point"]) if "contact_point" in frame else 0.0
        a, b = self._corners(frame, 0)[:2]
        tangent = (a - b) / np.linalg.norm(a - b)
        normal = np.array([tangent[1], -tangent[0]])
        scale = ARROW * self.blocks.l_ab / self._largest_force
        N, F = (scale * float(frame[name]) for name in ("N", "F"))
        return (a + b) / 2 + place * tangent, np.array([-N * normal, N * normal, -F * tangent, F * tangent])

    def _draw_forces(self, frame: xr.Dataset, touching: bool) -> None:
        """Draw the forces on both blocks where they touch."""
        self.arrows.set_visible(touching)
        self.point.set_visible(touching)
        if not touching:
            return
        point, forces = self._forces(frame)
        self.arrows.set_offsets(np.tile(point, (4, 1)))
        self.arrows.set_UVC(*forces.T)
        self.point.set_data(*[[v] for v in point])
        self.point.set_color(MODE_STYLES[Mode(int(frame["mode"]))][1])
