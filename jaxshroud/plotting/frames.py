"""The frames of moving pictures: samples, the shape of blocks, where they touch, and the factor of exaggeration."""

import math
import tomllib
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxshroud.model.modes import Mode
from jaxshroud.plotting.run_data import RunData, places_of_points
from jaxshroud.plotting.style import BoolArray, PlotArray
from jaxshroud.scene.checks import InputError

FRAMES_PER_PERIOD = 60
SWING = 0.15  # the largest motion, relative to the face
NICE_FACTORS = (1, 2, 5)
ARROW = 0.8  # of the largest force, relative to the face


class Blocks(NamedTuple):
    """The shape of the blocks, with lengths in m."""

    l_oa: float
    l_ab: float
    alpha: float
    gaps: PlotArray  # (interfaces,)
    places: PlotArray | None = None  # of several points of contact, up the face from its middle

    @property
    def outline(self) -> PlotArray:
        """The corners relative to the centre (4, 2): a, b and their opposites."""
        lean, h = self.l_ab * math.cos(self.alpha) / 2, self.l_ab * math.sin(self.alpha) / 2
        a, b = np.array([self.l_oa / 2 + lean, h]), np.array([self.l_oa / 2 - lean, -h])
        return np.array([a, b, -a, -b])

    def rests(self, factor: float) -> PlotArray:
        """The x of the centres without motion, with exaggerated gaps; of a ring its circumference comes last."""
        return np.arange(len(self.gaps) + 1) * self.l_oa + factor * np.append(0.0, np.cumsum(self.gaps))

    def corners(self, frames: xr.Dataset, factor: float) -> PlotArray:
        """The corners (n, blades, 4, 2) of all blocks in all frames."""
        x, y, theta = (factor * frames[name].to_numpy() for name in ("x", "y", "theta"))
        s = np.sin(theta)
        c = np.cos(theta)
        turns = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        centres = np.stack([x + self.rests(factor)[: x.shape[1]], y], axis=-1)
        return self.outline @ turns + centres[:, :, None]

    def points_on_faces(self, corners: PlotArray, contact_point: PlotArray) -> PlotArray:
        """The places (..., 2) on the faces, which touch the next ones, of blocks with these corners (..., 4, 2)."""
        a, b = corners[..., 0, :], corners[..., 1, :]
        return (a + b) / 2 + contact_point[..., None] * _up_the_faces(corners)


def _up_the_faces(corners: PlotArray) -> PlotArray:
    """The unit vectors (..., 2) up the faces of blocks that touch the next ones."""
    up = corners[..., 0, :] - corners[..., 1, :]
    return up / np.linalg.norm(up, axis=-1, keepdims=True)


class ContactFrames:
    """The contact of each frame: where faces touch, at one point of contact or at several, and the forces there.

    Smooth contact has one mode, and touches where it penetrates.
    """

    touching: BoolArray  # (n, interfaces)
    mode: PlotArray  # (n, interfaces, points)
    N: PlotArray
    points: PlotArray  # (n, interfaces, points, 2)
    middle: PlotArray  # (n, interfaces, 2), where the sum of the forces acts
    forces: PlotArray  # (n, interfaces, 4, 2) as arrows: the normal ones on both blocks, and those of friction
    largest: float  # of the normal forces of interfaces [N]

    def __init__(self, frames: xr.Dataset, blocks: Blocks, corners: PlotArray):
        size = (frames.sizes["time"], len(blocks.gaps))

        def at_interfaces(name: str) -> PlotArray:
            return np.reshape(frames[name].to_numpy(), size) if name in frames else np.zeros(size)

        mode, v, N, F, place = map(at_interfaces, ("mode", "v", "N", "F", "contact_point"))
        left = corners[:, : size[1]]
        self.touching = (mode != Mode.APART) & ((mode != Mode.SMOOTH) | (v > 0))
        self.middle = blocks.points_on_faces(left, np.nan_to_num(place))
        if blocks.places is None:
            self.mode, self.N, self.points = (a[:, :, None] for a in (mode, N, self.middle))
        else:
            self.mode, self.N = (np.reshape(frames[name].to_numpy(), (*size, -1)) for name in ("point_mode", "point_N"))
            self.points = blocks.points_on_faces(left[:, :, None], np.broadcast_to(blocks.places, self.N.shape))
        self.largest = float(np.nanmax(np.abs(N), initial=0.0))
        scale = ARROW * blocks.l_ab / (self.largest or 1.0)
        up = _up_the_faces(left)
        normal = scale * N[..., None] * np.stack([up[..., 1], -up[..., 0]], axis=-1)
        friction = scale * F[..., None] * up
        self.forces = np.stack([-normal, normal, -friction, friction], axis=-2)


def last_frames(run: RunData, periods: int | None) -> xr.Dataset:
    """The samples nearest to the frames of the last periods."""
    shown = min(periods or run.repeats or 4, run.t[-1] - run.t[0])
    times = np.linspace(run.t[-1] - shown, run.t[-1], max(round(shown * FRAMES_PER_PERIOD), 2), endpoint=False)
    samples = np.clip(np.searchsorted(run.t, times), 0, len(run.t) - 1)
    return run.ds.isel(time=samples).assign(periods=("time", run.t[samples]))


def stored_blocks(ds: xr.Dataset) -> Blocks:
    """The shape of the blocks of a stored run.

    Raises:
        InputError: The run does not have it.
    """
    shroud = tomllib.loads(str(ds.attrs.get("scene", ""))).get("shroud", {})
    if not {"l_oa", "l_ab", "alpha"} <= set(shroud):
        raise InputError("This run does not hold the shape of its blocks; simulate it again.")
    gap = ds.attrs["gap"] if "gap" in ds.attrs else shroud["gap"]
    gaps = np.broadcast_to(np.asarray(gap, float), ds.sizes.get("interface", 1))
    return Blocks(shroud["l_oa"], shroud["l_ab"], shroud["alpha"], gaps, places_of_points(ds))


def fitting_factor(frames: xr.Dataset, blocks: Blocks) -> float:
    """The largest round factor with which the largest motion of a corner stays within `SWING`."""
    reach = math.hypot(blocks.l_oa, blocks.l_ab) / 2
    motion = max(float(np.abs(frames[name]).max()) * arm for name, arm in (("x", 1), ("y", 1), ("theta", reach)))
    limit = SWING * blocks.l_ab / motion if motion > 0 else 1.0
    power = 10.0 ** math.floor(math.log10(limit))
    return max(n * power for n in NICE_FACTORS if n * power <= limit)
