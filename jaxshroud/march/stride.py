"""One trial of the march by power series: as far as the series are exact enough, or to the first event.

The lane's course is expanded once. It says how long the trial may be, by its last coefficients, which guard rises
first, and where the lane is then: no trial is repeated to find an event.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.course import RADIANS, Course, course, frozen
from jaxshroud.march.crests import both, deepest, halfway, inside, strongest
from jaxshroud.march.events import FLAT_RETURN, Counters, Kind, any_of, count
from jaxshroud.march.implicit import at_the_root
from jaxshroud.march.lane import Fixed, Jumps, Lane, Tally, displacements_of, running
from jaxshroud.march.locate import select
from jaxshroud.march.method import Choices
from jaxshroud.march.peaks import Peaks
from jaxshroud.march.quadrature import rule
from jaxshroud.march.rise import Met, Stride, ended, first_rise, picked, returning
from jaxshroud.march.trial import Noted, Sizes, change, finite, status_of, tallied
from jaxshroud.march.within import Within
from jaxshroud.model.absent import ABSENT, Pair, Scalar, is_absent
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.rhs import Integrals, Ledger, mean_square, wave
from jaxshroud.model.series import Series, value, value_and_rate
from jaxshroud.model.state import State
from jaxshroud.model.trig import sincos_turns
from jaxshroud.scene.motion import Motion

LONGEST = 0.5  # [rad] of a trial: guards are looked at so often at least
MORE = 4  # terms of the works than of the motion: with none, those of squares err 100 times the tolerance
NOTHING = 1e-30  # a speed that does not matter [m/rad]
SLIVER = {8: 1e-12, 4: 1e-6}  # of a step, by bytes of a number: so much is not left over


class Leg(NamedTuple):
    """Where a trial ends."""

    motion: Motion
    gain: Integrals
    length: Scalar  # in steps
    kind: Int[Array, ""]  # of the event, or of what has only been met
    met: Met  # its `end` in radians
    seen: "Seen | None"  # None where derivatives are computed


class Seen(NamedTuple):
    """What a log is told of the way."""

    deepest: Scalar  # largest penetration [m]
    sizes: Sizes  # of the displacements halfway
    within: Within | None
    forces: Peaks | None


Places = tuple[Any, Any, Any]  # coefficients of x, y and theta, of both blades


def leg(lane: Lane, fixed: Fixed, method: Choices) -> Leg:
    """The trial of a lane."""
    return leg_and_places(lane, fixed, method)[0]


def leg_and_places(lane: Lane, fixed: Fixed, method: Choices) -> tuple[Leg, Places]:
    """The trial of a lane, and the polynomials of its displacements in radians from its start."""
    assert method.taylor is not None
    order = method.taylor.order
    way, step = course(lane, fixed, order, method.ledger), RADIANS * fixed.grid.turn
    still, found = (lax.stop_gradient((lane, fixed)), frozen(way)) if method.derivative else ((lane, fixed), way)
    met, kind = _trial(found, *still, order)
    s = jnp.where(met.again, 0.0, met.end)
    if method.derivative:
        s = _moving(way, order, met, s, _rest(lane, fixed))
    places = jax.tree.map(lambda a: a.upto(order), displacements_of(way.motion))
    seen = None if method.derivative else _seen(way, s, lane, met, kind, fixed, method)
    gain = Integrals(_squares(way, order, s, fixed.model.gyration), _works(way, order, s))
    return Leg(moved(places, way.unit, s), gain, s / step, kind, met, seen), places


def _trial(way: Course, lane: Lane, fixed: Fixed, order: int) -> tuple[Met, Int[Array, ""]]:
    """What the trial meets, and the kind of the event."""
    search = lane.search
    h = jnp.minimum(_allowed(way, order, search.tolerance, fixed), jnp.maximum(_rest(lane, fixed), 0.0))
    rocking = [g.upto(2) for kind, g in way.guards if kind in (Kind.TURN, Kind.HEIGHT)]
    soon = jnp.maximum(returning(rocking, h), FLAT_RETURN * RADIANS * fixed.grid.turn)  # beyond, contact is flat
    h = jnp.minimum(h, soon)
    h = jnp.where(search.tries > 0, jnp.minimum(h, search.cap), h)
    return _met(way, order, h, search)


def _rest(lane: Lane, fixed: Fixed) -> Scalar:
    """What is left until the march stops [rad]."""
    turn = fixed.grid.turn
    return ((fixed.stop - lane.step).astype(turn.dtype) - lane.search.done) * (RADIANS * turn)


def _moving(way: Course, order: int, met: Met, s: Scalar, rest: Scalar) -> Scalar:
    """The end of a trial with its derivative: that of the guard's root, or of what is left; none where it is chosen."""
    guard = picked(ended([g.upto(order) for _, g in way.guards], s), met.which)
    size, rate = value_and_rate(guard, s)
    rate = jnp.where(met.fire & (s > 0) & (rate > 0), lax.stop_gradient(rate), jnp.inf)
    root = at_the_root(s, jnp.ones_like(s), size, rate)
    return jnp.where(met.fire | met.peek | (s < rest), root, rest)


