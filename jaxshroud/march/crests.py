"""The largest numbers on the way of a trial by power series: between its ends too, by the polynomials themselves."""

from collections.abc import Iterator

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.course import Course
from jaxshroud.march.lane import displacements_of
from jaxshroud.march.locate import Rise
from jaxshroud.march.peaks import Peaks
from jaxshroud.march.rise import Coefficients
from jaxshroud.march.trial import Sizes
from jaxshroud.march.within import Within, crest
from jaxshroud.model.absent import Scalar, is_absent
from jaxshroud.model.friction import Springs, normal_force
from jaxshroud.model.modes import Mode
from jaxshroud.model.series import value, value_and_rate
from jaxshroud.model.state import State

PARTS = 2  # of a trial, in each of which a polynomial has one crest at most


def deepest(way: Course, order: int, s: Scalar) -> Scalar:
    """The largest penetration within `s` radians: at their end, or where the cubic between has its crest."""
    v = way.v.upto(order - 1)
    end, rate = value_and_rate(v, s)
    top, inside = crest(Rise(v[0], end, v[1] * s, rate * s))
    return jnp.where(inside, jnp.maximum(end, value(v, top * s)), end)


def halfway(way: Course, order: int, s: Scalar) -> Sizes:
    """Magnitudes of the displacements in the middle of `s` radians."""
    size = lambda a: a if is_absent(a) else jnp.abs(value(a.upto(order), s * 0.5))  # as the power's quadrature does  # noqa: E731
    x, y, theta = (tuple(map(size, pair)) for pair in displacements_of(way.motion))
    return x, y, theta  # pyright: ignore[reportReturnType]


def strongest(way: Course, order: int, s: Scalar, held: State, spring: Springs) -> Peaks:
    """The largest forces within `s` radians [N]."""
    N = normal_force(_highest(way.v.upto(order - 1), s), held.mode, spring)
    if is_absent(spring.lag):
        return Peaks(N, jnp.zeros_like(N))
    w = (way.u - held.u_s).upto(order - 1)
    stuck = spring.k_d * jnp.maximum(_highest(w, s), _highest(_negative(w), s))
    return Peaks(N, jnp.where(held.mode == Mode.STICK, stuck, spring.mu * N))


def inside(way: Course, order: int, s: Scalar, apart: Bool[Array, ""], onset: Bool[Array, ""]) -> Within:
    """The extremes within `s` radians, at whose end there may be an `onset`."""
    v, unit = way.v.upto(order - 1), way.unit
    rate, end = _rate(v), value_and_rate(v, s)[1] / unit
    missed = jnp.full_like(end, jnp.inf)
    for there, top in _crests(v, s):
        missed = jnp.where(there & apart & (top < 0), jnp.minimum(missed, -top), missed)
    return Within(
        v_max=jnp.where(apart, 0.0, _highest(v, s)),
        fastest=jnp.maximum(_highest(rate, s), _highest(_negative(rate), s)) / unit,
        slowest_onset=jnp.where(onset, end, jnp.inf),
        nearest_miss=missed,
    )


def both(a: Within, b: Within) -> Within:
    """The extremes of two stretches of time."""
    largest, least = jnp.maximum, jnp.minimum
    return Within(*(f(x, y) for f, x, y in zip((largest, largest, least, least), a, b, strict=True)))


def _highest(c: Coefficients, s: Scalar) -> Scalar:
    """The largest value of a polynomial within `s`."""
    best = jnp.maximum(c[0], value(c, s))
    for there, top in _crests(c, s):
        best = jnp.where(there, jnp.maximum(best, top), best)
    return best


def _crests(c: Coefficients, s: Scalar) -> Iterator[tuple[Bool[Array, ""], Scalar]]:
    """Whether a polynomial has a crest in a part of `s`, and its value there: a Newton step from that of the cubic."""
    width = s / PARTS
    for part in range(PARTS):
        low = part * width
        (g_0, m_0), (g_1, m_1) = value_and_rate(c, low), value_and_rate(c, low + width)
        top, there = crest(Rise(g_0, g_1, m_0 * width, m_1 * width))
        at = low + top * width
        slope, bend = value_and_rate(_rate(c), at)
        at = jnp.where(bend < 0, jnp.clip(at - slope / jnp.where(bend < 0, bend, -1.0), low, low + width), at)
        yield there, value(c, at)


def _rate(c: Coefficients) -> Coefficients:
    return tuple(n * a for n, a in enumerate(c))[1:]


def _negative(c: Coefficients) -> Coefficients:
    return tuple(-a for a in c)
