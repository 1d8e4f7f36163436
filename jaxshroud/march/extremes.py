"""The extremes of the motion and of the forces inside a trial: by cubics through its ends, or by its power series."""

from collections.abc import Callable, Iterator
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.accumulator import ContactPeaks, DisplacementRange, StepExtrema, watched_of
from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import HermiteCubic
from jaxshroud.march.observable import BladeTrial, InterfaceTrial
from jaxshroud.march.taylor_events import TRIAL_PARTS, Coefficients
from jaxshroud.model.arithmetic import Scalar, is_zero, where
from jaxshroud.model.geometry import contact_rates
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import law_forces
from jaxshroud.model.series import Series, coefficients, polynomial_value, polynomial_value_and_rate
from jaxshroud.scene.keys import Motion


def cubic_maximum(cubic: HermiteCubic) -> tuple[Scalar, Bool[Array, ""]]:
    """The place of the local maximum of a cubic, and whether it lies beyond the start and up to the end."""
    a, b, c = cubic.coefficients
    square = b * b - 3 * a * c
    down = jnp.sqrt(jnp.maximum(square, 0.0)) - b  # the maximum is the root a / down of the derivative
    there = (square > 0) & (down != 0)
    s = a / where(there, down, 1.0)
    return s, there & (s > 0) & (s <= 1)


def steepest_slope(cubic: HermiteCubic) -> Scalar:
    """The magnitude of the slope of a cubic at its inflection; 0 if that is outside the interval."""
    a, b, c = cubic.coefficients
    bends = c != 0
    at = -b / where(bends, 3 * c, 1.0)
    return where(bends & (at > 0) & (at < 1), jnp.abs(a + b * at), 0.0)


def trial_extrema(trial: InterfaceTrial) -> StepExtrema:
    """The extremes of a trial step, which may end in an onset."""
    start, z, h, model = trial.start, trial.end, trial.h, trial.model
    apart = interface_mode(start.mode) == Mode.APART
    (v_0, rate_0), (v_1, rate_1) = _penetration(start.motion, start, model), _penetration(z, start, model)
    cubic = HermiteCubic(v_0, v_1, rate_0 * h, rate_1 * h)
    s, inside = cubic_maximum(cubic)
    top = cubic(s)
    deepest = where(inside, jnp.maximum(top, v_1), v_1)
    between = steepest_slope(cubic) / where(h > 0, h, jnp.inf)
    return StepExtrema(
        v_max=where(apart, 0.0, deepest),
        fastest=jnp.maximum(between, jnp.maximum(jnp.abs(rate_0), jnp.abs(rate_1))),
        slowest_onset=where(trial.lift.onset, rate_1, jnp.inf),
        nearest_miss=where(apart & inside & (top < 0), -top, jnp.inf),
    )


def _penetration(z: Motion, state: State, model: Model) -> tuple[Scalar, Scalar]:
    """The penetration v and its rate."""
    _, case, at = place_contact(z, state, model)
    return at.v, contact_rates(at, z, case, model.reading).v


class _EndForces(NamedTuple):
    """The penetration and the contact forces at one end of a trial step."""

    v: Scalar
    v_rate: Scalar
    N: Scalar
    F: Scalar  # absent without friction
    F_rate: Scalar  # absent where it is not known


def trial_peaks(trial: InterfaceTrial) -> ContactPeaks:
    """The largest forces of a trial step."""
    state, h, model = trial.start, trial.h, trial.model
    a, b = _end_forces(state.motion, state, model), _end_forces(trial.end, state, model)
    deepest = _cubic_peak(HermiteCubic(a.v, b.v, a.v_rate * h, b.v_rate * h))
    N = model.law.largest_normal_force(deepest, state.mode, (a.N, b.N))
    if is_zero(a.F):
        return ContactPeaks(N, jnp.zeros_like(N))
    ends = jnp.maximum(jnp.abs(a.F), jnp.abs(b.F))
    if not is_zero(a.F_rate):
        for sign in (1.0, -1.0):
            ends = jnp.maximum(
                ends, _cubic_peak(HermiteCubic(sign * a.F, sign * b.F, sign * a.F_rate * h, sign * b.F_rate * h))
            )
    return ContactPeaks(N, where(state.mode == Mode.APART, 0.0, ends))


