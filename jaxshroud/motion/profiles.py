"""Profiles of chi^2: its least value at values of one number, all others fitted anew, and the intervals of numbers."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.descents import Points, descend_together
from jaxshroud.motion.estimation import Estimate

WIDE_INTERVAL = 0.1  # half width of an interval, over the range of its number, from which it is found by profile
CONFOUNDED = 0.99  # correlation from which two numbers cannot be told from one another
NONLINEAR = 0.3  # departure of a profile's ends from the linear interval, over its half width, that is told
AT_BOUND = 1e-3  # distance from a bound, over the range, at which a number ends at it
WIDEST_STEP = 0.25  # from node to node, over the range
NODES = (0.5, 1.0, 1.5, 2.0, 2.5, 4.0, 8.0, 16.0, 32.0, 64.0)  # over the half width of the linear interval
NODE_STEPS = 10  # down chi^2 at a node
MOST_REFINEMENTS = 4  # of a profile where it crosses its limit
COARSE = 0.1  # distance of that from the next node, in chi^2 and over the half width, from which there is one more
ENOUGH_OF_CHI2 = 1e-3  # of its rise at the ends of an interval
DEEPER = 0.01  # the same of a place that is better than the fit


class NumberInterval(NamedTuple):
    """The 95 % interval of one number, in the unit cube."""

    low: float
    high: float
    by: str  # "jacobian" or "profile"
    open: tuple[bool, bool] = (False, False)  # whether the data leave an end at the bound


class _Side:
    """A profile on one side of the best fit, node by node outwards."""

    def __init__(self, i: int, sign: int, u: np.ndarray, limit: float, half: float, ridge: np.ndarray):
        self.i, self.sign, self.limit, self.half, self.ridge = i, sign, limit, half, ridge
        self.nodes = [(u, 0.0)]  # places, and how far chi^2 is above that of the fit

    @property
    def goes_on(self) -> bool:
        """Whether chi^2 has not risen to its limit yet, nor the number reached its bound."""
        u, excess = self.nodes[-1]
        to_bound = u[self.i] if self.sign < 0 else 1.0 - u[self.i]
        return excess <= self.limit and float(to_bound) > 0.0

    def next_start(self, reach: float) -> np.ndarray:
        """Where the others begin at the next node: along the line through the latest two, or the linear ridge."""
        value = float(np.clip(self.nodes[0][0][self.i] + self.sign * reach * self.half, 0.0, 1.0))
        latest, along = self.nodes[-1][0], self.ridge
        if len(self.nodes) > 1:
            rise = latest - self.nodes[-2][0]
            along = rise / rise[self.i]
        u = np.clip(latest + along * (value - latest[self.i]), 0.0, 1.0)
        u[self.i] = value
        return u

    @property
    def crossing(self) -> int | None:
        """The first node at which chi^2 is above its limit; None if there is none."""
        return next((n for n, (_, excess) in enumerate(self.nodes) if excess > self.limit), None)

    def between(self, least: float = 0.0) -> np.ndarray:
        """The place before it where chi^2 crosses its limit, its root taken as linear, `least` of the way from both."""
        assert self.crossing is not None
        (before, low), (beyond, high) = self.nodes[self.crossing - 1 : self.crossing + 1]
        root, first, last = (math.sqrt(max(a, 0.0)) for a in (self.limit, low, high))
        share = (root - first) / (last - first)
        return before + min(max(share, least), 1 - least) * (beyond - before)

    @property
    def is_coarse(self) -> bool:
        """Whether chi^2 crosses its limit far from any node."""
        if self.crossing is None:
            return False
        (before, low), (beyond, high) = self.nodes[self.crossing - 1 : self.crossing + 1]
        is_wide = abs(float(beyond[self.i] - before[self.i])) > COARSE * self.half
        return is_wide and min(self.limit - low, high - self.limit) > COARSE * self.limit

    @property
    def end(self) -> tuple[float, bool]:
        """Where chi^2 crosses its limit, and whether the data leave that end at the bound."""
        is_open = self.crossing is None
        return float((self.nodes[-1][0] if is_open else self.between())[self.i]), is_open


class ProfiledNumber(NamedTuple):
    """The profile of one number."""

    low: _Side
    high: _Side
    half: float  # width of half the interval of the fit made linear
    confounded: bool  # whether it cannot be told from another number

    @property
    def nodes(self) -> list[tuple[np.ndarray, float]]:
        """The places, and how far chi^2 is above that of the fit; the number grows."""
        return [*self.low.nodes[:0:-1], *self.high.nodes]

    @property
    def value(self) -> float:
        """The number at the fit."""
        return float(self.low.nodes[0][0][self.low.i])

    @property
    def linear(self) -> tuple[float, float]:
        """The interval of the fit made linear."""
        return self.value - self.half, self.value + self.half

    @property
    def is_bent(self) -> bool:
        """Whether an end of the profile departs from the linear interval, where that is within the bounds."""
        low, high = self.linear
        away = [abs(self.low.end[0] - max(low, 0.0)), abs(self.high.end[0] - min(high, 1.0))]
        return float(max(away)) > NONLINEAR * self.half

    @property
    def interval(self) -> NumberInterval:
        """The 95 % interval: of the linear model, or by profile where that is wide, confounded or not linear."""
        (first, first_open), (last, last_open) = self.low.end, self.high.end
        at_bound = not AT_BOUND < self.value < 1 - AT_BOUND
        is_wide = self.half > WIDE_INTERVAL
        if is_wide or self.confounded or at_bound or first_open or last_open or self.is_bent:
            return NumberInterval(first, last, "profile", (first_open, last_open))
        return NumberInterval(*self.linear, "jacobian")


def _unprofiled(found: Estimate, i: int) -> ProfiledNumber:
    """The profile of a number, of which nothing but the fit is known yet."""
    half, covariance = float(found.half_widths[i]), found.covariance
    common = found.u, found.limit, min(half, WIDEST_STEP), covariance[:, i] / covariance[i, i]
    correlation = float(np.max(np.abs(np.delete(found.correlation[i], i)), initial=0.0))
    return ProfiledNumber(_Side(i, -1, *common), _Side(i, 1, *common), half, correlation > CONFOUNDED)


def profiles(found: Estimate) -> list[ProfiledNumber]:
    """The profiles of all numbers, whose nodes are computed together."""
    numbers = [_unprofiled(found, i) for i in range(len(found.u))]
    every = [side for number in numbers for side in (number.low, number.high)]
    for reach in NODES:
        going = [side for side in every if side.goes_on]
        _add_nodes(found, going, [side.next_start(reach) for side in going], [len(side.nodes) for side in going])
    for _ in range(MOST_REFINEMENTS):
        coarse = [side for side in every if side.is_coarse]
        _add_nodes(found, coarse, [side.between(0.2) for side in coarse], [side.crossing for side in coarse])
    return numbers


def _add_nodes(found: Estimate, sides: list[_Side], starts: list[np.ndarray], places: Sequence[int | None]) -> None:
    """Insert nodes into profiles at their places, the other numbers fitted anew from `starts`."""
    if not sides:
        return
    misfit = found.misfit
    free = np.array([np.arange(len(found.u)) != side.i for side in sides])
    points = Points.at(misfit, np.array(starts))
    points = descend_together(misfit, points, misfit.samples, NODE_STEPS, ENOUGH_OF_CHI2 * found.limit, free)
    for side, place, u, chi2 in zip(sides, places, points.u, points.chi2(misfit.size), strict=True):
        assert place is not None
        side.nodes.insert(place, (u, float(chi2) - found.chi2))


def better_place(found: Estimate, numbers: Sequence[ProfiledNumber]) -> np.ndarray | None:
    """A place on the profiles where chi^2 is less than at the fit, which is then no minimum; None if there is none."""
    u, excess = min((node for number in numbers for node in number.nodes), key=lambda node: node[1])
    return u if excess < -DEEPER * found.limit else None