def _seen(way: Course, s: Scalar, lane: Lane, met: Met, kind: Int[Array, ""], fixed: Fixed, method: Choices) -> Seen:
    assert method.taylor is not None
    order, held = method.taylor.order, lane.state
    apart = held.mode == Mode.APART
    onset = apart & met.fire & (kind == Kind.LIFT)
    within = inside(way, order, s, apart, onset) if method.within else None
    forces = strongest(way, order, s, held, fixed.model.spring) if method.forces else None
    return Seen(deepest(way, order, s), halfway(way, order, s), within, forces)


def _allowed(way: Course, order: int, tolerance: Scalar, fixed: Fixed) -> Scalar:
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


def moved(places: Places, unit: Scalar, s: Scalar) -> Motion:
    """The motion after `s` radians of `unit` seconds each."""
    ends = [[a if is_absent(a) else value_and_rate(a, s) for a in pair] for pair in places]
    here = [tuple(a if is_absent(a) else a[0] for a in pair) for pair in ends]
    speeds = [tuple(a if is_absent(a) else a[1] / unit for a in pair) for pair in ends]
    return Motion(*here, *speeds)


def _squares(way: Course, order: int, s: Scalar, gyration: Scalar) -> Pair:
    """Mean squares of the displacements, integrated over `s` radians."""
    pose, total = way.pose, (ABSENT, ABSENT)
    at = lambda a, t: a if is_absent(a) else value(a.upto(order), s * t) if t else a[0]  # noqa: E731
    mean = lambda a: a if is_absent(a) else value(_integral(a, order), s) / jnp.where(s > 0, s, 1.0)  # noqa: E731
    versine = tuple(map(mean, pose.versine))  # which counts for itself
    for t, weight in zip(*rule(order), strict=True):
        x, y = (tuple(at(a, t) for a in pair) for pair in (pose.x, pose.y))
        here = mean_square(pose._replace(x=x, y=y, versine=versine), gyration)
        total = total[0] + weight * here[0], total[1] + weight * here[1]
    left, right = (a if is_absent(a) else a * s * way.unit for a in total)
    return left, right


def _works(way: Course, order: int, s: Scalar) -> Ledger | None:
    """The works over `s` radians."""
    if way.works is None:
        return None
    gained = lambda rate, at=s: value(_integral(rate, order + MORE), at)  # noqa: E731
    half = gained(way.works.drive, s / 2)
    parts = (way.works.drive, way.works.viscous, way.works.friction)
    drive, viscous, friction = (a if is_absent(a) else gained(a) for a in parts)
    gross = jnp.abs(half) + jnp.abs(drive - half)
    joules = 1 / (way.unit * way.unit)
    return Ledger(*(a * joules for a in (drive, gross, viscous, friction)))


def _integral(rate: Series, terms: int) -> tuple[Scalar, ...]:
    """Coefficients of the integral."""
    return (jnp.zeros_like(rate[0]), *(rate[n] * (1 / (n + 1)) for n in range(terms)))


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
    tally = _tallied(lane, leg, jumps, h, lambda counters: count(counters, cross, fire, met.inside))
    status = status_of(z, ~finite(z), jnp.maximum(ahead.events, ahead.tries))
    state = select(fire, cross.after, State(z, held.u_s, held.mode, held.case))
    # contact may begin flat although one end of the overlap already pulls
    ahead = ahead._replace(recheck=ahead.recheck | (fire & (cross.after.case == FLAT)))
    return select(goes, Lane(state, step, ahead, None, tally, status), lane)


def _tallied(lane: Lane, leg: Leg, jumps: Jumps, h: Scalar, counts: Callable[[Counters], Counters]) -> Tally:
    seen = leg.seen
    if seen is None:
        return Tally(jax.tree.map(jnp.add, lane.tally.integrals, leg.gain), None, None)
    noted = Noted(
        counts,
        lambda before: both(before, seen.within),  # pyright: ignore[reportArgumentType]  # kept where `before` is
        lambda before: jax.tree.map(jnp.maximum, before, seen.forces),
    )
    sizes = jax.tree.map(lambda a, b: jnp.maximum(a, jnp.abs(b)), seen.sizes, displacements_of(leg.motion))
    return tallied(lane.tally, leg.gain, jumps, h, lane.state.mode, seen.deepest, sizes, noted)


def _advanced(lane: Lane, leg: Leg, fire: Bool[Array, ""], fixed: Fixed) -> tuple[Stride, Int[Array, ""]]:
    """The search of the next trial, and the clock."""
    search, met = lane.search, leg.met
    done = search.done + leg.length
    sliver = SLIVER[done.dtype.itemsize]
    whole = jnp.floor(done + sliver)
    done, whole = jnp.maximum(done - whole, 0.0), whole.astype(jnp.int32)
    done = jnp.where(done < sliver, 0.0, done)
    events = jnp.where(whole > 0, 0, search.events) + met.fire.astype(jnp.int32)
    moved = (leg.length > 0) | fire
    ahead = Stride(
        done=done,
        cap=met.end,
        recheck=fire & ((leg.kind == Kind.TURN) | (leg.kind == Kind.HEIGHT)),
        crossed=leg.kind,
        peeking=met.peek,
        events=events,
        tries=jnp.where(moved, 0, search.tries + 1),
        tolerance=search.tolerance,
    )
    return ahead, lane.step + whole
