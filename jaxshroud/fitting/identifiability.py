"""What data say of the numbers of a fit, and what they do not: which are determined, and why others are not.

Profiles of chi^2: its least value at values of one number, all others fitted anew.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.fitting.least_squares import Estimate, Minimum, Points, descend_together
from jaxshroud.fitting.noise import halves_differ, is_contradicted, lag_correlation, random_limit
from jaxshroud.fitting.searches import APART_PLACES

WIDE_INTERVAL = 0.1  # half width of an interval, over the range of its number, from which it is found by profile
CONFOUNDED = 0.99  # correlation from which two numbers cannot be told from one another
CURVED = 0.05  # departure of a profile's ends from the linear interval, over its half width, from which they count
NONLINEAR = 0.3  # departure of a profile's ends from the linear interval, over its half width, that is reported
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
        latest = self.nodes[-1][0]
        along = self.ridge
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
    def departure(self) -> float:
        """How far an end of the profile is from that of the linear interval within the bounds, over its half width."""
        low, high = self.linear
        away = [abs(self.low.end[0] - max(low, 0.0)), abs(self.high.end[0] - min(high, 1.0))]
        return float(max(away)) / self.half

    @property
    def is_bent(self) -> bool:
        """Whether the profile departs so far from the linear interval that this is said."""
        return self.departure > NONLINEAR

    @property
    def interval(self) -> NumberInterval:
        """The 95 % interval: of the linear model, or by profile where that is wide, confounded or not linear."""
        (first, first_open), (last, last_open) = self.low.end, self.high.end
        at_bound = not AT_BOUND < self.value < 1 - AT_BOUND
        is_wide, is_curved = self.half > WIDE_INTERVAL, self.departure > CURVED
        if is_wide or self.confounded or at_bound or first_open or last_open or is_curved:
            return NumberInterval(first, last, "profile", (first_open, last_open))
        low, high = self.linear
        return NumberInterval(low, high, "jacobian")


def _unprofiled(found: Estimate, i: int) -> ProfiledNumber:
    """The profile of a number, of which nothing but the fit is known yet."""
    half = float(found.half_widths[i])
    covariance = found.covariance
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


NO_INFLUENCE = 1.0  # change of all data over their noise that a number makes across its range
SENSITIVITY_GROWTH = (
    1e3  # of derivatives from the first half of a history to the second, from which its end is in doubt
)
BENT = "the model is not linear within the intervals, which are found by profile"
MARCH_ERROR = 0.1  # of the march in a number, over the half width of its interval, from which it counts
NARROWEST_PROFILE, WIDEST_PROFILE = 0.4, 2.5  # widths of an interval by profile over that of the linear one

NumbersAt = Callable[[np.ndarray], np.ndarray]  # places (n, keys) in the unit cube -> numbers in SI units


class Findings(NamedTuple):
    """What a fit determines."""

    determined: list[bool]  # of each number: whether its interval can be trusted
    notes: list[str]  # what should be known before the numbers are used; empty where there is no doubt


def findings(
    found: Estimate,
    keys: Sequence[str],
    profiled: Sequence[ProfiledNumber],
    values: NumbersAt,
    is_history: bool,
    march_error: float = 0.0,
) -> Findings:
    """What the data determine. A fit that the noise contradicts has no interval, nor a history's that is in doubt.

    Args:
        found: The fit.
        keys: Its numbers.
        profiled: Their profiles.
        values: The numbers of a place.
        is_history: Whether the data are a time history.
        march_error: How far the error of the march moves a number, over the half width of its interval.
    """
    ends = [number.interval for number in profiled]
    contradiction = _contradiction(found, is_history)
    doubts = [*contradiction, *_silence(found), *_doubts_of_residuals(found, is_history), *_doubts_of_search(found)]
    doubts += _doubts_of_march(march_error)
    reasons = [_undetermined(found, i, keys[i], ends[i], values) for i in range(len(keys))]
    if is_history:
        rough = [_roughness(found, i, keys[i], ends[i], values) for i in range(len(keys))]
        reasons = [reason or other for reason, other in zip(reasons, rough, strict=True)]
    alike = _as_good(found, ends)
    notes = [*filter(None, reasons), *_confounded(found, keys), *_other_minima(alike, keys, values), *doubts]
    notes += [BENT] if any(one.is_bent for one in profiled) else []
    notes += _growing(found) if is_history else []
    elsewhere = [is_history and any(_is_outside(end, m.u[i]) for m in alike) for i, end in enumerate(ends)]
    lost = [bool(reason) or other for reason, other in zip(reasons, elsewhere, strict=True)]
    nothing = contradiction or (is_history and doubts)
    return Findings([not (one or nothing) for one in lost], notes)


def _undetermined(found: Estimate, i: int, key: str, interval: NumberInterval, values: NumbersAt) -> str:
    """Why the data do not determine a number; empty if they do."""
    u = found.u[i]
    if found.influence[i] < NO_INFLUENCE:
        return f"the data do not depend on {key} here"
    if all(interval.open):
        return f"the data leave {key} open within its bounds"
    if not AT_BOUND < u < 1 - AT_BOUND:
        return f"{key} ends at its bound; widen it"
    low, high = _in_si(found, i, (interval.low, interval.high), values)
    if interval.open[0]:
        return f"the data do not bound {key} from below: 95 % below {high:.4g}"
    return f"the data do not bound {key} from above: 95 % above {low:.4g}" if interval.open[1] else ""


def _roughness(found: Estimate, i: int, key: str, interval: NumberInterval, values: NumbersAt) -> str:
    """What is said of a number whose interval by profile is of another size than the linear one."""
    ratio = (interval.high - interval.low) / (2 * found.half_widths[i])
    if NARROWEST_PROFILE <= ratio <= WIDEST_PROFILE:
        return ""
    low, high = _in_si(found, i, (interval.low, interval.high), values)
    return f"chi2 is no parabola along {key}, whose interval would be {low:.4g} to {high:.4g}"


def _in_si(found: Estimate, i: int, ends: Sequence[float], values: NumbersAt) -> list[float]:
    """Values of one number in SI units."""
    return values(np.array([np.where(np.arange(len(found.u)) == i, end, found.u) for end in ends]))[:, i].tolist()


def _confounded(found: Estimate, keys: Sequence[str]) -> list[str]:
    known = np.flatnonzero(found.influence >= NO_INFLUENCE).tolist()
    pairs = [(i, j) for i in known for j in known if i < j]
    of = {(i, j): float(found.correlation[i, j]) for i, j in pairs}
    return [
        f"{keys[i]} cannot be told from {keys[j]} here (correlation {r:+.4f})"
        for (i, j), r in of.items()
        if abs(r) > CONFOUNDED and max(found.half_widths[[i, j]]) > WIDE_INTERVAL
    ]


def _as_good(found: Estimate, ends: Sequence[NumberInterval]) -> list[Minimum]:
    """The other minima that fit as well, and lie outside of the intervals of numbers on which the data depend."""
    felt = found.influence >= NO_INFLUENCE
    alike = [m for m in found.minima[1:] if m.chi2 < found.chi2 + found.limit]
    apart = [m for m in alike if np.max(np.abs(m.u - found.u)[felt], initial=0.0) > APART_PLACES]
    return [m for m in apart if any(_is_outside(ends[i], m.u[i]) for i in np.flatnonzero(felt).tolist())]


def _is_outside(interval: NumberInterval, u: float) -> bool:
    return not interval.low <= u <= interval.high


def _other_minima(alike: list[Minimum], keys: Sequence[str], values: NumbersAt) -> list[str]:
    if not alike:
        return []
    numbers = ", ".join(f"{key} = {v:.4g}" for key, v in zip(keys, values(alike[0].u[None])[0], strict=True))
    return [f"{len(alike)} of the starts end elsewhere and fit as well: there is more than one answer, also {numbers}"]


def _doubts_of_search(found: Estimate) -> list[str]:
    if found.searches == 1 or found.alike > 1:
        return []
    return [f"{found.searches} searches end in different places: there may be a better fit; give more points to scan"]


def _doubts_of_march(error: float) -> list[str]:
    if error <= MARCH_ERROR:
        return []
    return [f"the march's own error moves numbers by {error:.2g} of their intervals: ask for a finer method"]


def _silence(found: Estimate) -> list[str]:
    silent = int(np.sum(~found.known))
    if not silent:
        return []
    return [
        f"of {silent} of {found.known.size} values the fitted scene says nothing: it stops, or finds no orbit there"
    ]


def _contradiction(found: Estimate, is_history: bool) -> list[str]:
    """Why the residuals are larger than the noise that is known, or that neighbours of a history have."""
    known = found.misfit.data.sigma_is_known
    if not ((known or is_history) and is_contradicted(found.chi2, found.freedom)):
        return []
    factor = math.sqrt(found.chi2 / found.freedom)
    of = "is stated" if known else "neighbours have"
    return [f"the residuals are {factor:.3g} times the noise that {of}: no number is claimed"]


def _doubts_of_residuals(found: Estimate, is_history: bool) -> list[str]:
    """Why the residuals are no white noise."""
    said = []
    residuals = found.residuals.reshape(found.misfit.data.values.shape)
    correlation = lag_correlation(residuals)
    if correlation > random_limit(residuals.size):
        said.append(
            f"neighbouring residuals are alike (correlation {correlation:.2f}): model and data differ by more than "
            "noise, and intervals are too narrow"
        )
    if is_history and halves_differ(residuals):
        said.append("the residuals of one half of the record are larger than those of the other: they are no noise")
    return said


def _growing(found: Estimate) -> list[str]:
    rows = np.linalg.norm(found.jacobian.reshape(len(found.misfit.data.values), -1), axis=1)
    first, second = (float(np.max(part, initial=0.0)) for part in np.array_split(rows, 2))
    if second <= SENSITIVITY_GROWTH * first:
        return []
    return [f"derivatives grow {second / max(first, 1e-300):.1e}-fold along the record, as in chaos: use less of it"]
