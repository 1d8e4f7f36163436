"""The first guard to rise through zero along a course, by their polynomials.

Each guard is looked at where parts of the trial end, and at the hump of its cubic in between: a guard may rise and fall
back within a part. The one that seems first is closed in on by Newton's rule. Should another one be above zero there,
which had crossed before, the trial is not accepted and the next one ends at this place: there the order is plain.

No trial is accepted on which a guard may have risen unseen. A guard differs from its cubic by no more than its fourth
derivative allows, which its coefficients bound. Where that leaves a doubt in the second part, the trial ends with the
first; where it does so in the first, nothing is accepted and the next trial is a quarter as long. The bound falls with
the fourth power of the length: after at most seven quarters it is less than the rounding of the guard, which counts as
no rise. More than 64 trials in a row that come to nothing end a lane as TOO_MANY_EVENTS.
"""

import math
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.events import any_of
from jaxshroud.march.locate import Rise, root, select
from jaxshroud.model.absent import Scalar, filled, is_absent
from jaxshroud.model.series import value, value_and_rate

PARTS = 2  # of a trial, at whose ends guards are looked at
RETURNS = 2  # of a guard, in a trial at most
NEWTONS = 3  # and the one by which the root is known to be found
# Events are met so much of a trial late, by bytes of a number. Loaded case switches jump the force: nearly parallel
# faces, with dozens of them, made 1e-6 of 2^-42.
BEYOND = {8: 2.0**-50, 4: 2.0**-18}
CONVERGED = {8: 2.0**-34, 4: 2.0**-14}  # of a trial: Newton steps that are as good as none
MOST_TRIES = 4  # to tell which guard is first

Coefficients = tuple[Scalar, ...]


class Met(NamedTuple):
    """What a trial meets."""

    end: Scalar  # where it ends [rad]
    which: Int[Array, ""]  # guard
    fire: Bool[Array, ""]  # an event
    peek: Bool[Array, ""]  # the top of a guard that had seemed to rise above zero
    again: Bool[Array, ""]  # nothing is accepted, and the next trial ends here
    inside: Bool[Array, ""]  # the guard has fallen below zero again by the end


class Stride(NamedTuple):
    """Where a lane is inside its current step, and what the trial before has found."""

    done: Scalar  # of the step
    cap: Scalar  # where the next trial ends at the latest, after one that was not accepted [rad]
    recheck: Bool[Array, ""]  # guards may have jumped: one above zero is crossed at once ...
    crossed: Int[Array, ""]  # ... but for that of this kind, which just was; -1: none
    peeking: Bool[Array, ""]  # the trial has ended at the top of a guard
    events: Int[Array, ""]  # in this step
    tries: Int[Array, ""]  # trials in a row that came to nothing
    tolerance: Scalar  # of the last terms of the speeds, over the largest speed


class _Place(NamedTuple):
    """Where a guard seems to rise through zero."""

    at: Scalar
    low: Scalar  # the part's beginning
    which: Int[Array, ""]
    hump: Bool[Array, ""]  # `at` is the top of a hump
    rise: Rise


