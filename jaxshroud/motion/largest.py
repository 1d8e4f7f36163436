"""The largest Lyapunov exponent of many lanes, from one tangent of each."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.runs import Tick
from jaxshroud.batch.states import STATE, from_vector, to_vector
from jaxshroud.batch.tangents import Dual, differentiable, onward, run_flow
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.interval import interval
from jaxshroud.motion.lyapunov import units
from jaxshroud.scene.scene import Scene

TURNING = 32  # periods in which a tangent turns into the direction that grows most
BLOCK = 4  # periods between two looks at its length


class Largest(NamedTuple):
    """Of each lane, per drive period."""

    exponent: np.ndarray  # (lanes,); -inf where the motion forgets every push; NaN once a lane has stopped
    ci: np.ndarray  # (lanes,) half width of the 95 % interval
    growth: np.ndarray  # (lanes, blocks) of each block of periods, per period
    status: np.ndarray  # (lanes,)
    last: State


def shifted(scenes: Scene, phase: float) -> Scene:
    """Scenes whose drive has at t = 0 the phase that it now has at `phase` [rad]."""
    return eqx.tree_at(lambda s: s.drive.phase, scenes, scenes.drive.phase + phase) if phase else scenes


def largest_exponents(
    scenes: Scene,
    states: State,
    n: int,
    steps: int,
    method: Choices,
    ticker: Tick = lambda _: None,
    numbers: np.ndarray | None = None,
) -> Largest:
    """The largest exponent of settled motions from their states at drive phase 0.

    It is that of `n` periods, a multiple of 4, after the first 32, in which tangents turn into their direction. A
    tangent begins in a random direction without a share of the slider: one in permanent stick stays wherever it starts,
    an exponent of 0 that says nothing of the motion. Each lane has a direction of its own, by the `numbers` of lanes
    (lanes,) where these are not all.
    """
    lanes, unit = len(scenes.drive.omega), units(scenes)
    numbers = np.arange(lanes) if numbers is None else numbers
    along = np.random.default_rng(0).standard_normal((numbers.max() + 1, STATE))[numbers] * unit
    along[:, -1] = 0.0
    still, method = jax.tree.map(np.zeros_like, scenes), differentiable(method)
    turning, blocks = TURNING // BLOCK, max(round(n / BLOCK), 1)
    growth, status = np.empty((lanes, turning + blocks)), np.full(lanes, Status.OK, np.int32)
    for i in range(turning + blocks):
        with np.errstate(divide="ignore", invalid="ignore"):
            along = along / np.linalg.norm(along / unit, axis=1, keepdims=True)
        along = np.where(np.isfinite(along), along, 0.0).astype(scenes.drive.omega.dtype)
        came = run_flow(Dual(scenes, still), Dual(states, from_vector(along, None, None)), BLOCK, steps, method)
        status = np.where(status == Status.OK, came.value.status, status)
        states, along = onward(came).value, to_vector(came.tangent.state)
        with np.errstate(divide="ignore", invalid="ignore"):
            grown = np.log(np.linalg.norm(along / unit, axis=1)) / BLOCK
        growth[:, i] = np.where(status == Status.OK, grown, np.nan)
        ticker(lanes * BLOCK)
    growth = growth[:, turning:]
    with np.errstate(invalid="ignore"):
        return Largest(growth.mean(axis=1), interval(growth), growth, status, states)
