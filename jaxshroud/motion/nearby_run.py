"""How fast a nearby run parts from a run: the largest Lyapunov exponent by differences, where there are no tangents.

As in G. Benettin et al. (1980), with two runs in place of a tangent: after every drive period their logarithmic growth
is noted, and the second run begins anew near the first one. Sliders count as the motion does.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.model.prepared import State
from jaxshroud.motion.statistics import confidence_interval
from jaxshroud.scene.keys import Motion

NEARBY = 1e-7  # distance of the two runs at the start of each period, in sizes of the motion
ALIGNED = 8  # periods that turn the difference into the direction that grows most
SEED = 0  # of the first direction
LEAST_DISTANCE = 1e-14  # in sizes of the motion: what is left of a smaller distance is rounding


class NearbyGrowth(NamedTuple):
    """The growth of the distance of a nearby run."""

    exponent: float  # per drive period; NaN where a run stopped, or rounding hides what is left of the distance
    ci: float  # half width of its 95 % interval
    periods: int  # over which it is averaged


def nearby_growth(
    states: State, size: Motion, period_of: Callable[[State], tuple[State, bool]], periods: int
) -> NearbyGrowth:
    """The growth over so many periods.

    Args:
        states: The state of one lane (leading axis) at drive phase 0.
        size: Of each number of the motion, for its distance; 0 of those that do not move.
        period_of: The state after a period, and whether the run goes on.
        periods: Drive periods, after those for alignment.
    """
    drawn = np.random.default_rng(SEED).standard_normal((len(Motion._fields), *np.shape(states.motion.x)))
    here = states
    there = _moved_by(here, Motion(*(a * s for a, s in zip(drawn, size, strict=True))), np.zeros_like(here.u_s), size)
    growth = []
    for _ in range(ALIGNED + periods):
        (here, goes), (there, also) = period_of(here), period_of(there)
        if not (goes and also):
            return NearbyGrowth(np.nan, np.nan, 0)
        motion, u_s = _difference(here, there)
        distance = _sized_distance(motion, u_s, size)
        growth.append(np.log(distance / NEARBY) if distance > LEAST_DISTANCE else np.nan)
        there = _moved_by(here, motion, u_s, size)
    kept = np.array(growth[ALIGNED:])
    return NearbyGrowth(float(kept.mean()), float(confidence_interval(kept[None])[0]), periods)


def _difference(here: State, there: State) -> tuple[Motion, np.ndarray]:
    """The difference of two states; of sliders where both stick or slip alike."""
    motion = jax.tree.map(lambda a, b: np.asarray(b) - np.asarray(a), here.motion, there.motion)
    case, mode = np.asarray(here.case) == there.case, np.asarray(here.mode) == there.mode
    alike = mode & (case if case.ndim == mode.ndim else case[..., None])  # of several points each
    return motion, np.where(alike, np.asarray(there.u_s) - np.asarray(here.u_s), 0.0)


def _sized_distance(motion: Motion, u_s: np.ndarray, size: Motion) -> float:
    """The distance in sizes of the motion; sliders in those of x."""
    lengths = [*zip(motion, size, strict=True), (u_s, size.x)]
    return float(np.sqrt(sum(np.sum((a / s) ** 2) for a, s in lengths if s > 0)))


def _moved_by(state: State, motion: Motion, u_s: np.ndarray, size: Motion) -> State:
    """A state moved by `NEARBY` in the direction of a difference."""
    share = NEARBY / max(_sized_distance(motion, u_s, size), np.finfo(float).tiny)
    moved = jax.tree.map(lambda a, d: np.asarray(a) + share * d, state.motion, motion)
    return State(moved, np.asarray(state.u_s) + share * u_s, state.mode, state.case)