def first_rise(guards: list[Coefficients], h: Scalar, peeked: Bool[Array, ""], tries: Int[Array, ""]) -> Met:
    """What the first `h` radians of a course meet.

    Args:
        guards: The guards as polynomials.
        h: Length of the trial.
        peeked: The trial before has ended at the top of a hump.
        tries: Trials in a row that were not accepted.
    """
    guards = ended(guards, h)
    width, size = h * (1 / PARTS), h.dtype.itemsize
    found, place, (start, middle, last) = _sought(guards, h, width, peeked)
    s, missed, error = _polished(picked(guards, place.which), place, width)
    there = [value_and_rate(g, s) for g in guards]
    over = any_of(((g > 0) & (place.which != i)) for i, (g, _) in enumerate(there))
    sure = missed | (jnp.abs(error) <= CONVERGED[size] * h)
    unclear = found & (over | ~sure) & (tries < MOST_TRIES)

    in_first = found & (place.low == 0)
    end, part = jnp.where(found, s, h), jnp.where(in_first, s, width)
    at_part, at_end = select(in_first, there, middle), select(found, there, last)
    early = any_of(may_rise(a, b, part, fourth(g, part)) for g, a, b in zip(guards, start, at_part, strict=True))
    late = any_of(may_rise(a, b, end - part, fourth(g, end)) for g, a, b in zip(guards, at_part, at_end, strict=True))

    again = unclear | early
    shorter = late & ~again
    whole = ~again & ~shorter
    stop = jnp.where(found, jnp.minimum(s + BEYOND[size] * h, h), h)
    return Met(
        end=jnp.where(shorter, part, jnp.where(early & ~unclear, part / 2, stop)),
        which=place.which,
        fire=found & ~missed & whole,
        peek=found & missed & whole,
        again=again,
        inside=place.hump & (picked(last, place.which)[0] < 0),
    )


def fourth(guard: Coefficients, s: Scalar) -> Scalar:
    """A bound of the size of a guard's fourth derivative up to `s`, over 24."""
    sizes = tuple(math.comb(n, 4) * jnp.abs(c) for n, c in enumerate(guard) if n >= 4)
    return value(sizes, s) if sizes else jnp.zeros_like(s)


def may_rise(start: tuple, end: tuple, width: Scalar, bound: Scalar) -> Bool[Array, ""]:
    """Whether a guard, not above zero at the ends of a stretch, may be above zero in between.

    With s from 0 to 1 along the stretch, it differs from its Hermite cubic by at most E s^2 (1 - s)^2, where
    E = `bound` width^4. It cannot rise where no coefficient of the sum in Bernstein polynomials of degree 4 is above
    zero; nor where it starts (ends) nearly level and the parabola that is above it from there on has no root.

    Args:
        start: Value and rate at the start.
        end: Value and rate at the end.
        width: Length of the stretch.
        bound: Of the fourth derivative, over 24.
    """
    rise = Rise(jnp.minimum(start[0], 0.0), jnp.minimum(end[0], 0.0), start[1] * width, end[1] * width)
    (g_0, g_1, m_0, m_1), (_, b, c) = rise, rise.powers
    square = width * width
    E = bound * square * square
    highest = reduce(jnp.maximum, (g_0 + m_0 / 4, g_0 + m_0 / 2 + (b + E) / 6, g_1 - m_1 / 4))
    onward, back = b + E + jnp.maximum(c, 0.0), b + E + jnp.maximum(3 * c, 2 * c)  # of s^2 and (1 - s)^2
    level = (onward < 0) & (m_0 * m_0 <= 4 * g_0 * onward) | (back < 0) & (m_1 * m_1 <= 4 * g_1 * back)
    return (highest > BEYOND[8] * (jnp.abs(m_0) + jnp.abs(m_1))) & ~level


def returning(guards: list[Coefficients], longest: Scalar) -> Scalar:
    """How long a trial may be where guards bend up: twice what their parabolas take to reach zero.

    Between nearly parallel faces that is a small part of a trial, by whose end a guard may be far below zero again.
    """
    for guard in ended(guards, longest):
        g, rate, bend = (*guard, jnp.zeros_like(longest))[:3]
        bends = bend > 0
        twice = jnp.where(bends, 2 * bend, 1.0)
        back = (jnp.sqrt(jnp.maximum(rate * rate - 2 * twice * jnp.minimum(g, 0.0), 0.0)) - rate) / twice
        longest = jnp.where(bends, jnp.minimum(longest, RETURNS * back), longest)
    return longest


def ended(guards: list[Coefficients], like: Scalar) -> list[Coefficients]:
    """Each without absent coefficients, at the end of which it ends."""
    last = [max(n for n, c in enumerate(guard) if n < 2 or not is_absent(c)) for guard in guards]
    return [tuple(filled(guard[: n + 1], like)) for guard, n in zip(guards, last, strict=True)]


