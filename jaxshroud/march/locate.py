"""The location of events: the time inside a step at which a guard crosses zero, and the derivative of that time.

A primitive that raises stands for numbers that JAX must not differentiate once more.
"""

from typing import Any, NamedTuple, NoReturn

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import Search, Target
from jaxshroud.march.event import Guards, Violated, any_of, present
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import Pair, Scalar, any_along, is_place, is_zero, traced_once, where
from jaxshroud.scene.typed import Tree


def _refuse(primals: object, tangents: object) -> NoReturn:
    raise TypeError(
        "Derivatives through contact events are of first order only: this motion is differentiated twice. "
        "Take differences of first derivatives instead, or period_map of contact that is smooth or absent."
    )


# The identity, whose derivative raises a TypeError; a custom rule would be lost in reverse mode.
_first_order = Primitive("once")
_first_order.def_impl(lambda a: a)
_first_order.def_abstract_eval(lambda a: a)
ad.primitive_jvps[_first_order] = _refuse
batching.primitive_batchers[_first_order] = lambda args, axes: (_first_order.bind(*args), *axes)
mlir.register_lowering(_first_order, lambda _, a: [a])


def first_order_only(tree: Tree) -> Tree:
    """The numbers, for which a further derivative raises a TypeError."""
    return jax.tree.map(_first_order.bind, tree)


CUBIC_TRIALS = 5  # in one bracket; after these, every other trial bisects it


def select(condition: Bool[Array, "..."], yes, no):
    """`yes` where `condition`, else `no`, leaf by leaf."""
    return jax.tree.map(lambda a, b: where(condition, a, b), yes, no)


