"""Branches of periodic orbits: followed from point to point both ways, past folds, and on from flips."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxshroud.model.modes import MULTIPLIER_KINDS
from jaxshroud.orbits.batched_algorithms import Algorithm, StagedProgress, run_together
from jaxshroud.orbits.bifurcation import (
    MAX_MULTIPLIER_MISS,
    ContactSummary,
    contact_summary,
    finer_value,
    grazing_point,
    special_points,
)
from jaxshroud.orbits.branch import BranchPoint, ContinuationProblem, corrected_point
from jaxshroud.orbits.orbit import determined
from jaxshroud.orbits.shooting import closed_orbit
from jaxshroud.scene.typed import T
from jaxshroud.signals.period import LARGEST_PERIOD

FIRST_STEP, MAX_STEP, MIN_STEP = 0.01, 0.1, 1e-6  # arc length, in units of the motion and of the parameter's range
STEP_GROWTH, EASY_UPDATES = 1.5, 4  # growth of the step after at most so many Newton updates
MIN_TANGENT_COSINE = 0.9  # smallest cosine between consecutive tangents
KINK_STEP = 1e-4  # in steps this short the tangent may turn by any angle: the branch has a corner
# distances beyond a jump of the map at which the branch is sought, of the parameter's range
JUMP_STEPS = 1e-5, 1e-4, 1e-3, 4e-3
MAX_JUMP_DISTANCE = 0.1  # largest distance of the orbit beyond a jump from the last one, in units of the motion
# Special points at which an orbit of period q may become one of period q / 2, or a broken wave whole, and the closing
# error over half the period, or of the wave, that shows it: two branches cross there, where Newton's method stalls.
HALVING_KINDS = ("fold", "branch point", "corner")
HALF_PERIOD_RESIDUAL = 0.03
DOUBLING_STEP = 1e-2  # distance from a flip at which the orbit of twice the period is sought, in units of the motion
PLANE_DIRECTIONS = 8  # tried in a plane of eigenvectors
USUAL_POINTS = 400  # of a branch in one direction, of those that may have more
DERIVATIVES_OF_POINT, DERIVATIVES_OF_SPECIAL_POINT = 4, 20  # about so many, of a point and of one that is located
SAME_FLIP = 1e-3  # of the parameter's range: distance of flips that count as the two ends of one branch


class Arc(NamedTuple):
    """The points from a first one to the end of a branch, in one direction."""

    points: list[BranchPoint]
    end: str  # the reason why it ended


def continue_branch(problem: ContinuationProblem, first: BranchPoint, max_points: int) -> Algorithm[Arc]:
    """Continue the branch from a point in the direction of its tangent."""
    points = [first]
    here = first
    step = FIRST_STEP
    while len(points) < max_points:
        there = yield from _next_point(problem, here, step)
        if there is None:
            step /= 4
            if step >= MIN_STEP:
                continue
            there = yield from _point_beyond_jump(problem, here)
            if there is None:
                return Arc(points, "lost")
            step = FIRST_STEP
        if not problem.low <= there.value <= problem.high:
            edge, end = (problem.low, "start") if there.value < problem.low else (problem.high, "stop")
            last = yield from _point_at_value(problem, here, there, edge)
            return Arc(points + ([] if last is None else [last]), end)
        special = [] if there.kind else (yield from special_points(problem, here, there))
        for i, point in enumerate(special):
            origin = (yield from _reached_origin(problem, here, point)) if point.kind in HALVING_KINDS else ""
            if origin:
                return Arc([*points, *special[:i], point._replace(kind="")], origin)
        points += [*special, there]
        if len(points) > 10 and _is_same_point(there, first, step):
            return Arc([*points, first], "closed")
        here = there
        step = min(step * (STEP_GROWTH if there.updates <= EASY_UPDATES else 1.0), MAX_STEP)
    return Arc(points, "most points")


def _next_point(problem: ContinuationProblem, here: BranchPoint, step: float) -> Algorithm[BranchPoint | None]:
    """The point one step further; None unless it is so near that it certainly belongs to the branch."""
    guess = here.y + step * here.tangent
    there = yield from corrected_point(problem, guess, here.tangent, here.cycle.start, here.cycle.q)
    if there is None or np.linalg.norm(there.y - guess) > step:
        return None
    return there if there.tangent @ here.tangent >= MIN_TANGENT_COSINE or step <= KINK_STEP else None


def _point_beyond_jump(problem: ContinuationProblem, here: BranchPoint) -> Algorithm[BranchPoint | None]:
    """The orbit beyond a jump of the map, if it is near; its kind is "jump"."""
    for step in JUMP_STEPS:
        normal = problem.along_parameter * np.sign(here.tangent[-1])
        guess = here.y + step * normal
        there = yield from corrected_point(problem, guess, normal, here.cycle.start, here.cycle.q)
        if there is not None and np.linalg.norm(there.y - guess) <= MAX_JUMP_DISTANCE:
            return there._replace(kind="jump")
    return None


def _point_at_value(
    problem: ContinuationProblem, here: BranchPoint, there: BranchPoint, value: float
) -> Algorithm[BranchPoint | None]:
    """The point between two at a value of the parameter."""
    share = (value - here.value) / (there.value - here.value)
    y = here.y + share * (there.y - here.y)
    normal = problem.along_parameter
    point = yield from corrected_point(problem, y, normal, here.cycle.start, here.cycle.q)
    return None if point is None else point._replace(tangent=here.tangent)


def _reached_origin(problem: ContinuationProblem, here: BranchPoint, point: BranchPoint) -> Algorithm[str]:
    """The kind of the special point from which the branch emanates, if it has reached one behind `here`; else ""."""
    if not here.is_wave and point.wave is not None and point.wave.residual <= HALF_PERIOD_RESIDUAL:
        return "localisation"
    return "flip" if (yield from _closes_in_half_period(problem, point)) else ""


def _closes_in_half_period(problem: ContinuationProblem, point: BranchPoint) -> Algorithm[bool]:
    """Whether the orbit closes in half its period: the branch has reached the flip from which it emanates."""
    q = point.cycle.q
    if q % 2:
        return False
    half = yield from closed_orbit(point.cycle.scene, point.cycle.start, q // 2, problem.aim, max_updates=0)
    return half.residual <= HALF_PERIOD_RESIDUAL


def _is_same_point(a: BranchPoint, b: BranchPoint, step: float) -> bool:
    return bool(np.linalg.norm(a.y - b.y) < step and a.tangent @ b.tangent > MIN_TANGENT_COSINE)


def emanating_multiplier(origin: BranchPoint) -> float:
    """The multiplier of the period, -1 or 1, with which another branch emanates from a special point; else 0.

    Where a pair breaks a travelling wave, no branch of orbits begins.
    """
    if origin.kind == "flip":
        return -1.0
    if origin.kind != "localisation":
        return 0.0
    near = (target for target in (-1.0, 1.0) if np.abs(origin.cycle.others - target).min() <= MAX_MULTIPLIER_MISS)
    return next(near, 0.0)


def emanating_point(problem: ContinuationProblem, origin: BranchPoint) -> Algorithm[BranchPoint | None]:
    """The first point of the branch that emanates from a flip, with twice the period, or from a broken wave.

    Where two multipliers are at the target at once, several branches may begin: the least unstable of those is taken
    that are found.
    """
    target = emanating_multiplier(origin)
    found = []
    q = origin.cycle.q * (2 if target == -1.0 else 1)
    for direction in _eigenvectors(problem, origin, target):
        if target == -1.0:
            direction -= (direction @ origin.tangent) * origin.tangent
        direction /= np.linalg.norm(direction)
        guess = origin.y + DOUBLING_STEP * direction
        point = yield from corrected_point(problem, guess, direction, origin.cycle.start, q)
        if point is not None and np.linalg.norm(point.y - guess) <= 3 * DOUBLING_STEP:
            found.append(point)
    return min(found, key=lambda point: np.abs(point.multipliers).max(), default=None)


def _eigenvectors(problem: ContinuationProblem, point: BranchPoint, target: float) -> list[np.ndarray]:
    """The directions (numbers + 1,) that the map stretches by the multiplier next to a target; free sliders are held.

    There is one; if two multipliers are there at once, there is a plane of them, of which evenly spread ones are given.
    """
    tangents = point.cycle.jacobian
    assert tangents is not None  # points have orbits
    moves = determined(len(problem.units), np.array(point.free))
    by_state = tangents.by_state * problem.units / problem.units[:, None]
    system = by_state[np.ix_(moves, moves)]
    values, vectors = np.linalg.eig(system)
    miss = np.abs(values - target)
    stretched = [np.real(vectors[:, miss.argmin()])]
    if np.sort(miss)[1] <= MAX_MULTIPLIER_MISS:
        plane = np.linalg.svd(system - target * np.eye(len(system)))[2][-2:]
        turns = np.pi * np.arange(PLANE_DIRECTIONS) / PLANE_DIRECTIONS
        stretched = [np.cos(turn) * plane[0] + np.sin(turn) * plane[1] for turn in turns]
    directions = np.zeros((len(stretched), len(problem.units) + 1))
    directions[:, moves] = stretched
    return list(directions)


class ContinuedBranch(NamedTuple):
    """A branch in order of its arc length; the orbit jumps between a point of kind "jump" and the previous one."""

    points: list[BranchPoint]
    ends: tuple[str, str]
    touches: list[ContactSummary]


def branches_from(
    problem: ContinuationProblem, first: BranchPoint, max_points: int, doublings: int, progress: StagedProgress
) -> list[ContinuedBranch]:
    """The branch through a point, and those that emanate from its flips and broken waves, and from theirs ..."""
    backward = first._replace(tangent=-first.tangent)
    both = [continue_branch(problem, first, max_points), continue_branch(problem, backward, max_points)]
    arcs = run_together(both, progress.stage(), _periods_of_arc(max_points, first.cycle.q))
    branches = [joined_arcs(*(_unless_failed(arc, Arc([first], "lost")) for arc in arcs))]
    latest = branches
    for _ in range(doublings):
        origins = [
            p for points, _ in latest for p in points if emanating_multiplier(p) and 2 * p.cycle.q <= LARGEST_PERIOD
        ]
        latest = _emanating_branches(problem, origins, max_points, progress)
        branches += latest
    return _with_grazings(problem, branches, progress)


def joined_arcs(forward: Arc, backward: Arc) -> tuple[list[BranchPoint], tuple[str, str]]:
    """The branch through the first point of two arcs, and its ends; of a closed one either arc is the whole."""
    for arc in (forward, backward):
        if arc.end == "closed":
            return arc.points, ("closed", "closed")
    return _reversed(backward.points) + forward.points[1:], (backward.end, forward.end)


def _periods_of_arc(max_points: int, q: int) -> int:
    """An estimate of the drive periods that an arc of orbits of `q` periods takes."""
    return DERIVATIVES_OF_POINT * min(max_points, USUAL_POINTS) * q


def _emanating_branches(
    problem: ContinuationProblem, origins: list[BranchPoint], max_points: int, progress: StagedProgress
) -> list[tuple[list[BranchPoint], tuple[str, str]]]:
    """The branches that emanate from special points; one that joins two is continued from both, and kept once."""
    q = 2 * max((origin.cycle.q for origin in origins), default=0)
    seeking = [emanating_point(problem, origin) for origin in origins]
    starts = run_together(seeking, progress.stage(), DERIVATIVES_OF_POINT * q)
    pairs = [(origin, p) for origin, p in zip(origins, starts, strict=True) if isinstance(p, BranchPoint)]
    following = [continue_branch(problem, p, max_points) for _, p in pairs]
    arcs = run_together(following, progress.stage(), _periods_of_arc(max_points, q))
    branches: list[tuple[list[BranchPoint], tuple[str, str]]] = []
    for (origin, first), arc in zip(pairs, arcs, strict=True):
        branch = _unless_failed(arc, Arc([first], "lost"))
        joins = [points[-1].value for points, ends in branches if ends[1] == origin.kind]
        if not any(abs(value - origin.value) <= SAME_FLIP * problem.width for value in joins):
            branches.append((branch.points, (origin.kind, branch.end)))
    return branches


def _unless_failed(result: T | Exception, otherwise: T) -> T:
    """The result, or `otherwise` if an error ended the algorithm."""
    return otherwise if isinstance(result, Exception) else result


def _reversed(points: list[BranchPoint]) -> list[BranchPoint]:
    """The points in reverse order, with the jumps marked at their other ends."""
    kinds = [p.kind for p in points]
    for i in range(1, len(points)):
        if kinds[i] == "jump":
            kinds[i], kinds[i - 1] = "", "jump"
    return [p._replace(kind=kind) for p, kind in zip(points, kinds, strict=True)][::-1]


def _with_grazings(
    problem: ContinuationProblem,
    branches: list[tuple[list[BranchPoint], tuple[str, str]]],
    progress: StagedProgress,
) -> list[ContinuedBranch]:
    """The branches with their grazing points, and the contact summaries of all points."""
    touches = [_contacts_of_all(points, progress) for points, _ in branches]
    places = [
        (b, i)
        for b, (points, _) in enumerate(branches)
        for i, ((_, there), (a, z)) in enumerate(zip(pairwise(points), pairwise(touches[b]), strict=True), 1)
        if a.onsets != z.onsets and there.kind != "jump"
    ]
    q = max((branches[b][0][i].cycle.q for b, i in places), default=0)
    locating = [grazing_point(problem, *branches[b][0][i - 1 : i + 1]) for b, i in places]
    located = run_together(locating, progress.stage(), DERIVATIVES_OF_SPECIAL_POINT * q)
    grazings = [(b, i, p) for (b, i), p in zip(places, located, strict=True) if isinstance(p, BranchPoint)]
    for (b, i, point), touch in zip(
        grazings[::-1], _contacts_of_all([p for _, _, p in grazings], progress)[::-1], strict=True
    ):
        branches[b][0].insert(i, point)
        touches[b].insert(i, touch)
    return [ContinuedBranch(points, ends, touch) for (points, ends), touch in zip(branches, touches, strict=True)]


def with_errors(
    branches: list[ContinuedBranch], fine_problem: ContinuationProblem, progress: StagedProgress
) -> list[ContinuedBranch]:
    """The branches with the errors of their bifurcations, by a finer march."""
    places = [
        (b, i)
        for b, branch in enumerate(branches)
        for i, point in enumerate(branch.points)
        if point.kind in MULTIPLIER_KINDS and 0 < i < len(branch.points) - 1
    ]
    q = max((branches[b].points[i].cycle.q for b, i in places), default=0)
    locating = [finer_value(fine_problem, *branches[b].points[i - 1 : i + 2]) for b, i in places]
    values = run_together(locating, progress.stage(), DERIVATIVES_OF_SPECIAL_POINT * q)
    for (b, i), value in zip(places, values, strict=True):
        point = branches[b].points[i]
        error = np.nan if isinstance(value, Exception) else abs(value - point.value)
        branches[b].points[i] = point._replace(error=error)
    return branches


def _contacts_of_all(points: list[BranchPoint], progress: StagedProgress) -> list[ContactSummary]:
    q = max((point.cycle.q for point in points), default=0)
    summaries = run_together([contact_summary(point) for point in points], progress.stage(), q)
    return [one for one in summaries if not isinstance(one, Exception)]
