"""What data say of the numbers of a fit, and what they do not: which are determined, and why others are not."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.motion.estimation import Estimate, Minimum
from jaxshroud.motion.profiles import AT_BOUND, CONFOUNDED, WIDE_INTERVAL, NumberInterval, ProfiledNumber
from jaxshroud.motion.searches import APART_PLACES

NO_INFLUENCE = 1.0  # change of all data over their noise that a number makes across its range
SENSITIVITY_GROWTH = (
    1e3  # of derivatives from the first half of a history to the second, from which its end is in doubt
)
BENT = "the model is not linear within the intervals, which are found by profile"
ILL_FIT = 4.0  # standard deviations of chi^2 above its expectation
BY_NEIGHBOURS = 1.8  # how much larger these are where the noise is that of neighbouring residuals
CONTRAST = 1e-4  # probability with which the halves of white noise differ as much
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
) -> Findings:
    """What the data determine. Of a time history doubts of the fit as a whole take back all intervals.

    Args:
        found: The fit.
        keys: Its numbers.
        profiled: Their profiles.
        values: The numbers of a place.
        is_history: Whether the data are a time history.
    """
    ends = [number.interval for number in profiled]
    doubts = [*_silence(found), *_doubts_of_residuals(found, is_history), *_doubts_of_search(found)]
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
    return Findings([not (one or (is_history and doubts)) for one in lost], notes)


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


def _silence(found: Estimate) -> list[str]:
    silent = int(np.sum(~found.known))
    if not silent:
        return []
    return [
        f"of {silent} of {found.known.size} values the fitted scene says nothing: it stops, or finds no orbit there"
    ]


def _doubts_of_residuals(found: Estimate, is_history: bool) -> list[str]:
    """Why the residuals are no white noise of the size that is known, or that neighbours have."""
    said, data = [], found.misfit.data
    is_tested = data.sigma_is_known or is_history
    spread = math.sqrt(2 / found.freedom) * (1.0 if data.sigma_is_known else BY_NEIGHBOURS)
    if is_tested and found.chi2 / found.freedom - 1 > ILL_FIT * spread:
        factor, of = math.sqrt(found.chi2 / found.freedom), "is stated" if data.sigma_is_known else "neighbours have"
        said.append(f"the residuals are {factor:.3g} times the noise that {of}: intervals are too narrow")
    residuals = found.residuals.reshape(data.values.shape)
    correlation = lag_correlation(residuals)
    if correlation > random_limit(residuals.size):
        said.append(
            f"neighbouring residuals are alike (correlation {correlation:.2f}): model and data differ by more than "
            "noise, and intervals are too narrow"
        )
    if is_history and _halves_differ(residuals):
        said.append("the residuals of one half of the record are larger than those of the other: they are no noise")
    return said


def _halves_differ(residuals: np.ndarray) -> bool:
    """Whether the residuals (n, channels) of one half are larger by more than noise is, by the F test."""
    from scipy.stats import f

    first, second = (part.ravel() for part in np.array_split(residuals, 2))
    squares = [float(np.mean(part**2)) for part in (first, second)]
    limit = float(f(first.size, second.size).isf(CONTRAST / 2))
    return min(squares) > 0 and max(squares) / min(squares) > limit


def _growing(found: Estimate) -> list[str]:
    rows = np.linalg.norm(found.jacobian.reshape(len(found.misfit.data.values), -1), axis=1)
    first, second = (float(np.max(part, initial=0.0)) for part in np.array_split(rows, 2))
    if second <= SENSITIVITY_GROWTH * first:
        return []
    return [f"derivatives grow {second / max(first, 1e-300):.1e}-fold along the record, as in chaos: use less of it"]


def lag_correlation(residuals: np.ndarray) -> float:
    """The correlation of each residual with the next of its channel, (n, c); 0 of white noise."""
    power = float(np.sum(residuals**2))
    return float(np.sum(residuals[1:] * residuals[:-1])) / power if power > 0 else 0.0


def random_limit(count: int) -> float:
    """The correlation of neighbours that white noise exceeds once in some hundred times."""
    return 2.6 / math.sqrt(count)