class LocationDecision(NamedTuple):
    """The decision on a trial of a pair or of a row, by what it has shown of the place of an event."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept, and cross the violated guards
    move_low: Bool[Array, ""]  # the trial's end is the new lower end of the bracket
    delay: Scalar  # upper bound of the time since the event [s]
    search: Search  # the search that continues if the trial is not accepted


class HermiteCubic(NamedTuple):
    """A cubic on [0, 1] in Hermite form: its values and its slopes at the ends."""

    g_0: Any
    g_1: Any
    m_0: Any
    m_1: Any

    def __call__(self, s: Any) -> Any:
        """The value at `s`."""
        _, b, c = self.coefficients
        return self.g_0 + s * (self.m_0 + s * (b + s * c))

    @property
    def coefficients(self) -> tuple[Any, Any, Any]:
        """The coefficients of s, s^2 and s^3."""
        rise = self.g_1 - self.g_0
        return self.m_0, 3 * rise - 2 * self.m_0 - self.m_1, self.m_0 + self.m_1 - 2 * rise

    @property
    @traced_once
    def interior_maximum(self) -> tuple[Scalar, Scalar]:
        """The place of a positive maximum inside, and the curvature there; 1 and 0 if there is none.

        A guard that has just been crossed falls before it rises, and may have fallen again by the end.
        """
        a, b, c = self.coefficients
        square = b * b - 3 * a * c
        root = jnp.sqrt(jnp.maximum(square, 0.0))
        # a quotient without cancellation
        num, den = where(b > 0, -(b + root), a), where(b > 0, 3 * c, root - b)
        inside = (square > 0) & (num * den > 0) & (jnp.abs(num) < jnp.abs(den))
        s = where(inside, num / where(inside, den, 1.0), 1.0)
        positive = inside & (self(s) > 0)
        return where(positive, s, 1.0), where(positive, 2 * root, 0.0)


def guard_cubic(value: tuple, rate: tuple, integral: tuple | None, h: Scalar) -> HermiteCubic:
    """The cubic of a guard from its values, rates and integrals, if any, at both ends of `h` seconds.

    A guard with an integral, that of slip with the path of the slider, has no rate: its cubic is the parabola with the
    right mean, or the straight line where the path is so short that its rounding error would bend the parabola. The
    straight line is also taken where neither is known.
    """
    g_0, g_1 = value
    secant = g_1 - g_0
    unknown = (rate[0] == 0) & (rate[1] == 0)
    m_0, m_1 = (where(unknown, secant, m * h) for m in rate)
    if integral is None:
        return HermiteCubic(g_0, g_1, m_0, m_1)
    length = integral[1] - integral[0]
    excess = 6 * length / where(h > 0, h, 1.0) - 3 * (g_0 + g_1)
    rounding = jnp.finfo(h.dtype).eps * (jnp.abs(integral[0]) + jnp.abs(integral[1]))
    parabola = (integral[0] != 0) & (integral[1] != 0) & (h > 0) & (jnp.abs(length) > 1000 * rounding)
    m_0, m_1 = where(parabola, secant + excess, m_0), where(parabola, secant - excess, m_1)
    return HermiteCubic(g_0, g_1, m_0, m_1)


def integral_of(guards: Guards, kind: int) -> Scalar:
    """The integral of a guard, 0 where it has none."""
    integral = guards.integral[kind]
    return jnp.zeros_like(guards.value[kind]) if is_zero(integral) else integral


def first_interior_maximum(start: Guards, end: Guards, h: Scalar) -> Scalar:
    """The earliest fraction of a trial at which a guard seems to be above zero that is not at its ends; 1 if none."""
    first = jnp.ones_like(h)
    for kind in present(start.value):
        ends = (start.value[kind], end.value[kind]), (start.rate[kind], end.rate[kind])
        integrals = start.integral[kind], end.integral[kind]
        cubic = guard_cubic(*ends, None if is_zero(integrals[0]) else integrals, h)
        below = (cubic.g_0 <= 0) & (cubic.g_1 <= 0)
        first = where(below, jnp.minimum(first, cubic.interior_maximum[0]), first)
    return first


def event_tolerance(jumps: Bool[Array, ""], method: Choices, dtype) -> Scalar:
    """The tolerance of the time of an event, in steps; `jumps`: the forces jump at it.

    Where the forces are continuous, the error of the motion is quadratic in this tolerance. With cubics, it needs to be
    no finer than the order of the method resolves; the error of a derivative is linear in it. At a loaded case switch
    the error of the motion is linear too, and nearly parallel faces switch dozens of times in a period: these events
    are located to rounding.
    """
    single = dtype != jnp.float64
    coarse = (10 if single else 20) if method.locate == "bisection" else 10 if single else 10 + method.rk.order
    coarse = (16 if single else 36) if method.derivative else coarse
    return where(jumps, 2.0 ** -(16 if single else 48), 2.0**-coarse).astype(dtype)


class TrialOutcome(NamedTuple):
    """What a trial has shown of the events that are searched for, over all interfaces."""

    hits: Int[Array, ""]  # number of interfaces where a guard is violated
    jumps: Bool[Array, ""]  # the forces jump at one of them
    exact: Bool[Array, ""]  # all of their guards are zero to rounding, and no other is violated there
    top: Scalar  # the fraction of the trial at which a guard seems to be above zero; 1 if there is none
    crossed: Target  # the guard that was crossed first, at its place or that of the previous target
    low: Guards  # at this interface, at the lower end of the bracket or the start of the trial


def judge_trial(
    search: Search, outcome: TrialOutcome, active: Bool[Array, ""], h: Scalar, method: Choices
) -> LocationDecision:
    """Decide on a trial with such an `outcome`; `h` is the length of a whole step [s].

    The search of a lane that is not `active` goes on as it is.
    """
    hit = outcome.hits > 0
    if method.locate == "none":
        return LocationDecision(active, hit & active, jnp.zeros_like(hit), search.length * h, search)
    finest = event_tolerance(jnp.ones_like(hit), method, h.dtype)
    # within a shorter trial a maximum would be looked for again and again, as the clock does not move
    seen = search.length > finest
    probes = (search.low == 0) & ~search.probing & (outcome.top < 1) & seen
    bracketing, move_low = (search.bracketing | hit) & ~probes, search.bracketing & ~hit & ~probes
    high = where(hit, search.length, search.high)
    below = where(move_low, search.length, search.low)
    tolerance = event_tolerance(outcome.jumps, method, high.dtype)
    target = search.target
    next_end = (below + high) / 2
    if target is None:
        delay = high - below
    else:
        crossed = outcome.crossed
        target = select(hit, crossed._replace(tries=target.tries), target._replace(place=crossed.place))
        target = target._replace(tries=where(hit | search.bracketing, target.tries + 1, 0))
        by_cubic, delay = next_trial_end(target, outcome.low, below, high, h, tolerance)
        halve = (target.tries > CUBIC_TRIALS) & (target.tries % 2 == 0)
        next_end = where(halve, next_end, by_cubic)
    exact = outcome.exact & (outcome.hits == 1)
    fire = hit & ~probes & ((delay <= tolerance) | exact)
    after = search._replace(
        length=where(probes, outcome.top * search.length, where(high - below <= finest, high, next_end)),
        low=below,
        high=high,
        bracketing=bracketing,
        probing=probes,
        inside=search.inside | (search.probing & hit),
        target=target,
    )
    accept = (~bracketing & ~probes) | fire
    return LocationDecision(accept & active, fire & active, move_low & active, delay * h, select(active, after, search))


def one_after_the_other(fires: Any, place: Any, pending: Any, moves: Any) -> tuple[Any, Any, Any]:
    """Of the events of an instant that at one `place` alone, whether it is at a root, and those that are left.

    Each is the root of its own guard, and moves with it: the trials to those that are left, which are `pending`, have
    no length, and do not move.
    """
    first = fires & is_place(place, fires)
    waits = ~moves & any_along(first & pending)
    left = where(any_along(first), fires & (pending | moves) & ~first, pending & ~moves)
    return first, moves | waits, left


def first_crossed(
    low: Guards, end: Guards, violated: Violated, width: Scalar, otherwise: Target
) -> tuple[Pair, Target]:
    """The guard that was crossed first, and the share of the `width` [s] in which it was above zero, as a fraction.

    The share is that of a straight line between both ends, or along the rate at the upper one where this is less: a
    guard that has just been crossed is zero at the lower end. Where none is violated, it is 0, and the target is the
    one that is given.
    """
    largest = (jnp.zeros_like(otherwise.value), jnp.ones_like(otherwise.value))
    chosen = otherwise
    for kind in violated:
        above = end.value[kind]
        rise = jnp.maximum(above - jnp.minimum(low.value[kind], 0.0), end.rate[kind] * width)
        share = above, rise  # numerator, denominator
        earlier = violated[kind] & (share[0] * largest[1] > largest[0] * share[1])
        largest = select(earlier, share, largest)
        new = Target(jnp.int32(kind), above, end.rate[kind], integral_of(end, kind), otherwise.tries)
        chosen = select(earlier, new, chosen)
    return largest, chosen


def next_trial_end(target: Target, low: Guards, below: Scalar, high: Scalar, h: Scalar, tolerance: Scalar):
    """The end of the next trial, just beyond the target's root, and the delay of the upper end after it, in steps."""

    def of_target(numbers):
        return select_guard(numbers, target.kind)

    width = high - below
    integral = _selected_integral(low, target.kind, jnp.zeros_like(width))
    values, rates = (of_target(low.value), target.value), (of_target(low.rate), target.rate)
    cubic = guard_cubic(values, rates, (integral, target.integral), width * h)
    delay = where(cubic.m_1 > 0, jnp.minimum(cubic.g_1 / where(cubic.m_1 > 0, cubic.m_1, 1.0), 1.0), 1.0)
    return jnp.minimum(below + width * cubic_root(cubic) + tolerance / 2, high), delay * width


