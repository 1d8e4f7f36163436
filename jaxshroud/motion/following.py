"""Branches of periodic orbits followed from point to point, past folds, up to where they end."""

from typing import NamedTuple

import numpy as np

from jaxshroud.batch.states import STATE
from jaxshroud.motion.bifurcation import special_points
from jaxshroud.motion.branch import Line, Point, corrected
from jaxshroud.motion.shooting import closed_orbit
from jaxshroud.motion.together import Algorithm

FIRST, LONGEST, SHORTEST = 0.01, 0.1, 1e-6  # steps, in sizes of the motion and in the number's range
GROWTH, EASY = 1.5, 4  # of the step where Newton's method took at most so many updates
STRAIGHT = 0.9  # cosine between tangents that is near enough to 1
KINK = 1e-4  # steps so short may turn by any angle: the branch has a corner there
JUMPS = (1e-5, 1e-4, 1e-3, 4e-3)  # of the number's range: how far beyond a place where the map jumps to look on,
NEAR = 0.1  # and how far the orbit may be from the last one, in sizes of the motion
# Special points at which an orbit of period q may become one of period q / 2, and the closing error in half its period
# that shows it: two branches cross there, where Newton's method comes no nearer.
ENDINGS, SHORTER = ("fold", "branch point", "corner"), 0.03
ASIDE = 1e-2  # of the motion's size: where an orbit of twice the period is looked for beside a flip


class Arc(NamedTuple):
    """Points from a first one to where a branch ended, in one direction."""

    points: list[Point]
    end: str  # why it ended


def arc(line: Line, first: Point, most: int) -> Algorithm[Arc]:
    """The branch from a point on, to the side of its tangent."""
    points, here, step = [first], first, FIRST
    while len(points) < most:
        there = yield from _next_point(line, here, step)
        if there is None:
            step /= 4
            if step >= SHORTEST:
                continue
            there = yield from _beyond(line, here)
            if there is None:
                return Arc(points, "lost")
            step = FIRST
        if not line.low <= there.value <= line.high:
            edge, end = (line.low, "start") if there.value < line.low else (line.high, "stop")
            last = yield from _at_value(line, here, there, edge)
            return Arc(points + ([] if last is None else [last]), end)
        special = [] if there.kind else (yield from special_points(line, here, there))
        for i, point in enumerate(special):
            if point.kind in ENDINGS and (yield from _is_shorter(line, point)):
                return Arc([*points, *special[:i], point._replace(kind="")], "flip")
        points += [*special, there]
        if len(points) > 10 and _same(there, first, step):
            return Arc([*points, first], "closed")
        here, step = there, min(step * (GROWTH if there.updates <= EASY else 1.0), LONGEST)
    return Arc(points, "most points")


def _next_point(line: Line, here: Point, step: float) -> Algorithm[Point | None]:
    """The point a step further; None where there is none so near that the branch is surely the same."""
    guess = here.y + step * here.tangent
    there = yield from corrected(line, guess, here.tangent, here.cycle.start, here.cycle.q)
    if there is None or np.linalg.norm(there.y - guess) > step:
        return None
    return there if there.tangent @ here.tangent >= STRAIGHT or step <= KINK else None


def _beyond(line: Line, here: Point) -> Algorithm[Point | None]:
    """The orbit on the other side of a place where the map jumps, if it is near; its kind is "jump"."""
    for step in JUMPS:
        normal = np.eye(STATE + 1)[-1] * np.sign(here.tangent[-1])
        guess = here.y + step * normal
        there = yield from corrected(line, guess, normal, here.cycle.start, here.cycle.q)
        if there is not None and np.linalg.norm(there.y - guess) <= NEAR:
            return there._replace(kind="jump")
    return None


def _at_value(line: Line, here: Point, there: Point, value: float) -> Algorithm[Point | None]:
    """The point between two at which the number has a value."""
    share = (value - here.value) / (there.value - here.value)
    y, normal = here.y + share * (there.y - here.y), np.eye(STATE + 1)[-1]
    point = yield from corrected(line, y, normal, here.cycle.start, here.cycle.q)
    return None if point is None else point._replace(tangent=here.tangent)


def _is_shorter(line: Line, point: Point) -> Algorithm[bool]:
    """Whether the orbit closes in half its period: the branch has come to the flip that it is from."""
    q = point.cycle.q
    if q % 2:
        return False
    half = yield from closed_orbit(point.cycle.scene, point.cycle.start, q // 2, line.aim, most=0)
    return half.residual <= SHORTER


def _same(a: Point, b: Point, step: float) -> bool:
    return bool(np.linalg.norm(a.y - b.y) < step and a.tangent @ b.tangent > STRAIGHT)


def doubled(line: Line, flip: Point) -> Algorithm[Point | None]:
    """The first point of the branch of twice the period that leaves a flip."""
    at = flip.cycle.jacobian
    assert at is not None  # points have orbits
    values, vectors = np.linalg.eig(at.by_state * line.units / line.units[:, None])
    aside = np.append(np.real(vectors[:, np.abs(values + 1).argmin()]), 0.0)
    aside -= (aside @ flip.tangent) * flip.tangent
    aside /= np.linalg.norm(aside)
    guess = flip.y + ASIDE * aside
    point = yield from corrected(line, guess, aside, flip.cycle.start, 2 * flip.cycle.q)
    if point is None or np.linalg.norm(point.y - guess) > 3 * ASIDE:
        return None
    return point
