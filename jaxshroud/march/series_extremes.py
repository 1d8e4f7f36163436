"""The extremes of the motion and of the forces inside a trial by power series, by its polynomials."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.cubic_extremes import Extent, cubic_maximum, extent_of, range_from, turning_point
from jaxshroud.march.locate import HermiteCubic
from jaxshroud.march.tally import ContactPeaks, DisplacementRange, StepExtrema, displacements_of
from jaxshroud.march.taylor_events import TRIAL_PARTS, Coefficients
from jaxshroud.model.arithmetic import Scalar, is_absent, where
from jaxshroud.model.contact_law import LinearLaw
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.series import Series, polynomial_value, polynomial_value_and_rate
from jaxshroud.scene.keys import Motion


class ContactSeries(NamedTuple):
    """The contact of both blades within a trial by power series."""

    v: Series  # penetration, in radians from the start of the trial, as is the next [m]
    u: Series  # slide [m]
    unit: Scalar  # seconds per radian
    order: int  # of the polynomials
    end: Scalar  # the end of the trial [rad]
    start: State
    onset: Bool[Array, ""]  # the trial ends in an onset
    law: LinearLaw


class MotionSeries(NamedTuple):
    """The motion of one blade, or of both, within a trial by power series."""

    motion: Motion  # of `Series`
    order: int  # of the polynomials
    end: Scalar  # the end of the trial [rad]


def deepest_penetration(inside: ContactSeries) -> Scalar:
    """The largest penetration: at the end, or at the maximum of the cubic in between."""
    v, s = inside.v.coefficients(inside.order - 1), inside.end
    end, rate = polynomial_value_and_rate(v, s)
    top, there = cubic_maximum(HermiteCubic(v[0], end, v[1] * s, rate * s))
    return where(there, jnp.maximum(end, polynomial_value(v, top * s)), end)


def final_closing_speed(inside: ContactSeries) -> Scalar:
    """The rate of the penetration at the end [m/s]."""
    return polynomial_value_and_rate(inside.v.coefficients(inside.order - 1), inside.end)[1] / inside.unit


def midpoint_magnitudes(inside: MotionSeries) -> tuple[Any, Any, Any]:
    """The magnitudes of the displacements in the middle, a node of the power's quadrature."""
    return _of_each_displacement(lambda c: jnp.abs(polynomial_value(c, inside.end * 0.5)), inside)


def taylor_range(inside: MotionSeries) -> DisplacementRange:
    """The range of the displacements."""
    return range_from(_of_each_displacement(lambda c: _polynomial_extent_of(c, inside.end), inside))


def _of_each_displacement(f: Callable[[Coefficients], Any], inside: MotionSeries) -> tuple[Any, Any, Any]:
    """`f` of the coefficients of each displacement that is not absent."""
    of = lambda a: a if is_absent(a) else f(a.coefficients(inside.order))
    return jax.tree.map(of, displacements_of(inside.motion), is_leaf=is_absent)


def _polynomial_extent_of(c: Coefficients, s: Scalar) -> Extent:
    """The interval of a polynomial's values within `s`; in each part it turns once at most."""
    width, values = s / TRIAL_PARTS, [c[0]]
    end = c[0], c[1]
    for part in range(TRIAL_PARTS):
        low, start = part * width, end
        end = polynomial_value_and_rate(c, low + width)
        cubic = HermiteCubic(start[0], end[0], start[1] * width, end[1] * width)
        at, turns = turning_point(cubic)
        at = low + at * width
        slope, bend = polynomial_value_and_rate(_derivative(c), at)
        at = jnp.clip(at - slope / where(turns & (bend != 0), bend, jnp.inf), low, low + width)
        values += [end[0], where(turns, polynomial_value(c, at), end[0])]
    return extent_of(*values)


def taylor_peaks(inside: ContactSeries) -> ContactPeaks:
    """The largest forces [N]."""
    state, law, order, s = inside.start, inside.law, inside.order, inside.end
    N = law.normal_force(_polynomial_maximum(inside.v.coefficients(order - 1), s), state.mode)
    if not law.has_stick:
        return ContactPeaks(N, jnp.zeros_like(N))
    w = (inside.u - state.u_s).coefficients(order - 1)
    size = jnp.maximum(_polynomial_maximum(w, s), _polynomial_maximum(_negated(w), s))
    return ContactPeaks(N, law.largest_friction_force(size, N, state.mode))


def taylor_extrema(inside: ContactSeries) -> StepExtrema:
    """The extremes of a trial, which may end in an onset."""
    v, s, apart = inside.v.coefficients(inside.order - 1), inside.end, inside.start.mode == Mode.APART
    rate, end = _derivative(v), final_closing_speed(inside)
    missed = jnp.full_like(end, jnp.inf)
    for there, top in _polynomial_crests(v, s):
        missed = where(there & apart & (top < 0), jnp.minimum(missed, -top), missed)
    return StepExtrema(
        v_max=where(apart, 0.0, _polynomial_maximum(v, s)),
        fastest=jnp.maximum(_polynomial_maximum(rate, s), _polynomial_maximum(_negated(rate), s)) / inside.unit,
        slowest_onset=where(inside.onset, end, jnp.inf),
        nearest_miss=missed,
    )


def merged_extrema(a: StepExtrema, b: StepExtrema) -> StepExtrema:
    """The extremes of two intervals of time taken together."""
    largest, least = jnp.maximum, jnp.minimum
    return StepExtrema(*(f(x, y) for f, x, y in zip((largest, largest, least, least), a, b, strict=True)))


def _polynomial_maximum(c: Coefficients, s: Scalar) -> Scalar:
    """The largest value of a polynomial within `s`."""
    best = jnp.maximum(c[0], polynomial_value(c, s))
    for there, top in _polynomial_crests(c, s):
        best = where(there, jnp.maximum(best, top), best)
    return best


def _polynomial_crests(c: Coefficients, s: Scalar) -> Iterator[tuple[Bool[Array, ""], Scalar]]:
    """For each part of `s`: whether a polynomial has a maximum, and its value, by a Newton step from the cubic's."""
    width = s / TRIAL_PARTS
    for part in range(TRIAL_PARTS):
        low = part * width
        (g_0, m_0), (g_1, m_1) = polynomial_value_and_rate(c, low), polynomial_value_and_rate(c, low + width)
        top, there = cubic_maximum(HermiteCubic(g_0, g_1, m_0 * width, m_1 * width))
        at = low + top * width
        slope, bend = polynomial_value_and_rate(_derivative(c), at)
        at = where(bend < 0, jnp.clip(at - slope / where(bend < 0, bend, -1.0), low, low + width), at)
        yield there, polynomial_value(c, at)


def _derivative(c: Coefficients) -> Coefficients:
    return tuple(n * a for n, a in enumerate(c))[1:]


def _negated(c: Coefficients) -> Coefficients:
    return tuple(-a for a in c)
