"""What is read off the polynomials of a trial: its end, the integrals of the motion and of contact, and extremes."""

import math
from functools import cache, partial
from itertools import count
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.polynomial.legendre import Legendre

from jaxshroud.march.events import events_at_points, happens
from jaxshroud.march.extremes import ContactSeries, MotionSeries, deepest_penetration
from jaxshroud.march.log import found_by_series
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import TOLERANCE_RANGE
from jaxshroud.march.taylor_expansion import (
    BladeSeries,
    Coefficients,
    FaceSeries,
    motion_of_series,
    per_radian,
    series_of_wave,
)
from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, summed, where
from jaxshroud.model.blade import AnyBlade
from jaxshroud.model.contact_law import ContactLoads, ContactPoint, LinearLaw, linear_laws
from jaxshroud.model.drive import Excitation
from jaxshroud.model.geometry import PointRates
from jaxshroud.model.linear import StaticPosition
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Integrals, Ledger, Means, Moments, blade_mean_square
from jaxshroud.model.row import RowModel, alone, coupling_losses, in_one_ledger, of_blades_that_count, over
from jaxshroud.model.series import coefficients, polynomial, polynomial_value, polynomial_value_and_rate, rate_of

EXTRA_WORK_TERMS = 4  # further terms of the works: without them the error of squares is 100 times the tolerance
NO_MOTION = {8: 1e-250, 4: 1e-30}  # by the bytes of a number: a coordinate of a blade and its rate per radian
TESTED_TOLERANCES = np.geomspace(*TOLERANCE_RANGE, 16)


class OfShroud(NamedTuple):
    """The polynomials of one shroud, or of each."""

    x: Coefficients
    y: Coefficients
    theta: Coefficients
    sine: Coefficients
    versine: Coefficients


class TrialSpan(NamedTuple):
    """The span of a trial."""

    end: Scalar  # [rad]
    unit: Scalar  # seconds per radian
    wave: tuple[Scalar, Scalar]  # (sin, cos) of omega t at its start


class TrialReading(NamedTuple):
    """What is read off the polynomials of a trial."""

    motion: Any  # at its end
    gain: Integrals
    deepest: Any  # largest penetration at each interface [m]; None with derivatives
    by_series: dict[str, Any] | None  # what each observable reads; None with derivatives


def read_off(
    span: TrialSpan,
    blades: BladeSeries,
    faces: FaceSeries,
    contact: State,
    events: tuple[Any, Any],
    model: RowModel,
    method: Choices,
) -> TrialReading:
    """What is read off the polynomials of a trial, for an element of a row or for an unrolled one.

    Args:
        span: The span of the trial.
        blades: The polynomials of the blades.
        faces: Those of contact.
        contact: The state at the start; its motion is not used.
        events: Whether a trial ends in an event, and of what kind, at each interface.
        model: The model.
        method: The method.
    """
    order, recorded = method.taylor.order, method.recorded
    z = motion_of_series([over(alone, polynomial, a) for a in blades.own], model.blades)
    up_to_order = partial(over, alone, partial(coefficients, n=order))
    x, y, theta = map(up_to_order, model.blades.shroud(z)[:3])
    shrouds = OfShroud(x=x, y=y, theta=theta, sine=blades.sine, versine=blades.versine)
    counted = of_blades_that_count(shrouds, model)
    moments = over(alone, lambda own: integrated_moments(own, order, span), shrouds) if recorded.moments else None
    means = over(alone, lambda own: integrated_means(own, order, span), counted) if recorded.means else None

    def of_face(own: FaceSeries, contact: State, model: Model) -> ContactLoads:
        of_points = [integrated_loads(point, order, span) for point in sliding_points(own, contact, model)]
        return model.law.loads_of_interface(of_points)

    loads = over(alone, of_face, faces, contact, model.interfaces) if recorded.loads else None

    def power_of(own: OfShroud, gyration: Scalar, static: StaticPosition | None) -> Scalar:
        return integrated_square(own, order, span, gyration, static)

    power = over(alone, power_of, shrouds, model.gyration, model.static)
    ledger = None
    if recorded.ledger:
        ledger = integrated_works(z, faces, contact, span, per_radian(model, span.unit), order)
    end = motion_after(blades.own, model.blades, span.unit, span.end)
    gain = Integrals(power=power, ledger=ledger, moments=moments, loads=loads, means=means)
    if method.derivative:
        return TrialReading(end, gain, None, None)

    def at_face(own: FaceSeries, contact: State, events: tuple[Any, Any], model: Model) -> Any:
        fire, kind = events
        apart = interface_mode(contact.mode) == Mode.APART
        points = sliding_points(own, contact, model)
        begins = [apart & fire & happens(kind, lift) for lift, _ in events_at_points(model.law)]
        forces = [point.law.forces(point.contact) for point in points]
        inside = ContactSeries(
            v=[point.contact.at.v for point in points],
            N=summed(own.N for own in forces),
            F=summed(own.F for own in forces),
            apart=apart,
            onset=begins,
            unit=span.unit,
            order=order,
            end=span.end,
        )
        return deepest_penetration(inside), found_by_series(inside, method)

    def at_blade(z: Any, blade: AnyBlade) -> Any:
        return found_by_series(MotionSeries(blade.watched(z), order, span.end), method)

    deepest, by_series = over(alone, at_face, faces, contact, events, model.interfaces)
    return TrialReading(end, gain, deepest, by_series | over(alone, at_blade, z, model.blades))


