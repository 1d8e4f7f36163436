"""One trial of the march by power series: as far as the series are exact enough, or to the first event.

The lane's course is expanded once. It says how long the trial may be, by its last coefficients, which guard rises
first, and where the lane is then: no trial is repeated to find an event.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.course import RADIANS, Course, course
from jaxshroud.march.events import Kind, any_of, count
from jaxshroud.march.lane import Fixed, Lane, displacements_of, running
from jaxshroud.march.locate import Rise, select
from jaxshroud.march.method import Choices
from jaxshroud.march.rise import MOST_TRIES, Met, Stride, first_rise
from jaxshroud.march.trial import Noted, Sizes, change, finite, status_of, tallied
from jaxshroud.march.within import crest
from jaxshroud.model.absent import Scalar, is_absent
from jaxshroud.model.modes import Mode
from jaxshroud.model.rhs import Integrals, Ledger, wave
from jaxshroud.model.series import Series, value, value_and_rate
from jaxshroud.model.state import State
from jaxshroud.model.trig import sincos_turns
from jaxshroud.scene.motion import Motion

LONGEST = 0.5  # [rad] of a trial: guards are looked at so often at least
NOTHING = 1e-30  # a speed that does not matter [m/rad]
SLIVER = {8: 1e-12, 4: 1e-6}  # of a step, by bytes of a number: so much is not left over


class Leg(NamedTuple):
    """Where a trial ends."""

    motion: Motion
    gain: Integrals
    length: Scalar  # in steps
    kind: Int[Array, ""]  # of the event, or of what has only been met
    met: Met  # its `end` in radians
    deepest: Scalar  # largest penetration on the way [m]
    sizes: Sizes | None  # of the displacements halfway


def leg(lane: Lane, fixed: Fixed, method: Choices) -> Leg:
    """The trial of a lane."""
    assert method.taylor is not None
    assert isinstance(lane.search, Stride)
    order, tolerance = method.taylor
    way, search, grid = course(lane, fixed, order, method.ledger), lane.search, fixed.grid
    step = RADIANS * grid.turn  # [rad]
    rest = ((fixed.stop - lane.step).astype(step.dtype) - search.done) * step
    h = jnp.minimum(_allowed(way, order, tolerance, fixed), jnp.maximum(rest, 0.0))
    h = jnp.where((search.tries > 0) & (search.tries < MOST_TRIES), jnp.minimum(h, search.cap), h)
    met, kind = _met(way, order, h, search)
    s = jnp.where(met.again, 0.0, met.end)
    z, gain = _reached(way, order, s)
    sizes = None if method.derivative else _halfway(way, order, s)
    return Leg(z, gain, s / step, kind, met, _deepest(way, order, s), sizes)


def _allowed(way: Course, order: int, tolerance: float, fixed: Fixed) -> Scalar:
    """The length at which the last terms of the speeds are so small a part of the largest speed [rad]."""
    largest = lambda n: reduce(jnp.maximum, (jnp.abs(c) for c in _metres(way, n, fixed)))  # noqa: E731
    speed = reduce(jnp.maximum, map(largest, (1, 2, 3)))
    allowed = tolerance * speed + NOTHING
    lengths = [_power(allowed / (n * largest(n) + NOTHING), 1 / (n - 1)) for n in (order - 1, order)]
    return jnp.minimum(jnp.minimum(*lengths), LONGEST)


def _metres(way: Course, n: int, fixed: Fixed) -> list[Scalar]:
    """Coefficients `n` of the displacements, those of theta as a corner's way."""
    x, y, theta = displacements_of(way.motion)
    lever = fixed.model.block.a_x
    return [a[n] for a in (*x, *y) if not is_absent(a)] + [lever * a[n] for a in theta if not is_absent(a)]


def _power(x: Scalar, exponent: float) -> Scalar:
    """Some `x ** exponent` of a positive number, to a few percent: from its bits in float32, where its root fits."""
    bits = lax.bitcast_convert_type(jnp.sqrt(jnp.sqrt(x)).astype(jnp.float32), jnp.int32)
    log = bits.astype(jnp.float32) * (1 / 2**23) - 127.0
    power = ((log * (4 * exponent) + (127.0 - 0.043)) * 2**23).astype(jnp.int32)
    return lax.bitcast_convert_type(power, jnp.float32).astype(x.dtype)


def _met(way: Course, order: int, h: Scalar, search: Stride) -> tuple[Met, Int[Array, ""]]:
    """What the first `h` radians of the course meet, and the kind of the event."""
    kinds = [k for k, _ in way.guards]
    at_start = [(g[0] > 0) & search.recheck & (search.crossed != k) for k, g in way.guards]
    met = first_rise([g.upto(order) for _, g in way.guards], h, search.peeking, search.tries)
    at_once = any_of(at_start)
    which = met.which
    for i in reversed(range(len(kinds))):
        which = jnp.where(at_start[i], jnp.int32(i), which)
    now = Met(jnp.zeros_like(h), which, at_once, ~at_once, ~at_once, ~at_once)
    met = select(at_once, now, met._replace(which=which))
    kind = jnp.int32(kinds[-1])
    for i, k in enumerate(kinds[:-1]):
        kind = jnp.where(which == i, jnp.int32(k), kind)
    return met, kind


