"""What data say of the numbers of a fit, and what they do not, in sentences."""

from collections.abc import Sequence

import numpy as np

from jaxshroud.motion.estimation import (
    APART_MINIMA,
    CONFOUNDED,
    NO_INFLUENCE,
    NONLINEAR,
    PROFILE_TOLERANCE,
    Estimate,
    NumberInterval,
    lag_correlation,
    random_limit,
)

SENSITIVITY_GROWTH = (
    1e3  # of derivatives from the first half of a history to the second, from which its end is in doubt
)
BENT = "the model is not linear within the intervals, which are found by profile"
ILL_FIT = 4.0  # standard deviations of chi^2 above its expectation


def findings(
    found: Estimate, keys: Sequence[str], ends: Sequence[NumberInterval], departure: float, is_history: bool
) -> list[str]:
    """What should be known before the numbers are used; empty where all are determined by the data.

    Args:
        found: The fit.
        keys: Its numbers.
        ends: Their intervals.
        departure: From the linear model, see `linear_departure`.
        is_history: Whether the data are a time history.
    """
    return [
        *_undetermined(found, keys, ends),
        *_confounded(found, keys),
        *_other_minima(found),
        *_silence(found),
        *_doubts_of_residuals(found),
        *([BENT] if departure > NONLINEAR else []),
        *(_growing(found) if is_history else []),
    ]


def _undetermined(found: Estimate, keys: Sequence[str], ends: Sequence[NumberInterval]) -> list[str]:
    said = []
    for key, interval, influence, u in zip(keys, ends, found.influence, found.u, strict=True):
        if influence < NO_INFLUENCE:
            said.append(f"the data do not depend on {key} here")
        elif all(interval.open):
            said.append(f"the data leave {key} open within its bounds")
        elif u <= PROFILE_TOLERANCE or u >= 1 - PROFILE_TOLERANCE:
            said.append(f"{key} ends at its bound; widen it")
        elif any(interval.open):
            said.append(f"the data do not bound {key} from {'below' if interval.open[0] else 'above'}")
    return said


def _confounded(found: Estimate, keys: Sequence[str]) -> list[str]:
    known = np.flatnonzero(found.influence >= NO_INFLUENCE).tolist()
    pairs = [(i, j) for i in known for j in known if i < j]
    of = {(i, j): float(found.correlation[i, j]) for i, j in pairs}
    return [
        f"{keys[i]} cannot be told from {keys[j]} here (correlation {r:+.4f})"
        for (i, j), r in of.items()
        if abs(r) > CONFOUNDED
    ]


def _other_minima(found: Estimate) -> list[str]:
    felt = found.influence >= NO_INFLUENCE
    far = [m for m in found.minima[1:] if np.max(np.abs(m.u - found.u)[felt], initial=0.0) > APART_MINIMA]
    alike = [m for m in far if m.chi2 < found.chi2 + found.quantile**2]
    return [f"{len(alike)} of the starts end elsewhere and fit as well: there is more than one answer"] if alike else []


def _silence(found: Estimate) -> list[str]:
    silent = int(np.sum(~found.known))
    if not silent:
        return []
    return [
        f"of {silent} of {found.known.size} values the fitted scene says nothing: it stops, or finds no orbit there"
    ]


def _doubts_of_residuals(found: Estimate) -> list[str]:
    said, data = [], found.misfit.data
    excess = (found.chi2 / found.freedom - 1) / np.sqrt(2 / found.freedom)
    if data.sigma_is_known and excess > ILL_FIT:
        factor = np.sqrt(found.chi2 / found.freedom)
        said.append(f"the residuals are {factor:.3g} times the noise that is stated: intervals are too narrow")
    correlation = lag_correlation(found.residuals.reshape(data.values.shape))
    if correlation > random_limit(found.residuals.size):
        said.append(
            f"neighbouring residuals are alike (correlation {correlation:.2f}): model and data differ by more than "
            "noise, and intervals are too narrow"
        )
    return said


def _growing(found: Estimate) -> list[str]:
    rows = np.linalg.norm(found.jacobian.reshape(len(found.misfit.data.values), -1), axis=1)
    first, second = (float(np.max(part, initial=0.0)) for part in np.array_split(rows, 2))
    if second <= SENSITIVITY_GROWTH * first:
        return []
    return [f"derivatives grow {second / max(first, 1e-300):.1e}-fold along the record, as in chaos: use less of it"]