def closing_speed(trial: InterfaceTrial) -> Scalar:
    """The rate of the penetration at the end of a trial [m/s]."""
    return _penetration(trial.end, trial.start, trial.model)[1]


def trial_range(trial: BladeTrial) -> DisplacementRange:
    """The range of the displacements in a trial step."""
    start, z, h = trial.start, trial.end, trial.h

    def rates(z):
        return (z.v_x, z.v_y, z.v_theta, *z[7:])

    def within(a: Scalar, b: Scalar, rate_a: Scalar, rate_b: Scalar) -> Extent:
        cubic = HermiteCubic(a, b, rate_a * h, rate_b * h)
        s, turns = turning_point(cubic)
        return extent_of(a, b, where(turns, cubic(s), b))

    ends = watched_of(start), watched_of(z), rates(start), rates(z)
    return range_from(jax.tree.map(within, *ends))


class Extent(NamedTuple):
    """The interval of a number's values."""

    highest: Scalar
    lowest: Scalar


def extent_of(*values: Scalar) -> Extent:
    """The interval that some values span."""
    return Extent(reduce(jnp.maximum, values), reduce(jnp.minimum, values))


def range_from(intervals: Any) -> DisplacementRange:
    """The range from the interval of each displacement."""

    def end(i):
        return jax.tree.map(lambda a: a[i], intervals, is_leaf=lambda a: isinstance(a, Extent))

    return DisplacementRange(end(0), end(1))


def turning_point(cubic: HermiteCubic) -> tuple[Scalar, Bool[Array, ""]]:
    """The place where a cubic turns once, and whether it does."""
    up = where(cubic.m_0 > 0, 1.0, -1.0)
    s, inside = cubic_maximum(jax.tree.map(lambda a: up * a, cubic))
    return s, inside & (cubic.m_0 * cubic.m_1 < 0)


def merged_peaks(a: ContactPeaks, b: ContactPeaks) -> ContactPeaks:
    """The largest forces of two intervals of time taken together."""
    return jax.tree.map(jnp.maximum, a, b)


def merged_range(a: DisplacementRange, b: DisplacementRange) -> DisplacementRange:
    """The range of two intervals of time taken together."""
    highest = jax.tree.map(jnp.maximum, a.highest, b.highest)
    return DisplacementRange(highest, jax.tree.map(jnp.minimum, a.lowest, b.lowest))


def _cubic_peak(cubic: HermiteCubic) -> Scalar:
    """The largest value of a cubic on its interval."""
    s, inside = cubic_maximum(cubic)
    return jnp.maximum(jnp.maximum(cubic.g_0, cubic.g_1), where(inside, cubic(s), cubic.g_1))


def _end_forces(z: Motion, state: State, model: Model) -> _EndForces:
    _, case, at = place_contact(z, state, model)
    rate = contact_rates(at, z, case, model.reading)
    forces = law_forces(at, case, State(z, state.u_s, state.mode, state.case), model)
    return _EndForces(at.v, rate.v, forces.N, forces.F, model.law.friction_rate(rate, state.mode))


class ContactSeries(NamedTuple):
    """The contact of both blades within a trial by power series, in radians from its start."""

    v: list[Series]  # penetration of each point of contact [m]
    N: Any  # the sum of their normal forces [N]; absent without contact
    F: Any  # that of their friction forces; absent without friction
    apart: Bool[Array, ""]  # no point touches
    onset: list[Bool[Array, ""]]  # the trial ends as contact begins, at this point
    unit: Scalar  # seconds per radian
    order: int  # of the polynomials
    end: Scalar  # the end of the trial [rad]


class MotionSeries(NamedTuple):
    """The motion of one blade, or of both, within a trial by power series."""

    motion: Any  # of the shroud, watched, of `Series`
    order: int  # of the polynomials
    end: Scalar  # the end of the trial [rad]


