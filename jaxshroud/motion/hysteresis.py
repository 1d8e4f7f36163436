"""Where the motions along a number jump, and where several coexist: forward, backward and from rest."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.apart import Floats, alike, distance

APART, DRIFTS = 0.01, 10.0  # of the motion's size, and of what it still drifts in a period: motions so far are others
LEAP, TIMES, AROUND = 0.05, 5.0, 4  # a jump: so far at least, so much further than the median of so many neighbours


class Lane(NamedTuple):
    """A motion of a sweep."""

    points: Floats  # (n, k) at the strobe, in sizes of the motion; NaN where it stopped
    number: int  # period number, 0: aperiodic
    over: bool  # its transient is not known to go on

    @property
    def orbit(self) -> Floats:
        """The points of one orbit, or all."""
        return self.points[-self.number :] if self.number else self.points

    @property
    def drift(self) -> float:
        """How far the orbit moves from one period of its own to the next."""
        q = self.number
        return (
            float(np.abs(self.points[-q:] - self.points[-2 * q : -q]).max()) if 0 < 2 * q <= len(self.points) else 0.0
        )


def differ(a: Lane, b: Lane) -> bool:
    """Whether two lanes of one scene have come to different motions, on evidence."""
    if not (np.isfinite(a.points).all() and np.isfinite(b.points).all() and a.over and b.over):
        return False
    if a.number or b.number:
        return distance(a.orbit, b.orbit) > max(APART, DRIFTS * max(a.drift, b.drift))
    return alike(a.points, b.points) is False


def jumps(lanes: list[Lane]) -> np.ndarray:
    """Whether the motion jumps between each value and the next, (n - 1,), from lanes in order of the values."""
    steps = np.array([_step(a, b) for a, b in pairwise(lanes)])
    found = np.zeros(len(steps), bool)
    for i, step in enumerate(steps):
        others = np.delete(steps[max(i - AROUND, 0) : i + AROUND + 1], min(i, AROUND))
        usual = np.nanmedian(others) if np.isfinite(others).any() else 0.0
        found[i] = step > max(LEAP, TIMES * usual)
    return found


def _step(a: Lane, b: Lane) -> float:
    if not (np.isfinite(a.points).all() and np.isfinite(b.points).all()):
        return float("nan")
    return distance(a.orbit, b.orbit)
