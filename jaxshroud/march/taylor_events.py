"""Event location for power series: the first guard to rise through zero, by the polynomials of the guards.

Each guard is evaluated at the ends of the parts of a trial, and at the maximum of its cubic in between: a guard may
rise and fall back within a part. The root that seems to be the first is refined by Newton's method. If another guard,
which must have crossed before, is above zero there, the trial is rejected and the next one ends at this place, where
the order of the crossings is clear.

No trial is accepted in which a guard may have risen undetected. A guard differs from its cubic by no more than its
fourth derivative allows, which its coefficients bound. Where that leaves a doubt in the second part, the trial ends
with the first part; where it does so in the first part, the trial is rejected and the next one is a quarter as long.
The bound falls with the fourth power of the length: after at most seven such reductions it is less than the rounding
error of the guard, which does not count as a rise. A lane ends as TOO_MANY_EVENTS after more than 64 rejected trials
in a row.
"""

import math
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.event import any_of
from jaxshroud.march.locate import HermiteCubic, cubic_root, select
from jaxshroud.model.arithmetic import Scalar, filled, is_zero, times, traced_once, where
from jaxshroud.model.series import polynomial_value, polynomial_value_and_rate

TRIAL_PARTS = 2  # of a trial, at whose ends the guards are evaluated
RETURN_FACTOR = 2  # longest trial, in times that a guard takes to return to zero
ROOT_UPDATES = 3  # and one more, which shows that the root was found
# Delay of events, as a share of a trial, by the bytes of a number. The force jumps at loaded case switches: nearly
# parallel faces, with dozens of them, turned a delay of 2^-42 into an error of 1e-6.
EVENT_OVERSHOOT = {8: 2.0**-50, 4: 2.0**-18}
ROOT_TOLERANCE = {8: 2.0**-34, 4: 2.0**-14}  # of a trial: shorter Newton steps count as converged
MAX_ROOT_TRIES = 4  # to decide which guard is the first

Coefficients = tuple[Scalar, ...]


class TrialEvent(NamedTuple):
    """The event, if any, at which a trial ends."""

    end: Scalar  # the end of the trial [rad]
    which: Int[Array, ""]  # index of the guard
    fire: Bool[Array, ""]  # an event
    probe: Bool[Array, ""]  # the trial ends at a maximum that turned out to be below zero
    reject: Bool[Array, ""]  # the trial is rejected, and the next one ends here
    inside: Bool[Array, ""]  # the guard has fallen below zero again by the end