def _reached(way: Course, order: int, s: Scalar) -> tuple[Motion, Integrals]:
    """Motion and integrals after `s` radians."""
    ends = [[a if is_absent(a) else value_and_rate(a.upto(order), s) for a in pair] for pair in way.motion[:3]]
    places = [tuple(a if is_absent(a) else a[0] for a in pair) for pair in ends]
    speeds = [tuple(a if is_absent(a) else a[1] / way.unit for a in pair) for pair in ends]
    gained = lambda rate, at=s: value(_integral(rate, order), at)  # noqa: E731
    left, right = (a if is_absent(a) else gained(a) * way.unit for a in way.rates.power)
    ledger = way.rates.ledger
    if ledger is not None:
        half = gained(ledger.drive, s / 2)
        parts = (ledger.drive, ledger.viscous, ledger.friction)
        drive, viscous, friction = (a if is_absent(a) else gained(a) for a in parts)
        gross = jnp.abs(half) + jnp.abs(drive - half)
        joules = 1 / (way.unit * way.unit)
        ledger = Ledger(*(a * joules for a in (drive, gross, viscous, friction)))
    return Motion(*places, *speeds), Integrals((left, right), ledger)


def _integral(rate: Series, order: int) -> tuple[Scalar, ...]:
    """Coefficients of the integral."""
    return (jnp.zeros_like(rate[0]), *(rate[n] * (1 / (n + 1)) for n in range(order)))


def _deepest(way: Course, order: int, s: Scalar) -> Scalar:
    """The largest penetration within `s` radians: at their end, or where the cubic between has its crest."""
    v = way.v.upto(order - 1)
    end, rate = value_and_rate(v, s)
    top, inside = crest(Rise(v[0], end, v[1] * s, rate * s))
    return jnp.where(inside, jnp.maximum(end, value(v, top * s)), end)


def _halfway(way: Course, order: int, s: Scalar) -> Sizes:
    """Magnitudes of the displacements in the middle of `s` radians."""
    size = lambda a: a if is_absent(a) else jnp.abs(value(a.upto(order), s / 2))  # noqa: E731
    x, y, theta = (tuple(map(size, pair)) for pair in displacements_of(way.motion))
    return x, y, theta  # pyright: ignore[reportReturnType]


def settle(lane: Lane, leg: Leg, fixed: Fixed, method: Choices) -> Lane:
    """What becomes of a lane whose trial has come to `leg`; nothing if it has arrived or failed."""
    (model, grid, _), held, search, met = fixed, lane.state, lane.search, leg.met
    assert isinstance(search, Stride)
    goes, z = running(lane, fixed.stop), leg.motion
    apart = held.mode == Mode.APART
    fire = met.fire & ~(apart & (leg.kind != Kind.LIFT)) & goes  # apart, another case has no consequence
    ahead, step = _advanced(lane, leg, fire, fixed)
    done = step.astype(grid.turn.dtype) + ahead.done
    Q = wave(*sincos_turns(grid.start + done * grid.turn), model.drive)
    h = leg.length * grid.h
    _, cross, _, jumps = change(z, Q, held, fire, leg.kind, h, fixed)
    same = lambda before: before  # noqa: E731  # extremes and forces are refused where a method is chosen
    noted = Noted(lambda counters: count(counters, cross, fire, met.inside), same, same)
    sizes = jax.tree.map(lambda a, b: jnp.maximum(a, jnp.abs(b)), leg.sizes, displacements_of(z))
    tally = tallied(lane.tally, leg.gain, jumps, h, held.mode, leg.deepest, sizes, noted)
    status = status_of(z, ~finite(z), ahead.events)
    state = select(fire, cross.after, State(z, held.u_s, held.mode, held.case))
    return select(goes, Lane(state, step, ahead, None, tally, status), lane)


def _advanced(lane: Lane, leg: Leg, fire: Bool[Array, ""], fixed: Fixed) -> tuple[Stride, Int[Array, ""]]:
    """The search of the next trial, and the clock."""
    search, met = lane.search, leg.met
    done = search.done + leg.length
    sliver = SLIVER[done.dtype.itemsize]
    whole = jnp.floor(done + sliver)
    done, whole = jnp.maximum(done - whole, 0.0), whole.astype(jnp.int32)
    done = jnp.where(done < sliver, 0.0, done)
    met_any = met.fire | met.peek | met.again
    events = jnp.where(whole > 0, 0, search.events) + met_any.astype(jnp.int32)
    moved = (leg.length > 0) | fire
    ahead = Stride(
        done=done,
        cap=met.end,
        recheck=fire & ((leg.kind == Kind.TURN) | (leg.kind == Kind.HEIGHT)),
        crossed=leg.kind,
        peeking=met.peek,
        events=events,
        tries=jnp.where(moved, 0, search.tries + 1),
    )
    return ahead, lane.step + whole
