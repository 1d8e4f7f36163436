"""Special points of a branch: where a multiplier passes the unit circle, solved with the multiplier as an equation."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.branch import Line, Point, corrected
from jaxshroud.motion.together import Algorithm

MOST_TRIALS = 60
SOLVED = 1e-8  # distance of the multiplier from the unit circle
CROSSED = 1e-4  # the same beyond which it has not passed the circle but jumped over it
COMPLEX = 1e-6  # imaginary part, relative, of a multiplier that is one of a pair

Test = Callable[[Point], Algorithm[float]]  # of a branch's points; changes sign at a special one


class Passing(NamedTuple):
    """A special point between two points of a branch, to be located."""

    kind: str
    measure: Callable[[Point], float]


def known(measure: Callable[[Point], float]) -> Test:
    """A test that needs nothing computed."""

    def test(point: Point) -> Algorithm[float]:
        return measure(point)
        yield  # it is an algorithm all the same

    return test


def distance_from(point: Point, at: float) -> float:
    """Distance of the nearest multiplier from 1 or -1, with the sign of det(M - at I): continuous along a branch."""
    apart = point.multipliers - at
    size = np.abs(apart)
    sign = np.sign(np.prod(apart / np.where(size > 0, size, 1.0)).real)
    return float(sign * size.min())


def pair_outside(point: Point) -> float:
    """By how much the complex pair that is nearest to the unit circle is outside it; -1 where there is no pair."""
    pairs = _pairs(point)
    return float(pairs[np.abs(pairs - 1).argmin()] - 1) if len(pairs) else -1.0


def _pairs(point: Point) -> np.ndarray:
    """Magnitudes of the complex multipliers with a positive imaginary part."""
    size = np.abs(point.multipliers)
    return size[np.imag(point.multipliers) > COMPLEX * size]


def passings(here: Point, there: Point) -> Iterator[Passing]:
    """What must lie between two neighbouring points of a branch."""
    turned = here.tangent[-1] * there.tangent[-1] < 0
    differs = lambda at: distance_from(here, at) * distance_from(there, at) < 0  # noqa: E731
    if here.free != there.free:
        return  # the multipliers are others
    if turned or differs(1.0):
        yield Passing("fold" if turned else "branch point", lambda point: distance_from(point, 1.0))
    if differs(-1.0):
        yield Passing("flip", lambda point: distance_from(point, -1.0))
    if (_pairs(here) > 1).sum() != (_pairs(there) > 1).sum() and pair_outside(here) * pair_outside(there) < 0:
        yield Passing("Neimark-Sacker", pair_outside)


def special_points(line: Line, here: Point, there: Point) -> Algorithm[list[Point]]:
    """The special points between two neighbouring points of a branch, in order."""
    found = []
    for passing in passings(here, there):
        point, miss = yield from located(line, here, there, known(passing.measure))
        if abs(miss) <= CROSSED:
            found.append(point._replace(kind=passing.kind))
        elif passing.kind != "Neimark-Sacker":  # else two pairs that met outside the circle
            found.append(point._replace(kind="corner"))
    return sorted(found, key=lambda point: float((point.y - here.y) @ (there.y - here.y)))


def located(line: Line, here: Point, there: Point, test: Test) -> Algorithm[tuple[Point, float]]:
    """The point between two at which a test changes sign, and what is left of the test there.

    By false position (Illinois) on hyperplanes at right angles to the chord; every third trial halves, so that a test
    that jumps is located as well.
    """
    chord, q = there.y - here.y, here.cycle.q
    normal = chord / np.linalg.norm(chord)
    ends = [(0.0, (yield from test(here))), (1.0, (yield from test(there)))]
    best = min((here, ends[0][1]), (there, ends[1][1]), key=lambda one: abs(one[1]))
    weights = [1.0, 1.0]
    for trial in range(MOST_TRIALS):
        (a, f_a), (b, f_b) = ends
        w_a, w_b = f_a * weights[0], f_b * weights[1]
        s = (a + b) / 2 if trial % 3 == 2 else (a * w_b - b * w_a) / (w_b - w_a)
        held = here.cycle.start if s < 0.5 else there.cycle.start
        point = yield from corrected(line, here.y + s * chord, normal, held, q)
        if point is None:
            break
        f = yield from test(point)
        best = min(best, (point, f), key=lambda one: abs(one[1]))
        if abs(f) <= SOLVED or b - a < 1e-13:
            break
        side = 0 if f * f_a > 0 else 1
        ends[side], weights = (s, f), [1.0, 0.5] if side == 0 else [0.5, 1.0]
    return best
