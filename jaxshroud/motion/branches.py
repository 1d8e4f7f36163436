"""Branches of one scene: both ways from an orbit, and on from flips along orbits of twice the period."""

from itertools import pairwise
from typing import NamedTuple, TypeVar

from jaxshroud.batch.runs import Progress
from jaxshroud.motion.branch import Line, Point
from jaxshroud.motion.following import Arc, arc, doubled
from jaxshroud.motion.grazing import Contacts, contacts, grazing
from jaxshroud.motion.settling import LARGEST_PERIOD
from jaxshroud.motion.together import together

ALIKE = 1e-3  # of the number's range: flips so close that are joined by a branch are its two ends

T = TypeVar("T")


class Followed(NamedTuple):
    """A branch in order of its arc length; the orbit jumps between a point of kind "jump" and the one before."""

    points: list[Point]
    ends: tuple[str, str]
    touches: list[Contacts]


def branches_from(line: Line, first: Point, most: int, doublings: int, progress: Progress | None) -> list[Followed]:
    """The branch through a point, and those of twice, four times ... its period that leave it at flips."""
    back = first._replace(tangent=-first.tangent)
    total = 4 * most * first.cycle.q  # periods: about four derivatives for each point
    halves = together([arc(line, first, most), arc(line, back, most)], progress, total)
    onward, before = (_or(half, Arc([first], "lost")) for half in halves)
    whole = [(_reversed(before.points) + onward.points[1:], (before.end, onward.end))]
    latest = whole
    for _ in range(doublings):
        flips = [p for points, _ in latest for p in points if p.kind == "flip" and 2 * p.cycle.q <= LARGEST_PERIOD]
        latest = _doubled(line, flips, most)
        whole += latest
    return _with_grazings(line, whole)


def _doubled(line: Line, flips: list[Point], most: int) -> list[tuple[list[Point], tuple[str, str]]]:
    """The branches that leave flips; one that joins two of them is followed from both, and kept once."""
    begun = together([doubled(line, flip) for flip in flips])
    pairs = [(flip, p) for flip, p in zip(flips, begun, strict=True) if isinstance(p, Point)]
    arcs = together([arc(line, p, most) for _, p in pairs])
    kept: list[tuple[list[Point], tuple[str, str]]] = []
    for (flip, first), one in zip(pairs, arcs, strict=True):
        found = _or(one, Arc([first], "lost"))
        joins = [points[-1].value for points, ends in kept if ends[1] == "flip"]
        if not any(abs(value - flip.value) <= ALIKE * line.width for value in joins):
            kept.append((found.points, ("flip", found.end)))
    return kept


def _or(found: T | Exception, otherwise: T) -> T:
    """What was found, unless an error ended it."""
    return otherwise if isinstance(found, Exception) else found


def _reversed(points: list[Point]) -> list[Point]:
    """Points from the last to the first: what lies before a point lies behind it."""
    kinds = [p.kind for p in points]
    for i in range(1, len(points)):
        if kinds[i] == "jump":
            kinds[i], kinds[i - 1] = "", "jump"
    return [p._replace(kind=kind) for p, kind in zip(points, kinds, strict=True)][::-1]


def _with_grazings(line: Line, whole: list[tuple[list[Point], tuple[str, str]]]) -> list[Followed]:
    """The branches with their grazing points, and how every point touches."""
    touches = [_all(contacts(p) for p in points) for points, _ in whole]
    places = [
        (b, i)
        for b, (points, _) in enumerate(whole)
        for i, ((_, there), (a, z)) in enumerate(zip(pairwise(points), pairwise(touches[b]), strict=True), 1)
        if a.onsets != z.onsets and there.kind != "jump"
    ]
    located = together([grazing(line, *whole[b][0][i - 1 : i + 1]) for b, i in places])
    found = [(b, i, p) for (b, i), p in zip(places, located, strict=True) if isinstance(p, Point)]
    for (b, i, point), touch in zip(found[::-1], _all(contacts(p) for _, _, p in found)[::-1], strict=True):
        whole[b][0].insert(i, point)
        touches[b].insert(i, touch)
    return [Followed(points, ends, touch) for (points, ends), touch in zip(whole, touches, strict=True)]


def _all(algorithms) -> list[Contacts]:
    return [one for one in together(list(algorithms)) if not isinstance(one, Exception)]
