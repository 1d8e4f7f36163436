"""Distances between orbits, as sets of points at one phase of the drive, and the steps that they take along a sweep.

Period numbers do not distinguish motions, and two lanes on one orbit may differ by whole periods. An orbit is therefore
the set of its points at the strobe, and an aperiodic motion the set of the points that were kept.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxshroud.scene.typed import FloatArray

# in distances between halves of one motion: below the first the sets are equal, above the second different
SAME_SET_RATIO, OTHER_SET_RATIO = 2.0, 4.0
# smallest distance of different motions, over their size, and over their drift in a period
MIN_DISTANCE, DRIFT_MULTIPLE = 0.01, 10.0
# smallest distance of a step that may be a jump, also over the median of so many neighbouring steps
LEAST_STEEP, STEP_RATIO, NEIGHBOURING_STEPS = 0.05, 5.0, 4


def set_distance(a: FloatArray, b: FloatArray) -> float:
    """The distance of two sets of points (n, k), (m, k): the larger mean distance to the nearest point of the other."""
    return max(mean_nearest_distance(a, b), mean_nearest_distance(b, a))


def mean_nearest_distance(a: FloatArray, b: FloatArray) -> float:
    """The mean distance of points (n, k) from the nearest of others (m, k), in the maximum norm."""
    from scipy.spatial import KDTree

    return float(np.mean(KDTree(b).query(a, p=np.inf)[0]))


def fill_one_set(one: FloatArray, other: FloatArray) -> bool | None:
    """Whether two aperiodic motions (n, k) fill one set; None where that cannot be decided.

    The halves of both are compared: on one attractor, halves of different motions are as near as those of one motion.
    Of 240 pairs of motions on the Henon attractor, of 512 points each, none exceeded this distance by a factor of 1.6.
    """
    if min(len(one), len(other)) < 2:  # nothing to halve
        return None
    halves = [np.array_split(points, 2) for points in (one, other)]
    own_distance = max(set_distance(*pair) for pair in halves)
    largest = max(set_distance(a, b) for a in halves[0] for b in halves[1])
    if largest <= SAME_SET_RATIO * own_distance:
        return True
    return False if largest >= OTHER_SET_RATIO * own_distance else None


def containing_set(references: list[FloatArray], points: FloatArray) -> int | None:
    """The index of the set, filled by an aperiodic motion, that contains points (n, k); None unless it is certain."""
    containing = [
        i
        for i, reference in enumerate(references)
        if len(reference) > 1
        and mean_nearest_distance(points, reference) <= SAME_SET_RATIO * set_distance(*np.array_split(reference, 2))
    ]
    return containing[0] if len(containing) == 1 else None


class SweptMotion(NamedTuple):
    """The motion at one value of a sweep."""

    points: FloatArray  # (n, k) at the strobe, in units of the motion; NaN where it stopped
    number: int  # period number, 0: aperiodic
    settled: bool  # whether the transient is over, as far as known

    @property
    def is_known(self) -> bool:
        """Whether the lane has settled, and runs to its end."""
        return self.settled and bool(np.isfinite(self.points).all())

    @property
    def orbit(self) -> FloatArray:
        """The points of one orbit, or all points of an aperiodic motion."""
        return self.points[-self.number :] if self.number else self.points

    @property
    def drift(self) -> float:
        """The change of the orbit from one of its periods to the next."""
        q = self.number
        return (
            float(np.abs(self.points[-q:] - self.points[-2 * q : -q]).max()) if 0 < 2 * q <= len(self.points) else 0.0
        )


def motions_differ(a: SweptMotion, b: SweptMotion) -> bool:
    """Whether two lanes of one scene are known to have different motions."""
    if not (a.is_known and b.is_known):
        return False
    if a.number or b.number:
        return set_distance(a.orbit, b.orbit) > max(MIN_DISTANCE, DRIFT_MULTIPLE * max(a.drift, b.drift))
    return fill_one_set(a.points, b.points) is False


def are_one_motion(a: SweptMotion, b: SweptMotion) -> bool:
    """Whether two lanes of one scene are known to have the same motion."""
    if not (a.is_known and b.is_known):
        return False
    return not motions_differ(a, b) if a.number or b.number else fill_one_set(a.points, b.points) is True


def number_motions(lanes: Sequence[SweptMotion]) -> np.ndarray:
    """The number of each lane's motion, (n,), in the order in which they are first met; -1 where it has not settled.

    Lanes share a motion where they are not known to differ.
    """
    first: list[SweptMotion] = []
    numbers = np.full(len(lanes), -1)
    for i, lane in enumerate(lanes):
        if not lane.is_known:
            continue
        alike = [j for j, other in enumerate(first) if not motions_differ(lane, other)]
        numbers[i] = alike[0] if alike else len(first)
        first += [] if alike else [lane]
    return numbers


def steep_steps(lanes: list[SweptMotion]) -> np.ndarray:
    """Whether the motion may jump between each value and the next, (n - 1,), from lanes in order of the values."""
    steps = np.array([step_distance(a, b) for a, b in pairwise(lanes)])
    steep = np.zeros(len(steps), bool)
    for i, step in enumerate(steps):
        neighbours = np.delete(
            steps[max(i - NEIGHBOURING_STEPS, 0) : i + NEIGHBOURING_STEPS + 1], min(i, NEIGHBOURING_STEPS)
        )
        usual_step = np.nanmedian(neighbours) if np.isfinite(neighbours).any() else 0.0
        steep[i] = step > max(LEAST_STEEP, STEP_RATIO * usual_step)
    return steep


def step_distance(a: SweptMotion, b: SweptMotion) -> float:
    """The distance of the orbits of two lanes; NaN where one of them stopped."""
    if not (np.isfinite(a.points).all() and np.isfinite(b.points).all()):
        return float("nan")
    return set_distance(a.orbit, b.orbit)
