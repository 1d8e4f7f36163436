"""Finding the instant inside a step at which a guard crosses zero.

A lane that has made a trial step either marches on, looks at a point inside the step where a guard seems to have risen
and fallen back, closes in on a crossing, or has found it. Between two ends of a trial every guard is taken as the
cubic through its values and rates there, so nothing more needs to be evaluated.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.events import Guards, Kind, Violated, any_of, kinds
from jaxshroud.march.words import Locate
from jaxshroud.model.absent import Scalar, is_absent

CUBIC_TRIALS = 5  # in one bracket; then every other one halves it


class Target(NamedTuple):
    """The guard that a search closes in on, at the upper end of the bracket."""

    kind: Int[Array, ""]
    value: Scalar
    rate: Scalar
    slid: Scalar
    tries: Int[Array, ""]


class Search(NamedTuple):
    """Where a lane is inside its current step; lengths are fractions of a step."""

    done: Scalar  # accepted so far
    length: Scalar  # of the next trial
    low: Scalar  # bracket of the event, lengths from `done`
    high: Scalar
    bracketing: Bool[Array, ""]
    peeking: Bool[Array, ""]  # the next trial ends where a guard seems to peak
    inside: Bool[Array, ""]  # the bracket was found by peeking
    recheck: Bool[Array, ""]  # guards may have jumped: a violated one counts even in a trial of length zero
    events: Int[Array, ""]  # in this step
    target: Target | None  # None unless the locator is "cubic"
    met: Int[Array, ""] | None  # how often the event was found, to learn how its instant moves; None: no derivatives


def fresh(
    done: Scalar,
    length: Scalar,
    recheck: Bool[Array, ""],
    events: Int[Array, ""],
    locate: Locate,
    derivative: bool,
) -> Search:
    """A search that has not met anything yet."""
    zero, no, none = jnp.zeros_like(done), jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    target = Target(none, zero, zero, zero, none) if locate == "cubic" else None
    met = none if derivative and locate != "none" else None
    return Search(done, length, zero, zero, no, no, no, recheck, events, target, met)


def select(condition: Bool[Array, ""], yes, no):
    """`yes` where `condition`, else `no`, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


