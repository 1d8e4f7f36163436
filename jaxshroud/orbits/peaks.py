"""The peaks of an amplitude: their place, and their width at half power.

They are sought along branches of periodic orbits; of a scene whose contact stays in one state, by its closed form.

At half power an amplitude is 1 / sqrt(2) of its peak. Of a linear oscillator with the damping ratio zeta the width
there, over the frequency of the peak, is 2 zeta.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.orbits.batched_algorithms import Algorithm, run_together
from jaxshroud.orbits.bifurcation import ContactSummary, contact_summary, locate_point
from jaxshroud.orbits.branch import BranchPoint, ContinuationProblem, corrected_point
from jaxshroud.orbits.branch_continuation import ContinuedBranch
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.quantities import counted_amplitude
from jaxshroud.signals.waves import HALF_POWER

MAX_PARABOLAS = 12  # fitted to an amplitude about its maximum
COPY = 1e-6  # relative distance of two peaks that are of one motion
PLACED = 1e-6  # of the distance between the neighbours: a smaller shift of the maximum does not count
PEAK_ZOOMS = 13  # closer looks at a peak of a closed form, or at where its amplitude has fallen to half power
PEAK_VALUES = 8  # in each of them: each is 3.5 times closer
AmplitudesAt = Callable[[np.ndarray], np.ndarray]  # values (n,) -> those of all blades (n, blades)


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
    of_blades: np.ndarray  # (blades,) amplitude of each at the maximum


class Peaked(NamedTuple):
    """The amplitude whose peaks are sought: the largest of the blades that count."""

    problem: ContinuationProblem
    of: str

    def level(self, touch: ContactSummary) -> float:
        """The amplitude of an orbit."""
        return float(counted_amplitude(touch.amplitudes[self.of], self.problem.scene.layout))


def branch_peaks(problem: ContinuationProblem, branches: Sequence[ContinuedBranch], of: str) -> list[Peak]:
    """The peaks of an amplitude on branches, e.g. "x_peak", in order."""
    peaked = Peaked(problem, of)
    places = [
        (b, i)
        for b, branch in enumerate(branches)
        for i in range(1, len(branch.points) - 1)
        if _is_maximum([peaked.level(touch) for touch in branch.touches[i - 1 : i + 2]])
        and "jump" not in {point.kind for point in branch.points[i : i + 2]}
    ]
    peaks = run_together([_peak(peaked, branches[b], b, i) for b, i in places])
    return _without_copies([peak for peak in peaks if isinstance(peak, Peak)])


def _without_copies(peaks: Sequence[Peak]) -> list[Peak]:
    """The peaks without those of the same motion of other blades, which a broken branch of a row passes as well."""
    kept: list[Peak] = []
    for peak in peaks:
        if not any(_is_copy(peak, other) for other in kept):
            kept.append(peak)
    return kept


def _is_copy(one: Peak, other: Peak) -> bool:
    def numbers(peak):
        return np.array([peak.q, peak.value, peak.amplitude])

    return np.allclose(numbers(one), numbers(other), rtol=COPY, atol=0)


def _is_maximum(levels: Sequence[float]) -> bool:
    before, here, after = levels
    return bool(before < here and here >= after)


def _peak(peaked: Peaked, branch: ContinuedBranch, number: int, i: int) -> Algorithm[Peak]:
    """The peak about point `i` of a branch."""
    top, touch = yield from _maximum(peaked, branch.points[i - 1 : i + 2], branch.touches[i - 1 : i + 2])
    level = peaked.level(touch)
    ends, reasons = [], []
    for side in (-1, 1):
        value, reason = yield from _half_power(peaked, branch, i, side, level * HALF_POWER)
        ends.append(value)
        reasons.append(reason)
    reason = next(filter(None, reasons), "")
    low, high = (np.nan, np.nan) if reason else sorted(ends)
    stable = bool(np.all(np.abs(top.multipliers) < 1))
    return Peak(number, top.value, level, top.cycle.q, stable, low, high, reason, touch.amplitudes[peaked.of])


def _maximum(
    peaked: Peaked, points: Sequence[BranchPoint], touches: Sequence[ContactSummary]
) -> Algorithm[tuple[BranchPoint, ContactSummary]]:
    """The point between three at which the amplitude is largest, and its contacts, by successive parabolas."""
    chord = points[2].y - points[0].y
    normal = chord / np.linalg.norm(chord)
    places = [float((point.y - points[0].y) @ normal) for point in points]
    found = [(s, peaked.level(touch), p, touch) for s, touch, p in zip(places, touches, points, strict=True)]
    for _ in range(MAX_PARABOLAS):
        nearest = sorted(found, key=lambda one: -one[1])[:3]
        s = _vertex([one[:2] for one in nearest])
        if not places[0] < s < places[2] or abs(s - nearest[0][0]) <= PLACED * (places[2] - places[0]):
            break
        guess = _parabola_at([(one[0], one[2].y) for one in nearest], s)
        start = nearest[0][2].cycle
        point = yield from corrected_point(peaked.problem, guess, normal, start.start, start.q)
        if point is None:
            break
        touch = yield from contact_summary(point)
        found.append((s, peaked.level(touch), point, touch))
    _, _, top, touch = max(found, key=lambda one: one[1])
    return top, touch


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
    peaked: Peaked, branch: ContinuedBranch, i: int, side: int, level: float
) -> Algorithm[tuple[float, str]]:
    """Where the amplitude falls to a level on one side of point `i`, or why there is no such place."""
    points, touches = branch.points, branch.touches
    here = i
    turned = 0.0
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
        if peaked.level(touches[there]) < level:
            break
        here = there

    def excess(point: BranchPoint) -> Algorithm[float]:
        touch = yield from contact_summary(point)
        return peaked.level(touch) / level - 1

    point, _ = yield from locate_point(peaked.problem, points[here], points[there], excess)
    return point.value, ""


def linear_peaks(amplitudes: AmplitudesAt, values: np.ndarray, layout: Layout) -> list[Peak]:
    """The peaks between the ends of values.

    Args:
        amplitudes: The amplitudes at any values of the number.
        values: The values (n,), in order.
        layout: The layout of the blades.
    """
    here = counted_amplitude(amplitudes(values), layout)
    inner = np.flatnonzero((here[1:-1] > here[:-2]) & (here[1:-1] >= here[2:])) + 1
    return [_linear_peak(amplitudes, layout, values, here, int(i)) for i in inner]


def _linear_peak(amplitudes: AmplitudesAt, layout: Layout, values: np.ndarray, here: np.ndarray, i: int) -> Peak:
    def level(at):
        return counted_amplitude(amplitudes(at), layout)

    fine = values[i - 1 : i + 2]
    of_blades = amplitudes(fine)
    place = 1
    for _ in range(PEAK_ZOOMS):
        fine = np.linspace(fine[max(place - 1, 0)], fine[min(place + 1, len(fine) - 1)], PEAK_VALUES)
        of_blades = amplitudes(fine)
        place = int(np.nanargmax(counted_amplitude(of_blades, layout)))
    top = float(fine[place])
    blades = of_blades[place]
    size = float(counted_amplitude(of_blades[place : place + 1], layout)[0])
    ends, reasons = zip(*(_half_power_end(level, values, here, i, top, size, side) for side in (-1, 1)), strict=True)
    reason = next(filter(None, reasons), "")
    first, last = (np.nan, np.nan) if reason else ends
    return Peak(0, top, size, 1, True, first, last, reason, blades)


def _half_power_end(
    level: AmplitudesAt, values: np.ndarray, here: np.ndarray, i: int, top: float, size: float, side: int
) -> tuple[float, str]:
    """Where the amplitude has fallen to half power on a side of a peak; or why there is no such place."""
    beyond = range(i + side, -1 if side < 0 else len(values), side)
    end = next((k for k in beyond if not here[k] > size * HALF_POWER), None)
    if end is None:
        return np.nan, "it does not fall to half power within the range"
    if not np.isfinite(here[end]):
        return np.nan, "contact leaves its state before half power"
    near, far = (top, float(values[end])) if end == i + side else (float(values[end - side]), float(values[end]))
    for _ in range(PEAK_ZOOMS):
        fine = np.linspace(near, far, PEAK_VALUES)
        k = int(np.argmax(~(level(fine) > size * HALF_POWER)))
        near, far = float(fine[max(k - 1, 0)]), float(fine[k])
    return far, ""
