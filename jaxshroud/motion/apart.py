"""Whether two motions are one: distances between orbits, as sets of points at one phase of the drive.

Period numbers do not tell motions apart, and two lanes on one orbit may be whole periods behind each other. An orbit is
therefore the set of its points at the strobe; an aperiodic motion is the set of as many of them as were kept.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
SAME, OTHER = 1.5, 3.0  # times the distance between halves of one motion: at most so far is the same, at least so other


def distance(a: Floats, b: Floats) -> float:
    """How far two sets of points (n, k), (m, k) are apart: the mean way to the other's nearest point, the longer."""
    return max(to_nearest(a, b), to_nearest(b, a))


def to_nearest(a: Floats, b: Floats) -> float:
    """Mean distance from points (n, k) to the nearest of others (m, k), by the largest difference of any number."""
    return float(np.mean(cKDTree(b).query(a, p=np.inf)[0]))


def alike(reference: Floats, other: Floats) -> bool | None:
    """Whether two aperiodic motions (n, k) fill one set; None where that cannot be told.

    Both halves of the other are compared with the first half of the reference, and so is the reference's second half:
    on one attractor all are as near.
    """
    first, second = np.array_split(reference, 2)
    own = _own(reference)
    halves = [to_nearest(half, first) for half in np.array_split(other, 2)]
    back = [to_nearest(first, half) for half in np.array_split(other, 2)]
    most = max(*halves, *back) / max(own, to_nearest(first, second))
    if most <= SAME:
        return True
    return False if min(max(halves), max(back)) / max(own, 1e-300) >= OTHER or most >= 2 * OTHER else None


def home(references: list[Floats], points: Floats) -> int | None:
    """Which of the sets that aperiodic motions fill some points (n, k) are on; None where there is none for sure."""
    found = [i for i, one in enumerate(references) if to_nearest(points, one) <= SAME * _own(one)]
    return found[0] if len(found) == 1 else None


def _own(reference: Floats) -> float:
    """How far the second half of a motion is from the first."""
    first, second = np.array_split(reference, 2)
    return to_nearest(second, first)