class Verdict(NamedTuple):
    """What to do with a finished trial."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept and change mode
    late: Scalar  # the event is at most so long ago, in steps
    search: Search  # if the trial was not accepted


class Rise(NamedTuple):
    """A guard over a stretch of time scaled to [0, 1]: end values and end slopes of its cubic."""

    g_0: Scalar
    g_1: Scalar
    m_0: Scalar
    m_1: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        """The cubic at `s`."""
        _, b, c = self.powers
        return self.g_0 + s * (self.m_0 + s * (b + s * c))

    @property
    def powers(self) -> tuple[Scalar, Scalar, Scalar]:
        """Coefficients of s, s^2 and s^3."""
        rise = self.g_1 - self.g_0
        return self.m_0, 3 * rise - 2 * self.m_0 - self.m_1, self.m_0 + self.m_1 - 2 * rise

    @property
    def hump(self) -> tuple[Scalar, Scalar]:
        """Where in between the cubic has a maximum above zero, and its curvature there; 1 and 0 if nowhere.

        A guard that has just been crossed falls before it rises, and may have fallen again by the end.
        """
        a, b, c = self.powers
        square = b * b - 3 * a * c
        bend = jnp.sqrt(jnp.maximum(square, 0.0))
        over = jnp.where(b > 0, -(b + bend), a), jnp.where(b > 0, 3 * c, bend - b)  # a quotient that loses no digits
        inside = (square > 0) & (over[0] * over[1] > 0) & (jnp.abs(over[0]) < jnp.abs(over[1]))
        top = jnp.where(inside, over[0] / jnp.where(inside, over[1], 1.0), 1.0)
        humps = inside & (self(top) > 0)
        return jnp.where(humps, top, 1.0), jnp.where(humps, 2 * bend, 0.0)


def _rise(value: tuple, rate: tuple, slid: tuple | None, h: Scalar) -> Rise:
    """From values, rates and, where there are any, integrals at both ends of a stretch of `h` seconds.

    The slip guard has no rate but an integral, the slider's way: its cubic is the parabola with the right mean, or the
    straight line where the way is so short that its rounding would bend the parabola. Where nothing at all is known of
    the rates it is the straight line too.
    """
    g_0, g_1 = value
    straight, unknown = g_1 - g_0, (rate[0] == 0) & (rate[1] == 0)
    m_0, m_1 = (jnp.where(unknown, straight, m * h) for m in rate)
    if slid is None:
        return Rise(g_0, g_1, m_0, m_1)
    way = slid[1] - slid[0]
    bulge = 6 * way / jnp.where(h > 0, h, 1.0) - 3 * (g_0 + g_1)
    rounding = jnp.finfo(h.dtype).eps * (jnp.abs(slid[0]) + jnp.abs(slid[1]))
    parabola = (slid[0] != 0) & (slid[1] != 0) & (h > 0) & (jnp.abs(way) > 1000 * rounding)
    m_0, m_1 = jnp.where(parabola, straight + bulge, m_0), jnp.where(parabola, straight - bulge, m_1)
    return Rise(g_0, g_1, m_0, m_1)


def _slid(guards: Guards, kind: int) -> Scalar:
    return guards.slid if kind == Kind.RUB else jnp.zeros_like(guards.value[0])


def peak(start: Guards, end: Guards, h: Scalar) -> Scalar:
    """Earliest fraction of a trial at which a guard seems to be above zero; 1 if none.

    All guards must be below zero at the end of the trial.
    """
    first = jnp.ones_like(h)
    for kind in kinds(start.value):
        ends = (start.value[kind], end.value[kind]), (start.rate[kind], end.rate[kind])
        rise = _rise(*ends, (start.slid, end.slid) if kind == Kind.RUB else None, h)
        first = jnp.where(rise.g_0 <= 0, jnp.minimum(first, rise.hump[0]), first)
    return first


def tolerance(jumps: Bool[Array, ""], locate: Locate, order: int, derivative: bool, dtype) -> Scalar:
    """How late an event may be found, in steps; `jumps`: forces jump at it.

    Force-continuous events cost an error of the square of this. Closing in by the cubic, no more is asked of them than
    a method of this order resolves; a derivative's error is one power lower. Loaded case switches cost its first power,
    and nearly parallel faces make dozens of them in a period: they are found to rounding.
    """
    single = dtype != jnp.float64
    coarse = (10 if single else 20) if locate == "bisection" else 10 if single else 10 + order
    coarse = (16 if single else 36) if derivative else coarse
    return jnp.where(jumps, 2.0 ** -(16 if single else 48), 2.0**-coarse).astype(dtype)


def judge(
    search: Search,
    low: Guards,
    end: Guards,
    violated: Violated,
    jumps: Bool[Array, ""],
    exact: Bool[Array, ""],
    h: Scalar,
    locate: Locate,
    order: int,
) -> Verdict:
    """Judge a trial that ended with the guards `end`.

    Args:
        search: The search that made the trial.
        low: Guards at the lower end of the bracket, or at the trial's start.
        end: Guards at its end.
        violated: Those above zero that count.
        jumps: Whether forces jump at the one of them that takes precedence.
        exact: Whether that one is zero to rounding.
        h: Length of a whole step [s].
        locate: Way of closing in.
        order: Of the Runge-Kutta method.
    """
    hit = any_of(violated.values())
    if locate == "none":
        return Verdict(jnp.ones_like(hit), hit, search.length, search)
    bracketing = search.bracketing | hit
    high = jnp.where(hit, search.length, search.high)
    below = jnp.where(search.bracketing & ~hit, search.length, search.low)
    top = peak(low, end, search.length * h)
    peeks = ~bracketing & ~search.peeking & (top < 1)
    derivative = search.met is not None
    narrow = tolerance(jnp.ones_like(hit), locate, order, derivative, high.dtype)
    allowed = tolerance(jumps, locate, order, derivative, high.dtype)
    if locate == "cubic":
        target = _target(search, low, end, violated, search.length - search.low, h)
        now = select(hit | ~search.bracketing, low, end)
        nearer, late = _close_in(target, now, below, high, h, allowed)
        halve = (target.tries > CUBIC_TRIALS) & (target.tries % 2 == 0)
        nearer = jnp.where(halve, (below + high) / 2, nearer)
    else:
        target, late, nearer = None, high - below, (below + high) / 2
    fire = hit & ((late <= allowed) | exact)
    after = search._replace(
        length=jnp.where(peeks, top * search.length, jnp.where(high - below <= narrow, high, nearer)),
        low=below,
        high=high,
        bracketing=bracketing,
        peeking=peeks,
        inside=search.inside | (search.peeking & hit),
        target=target,
    )
    return Verdict((~bracketing & ~peeks) | fire, fire, late, after)


def _target(search: Search, low: Guards, end: Guards, violated: Violated, width: Scalar, h: Scalar) -> Target:
    """The guard that was crossed first, by the straight lines between the ends; the old one if none is violated."""
    old = search.target
    assert old is not None
    hit = any_of(violated.values())
    best, chosen = (jnp.zeros_like(h), jnp.ones_like(h)), old
    for kind in violated:
        above = end.value[kind]
        share = above, above - jnp.minimum(low.value[kind], 0.0)  # of the width, spent above zero: a quotient
        sooner = violated[kind] & (share[0] * best[1] > best[0] * share[1])
        best = select(sooner, share, best)
        new = Target(jnp.int32(kind), above, end.rate[kind], _slid(end, kind), old.tries)
        chosen = select(sooner, new, chosen)
    return chosen._replace(tries=jnp.where(hit | search.bracketing, old.tries + 1, 0))


def _close_in(target: Target, low: Guards, below: Scalar, high: Scalar, h: Scalar, allowed: Scalar):
    """Length of the next trial, just beyond the target's root, and how late the upper end is, in steps."""
    pick, width = lambda four: picked(four, target.kind), high - below
    slid = jnp.zeros_like(width) if is_absent(low.slid) else jnp.where(target.kind == Kind.RUB, low.slid, 0.0)
    rise = _rise((pick(low.value), target.value), (pick(low.rate), target.rate), (slid, target.slid), width * h)
    late = jnp.where(rise.m_1 > 0, jnp.minimum(rise.g_1 / jnp.where(rise.m_1 > 0, rise.m_1, 1.0), 1.0), 1.0)
    return jnp.minimum(below + width * root(rise) + allowed / 2, high), late * width


def picked(four, kind: Int[Array, ""]) -> Scalar:
    """The one of four scalars that belongs to `kind`."""
    first, *others = kinds(four)
    chosen = four[first]
    for k in others:
        chosen = jnp.where(kind == k, four[k], chosen)
    return chosen


def root(rise: Rise) -> Scalar:
    """Where the cubic, negative at 0 and positive at 1, crosses zero: Newton steps from the straight line's root."""
    a, b, c = rise.powers
    climb = jnp.maximum(rise.g_1 - rise.g_0, jnp.finfo(rise.g_1.dtype).tiny)
    straight = jnp.clip(-rise.g_0 / climb, 0.0, 1.0)
    rises = a + straight * (2 * b + straight * 3 * c) > climb / 8
    s = jnp.where(rises, straight, 1.0)  # a guard that starts at its limit and first falls has its root far from there
    for _ in range(3):
        slope = a + s * (2 * b + s * 3 * c)
        s = jnp.clip(s - rise(s) / jnp.where(slope > climb / 8, slope, climb), 0.0, 1.0)
    return s