def integrated_square(
    own: OfShroud, order: int, span: TrialSpan, gyration: Scalar, static: StaticPosition | None
) -> Scalar:
    """The mean square of the displacements of one blade, integrated in time."""
    s = span.end

    def mean(a: Coefficients) -> Any:
        return ZERO if is_zero(a[0]) else polynomial_value(_integrated(a[:order])[1:], s)

    versine = mean(own.versine)  # which enters linearly, as the sine does
    sine = ZERO if static is None else mean(own.sine)
    summed = ZERO
    for t, weight in zip(*lobatto_rule_for(order), strict=True):
        x, y = (_at_node(a, s, t) for a in (own.x, own.y))
        summed = summed + weight * blade_mean_square(x, y, sine, versine, gyration, static)
    return summed * s * span.unit


def _at_node(a: Coefficients, s: Scalar, t: float) -> Any:
    """A polynomial at the node `t` of a rule over `s` radians."""
    return a[0] if is_zero(a[0]) or not t else polynomial_value(a, s * t)


def integrated_means(own: OfShroud, order: int, span: TrialSpan) -> Means:
    """The position of one blade, integrated; x and y at the nodes at which their squares are needed."""
    rule = list(zip(*lobatto_rule_for(order), strict=True))
    seconds = span.end * span.unit

    def at_nodes(a: Coefficients) -> Any:
        return ZERO if is_zero(a[0]) else seconds * sum(w * _at_node(a, span.end, t) for t, w in rule)

    def gained(a: Coefficients) -> Any:
        return ZERO if is_zero(a[0]) else polynomial_value(_integrated(a[:order]), span.end) * span.unit

    return Means(at_nodes(own.x), at_nodes(own.y), gained(own.sine), gained(own.versine))


def integrated_works(z: Any, faces: FaceSeries, contact: State, span: TrialSpan, model: RowModel, order: int) -> Ledger:
    """The works of a trial by a model per radian: those of a pair, or of each blade and of each interface of a row."""
    wave = series_of_wave(span.wave)

    def rates(z: Any, blade: AnyBlade, drive: Excitation) -> tuple[Any, Any]:
        return blade.drive_power(z, drive.wave(*wave), drive), blade.viscous_power(z)

    drive, viscous = over(alone, rates, z, model.blades, model.drive)
    viscous = viscous + coupling_losses(z, model)
    lost = over(alone, _lost_in_contact, faces, contact, model.interfaces)
    drive, viscous, lost = (in_one_ledger(a, model) for a in (drive, viscous, lost))
    joules = 1 / (span.unit * span.unit)

    def gained(rate: Any, share: float = 1.0) -> Any:
        if is_zero(rate):
            return rate
        # Products have twice the frequency: their integrals need more terms of the truncated motion.
        coefficients = rate.coefficients(order + EXTRA_WORK_TERMS - 1)
        return polynomial_value(_integrated(coefficients), span.end * share) * joules

    def of_drive(rate: Any) -> tuple[Any, Any]:
        half, whole = gained(rate, 0.5), gained(rate)
        return whole, jnp.abs(half) + jnp.abs(whole - half)

    work, gross = over(alone, of_drive, drive)
    return Ledger(drive=work, gross=gross, viscous=over(alone, gained, viscous), friction=over(alone, gained, lost))


def _lost_in_contact(own: FaceSeries, contact: State, model: Model) -> Any:
    """The power that contact dissipates at one interface, as a series."""
    points = sliding_points(own, contact, model)
    return summed(law.dissipated_power(point, law.forces(point)) for law, point in points)


class SlidingSeries(NamedTuple):
    """The kinematics of contact as far as laws that are linear ask for series."""

    v: Any
    u: Any
    rounding: Any


class SlidingPoint(NamedTuple):
    """A point of contact within a trial."""

    law: LinearLaw
    contact: ContactPoint  # at a `SlidingSeries`


def sliding_points(own: FaceSeries, contact: State, model: Model) -> list[SlidingPoint]:
    """The points of contact of one interface from its polynomials; of the state only the contact is used."""
    laws = linear_laws(model.law)
    modes = contact.mode if isinstance(contact.mode, tuple) else (contact.mode,)
    sliders = contact.u_s if isinstance(contact.u_s, tuple) else (contact.u_s,) * len(laws)
    u = polynomial(own.u)
    points = []
    for law, point, u_s, mode in zip(laws, own.points, sliders, modes, strict=True):
        at = SlidingSeries(polynomial(point.v), u, point.rounding)
        rates = PointRates(v=rate_of(at.v), u=rate_of(u))
        points.append(SlidingPoint(law, ContactPoint(at, contact.motion, own.case, u_s, mode, model.reading, rates)))
    return points