def _sought(guards: list[Coefficients], h: Scalar, width: Scalar, peeked: Bool[Array, ""]):
    """Whether a guard rises, where the first of them seems to, and the guards at the end with their rates."""
    zero, none = jnp.zeros_like(h), jnp.zeros((), bool)
    place = _Place(h, zero, jnp.int32(0), none, Rise(zero, zero, zero, zero))
    found, before = none, [(g[0], g[1]) for g in guards]
    seen = [before]
    for part in range(PARTS):
        ends = [value_and_rate(g, width * (part + 1.0)) for g in guards]
        here = found
        for i, (start, end) in enumerate(zip(before, ends, strict=True)):
            rises, hump, share, rise = _looked_at(start, end, width, peeked if part == 0 else none)
            at = width * (part + share)
            sooner = rises & ~found & (at < place.at)
            place = select(sooner, _Place(at, width * float(part), jnp.int32(i), hump, rise), place)
            here = here | rises
        found, before = here, ends
        seen.append(ends)
    return found, place, seen


def _looked_at(start: tuple, end: tuple, width: Scalar, peeked: Bool[Array, ""]):
    """Whether a guard rises in a part, by a hump, at which share of it, and its cubic there."""
    g_0, g_1 = jnp.minimum(start[0], 0.0), end[0]  # what has just been crossed may begin above zero
    rise = Rise(g_0, g_1, start[1] * width, end[1] * width)
    top, bend = rise.hump  # by the end it may still be above zero
    hump = (bend > 0) & ~peeked
    share = jnp.where(hump, top, -g_0 / jnp.where(g_1 > 0, g_1 - g_0, 1.0))
    return hump | (g_1 > 0), hump, share, rise


def _polished(chosen: Coefficients, place: _Place, width: Scalar):
    """The root, whether it turned out that there is none, and the last Newton step; infinite where the guard falls.

    A hump is left towards its rising side, by the root of the parabola through its top.
    """
    low, high, rise = place.low, place.low + width, place.rise
    s = jnp.where(place.hump, place.at, low + width * root(rise))
    g, rate = value_and_rate(chosen, s)
    missed = place.hump & (g <= 0)
    bend = jnp.where(place.hump, rise.hump[1] / jnp.where(width > 0, width * width, 1.0), 1.0)
    back = (jnp.sqrt(jnp.maximum(rate * rate + 2 * bend * g, 0.0)) - rate) / jnp.where(bend > 0, bend, 1.0)
    step = jnp.where(place.hump, back, _newton(g, rate))
    for _ in range(NEWTONS):
        low, high = jnp.where(g > 0, low, s), jnp.where(g > 0, s, high)
        s = jnp.where(missed, s, _nearer(s, step, low, high))
        g, rate = value_and_rate(chosen, s)
        step = _newton(g, rate)
    return jnp.where(missed, s, _nearer(s, step, low, high)), missed, step


def _nearer(s: Scalar, step: Scalar, low: Scalar, high: Scalar) -> Scalar:
    return jnp.where(step < jnp.inf, jnp.clip(s - step, low, high), (low + high) / 2)


def _newton(g: Scalar, rate: Scalar) -> Scalar:
    return jnp.where(rate > 0, g / jnp.where(rate > 0, rate, 1.0), jnp.inf)


def picked(guards: list, which: Int[Array, ""]) -> tuple:
    """The numbers of one guard; what it lacks is 0."""
    chosen = list(max(guards, key=len))
    for k, longest in enumerate(chosen):
        for i, guard in enumerate(guards):
            mine = guard[k] if k < len(guard) else jnp.zeros_like(longest)
            chosen[k] = jnp.where(which == i, mine, chosen[k])
    return tuple(chosen)