class TaylorSearch(NamedTuple):
    """The search of a lane inside its current step, with the outcome of the previous trial; of a row for each lane."""

    done: Scalar  # of the step
    cap: Scalar  # bound of the length of the trial after a rejected one [rad]
    recheck: Bool[Array, ""]  # guards may have jumped: a guard above zero is crossed at once,
    crossed: Any  # except for this kind, which was crossed at an interface just now; -1: none
    probing: Any  # the trial has ended at the maximum of a guard of an interface
    events: Int[Array, ""]  # in this step
    tries: Int[Array, ""]  # rejected trials in a row
    tolerance: Scalar  # last terms of the speeds over the largest speed
    turns: Any = None  # at each interface of a row whose blocks turn: changes of case within this step
    pending: Any = None  # at each interface of a row with derivatives: whether an event of this very instant is left

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent."""
        return (self.done,)


class _RootEstimate(NamedTuple):
    """An estimate of where a guard rises through zero."""

    at: Scalar
    low: Scalar  # the part's beginning
    which: Int[Array, ""]
    at_maximum: Bool[Array, ""]  # `at` is the maximum of the cubic
    rise: HermiteCubic


def first_event(guards: list[Coefficients], h: Scalar, probed: Bool[Array, ""], tries: Int[Array, ""]) -> TrialEvent:
    """The first event within `h` radians.

    Args:
        guards: The guards as polynomials.
        h: The length of the trial.
        probed: Whether the previous trial has ended at the maximum of a guard.
        tries: The number of rejected trials in a row.
    """
    guards = trimmed(guards, h)
    width = h * (1 / TRIAL_PARTS)
    size = h.dtype.itemsize
    found, estimate, (start, middle, last) = _first_crossing(guards, h, width, probed)
    s, missed, error = _refined_root(select_polynomial(guards, estimate.which), estimate, width)
    at_root = [polynomial_value_and_rate(g, s) for g in guards]
    other_above = any_of(((g > 0) & (estimate.which != i)) for i, (g, _) in enumerate(at_root))
    converged = missed | (jnp.abs(error) <= ROOT_TOLERANCE[size] * h)
    unclear = found & (other_above | ~converged) & (tries < MAX_ROOT_TRIES)

    in_first = found & (estimate.low == 0)
    end, part = where(found, s, h), where(in_first, s, width)
    at_part, at_end = select(in_first, at_root, middle), select(found, at_root, last)
    first_unsure = any_of(
        may_rise(a, b, part, fourth_derivative_bound(g, part)) for g, a, b in zip(guards, start, at_part, strict=True)
    )
    second_unsure = any_of(
        may_rise(a, b, end - part, fourth_derivative_bound(g, end))
        for g, a, b in zip(guards, at_part, at_end, strict=True)
    )

    reject = unclear | first_unsure
    shorter = second_unsure & ~reject
    whole = ~reject & ~shorter
    stop = where(found, jnp.minimum(s + EVENT_OVERSHOOT[size] * h, h), h)
    return TrialEvent(
        end=where(shorter, part, where(first_unsure & ~unclear, part / 2, stop)),
        which=estimate.which,
        fire=found & ~missed & whole,
        probe=found & missed & whole,
        reject=reject,
        inside=estimate.at_maximum & (select_polynomial(last, estimate.which)[0] < 0),
    )


def fourth_derivative_bound(guard: Coefficients, s: Scalar) -> Scalar:
    """A bound of the fourth derivative of a guard up to `s`, divided by 24."""
    sizes = tuple(times(math.comb(n, 4), jnp.abs(c)) for n, c in enumerate(guard) if n >= 4)
    return polynomial_value(sizes, s) if sizes else jnp.zeros_like(s)


@traced_once
def may_rise(start: tuple, end: tuple, width: Scalar, bound: Scalar) -> Bool[Array, ""]:
    """Whether a guard that is not above zero at the ends of an interval may be above zero in between.

    With s from 0 to 1 along the interval, the guard differs from its Hermite cubic by at most E s^2 (1 - s)^2, where
    E = `bound` width^4. It stays below zero if no Bernstein coefficient of degree 4 of the sum is above zero; or if it
    starts (ends) with a small slope and the parabola that bounds it from there has no root.

    Args:
        start: The value and the rate at the start.
        end: The value and the rate at the end.
        width: The length of the interval.
        bound: A bound of the fourth derivative, divided by 24.
    """
    rise = HermiteCubic(jnp.minimum(start[0], 0.0), jnp.minimum(end[0], 0.0), start[1] * width, end[1] * width)
    g_0, g_1, m_0, m_1 = rise
    _, b, c = rise.coefficients
    square = width * width
    E = bound * square * square
    highest = reduce(jnp.maximum, (g_0 + m_0 / 4, g_0 + m_0 / 2 + (b + E) / 6, g_1 - m_1 / 4))
    onward, back = b + E + jnp.maximum(c, 0.0), b + E + jnp.maximum(3 * c, 2 * c)  # of s^2 and (1 - s)^2
    level = (onward < 0) & (m_0 * m_0 <= 4 * g_0 * onward) | (back < 0) & (m_1 * m_1 <= 4 * g_1 * back)
    return (highest > EVENT_OVERSHOOT[8] * (jnp.abs(m_0) + jnp.abs(m_1))) & ~level


def return_length(guards: list[Coefficients], longest: Scalar) -> Scalar:
    """The longest trial where guards are convex: twice the time that their parabolas take to reach zero.

    Between nearly parallel faces a guard may rise and be far below zero again within a small part of a trial.
    """
    for guard in trimmed(guards, longest):
        g, rate, curvature = (*guard, jnp.zeros_like(longest))[:3]
        bends = curvature > 0
        twice = where(bends, 2 * curvature, 1.0)
        back = (jnp.sqrt(jnp.maximum(rate * rate - 2 * twice * jnp.minimum(g, 0.0), 0.0)) - rate) / twice
        longest = where(bends, jnp.minimum(longest, RETURN_FACTOR * back), longest)
    return longest


def trimmed(guards: list[Coefficients], like: Scalar) -> list[Coefficients]:
    """The guards without their absent leading coefficients."""
    last = [max(n for n, c in enumerate(guard) if n < 2 or not is_zero(c)) for guard in guards]
    return [tuple(filled(guard[: n + 1], like)) for guard, n in zip(guards, last, strict=True)]


def _first_crossing(guards: list[Coefficients], h: Scalar, width: Scalar, probed: Bool[Array, ""]):
    """Whether a guard rises, an estimate of the first root, and the guards and their rates at the ends of the parts."""
    zero = jnp.zeros_like(h)
    none = jnp.zeros((), bool)
    estimate = _RootEstimate(h, zero, jnp.int32(0), none, HermiteCubic(zero, zero, zero, zero))
    found = none
    before = [(g[0], g[1]) for g in guards]
    at_ends = [before]
    for part in range(TRIAL_PARTS):
        ends = [polynomial_value_and_rate(g, width * (part + 1.0)) for g in guards]
        here = found
        for i, (start, end) in enumerate(zip(before, ends, strict=True)):
            rises, at_maximum, share, rise = _crossing_in_part(start, end, width, probed if part == 0 else none)
            at = width * (part + share)
            earlier = rises & ~found & (~here | (at < estimate.at))
            estimate = select(earlier, _RootEstimate(at, width * float(part), jnp.int32(i), at_maximum, rise), estimate)
            here = here | rises
        found, before = here, ends
        at_ends.append(ends)
    return found, estimate, at_ends


@traced_once
def _crossing_in_part(start: tuple, end: tuple, width: Scalar, probed: Bool[Array, ""]):
    """Whether a guard rises in a part, whether by a maximum inside, at which share of the part, and its cubic."""
    g_0 = jnp.minimum(start[0], 0.0)
    g_1 = end[0]  # a guard that has just been crossed may begin above zero
    rise = HermiteCubic(g_0, g_1, start[1] * width, end[1] * width)
    top, curvature = rise.interior_maximum  # by the end it may still be above zero
    at_maximum = (curvature > 0) & ~probed
    share = where(at_maximum, top, -g_0 / where(g_1 > 0, g_1 - g_0, 1.0))
    return at_maximum | (g_1 > 0), at_maximum, share, rise


def _refined_root(chosen: Coefficients, estimate: _RootEstimate, width: Scalar):
    """The root, whether there turned out to be none, and the last Newton step; infinite where the guard falls.

    From a maximum the search starts on its rising side, at the root of the parabola through the maximum.
    """
    low = estimate.low
    high = estimate.low + width
    rise = estimate.rise
    s = where(estimate.at_maximum, estimate.at, low + width * cubic_root(rise))
    g, rate = polynomial_value_and_rate(chosen, s)
    missed = estimate.at_maximum & (g <= 0)
    curvature = where(estimate.at_maximum, rise.interior_maximum[1] / where(width > 0, width * width, 1.0), 1.0)
    back = (jnp.sqrt(jnp.maximum(rate * rate + 2 * curvature * g, 0.0)) - rate) / where(curvature > 0, curvature, 1.0)
    step = where(estimate.at_maximum, back, _root_step(g, rate))
    for _ in range(ROOT_UPDATES):
        low, high = where(g > 0, low, s), where(g > 0, s, high)
        s = where(missed, s, _bracketed_step(s, step, low, high))
        g, rate = polynomial_value_and_rate(chosen, s)
        step = _root_step(g, rate)
    return where(missed, s, _bracketed_step(s, step, low, high)), missed, step


def _bracketed_step(s: Scalar, step: Scalar, low: Scalar, high: Scalar) -> Scalar:
    return where(step < jnp.inf, jnp.clip(s - step, low, high), (low + high) / 2)


def _root_step(g: Scalar, rate: Scalar) -> Scalar:
    return where(rate > 0, g / where(rate > 0, rate, 1.0), jnp.inf)


def select_polynomial(guards: list, which: Int[Array, ""]) -> tuple:
    """The coefficients of one guard, filled up with zeros."""
    chosen = list(max(guards, key=len))
    for k, longest in enumerate(chosen):
        for i, guard in enumerate(guards):
            own = guard[k] if k < len(guard) else jnp.zeros_like(longest)
            chosen[k] = where(which == i, own, chosen[k])
    return tuple(chosen)
