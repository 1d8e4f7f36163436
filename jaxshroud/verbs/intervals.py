"""How far each number of a design may go, the others fixed, before too much of P_d is lost.

P_d jumps where one kind of motion ends, so that no slope tells how far: values are looked at, many at once. What is
looked at closes in on the interval until half of it at least lies within; then its ends are looked at closer. Losses
that begin and end between two neighbouring values are not seen.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.runs import Tick
from jaxshroud.results.tuned import ENDED_BY, Judged
from jaxshroud.verbs.design import Problem, judge_designs

PLACES = 65  # values looked at each time
ROUNDS = 8  # of closing in, at most: each finds intervals 32 times narrower
CLOSER = (16, 16)  # values between an end and what lies beyond, one time after the other
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
    why: np.ndarray  # BOUND where nothing is wrong

    def more(self, u: np.ndarray, judge: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> "Looked":
        """With further values, each looked at once."""
        new = np.setdiff1d(u, self.u)
        if not new.size:
            return self
        both = [np.concatenate(pair) for pair in zip(self, (new, *judge(new)), strict=True)]
        order = np.argsort(both[0])
        return Looked(*(a[order] for a in both))

    def around(self, at: float) -> tuple[int, int]:
        """Places of the outermost values that do, with none between them and `at` that does not."""
        middle = int(np.searchsorted(self.u, at))
        wrong = np.flatnonzero(self.why != BOUND)
        return int(max(wrong[wrong <= middle], default=-1)) + 1, int(
            min(wrong[wrong >= middle], default=self.u.size)
        ) - 1


def interval_of(problem: Problem, design: np.ndarray, i: int, own: Judged, most: float, tick: Tick) -> Interval:
    """How far number `i` of a design may go before `most` percentage points are lost in any condition.

    A design that is wrong itself, by its limits, has an interval without width.
    """
    at = float(np.clip(problem.cube(design)[i], 0.0, 1.0))

    def values(u: np.ndarray) -> np.ndarray:
        return np.where(u == at, design[i], problem.values(np.tile(u[:, None], len(design)))[:, i])

    def judge(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        designs = np.tile(design, (u.size, 1))
        designs[:, i] = values(u)
        judged = judge_designs(problem, designs, tick)
        with np.errstate(invalid="ignore"):  # of what stops
            loss = (own.P_d - judged.P_d).max(axis=1)
        wrong = [~np.isfinite(judged.objective), ~judged.keeps(), ~(loss <= most)]
        return loss, np.select(wrong, [STOP, LIMIT, LOSS], BOUND)

    looked = Looked(*(np.empty(0),) * 3).more(np.array([at]), judge)
    if looked.why[0] == BOUND:
        looked = _closer(_closed_in(looked, at, judge), at, judge)
    return _told(looked._replace(u=values(looked.u)), design[i])


def _closed_in(looked: Looked, at: float, judge: Callable) -> Looked:
    """With values all over the interval, half of `PLACES` at least."""
    low, high = 0.0, 1.0
    for _ in range(ROUNDS):
        looked = looked.more(np.linspace(low, high, PLACES), judge)
        first, last = looked.around(at)
        width, (low, high) = high - low, looked.u[[max(first - 1, 0), min(last + 1, looked.u.size - 1)]]
        if high - low > width / 2:
            break
    return looked


def _closer(looked: Looked, at: float, judge: Callable) -> Looked:
    """With values between each end and what lies beyond."""
    for n in CLOSER:
        first, last = looked.around(at)
        gaps = [i for i in (first - 1, last) if 0 <= i < looked.u.size - 1]
        between = [np.linspace(looked.u[i], looked.u[i + 1], n + 2)[1:-1] for i in gaps]
        looked = looked.more(np.concatenate([[at], *between]), judge)
    return looked


def _told(looked: Looked, at: float) -> Interval:
    first, last = looked.around(at)
    if last < first:  # the design itself is wrong, and nothing else was looked at
        return Interval(looked.u[[0, 0]], looked.u[[0, 0]], looked.why[[0, 0]], 0.0, looked.u, looked.loss)
    outside = [(first - 1, first > 0), (last + 1, last < looked.u.size - 1)]
    beyond = np.array([looked.u[i] if there else np.nan for i, there in outside])
    why = np.array([looked.why[i] if there else BOUND for i, there in outside], int)
    apart = float(np.diff(looked.u[first : last + 1]).max(initial=0.0))
    return Interval(looked.u[[first, last]], beyond, why, apart, looked.u, looked.loss)