def integrated_moments(own: OfShroud, order: int, span: TrialSpan) -> Moments:
    """The moments of the displacements of one blade."""
    s, unit = span.end, span.unit
    rule = list(zip(*lobatto_rule_for(order), strict=True))

    def first(a: Coefficients) -> Any:
        return ZERO if is_zero(a[0]) else polynomial_value(_integrated(a[:order]), s) * unit

    def second(a: Coefficients) -> Any:
        return ZERO if is_zero(a[0]) else s * sum(w * polynomial_value(a, s * t) ** 2 for t, w in rule) * unit

    displacements = own[:3]
    return Moments(tuple(map(first, displacements)), tuple(map(second, displacements)))  # pyright: ignore[reportArgumentType]


def integrated_loads(point: SlidingPoint, order: int, span: TrialSpan) -> ContactLoads:
    """The loads of a point of contact; in slip the slider never turns: its path is the distance of its ends."""
    law = point.law
    mode = point.contact.mode
    s = span.end
    displacements = [a.coefficients(order - 1) for a in (point.contact.at.v, point.contact.at.u)]
    impulse = polynomial_value(_integrated(displacements[0]), s) * span.unit
    N = law.normal_force(impulse, mode)
    if not law.has_stick:
        return ContactLoads(N, ZERO, ZERO, ZERO)
    v, u = (polynomial_value(a, s) - a[0] for a in displacements)
    slips = (mode == Mode.SLIP_PLUS) | (mode == Mode.SLIP_MINUS)
    path = jnp.abs(law.slider_speed(v, u, mode))
    return ContactLoads(N, where(slips, N, 0.0), where(slips, s * span.unit, 0.0), path)


def motion_after(own: tuple[Coefficients, ...], blades: AnyBlade, unit: Scalar, s: Scalar) -> Any:
    """The motion of blades after `s` radians of `unit` seconds each."""

    def end(a: Coefficients) -> tuple[Any, Any]:
        if is_zero(a[0]):
            return a[0], a[0]
        place, rate = _unless_at_rest(*polynomial_value_and_rate(a, s))
        return place, rate / unit

    return blades.motion(*zip(*(over(alone, end, a) for a in own), strict=True))


def _unless_at_rest(value: Scalar, rate: Scalar) -> tuple[Scalar, Scalar]:
    """A coordinate and its rate, both 0 where they are so small that rounding to 0 would let them change sign.

    What they would be beside that motion, their tangents, they keep.
    """
    moves = jnp.abs(value) + jnp.abs(rate) > NO_MOTION[value.dtype.itemsize]
    rest = partial(where, moves, 0.0)
    return value - lax.stop_gradient(rest(value)), rate - lax.stop_gradient(rest(rate))


def _integrated(rate: Coefficients) -> Coefficients:
    """The coefficients of the integral."""
    known = next(a for a in rate if not is_zero(a))
    return (jnp.zeros_like(known), *(a if is_zero(a) else a * (1 / (n + 1)) for n, a in enumerate(rate)))


class QuadratureRule(NamedTuple):
    """The nodes and weights on [0, 1]: the first and the last node are the ends, and the middle one is 1/2."""

    nodes: tuple[float, ...]
    weights: tuple[float, ...]


@cache
def lobatto_rule_for(order: int) -> QuadratureRule:
    """The shortest rule that integrates squares as accurately as series of that order are, at every tolerance.

    A trial is as long as the fastest vibration of the motion allows: its last term then equals the tolerance.
    """

    def exact(n):
        return all(lobatto_error(n, _trial_turn(order, at)) <= at for at in TESTED_TOLERANCES)

    return lobatto(next(n for n in count(3, 2) if exact(n)))


def _trial_turn(order: int, tolerance: float) -> float:
    """The phase that the square of the fastest vibration gains in a trial [rad]."""
    return 2 * (math.factorial(order) * tolerance) ** (1 / order)


def lobatto(n: int) -> QuadratureRule:
    """Lobatto's rule of an odd number `n` of nodes, exact up to degree 2 n - 3."""
    last = Legendre.basis(n - 1)
    nodes = np.concatenate([[-1.0], np.sort(last.deriv().roots().real), [1.0]])
    weights = 1 / (n * (n - 1) * last(nodes) ** 2)
    nodes = (1 + nodes) / 2
    nodes[n // 2] = 0.5
    return QuadratureRule(tuple(nodes.tolist()), tuple(weights.tolist()))


def lobatto_error(n: int, turn: float) -> float:
    """A bound of the rule's error on the mean of a wave of amplitude 1 that turns by `turn` radians: its remainder."""
    f = math.factorial
    return n * (n - 1) ** 3 * f(n - 2) ** 4 / ((2 * n - 1) * f(2 * n - 2) ** 3) * turn ** (2 * n - 2)