def deepest_penetration(inside: ContactSeries) -> Scalar:
    """The largest penetration of any point: at the end, or at the maximum of the cubic in between."""

    def of_point(point: Series) -> Scalar:
        v = point.coefficients(inside.order - 1)
        s = inside.end
        end, rate = polynomial_value_and_rate(v, s)
        top, there = cubic_maximum(HermiteCubic(v[0], end, v[1] * s, rate * s))
        return where(there, jnp.maximum(end, polynomial_value(v, top * s)), end)

    return reduce(jnp.maximum, map(of_point, inside.v))


def final_closing_speed(inside: ContactSeries) -> Scalar:
    """The rate of the penetration of the deepest point at the end [m/s]."""
    (deepest, speed), *others = (
        polynomial_value_and_rate(v.coefficients(inside.order - 1), inside.end) for v in inside.v
    )
    for v, rate in others:
        speed = where(v > deepest, rate, speed)
        deepest = jnp.maximum(v, deepest)
    return speed / inside.unit


def midpoint_magnitudes(inside: MotionSeries) -> tuple[Any, Any, Any]:
    """The magnitudes of the displacements in the middle, a node of the power's quadrature."""
    return _of_each(inside.motion[:3], lambda c: jnp.abs(polynomial_value(c, inside.end * 0.5)), inside)


def taylor_range(inside: MotionSeries) -> DisplacementRange:
    """The range of the displacements."""
    return range_from(_of_each(watched_of(inside.motion), lambda c: _polynomial_extent_of(c, inside.end), inside))


def _of_each(displacements: Any, f: Callable[[Coefficients], Any], inside: MotionSeries) -> Any:
    """`f` of the coefficients of each displacement that is not absent."""

    def of(a):
        return a if is_zero(a) else f(a.coefficients(inside.order))

    return jax.tree.map(of, displacements, is_leaf=is_zero)


def _polynomial_extent_of(c: Coefficients, s: Scalar) -> Extent:
    """The interval of a polynomial's values within `s`; in each part it turns once at most."""
    width = s / TRIAL_PARTS
    values = [c[0]]
    end = c[0], c[1]
    for part in range(TRIAL_PARTS):
        low = part * width
        start = end
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
    s = inside.end
    N = _polynomial_maximum(coefficients(inside.N, inside.order - 1), s)
    if is_zero(inside.F):
        return ContactPeaks(N, jnp.zeros_like(N))
    F = coefficients(inside.F, inside.order - 1)
    return ContactPeaks(N, jnp.maximum(_polynomial_maximum(F, s), _polynomial_maximum(_negated(F), s)))


def taylor_extrema(inside: ContactSeries) -> StepExtrema:
    """The extremes of a trial, which may end in an onset."""
    s = inside.end
    apart = inside.apart

    def of_point(point: Series, onset: Bool[Array, ""]) -> StepExtrema:
        v = point.coefficients(inside.order - 1)
        rate = _derivative(v)
        end = polynomial_value_and_rate(v, s)[1] / inside.unit
        missed = jnp.full_like(end, jnp.inf)
        for there, top in _polynomial_crests(v, s):
            missed = where(there & apart & (top < 0), jnp.minimum(missed, -top), missed)
        return StepExtrema(
            v_max=where(apart, 0.0, _polynomial_maximum(v, s)),
            fastest=jnp.maximum(_polynomial_maximum(rate, s), _polynomial_maximum(_negated(rate), s)) / inside.unit,
            slowest_onset=where(onset, end, jnp.inf),
            nearest_miss=missed,
        )

    return reduce(merged_extrema, map(of_point, inside.v, inside.onset))


def merged_extrema(a: StepExtrema, b: StepExtrema) -> StepExtrema:
    """The extremes of two intervals of time taken together."""
    return StepExtrema(
        v_max=jnp.maximum(a.v_max, b.v_max),
        fastest=jnp.maximum(a.fastest, b.fastest),
        slowest_onset=jnp.minimum(a.slowest_onset, b.slowest_onset),
        nearest_miss=jnp.minimum(a.nearest_miss, b.nearest_miss),
    )


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