def _selected_integral(guards: Guards, kind: Int[Array, "..."], zero: Scalar) -> Scalar:
    """The integral of the guard of number `kind`, 0 where it has none."""
    chosen: Any = 0.0
    for k in present(guards.integral):
        chosen = where(kind == k, guards.integral[k], chosen)
    return chosen if present(guards.integral) else zero


def at_least_two(flags: tuple[Bool[Array, ""], ...]) -> Bool[Array, ""]:
    """Whether at least two of the scalars are true."""
    none = jnp.zeros_like(flags[0])
    return any_of([none, *(a & any_of(flags[i + 1 :]) for i, a in enumerate(flags[:-1]))])


def select_guard(numbers: tuple[Any, ...], kind: Any) -> Any:
    """The number that belongs to `kind`."""
    first, *others = present(numbers)
    chosen = numbers[first]
    for k in others:
        chosen = where(kind == k, numbers[k], chosen)
    return chosen


@traced_once
def cubic_root(cubic: HermiteCubic) -> Scalar:
    """The root of a cubic, negative at 0 and positive at 1, by Newton steps from that of a line or a parabola."""
    a, b, c = cubic.coefficients
    rise = jnp.maximum(cubic.g_1 - cubic.g_0, jnp.finfo(cubic.g_1.dtype).tiny)
    secant = jnp.clip(-cubic.g_0 / rise, 0.0, 1.0)
    rises = a + secant * (2 * b + secant * 3 * c) > rise / 8
    # the root of a guard that starts at zero and first falls is about that of a parabola
    square = jnp.maximum(a * a - 4 * b * cubic.g_0, 0.0)
    bends = b > 0
    far = where(bends, jnp.minimum((jnp.sqrt(square) - a) / where(bends, 2 * b, 1.0), 1.0), 1.0)
    s = where(rises, secant, far)
    for _ in range(3):
        slope = a + s * (2 * b + s * 3 * c)
        s = jnp.clip(s - cubic(s) / where(slope > rise / 8, slope, rise), 0.0, 1.0)
    return s


@jax.custom_jvp
def at_event(quantities, slopes, guard, rate):
    """The `quantities` at the time when `guard` vanishes, with the derivative that this time contributes.

    The values are returned unchanged: the time has been found already. Their derivatives include the shift of the root,
    along which the quantities change with their `slopes`.

    Args:
        quantities: A tree of numbers at the time of the event.
        slopes: Their time derivatives.
        guard: The value of the guard there.
        rate: Its time derivative; infinite where the time is prescribed and not a root.

    Raises:
        TypeError: It is differentiated twice; the shift of the slopes themselves is not known.
    """
    del slopes, guard, rate
    return quantities


@at_event.defjvp
def _at_event_jvp(primals, tangents):
    quantities, slopes, _, rate = first_order_only(primals)
    shift = -tangents[2] / rate

    def moved(d, slope):
        return d + slope * lax.broadcast_to_rank(shift, slope.ndim)

    return quantities, jax.tree.map(moved, tangents[0], slopes)
