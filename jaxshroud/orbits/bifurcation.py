"""The bifurcations on a branch: multipliers that cross the unit circle, and grazings."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.lanes import motion_rows
from jaxshroud.batch.plan import Plan, Runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import one_lane
from jaxshroud.orbits.batched_algorithms import Algorithm, Periods
from jaxshroud.orbits.branch import BranchPoint, ContinuationProblem, corrected_point
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.travelling_wave import keeps_shift
from jaxshroud.signals.amplitudes import amplitude_values

MAX_LOCATE_TRIALS = 60
ASIDE = 0.0, 0.05, -0.05, 0.25, -0.25  # where it is looked instead, of the bracket, if an orbit is not found
MULTIPLIER_TOLERANCE = 1e-8  # distance of the multiplier from the unit circle at a solution
MAX_MULTIPLIER_MISS = 1e-4  # a larger distance means that the multiplier jumps across the circle
MIN_IMAGINARY = 1e-6  # smallest relative imaginary part of a multiplier of a pair

# a function of the points of a branch that changes sign at a special point, and one that may compute for it
PointMeasure = Callable[[BranchPoint], float]
TestFunction = Callable[[BranchPoint], Algorithm[float]]


def as_test_function(measure: PointMeasure) -> TestFunction:
    """A test function from a measure that needs no computation."""

    def test(point: BranchPoint) -> Algorithm[float]:
        return measure(point)
        yield  # makes it an algorithm

    return test


def distance_from(point: BranchPoint, target: float) -> float:
    """The distance of the nearest multiplier from 1 or -1, with the sign of det(M - at I); continuous on a branch."""
    differences = point.multipliers - target
    magnitudes = np.abs(differences)
    sign = np.sign(np.prod(differences / np.where(magnitudes > 0, magnitudes, 1.0)).real)
    return float(sign * magnitudes.min())


def pair_outside(point: BranchPoint) -> float:
    """The distance by which the complex pair nearest to the unit circle is outside it; -1 if there is no pair."""
    pairs = _pair_magnitudes(point)
    return float(pairs[np.abs(pairs - 1).argmin()] - 1) if len(pairs) else -1.0


def _pair_magnitudes(point: BranchPoint) -> np.ndarray:
    """The magnitudes of the complex multipliers with a positive imaginary part."""
    size = np.abs(point.multipliers)
    return size[np.imag(point.multipliers) > MIN_IMAGINARY * size]


def breaking_magnitudes(point: BranchPoint) -> np.ndarray:
    """The magnitudes of the multipliers that break the shift of a travelling wave, largest first, of pairs once.

    In a ring of an odd number of blades -1 is a flip: all blades stay alike in the wave of twice the period.
    """
    multipliers = point.multipliers[np.imag(point.multipliers) >= 0]
    keeps = keeps_shift(multipliers)
    if len(point.cycle.P) % 2:
        keeps |= keeps_shift(-multipliers)
    return np.sort(np.abs(multipliers[~keeps]))[::-1]


def breaking_outside(rank: int) -> PointMeasure:
    """The distance by which the breaking multiplier of a rank is outside the unit circle; -1 if there is none."""

    def measure(point: BranchPoint) -> float:
        sizes = breaking_magnitudes(point)
        return float(sizes[rank] - 1) if rank < len(sizes) else -1.0

    return measure


TEST_FUNCTIONS: dict[str, PointMeasure] = {
    "fold": lambda point: distance_from(point, 1.0),
    "branch point": lambda point: distance_from(point, 1.0),
    "flip": lambda point: distance_from(point, -1.0),
    "Neimark-Sacker": pair_outside,
}


def crossings(here: BranchPoint, there: BranchPoint) -> Iterator[tuple[str, PointMeasure]]:
    """The kinds of special points that lie between two neighbouring points of a branch, and what vanishes at each."""
    if here.free != there.free:
        return  # the sets of multipliers differ
    if not (here.is_wave and there.is_wave):
        for kind in _crossed_kinds(here.of_period, there.of_period):
            yield kind, _of_period(TEST_FUNCTIONS[kind])
        return
    for kind in _crossed_kinds(here, there):
        if kind in ("fold", "branch point") or (kind == "flip" and len(here.cycle.P) % 2):
            yield kind, TEST_FUNCTIONS[kind]
    outside = sorted(int((breaking_magnitudes(point) > 1).sum()) for point in (here, there))
    for rank in range(*outside):
        yield "localisation", breaking_outside(rank)


def _of_period(measure: PointMeasure) -> PointMeasure:
    """The measure of the multipliers of the whole period."""
    return lambda point: measure(point.of_period)


def measure_at(special: BranchPoint) -> PointMeasure:
    """What vanishes at a special point where a multiplier passes the unit circle."""
    if special.kind == "localisation":
        return breaking_outside(int(np.abs(breaking_magnitudes(special) - 1).argmin()))
    return TEST_FUNCTIONS[special.kind] if special.is_wave else _of_period(TEST_FUNCTIONS[special.kind])


def _crossed_kinds(here: BranchPoint, there: BranchPoint) -> Iterator[str]:
    """The kinds of special points between two points, by their multipliers: keys of `TEST_FUNCTIONS`."""
    turned = here.tangent[-1] * there.tangent[-1] < 0

    def differs(target):
        return distance_from(here, target) * distance_from(there, target) < 0

    if turned or differs(1.0):
        yield "fold" if turned else "branch point"
    if differs(-1.0):
        yield "flip"
    if (_pair_magnitudes(here) > 1).sum() != (_pair_magnitudes(there) > 1).sum() and pair_outside(here) * pair_outside(
        there
    ) < 0:
        yield "Neimark-Sacker"


def special_points(problem: ContinuationProblem, here: BranchPoint, there: BranchPoint) -> Algorithm[list[BranchPoint]]:
    """The special points between two neighbouring points of a branch, in order."""
    points = []
    for kind, measure in crossings(here, there):
        point, miss = yield from locate_point(problem, here, there, as_test_function(measure))
        if abs(miss) <= MAX_MULTIPLIER_MISS:
            points.append(point._replace(kind=kind))
        elif kind not in ("Neimark-Sacker", "localisation"):  # else two of them have met outside the circle
            points.append(point._replace(kind="corner"))
    return sorted(points, key=lambda point: float((point.y - here.y) @ (there.y - here.y)))


def finer_value(
    fine_problem: ContinuationProblem, before: BranchPoint, special: BranchPoint, after: BranchPoint
) -> Algorithm[float]:
    """The value of a special point by a finer march; NaN where this finds none between the neighbours."""
    ends = []
    q = special.cycle.q
    for point in (before, after):
        ends.append((yield from corrected_point(fine_problem, point.y, point.tangent, point.cycle.start, q)))
    here, there = ends
    measure = measure_at(special)
    if here is None or there is None or here.free != there.free or measure(here) * measure(there) > 0:
        return np.nan
    point, miss = yield from locate_point(fine_problem, here, there, as_test_function(measure))
    return point.value if abs(miss) <= MAX_MULTIPLIER_MISS else np.nan


def locate_point(
    problem: ContinuationProblem, here: BranchPoint, there: BranchPoint, test: TestFunction
) -> Algorithm[tuple[BranchPoint, float]]:
    """The point between two at which a test function changes sign, and its residual there.

    The method is false position (Illinois) on hyperplanes normal to the chord; every third trial bisects, so that a
    test function that jumps is located as well. At the special point itself the equations of the orbit may be singular:
    where none is found, or one that leaves the wave, the look is taken beside it, and the value of the point is
    interpolated between the nearest orbits on either side.
    """
    chord = there.y - here.y
    q = here.cycle.q
    normal = chord / np.linalg.norm(chord)
    ends = [(0.0, (yield from test(here)), here.value), (1.0, (yield from test(there)), there.value)]
    best = min((here, ends[0][1]), (there, ends[1][1]), key=lambda one: abs(one[1]))
    weights = [1.0, 1.0]
    failures = 0
    on_wave = here.is_wave and there.is_wave
    for trial in range(MAX_LOCATE_TRIALS):
        (a, f_a, _), (b, f_b, _) = ends
        w_a, w_b = f_a * weights[0], f_b * weights[1]
        s = (a + b) / 2 if trial % 3 == 2 else (a * w_b - b * w_a) / (w_b - w_a)
        s = min(max(s + ASIDE[failures] * (b - a), a), b)
        start = here.cycle.start if s < 0.5 else there.cycle.start
        point = yield from corrected_point(problem, here.y + s * chord, normal, start, q)
        if point is None or (on_wave and not point.is_wave):
            failures += 1
            if failures == len(ASIDE):
                break
            continue
        failures = 0
        f = yield from test(point)
        best = min(best, (point, f), key=lambda one: abs(one[1]))
        if abs(f) <= MULTIPLIER_TOLERANCE or b - a < 1e-13:
            break
        side = 0 if f * f_a > 0 else 1
        ends[side] = (s, f, point.value)
        weights = [1.0, 0.5] if side == 0 else [0.5, 1.0]
    point, miss = best
    if failures:
        (_, f_a, v_a), (_, f_b, v_b) = ends
        point = point._replace(value=(v_a * f_b - v_b * f_a) / (f_b - f_a))
    return point, miss


GRAZING_DEPTH = 1e-6  # largest distance or penetration at a grazing point, over the size of the motion


class ContactSummary(NamedTuple):
    """The contacts of an orbit."""

    onsets: int
    slowest: float  # closing speed at the gentlest onset [m/s]; infinite without contact
    miss: float  # least distance of the corners at a near miss [m]; infinite if there is none
    samples: np.ndarray  # (q, 6 blades) motion at the end of each of its periods
    amplitudes: dict[str, np.ndarray]  # (blades,) each


def contact_summary(point: BranchPoint) -> Algorithm[ContactSummary]:
    """The contacts of the orbit of a point."""
    cycle = point.cycle
    method = cycle.method._replace(ledger=False, vibration=False, within=True, amplitudes=True)
    plan = Plan(0, cycle.q, cycle.steps_per_period, 0.0, method)
    runs: Runs = yield Periods(cycle.scene, cycle.start, plan)
    counters, within = runs.log.counters, runs.log.within
    onsets = int(np.sum(np.asarray(counters.onset_slip)[0] + np.asarray(counters.onset_stick)[0]))
    slowest, miss = (float(a[0].min()) for a in within[2:])
    amplitudes = amplitude_values(one_lane(cycle.scene), runs.samples, np.array([cycle.q]))
    return ContactSummary(
        onsets, slowest, miss, motion_rows(runs.samples.motion)[0], {name: a[0] for name, a in amplitudes.items()}
    )


def grazing_point(problem: ContinuationProblem, here: BranchPoint, there: BranchPoint) -> Algorithm[BranchPoint | None]:
    """The grazing point between two neighbouring points of a branch with different numbers of contacts.

    The test function is the distance of the nearest miss or, where there is one more contact, the negative depth of the
    gentlest onset, which is proportional to the square of its closing speed. None where an onset appears or vanishes
    with a finite speed.
    """
    fewer = min((yield from contact_summary(here)).onsets, (yield from contact_summary(there)).onsets)
    size = problem.size
    omega = float(problem.scene.drive.omega)

    def depth(point: BranchPoint) -> Algorithm[float]:
        touches = yield from contact_summary(point)
        if touches.onsets > fewer:
            return float(-((touches.slowest / (omega * size)) ** 2))
        return min(touches.miss / size, 1.0)

    point, miss = yield from locate_point(problem, here, there, depth)
    return point._replace(kind="grazing") if abs(miss) <= GRAZING_DEPTH else None


class GrazingMargins(NamedTuple):
    """The distance of an orbit from grazing, where its derivatives would be infinite."""

    counters: dict[str, int]  # events on the orbit
    slowest_onset: float  # closing speed at the gentlest onset, over the largest on the orbit; NaN without contact
    nearest_miss: float  # least distance of the corners at a near miss [m]; NaN if there is none


def grazing_margins(orbit: PeriodicOrbit) -> GrazingMargins:
    """The grazing margins of an orbit, from its onsets and from the extremes inside its steps."""
    method = orbit.method._replace(ledger=False, within=True)
    plan = Plan(0, orbit.q, orbit.steps_per_period, 0.0, method)
    log = run_lanes(one_lane(orbit.scene), one_lane(orbit.start), plan, lambda _: None).log
    counters = {name: int(np.sum(n[0])) for name, n in vars(log.counters).items()}
    _, speeds, onsets, misses = log.within
    fastest, gentlest, miss = float(speeds.max()), float(onsets.min()), float(misses.min())
    slowest = gentlest / fastest if np.isfinite(gentlest) else np.nan
    return GrazingMargins(counters, slowest, miss if np.isfinite(miss) else np.nan)
