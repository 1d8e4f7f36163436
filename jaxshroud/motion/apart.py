"""Whether two motions are one: distances between orbits, as sets of points at one phase of the drive.

Period numbers do not tell motions apart, and two lanes on one orbit may be whole periods behind each other. An orbit is
therefore the set of its points at the strobe; an aperiodic motion is the set of as many of them as were kept.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SAME, OTHER = 2.0, 4.0  # times the distance between halves of one motion: at most so far the same, at least so another


def distance(a: Floats, b: Floats) -> float:
    """How far two sets of points (n, k), (m, k) are apart: the mean way to the other's nearest point, the longer."""
    return max(to_nearest(a, b), to_nearest(b, a))


def to_nearest(a: Floats, b: Floats) -> float:
    """Mean distance from points (n, k) to the nearest of others (m, k), by the largest difference of any number."""
    from scipy.spatial import KDTree

    return float(np.mean(KDTree(b).query(a, p=np.inf)[0]))


def alike(one: Floats, other: Floats) -> bool | None:
    """Whether two aperiodic motions (n, k) fill one set; None where that cannot be told.

    Halves of both are compared, each with each: on one attractor those of different motions are as near as those of
    one. Of 240 pairs of motions on the Henon attractor, 512 points each, none was further apart than 1.6 times.
    """
    halves = [np.array_split(points, 2) for points in (one, other)]
    own = max(distance(*pair) for pair in halves)
    most = max(distance(a, b) for a in halves[0] for b in halves[1])
    if most <= SAME * own:
        return True
    return False if most >= OTHER * own else None


def home(references: list[Floats], points: Floats) -> int | None:
    """Which of the sets that aperiodic motions fill some points (n, k) are on; None where there is none for sure."""
    found = [
        i for i, one in enumerate(references) if to_nearest(points, one) <= SAME * distance(*np.array_split(one, 2))
    ]
    return found[0] if len(found) == 1 else None
