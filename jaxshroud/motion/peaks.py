"""The peaks of an amplitude along branches of periodic orbits: their place, and their width at half power.

At half power an amplitude is 1 / sqrt(2) of its peak. Of a linear oscillator with the damping ratio zeta the width
there, over the frequency of the peak, is 2 zeta.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.amplification import HALF_POWER
from jaxshroud.motion.batched_algorithms import Algorithm, run_together
from jaxshroud.motion.bifurcation import ContactSummary, contact_summary, locate_point
from jaxshroud.motion.branch import BranchPoint, ContinuationProblem, corrected_point
from jaxshroud.motion.branch_continuation import ContinuedBranch

MAX_PARABOLAS = 12  # fitted to an amplitude about its maximum
PLACED = 1e-6  # of the distance between the neighbours: a smaller shift of the maximum does not count


class Peak(NamedTuple):
    """A local maximum of an amplitude along a branch."""

    branch: int
    value: float  # of the number followed
    amplitude: float
    q: int
    stable: bool
    low: float  # where the amplitude has fallen to half power, on either side; NaN if it has not
    high: float
    reason: str  # why there is no width; empty if there is one


def branch_peaks(problem: ContinuationProblem, branches: Sequence[ContinuedBranch], of: str) -> list[Peak]:
    """The peaks of an amplitude of the left blade on branches, e.g. "x_peak", in order."""
    places = [
        (b, i)
        for b, branch in enumerate(branches)
        for i in range(1, len(branch.points) - 1)
        if _is_maximum([touch.amplitudes[of][0] for touch in branch.touches[i - 1 : i + 2]])
        and "jump" not in {point.kind for point in branch.points[i : i + 2]}
    ]
    peaks = run_together([_peak(problem, branches[b], b, i, of) for b, i in places])
    return [peak for peak in peaks if isinstance(peak, Peak)]


def _is_maximum(levels: Sequence[float]) -> bool:
    before, here, after = levels
    return bool(before < here and here >= after)


def _peak(problem: ContinuationProblem, branch: ContinuedBranch, number: int, i: int, of: str) -> Algorithm[Peak]:
    """The peak about point `i` of a branch."""
    top, level = yield from _maximum(problem, branch.points[i - 1 : i + 2], branch.touches[i - 1 : i + 2], of)
    ends, reasons = [], []
    for side in (-1, 1):
        value, reason = yield from _half_power(problem, branch, i, side, level * HALF_POWER, of)
        ends.append(value)
        reasons.append(reason)
    reason = next(filter(None, reasons), "")
    low, high = (np.nan, np.nan) if reason else sorted(ends)
    stable = bool(np.all(np.abs(top.multipliers) < 1))
    return Peak(number, top.value, level, top.cycle.q, stable, low, high, reason)


def _maximum(
    problem: ContinuationProblem, points: Sequence[BranchPoint], touches: Sequence[ContactSummary], of: str
) -> Algorithm[tuple[BranchPoint, float]]:
    """The point between three at which the amplitude is largest, and the amplitude, by successive parabolas."""
    chord = points[2].y - points[0].y
    normal = chord / np.linalg.norm(chord)
    places = [float((point.y - points[0].y) @ normal) for point in points]
    found = [(s, touch.amplitudes[of][0], point) for s, touch, point in zip(places, touches, points, strict=True)]
    for _ in range(MAX_PARABOLAS):
        nearest = sorted(found, key=lambda one: -one[1])[:3]
        s = _vertex([one[:2] for one in nearest])
        if not places[0] < s < places[2] or abs(s - nearest[0][0]) <= PLACED * (places[2] - places[0]):
            break
        guess = _parabola_at([(one[0], one[2].y) for one in nearest], s)
        start = nearest[0][2].cycle
        point = yield from corrected_point(problem, guess, normal, start.start, start.q)
        if point is None:
            break
        touch = yield from contact_summary(point)
        found.append((s, touch.amplitudes[of][0], point))
    _, level, top = max(found, key=lambda one: one[1])
    return top, float(level)


def _vertex(points: Sequence[tuple[float, float]]) -> float:
    """Where the parabola through three points has its extreme."""
    (a, f_a), (b, f_b), (c, f_c) = points
    right, left = (b - a) * (f_b - f_c), (b - c) * (f_b - f_a)
    return b - ((b - a) * right - (b - c) * left) / (2 * (right - left)) if right != left else math.nan


def _parabola_at(points: Sequence[tuple[float, np.ndarray]], s: float) -> np.ndarray:
    """The value at `s` of the parabola through three vectors."""
    total = np.zeros_like(points[0][1])
    for k, (s_k, y) in enumerate(points):
        total = total + y * math.prod((s - other) / (s_k - other) for j, (other, _) in enumerate(points) if j != k)
    return total


def _half_power(
    problem: ContinuationProblem, branch: ContinuedBranch, i: int, side: int, level: float, of: str
) -> Algorithm[tuple[float, str]]:
    """Where the amplitude falls to a level on one side of point `i`, or why there is no such place."""
    points, touches = branch.points, branch.touches
    here, turned = i, 0.0
    while True:
        there = here + side
        if not 0 <= there < len(points):
            return math.nan, f"the branch ends at {points[here].value:.6g}, above half power"
        if "jump" in (points[max(here, there)].kind,):
            return math.nan, f"the orbit jumps at {points[there].value:.6g}, above half power"
        move = points[there].value - points[here].value
        if turned and move * turned < 0:
            return math.nan, f"the peak bends back at {points[here].value:.6g}: it has several values"
        turned = move or turned
        if touches[there].amplitudes[of][0] < level:
            break
        here = there

    def excess(point: BranchPoint) -> Algorithm[float]:
        touch = yield from contact_summary(point)
        return float(touch.amplitudes[of][0] / level - 1)

    point, _ = yield from locate_point(problem, points[here], points[there], excess)
    return point.value, ""
