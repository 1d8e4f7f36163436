"""Both blocks in motion, to scale but for their motion and the gap, which are exaggerated alike."""

import math
import os
import shutil
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from jaxshroud.model.modes import Mode
from jaxshroud.results.drawing import BLUE, COLUMN, GREY, INK, STYLE, Floats, new_figure
from jaxshroud.results.drawn import FEWEST, Drawn, drawn
from jaxshroud.results.files import write
from jaxshroud.results.panels import title_of
from jaxshroud.results.plot_contact import CASES, MODES
from jaxshroud.scene.errors import InputError

FRAMES = 60  # of a period
PER_SECOND, DPI = 20, 150
SWING, ARROW = 0.15, 0.5  # of the contact side: the largest motion shown, and the arrow of the largest force
NICE = (1, 2, 5)
Writers = {".gif": PillowWriter, ".mp4": FFMpegWriter}


class Blocks(NamedTuple):
    """Shape of the blocks, lengths in m."""

    l_oa: float
    l_ab: float
    alpha: float
    gap: float

    @property
    def outline(self) -> Floats:
        """Corners about the centre (4, 2): a, b and their opposites."""
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
    """Write the last periods of a run as a moving picture.

    Args:
        ds: A stored run of a single scene.
        path: A name that ends in .gif or .mp4; for the latter ffmpeg must be there.
        periods: Drive periods shown; by default those after which the motion repeats, or four.
        factor: By which motion and gap are exaggerated; by default so that the motion is well seen.
        title: In place of the run's own.
        progress: Called with (frames done, frames in all).

    Returns:
        The factor.

    Raises:
        ValueError: The suffix is another, ffmpeg is missing, or too little is stored.
        WriteError: The place cannot be written.
    """
    path = Path(path)
    if path.suffix not in Writers:
        raise InputError(f"{path}: a moving picture needs a name that ends in .gif or .mp4.")
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"{path}: mp4 needs ffmpeg, which is not installed; give a name that ends in .gif.")
    run = drawn(ds)
    if run is None or run.rate < FEWEST:
        raise InputError(f"Fewer than {FEWEST} samples of a period are stored, too few to show the motion; keep more.")
    frames, blocks = _chosen(run, periods), _blocks(ds)
    factor = factor or _fitting_factor(frames, blocks)
    with mpl.rc_context(STYLE), tempfile.TemporaryDirectory() as folder:
        film, part = _Film(frames, blocks, factor, title_of(ds) if title is None else title), Path(folder, path.name)
        writer = Writers[path.suffix](fps=PER_SECOND)
        with writer.saving(film.figure, str(part), DPI):
            for i in range(frames.sizes["time"]):
                film.show(i)
                writer.grab_frame()
                if progress is not None:
                    progress(i + 1, frames.sizes["time"])
        write(path, part.read_bytes())
    return factor


def _chosen(run: Drawn, periods: int | None) -> xr.Dataset:
    """The samples nearest to the frames of the last periods."""
    n = min(periods or run.repeats or 4, run.t[-1] - run.t[0])
    times = np.linspace(run.t[-1] - n, run.t[-1], max(round(n * FRAMES), 2), endpoint=False)
    at = np.clip(np.searchsorted(run.t, times), 0, len(run.t) - 1)
    return run.ds.isel(time=at).assign(periods=("time", run.t[at]))


def _blocks(ds: xr.Dataset) -> Blocks:
    shroud = tomllib.loads(str(ds.attrs.get("scene", ""))).get("shroud", {})
    if not {"l_oa", "l_ab", "alpha"} <= set(shroud):
        raise InputError("This run does not tell the shape of its blocks; simulate it again.")
    return Blocks(shroud["l_oa"], shroud["l_ab"], shroud["alpha"], float(ds.attrs["gap"]))


def _fitting_factor(frames: xr.Dataset, blocks: Blocks) -> float:
    """The largest nice number by which the largest motion of a corner stays within `SWING`."""
    reach = math.hypot(blocks.l_oa, blocks.l_ab) / 2
    moved = max(float(np.abs(frames[name]).max()) * arm for name, arm in (("x", 1), ("y", 1), ("theta", reach)))
    most = SWING * blocks.l_ab / moved if moved > 0 else 1.0
    power = 10.0 ** math.floor(math.log10(most))
    return max(n * power for n in NICE if n * power <= most)


