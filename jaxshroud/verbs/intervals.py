"""How far each number of a design may go, the others fixed, before too much of P_d is lost or a limit is exceeded.

P_d jumps where one kind of motion ends, and is rough in chaos; no slope tells how far. Values are looked at, many at
once: they close in on the interval until half of them at least lie within. Then its ends are looked at closer, and so
is what comes near to what is allowed, measured by how much it varies between neighbours. At last the whole interval is
looked at in other places, twice as many each time, until that finds nothing. Losses that begin and end between two
neighbouring values are not seen.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.runs import Tick
from jaxshroud.results.tuned import ENDED_BY, Judged
from jaxshroud.verbs.design import Problem, judge_designs

PLACES = 65  # values looked at each time
ROUNDS = 8  # of closing in, at most: each finds intervals 32 times narrower
AUDITS = 4  # looks at the whole interval in other places, at most
CLOSER, BETWEEN, MOST = 3, 7, 64  # rounds of looking closer, values between two neighbours, and pairs of these at most
BOUND, LOSS, LIMIT, STOP = range(len(ENDED_BY))


class Interval(NamedTuple):
    """Where one number may be, in SI units, and all that was looked at."""

    ends: np.ndarray  # (2,) the outermost values that do
    beyond: np.ndarray  # (2,) the next ones looked at, which do not; NaN at a bound
    ended_by: np.ndarray  # (2,) one of `ENDED_BY`
    apart: float  # largest distance between neighbours within
    looked: np.ndarray  # (n,) sorted
    loss: np.ndarray  # (n,) of P_d, in the condition that loses most [percentage points]


class Looked(NamedTuple):
    """Values of one number that were looked at, sorted."""

    u: np.ndarray
    loss: np.ndarray
    used: np.ndarray  # share of what is allowed, of loss or of a limit, whichever is more
    why: np.ndarray  # BOUND where nothing is wrong

    def around(self, at: float) -> tuple[int, int]:
        """Places of the outermost values that do, with none between them and `at` that does not."""
        middle, wrong = np.searchsorted(self.u, at), np.flatnonzero(self.why != BOUND)
        below, above = wrong[wrong <= middle], wrong[wrong >= middle]
        return int(below.max(initial=-1)) + 1, int(above.min(initial=self.u.size)) - 1


Look = Callable[[Looked, np.ndarray], Looked]  # what is known with further values


def interval_of(problem: Problem, design: np.ndarray, i: int, own: Judged, most: float, tick: Tick) -> Interval:
    """How far number `i` of a design may go before `most` percentage points are lost in any condition.

    A design that is wrong itself, by its limits, has an interval without width.
    """
    at = float(np.clip(problem.cube(design)[i], 0.0, 1.0))

    def values(u: np.ndarray) -> np.ndarray:
        return np.where(u == at, design[i], problem.values(np.tile(u[:, None], len(design)))[:, i])

    def look(known: Looked, u: np.ndarray) -> Looked:
        new = np.setdiff1d(u, known.u)
        if not new.size:
            return known
        designs = np.tile(design, (new.size, 1))
        designs[:, i] = values(new)
        found = _judged(problem, judge_designs(problem, designs, tick), own, most)
        both = [np.concatenate(pair) for pair in zip(known, (new, *found), strict=True)]
        return Looked(*(a[np.argsort(both[0])] for a in both))

    looked = look(Looked(*(np.empty(0),) * 4), np.array([at]))
    if looked.why[0] == BOUND:
        looked = _audited(_closer(_closed_in(looked, at, look), at, look), at, look)
    return _told(looked._replace(u=values(looked.u)), design[i])


def _judged(problem: Problem, judged: Judged, own: Judged, most: float) -> tuple[np.ndarray, ...]:
    """Loss, share of what is allowed, and what is wrong."""
    with np.errstate(invalid="ignore"):  # of what stops
        loss = (own.P_d - judged.P_d).max(axis=1)
        limits = np.maximum(judged.v_max / problem.most_penetration, judged.force / problem.most_force)
    wrong = [~np.isfinite(judged.objective), ~(limits <= 1), ~(loss <= most)]
    used = np.where(wrong[0], np.inf, np.maximum(loss / most, limits))
    return loss, used, np.select(wrong, [STOP, LIMIT, LOSS], BOUND)


def _closed_in(looked: Looked, at: float, look: Look) -> Looked:
    """With values all over the interval, half of `PLACES` at least."""
    low, high = 0.0, 1.0
    for _ in range(ROUNDS):
        looked = look(looked, np.linspace(low, high, PLACES))
        first, last = looked.around(at)
        width, (low, high) = high - low, looked.u[[max(first - 1, 0), min(last + 1, looked.u.size - 1)]]
        if high - low > width / 2:
            break
    return looked


def _closer(looked: Looked, at: float, look: Look) -> Looked:
    """With values between each end and what lies beyond, and where it comes near to what is allowed."""
    for _ in range(CLOSER):
        pairs = _doubtful(looked, at)
        between = [np.linspace(looked.u[i], looked.u[i + 1], BETWEEN + 2)[1:-1] for i in pairs]
        looked = look(looked, np.concatenate([[at], *between]))
    return looked


def _audited(looked: Looked, at: float, look: Look) -> Looked:
    """With other values all over the interval, until these find nothing wrong."""
    for i in range(AUDITS):
        ends, n = looked.u[list(looked.around(at))], PLACES << i
        looked = _closer(look(looked, ends[0] + (ends[1] - ends[0]) * (np.arange(n) + 0.5) / n), at, look)
        if np.ptp(ends) - np.ptp(looked.u[list(looked.around(at))]) < np.ptp(ends) / n:
            break
    return looked


def _doubtful(looked: Looked, at: float) -> list[int]:
    """The left of each pair of neighbours between which more may be used than is allowed, the likeliest `MOST`.

    It may where the most that is used nearby, and as much again as it varies there, is more than is allowed.
    """
    first, last = looked.around(at)
    used, size = looked.used, looked.u.size
    worst = {i: np.inf for i in (first - 1, last) if 0 <= i < size - 1}
    for i in range(first, last):
        near = used[max(i - 1, first) : min(i + 3, last + 1)]
        worst[i] = 2 * near.max() - near.min()
    return sorted(worst, key=lambda i: -worst[i])[: sum(w > 1 for w in worst.values())][:MOST]


def _told(looked: Looked, at: float) -> Interval:
    first, last = looked.around(at)
    if last < first:  # the design itself is wrong, and nothing else was looked at
        return Interval(looked.u[[0, 0]], looked.u[[0, 0]], looked.why[[0, 0]], 0.0, looked.u, looked.loss)
    outside = [(first - 1, first > 0), (last + 1, last < looked.u.size - 1)]
    beyond = np.array([looked.u[i] if there else np.nan for i, there in outside])
    why = np.array([looked.why[i] if there else BOUND for i, there in outside], int)
    apart = float(np.diff(looked.u[first : last + 1]).max(initial=0.0))
    return Interval(looked.u[[first, last]], beyond, why, apart, looked.u, looked.loss)
