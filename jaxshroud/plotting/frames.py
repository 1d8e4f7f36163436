"""What moving pictures of pairs and of rows share: frames, the shape of blocks, and the factor of exaggeration."""

import abc
import math
import tomllib
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jaxshroud.plotting.run_data import RunData, places_of_points
from jaxshroud.plotting.style import PlotArray
from jaxshroud.scene.checks import InputError

FRAMES_PER_PERIOD = 60
SWING = 0.15  # the largest motion, relative to the face
FRAME_MARGIN = 0.02  # around what is shown, relative to its width
NICE_FACTORS = (1, 2, 5)


class Blocks(NamedTuple):
    """The shape of the blocks, with lengths in m."""

    l_oa: float
    l_ab: float
    alpha: float
    gap: Any  # one number, or one for each interface
    places: PlotArray | None = None  # of several points of contact, up the face from its middle

    @property
    def outline(self) -> PlotArray:
        """The corners relative to the centre (4, 2): a, b and their opposites."""
        lean, h = self.l_ab * math.cos(self.alpha) / 2, self.l_ab * math.sin(self.alpha) / 2
        a, b = np.array([self.l_oa / 2 + lean, h]), np.array([self.l_oa / 2 - lean, -h])
        return np.array([a, b, -a, -b])

    def corners(self, frame: xr.Dataset, factor: float, rest: PlotArray, blade: int) -> PlotArray:
        """The corners (4, 2) of a blade's block in a frame, whose centre is at `rest` without motion."""
        x, y, theta = (factor * float(frame[name][blade]) for name in ("x", "y", "theta"))
        s = math.sin(theta)
        c = math.cos(theta)
        return self.outline @ np.array([[c, -s], [s, c]]) + np.array([x, y]) + rest

    def point_on_face(self, corners: PlotArray, contact_point: float) -> PlotArray:
        """The place (2,) on the face of a block with these corners that touches the next one."""
        a, b = corners[:2]
        return (a + b) / 2 + contact_point * (a - b) / np.linalg.norm(a - b)


class Animation(abc.ABC):
    """A figure that shows one frame after the other."""

    figure: Figure
    frames: xr.Dataset

    @abc.abstractmethod
    def show(self, i: int) -> None:
        """Show frame `i`."""

    def fix_layout(self) -> None:
        """Lay out the first frame, and keep the places for the others."""
        self.show(0)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")


def last_frames(run: RunData, periods: int | None) -> xr.Dataset:
    """The samples nearest to the frames of the last periods."""
    shown = min(periods or run.repeats or 4, run.t[-1] - run.t[0])
    times = np.linspace(run.t[-1] - shown, run.t[-1], max(round(shown * FRAMES_PER_PERIOD), 2), endpoint=False)
    samples = np.clip(np.searchsorted(run.t, times), 0, len(run.t) - 1)
    return run.ds.isel(time=samples).assign(periods=("time", run.t[samples]))


def stored_blocks(ds: xr.Dataset) -> Blocks:
    """The shape of the blocks of a stored run.

    Raises:
        InputError: The run does not tell it.
    """
    shroud = tomllib.loads(str(ds.attrs.get("scene", ""))).get("shroud", {})
    if not {"l_oa", "l_ab", "alpha"} <= set(shroud):
        raise InputError("This run does not tell the shape of its blocks; simulate it again.")
    gap = ds.attrs["gap"] if "gap" in ds.attrs else shroud["gap"]
    return Blocks(shroud["l_oa"], shroud["l_ab"], shroud["alpha"], np.asarray(gap, float), places_of_points(ds))


def fitting_factor(frames: xr.Dataset, blocks: Blocks) -> float:
    """The largest round factor with which the largest motion of a corner stays within `SWING`."""
    reach = math.hypot(blocks.l_oa, blocks.l_ab) / 2
    motion = max(float(np.abs(frames[name]).max()) * arm for name, arm in (("x", 1), ("y", 1), ("theta", reach)))
    limit = SWING * blocks.l_ab / motion if motion > 0 else 1.0
    power = 10.0 ** math.floor(math.log10(limit))
    return max(n * power for n in NICE_FACTORS if n * power <= limit)