class _Film:
    """A figure that shows one frame after the other."""

    def __init__(self, frames: xr.Dataset, blocks: Blocks, factor: float, title: str):
        self.frames, self.blocks, self.factor = frames, blocks, factor
        self.figure: Figure = new_figure(title, COLUMN, 2.2)
        panel = self.figure.subplots()
        self.shapes = [Polygon(blocks.outline, fc="#e8e8e8", ec=INK, lw=0.8) for _ in (0, 1)]
        for shape in self.shapes:
            panel.add_patch(shape)
        (self.point,) = panel.plot([], [], "o", ms=4, mew=0, zorder=4)
        style: Any = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.006, "zorder": 3}
        self.arrows = panel.quiver(*np.zeros((4, 4)), color=[INK, INK, BLUE, BLUE], **style)
        self.words = panel.text(0.5, 0.03, "", ha="center", transform=panel.transAxes)
        panel.text(0.02, 0.95, f"motion and gap × {factor:g}", va="top", color=GREY, transform=panel.transAxes)
        panel.text(0.98, 0.95, self._largest, va="top", ha="right", color=GREY, transform=panel.transAxes)
        edge, h = 1.25 * blocks.l_oa, blocks.l_ab * 0.95
        panel.set(xlim=(-0.8 * edge, 0.8 * edge + blocks.l_oa), ylim=(-h, h), aspect="equal")
        panel.set_axis_off()

    @property
    def _most(self) -> float:
        return float(np.nanmax(np.abs(self.frames["N"]), initial=0.0)) if "N" in self.frames else 0.0

    @property
    def _largest(self) -> str:
        return f"$N$ black, $F$ blue; $N$ up to {self._most:.3g} N" if self._most else ""

    def show(self, i: int) -> None:
        """The frame of that number."""
        now = self.frames.isel(time=i)
        for blade, shape in enumerate(self.shapes):
            shape.set_xy(self._placed(now, blade))
        touching = int(now["mode"]) != Mode.APART and self._most > 0
        self._draw_forces(now, touching)
        mode = MODES[Mode(int(now["mode"]))][0] if touching else "apart"
        case = f", {CASES[int(now['case'])][0]}" if touching and int(now["case"]) in CASES else ""
        self.words.set_text(f"$t/T$ = {float(now['periods']):.2f}   {mode}{case}")

    def _placed(self, now: xr.Dataset, blade: int) -> Floats:
        """Corners of a block."""
        angle = self.factor * float(now["theta"][blade])
        s, c = math.sin(angle), math.cos(angle)
        shift = self.factor * np.array([float(now["x"][blade]), float(now["y"][blade])])
        rest = [blade * (self.blocks.l_oa + self.factor * self.blocks.gap), 0.0]
        return self.blocks.outline @ np.array([[c, -s], [s, c]]) + shift + rest

    def _draw_forces(self, now: xr.Dataset, touching: bool) -> None:
        """Forces on the left block and back on the right one, at the contact point on the left block's face."""
        place = float(now["contact_point"]) if touching and "contact_point" in now else 0.0
        a, b = self._placed(now, 0)[:2]
        up = (a - b) / np.linalg.norm(a - b)
        out = np.array([up[1], -up[0]])
        at = (a + b) / 2 + place * up
        scale = ARROW * self.blocks.l_ab / (self._most or 1.0) * touching
        N, F = (scale * float(now[name]) if touching else 0.0 for name in ("N", "F"))
        forces = np.array([-N * out, N * out, -F * up, F * up])
        self.arrows.set_visible(touching)
        self.arrows.set_offsets(np.tile(at, (4, 1)))
        self.arrows.set_UVC(*forces.T)
        self.point.set_data(*([[v] for v in at] if touching else ([], [])))
        self.point.set_color(MODES[Mode(int(now["mode"]))][1] if touching else GREY)
