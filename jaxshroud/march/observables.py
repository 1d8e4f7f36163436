"""Observables of a state: forces and energy, and their extremes inside the steps."""

from collections.abc import Iterator
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.carry import PerLane
from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import HermiteCubic
from jaxshroud.march.tally import ContactPeaks, DisplacementRange, EnergyJumps, Impacts, StepExtrema, displacements_of
from jaxshroud.march.taylor_events import TRIAL_PARTS, Coefficients
from jaxshroud.march.taylor_expansion import TaylorExpansion
from jaxshroud.model.arithmetic import ABSENT, Pair, Scalar, blended, is_absent, where
from jaxshroud.model.friction import Slider, Springs, contact_energy, normal_force, slip_sign, stretch
from jaxshroud.model.geometry import Case, ContactKinematics, Pose, contact_rates, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import ContactLoads, Displacements, EndTorques, Ledger, end_torques, law_forces, stored_energy
from jaxshroud.model.series import polynomial_value, polynomial_value_and_rate
from jaxshroud.scene.keys import Motion


class ContactForces(NamedTuple):
    """The forces of contact. The left block feels -N n - F t, with the normal n and the tangent t of the face.

    The right block feels the opposite. When apart, the forces are 0 and -v > 0 is the remaining gap along the normal.
    """

    N: Any  # normal force [N]
    F: Any  # friction force; positive against sliding to larger u [N]
    v: Any  # penetration [m]
    u: Any  # slide of the left block against the right one [m]
    contact_point: Any  # up the left block's face from its middle [m]; NaN when apart, absent where blocks do not turn


def contact_forces(Q: Pair, state: State, model: Model) -> ContactForces:
    """The contact forces in a state; flat contact needs the drive's wave `Q` for the place where it acts."""
    placed = place_contact(state.motion, state, model)
    return contact_forces_at(placed, end_torques(state.motion, Q, placed[2], state, model), state, model)


def contact_forces_at(
    placed: tuple[Pose, Case, ContactKinematics], torques: EndTorques, state: State, model: Model
) -> ContactForces:
    """`contact_forces` of placed blocks under known torques."""
    _, case, at = placed
    N, F, _ = law_forces(at, state.motion, state, case, model)
    F = where(state.mode == Mode.APART, ABSENT, F)  # no negative zero
    point = ABSENT
    if has_torsion(model):
        place = _tip_position(at, case, model.block.l_ab)
        if model.spring.modal:
            place = where(case == FLAT, _flat_contact_position(at, torques, model), place)
        point = where(state.mode == Mode.APART, jnp.nan, place)
    return ContactForces(N, F, at.v, at.u, point)


def _tip_position(at: ContactKinematics, case: Case, l_ab: Scalar) -> Scalar:
    """The position of the penetrating corner along the left block's face."""
    return blended(is_upper(case), l_ab, -l_ab) / 2 - blended(tip_is_left(case), 0.0, _offset_along_face(at))


def _offset_along_face(at: ContactKinematics) -> Scalar:
    """The offset of the left block's corner from the right one's, up the face: the slide of the consistent reading."""
    return at.offset[0] * at.tangent[0] + at.offset[1] * at.tangent[1]


def _flat_contact_position(at: ContactKinematics, torque: EndTorques, model: Model) -> Scalar:
    """The position at which the resultant of flat contact keeps the blocks parallel, between the ends of the overlap.

    The torque on theta_1 - theta_2 is linear along the overlap, whose ends are the corners d and a, or b and c.
    """
    l_ab, along = model.block.l_ab, _offset_along_face(at)
    low = -l_ab / 2 - where(at.height > 0, 0.0, along)
    high = l_ab / 2 - where(at.height > 0, along, 0.0)
    apart = torque.lower - torque.upper
    return low + (high - low) * (torque.lower / where(apart == 0, 1.0, apart))


def total_energy(state: State, model: Model) -> Scalar:
    """The kinetic energy and the energy of the blades' and of the contact springs [J]."""
    return stored_energy(state.motion, model) + contact_spring_energy(state, model)


def contact_spring_energy(state: State, model: Model) -> Scalar:
    """The energy of the contact springs [J]."""
    at = place_contact(state.motion, state, model)[2]
    w = stretch(at.v, at.u, state.u_s, state.mode, model.spring)
    return contact_energy(at.v, w, state.mode, model.spring)


def slider_position(state: State, model: Model) -> Slider:
    """The slider, which compiled loops do not carry along in slip [m]; the state itself of laws that integrate it."""
    if model.spring.flows:
        return state.u_s
    at = place_contact(state.motion, state, model)[2]
    return at.u - stretch(at.v, at.u, state.u_s, state.mode, model.spring)


def energy_residual(ledger: Ledger, jumps: EnergyJumps, stored: PerLane) -> PerLane:
    """The residual of the energy balance [J]: works and jumps less the change of the `stored` energy."""
    return ledger.drive + jumps.springs - jumps.dropped - ledger.viscous - ledger.friction - stored


MAX_IMBALANCE = 0.5  # largest residual over the energy involved; an acceptable march has thousandths


def is_unbalanced(residual: PerLane, gross: PerLane, before: PerLane, after: PerLane) -> Bool[Array, "..."]:
    """Whether the residual is so large, against the gross work and the stored energy, that the motion is invalid."""
    return jnp.abs(residual) > MAX_IMBALANCE * (gross + jnp.abs(before) + jnp.abs(after))


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


def updated_extrema(
    before: StepExtrema,
    state: State,
    z: Motion,
    h: Scalar,
    apart: Bool[Array, ""],
    onset: Bool[Array, ""],
    model: Model,
) -> StepExtrema:
    """The extremes after a trial step of `h` seconds from `state` to the motion `z`, which may end in an `onset`."""
    (v_0, rate_0), (v_1, rate_1) = _penetration(state.motion, state, model), _penetration(z, state, model)
    cubic = HermiteCubic(v_0, v_1, rate_0 * h, rate_1 * h)
    s, inside = cubic_maximum(cubic)
    top = cubic(s)
    deepest = where(inside, jnp.maximum(top, v_1), v_1)
    missed = apart & inside & (top < 0)
    between = steepest_slope(cubic) / where(h > 0, h, jnp.inf)
    fastest = jnp.maximum(between, jnp.maximum(jnp.abs(rate_0), jnp.abs(rate_1)))
    return StepExtrema(
        where(apart, before.v_max, jnp.maximum(before.v_max, deepest)),
        jnp.maximum(before.fastest, fastest),
        where(onset, jnp.minimum(before.slowest_onset, rate_1), before.slowest_onset),
        where(missed, jnp.minimum(before.nearest_miss, -top), before.nearest_miss),
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
    F: Scalar  # absent without friction, like its rate
    F_rate: Scalar


def updated_peaks(before: ContactPeaks, state: State, z: Motion, h: Scalar, model: Model) -> ContactPeaks:
    """The largest forces after a trial step of `h` seconds from `state` to the motion `z`."""
    a, b = _end_forces(state.motion, state, model), _end_forces(z, state, model)
    deepest = _cubic_peak(HermiteCubic(a.v, b.v, a.v_rate * h, b.v_rate * h))
    own = not is_absent(model.spring.laws)
    N = jnp.maximum(before.N, jnp.maximum(a.N, b.N) if own else normal_force(deepest, state.mode, model.spring))
    if is_absent(a.F):
        return ContactPeaks(N, before.F)
    ends = jnp.maximum(jnp.abs(a.F), jnp.abs(b.F))
    if not model.spring.flows:
        for sign in (1.0, -1.0):
            ends = jnp.maximum(
                ends, _cubic_peak(HermiteCubic(sign * a.F, sign * b.F, sign * a.F_rate * h, sign * b.F_rate * h))
            )
    return ContactPeaks(N, jnp.maximum(before.F, where(_apart(state), 0.0, ends)))


def closing_speed(z: Motion, state: State, model: Model) -> Scalar:
    """The rate of the penetration at the motion `z` [m/s]."""
    return _penetration(z, state, model)[1]


def updated_impacts(
    before: Impacts,
    loads: ContactLoads | None,
    speed: Scalar | None,
    impact: Bool[Array, ""],
    separation: Bool[Array, ""],
) -> Impacts:
    """The impacts after a trial with these `loads` that ends at a closing `speed`, perhaps in an event."""
    assert loads is not None  # it is kept with impacts, as is the speed
    assert speed is not None
    now = before.now + loads.N
    return Impacts(
        before.number + where(impact, 1.0, 0.0),
        where(impact, jnp.maximum(before.approach, speed), before.approach),
        before.approach_sum + where(impact, speed, 0.0),
        before.ended + where(separation, 1.0, 0.0),
        before.impulse_sum + where(separation, now, 0.0),
        where(separation, jnp.maximum(before.impulse, now), before.impulse),
        where(separation, 0.0, now),
    )


def updated_range(before: DisplacementRange, start: Motion, z: Motion, h: Scalar) -> DisplacementRange:
    """The range of the displacements after a trial step of `h` seconds from the motion `start` to `z`."""
    rates = lambda z: (z.v_x, z.v_y, z.v_theta)

    def within(a: Scalar, b: Scalar, rate_a: Scalar, rate_b: Scalar) -> _Extent:
        cubic = HermiteCubic(a, b, rate_a * h, rate_b * h)
        s, turns = _turning_point(cubic)
        return _extent_of(a, b, where(turns, cubic(s), b))

    ends = displacements_of(start), displacements_of(z), rates(start), rates(z)
    return merged_range(before, _range_of(jax.tree.map(within, *ends)))


class _Extent(NamedTuple):
    highest: Scalar
    lowest: Scalar


def _extent_of(*values: Scalar) -> _Extent:
    return _Extent(reduce(jnp.maximum, values), reduce(jnp.minimum, values))


def _range_of(intervals: Any) -> DisplacementRange:
    """The range from the interval of each displacement."""
    end = lambda i: jax.tree.map(lambda a: a[i], intervals, is_leaf=lambda a: isinstance(a, _Extent))
    return DisplacementRange(end(0), end(1))


def _turning_point(cubic: HermiteCubic) -> tuple[Scalar, Bool[Array, ""]]:
    """The place where a cubic turns once, and whether it does."""
    up = where(cubic.m_0 > 0, 1.0, -1.0)
    s, inside = cubic_maximum(HermiteCubic(*(up * a for a in cubic)))
    return s, inside & (cubic.m_0 * cubic.m_1 < 0)


def merged_range(a: DisplacementRange, b: DisplacementRange) -> DisplacementRange:
    """The range of two intervals of time taken together."""
    highest = jax.tree.map(jnp.maximum, a.highest, b.highest)
    return DisplacementRange(highest, jax.tree.map(jnp.minimum, a.lowest, b.lowest))


def _apart(state: State) -> Bool[Array, ""]:
    return state.mode == Mode.APART


def _cubic_peak(cubic: HermiteCubic) -> Scalar:
    """The largest value of a cubic on its interval."""
    s, inside = cubic_maximum(cubic)
    return jnp.maximum(jnp.maximum(cubic.g_0, cubic.g_1), where(inside, cubic(s), cubic.g_1))


def _end_forces(z: Motion, state: State, model: Model) -> _EndForces:
    _, case, at = place_contact(z, state, model)
    rate, spring = contact_rates(at, z, case, model.reading), model.spring
    N, F, _ = law_forces(at, z, state, case, model)
    if spring.flows:
        return _EndForces(at.v, rate.v, N, F, ABSENT)
    slipping = spring.mu * (slip_sign(state.mode, at.v.dtype) * spring.k * rate.v)
    F_rate = F if is_absent(F) else where(state.mode == Mode.STICK, spring.k_d * rate.u, slipping)
    return _EndForces(at.v, rate.v, N, F, F_rate)


def deepest_penetration(expansion: TaylorExpansion, order: int, s: Scalar) -> Scalar:
    """The largest penetration within `s` radians: at the end, or at the maximum of the cubic in between."""
    v = expansion.v.coefficients(order - 1)
    end, rate = polynomial_value_and_rate(v, s)
    top, inside = cubic_maximum(HermiteCubic(v[0], end, v[1] * s, rate * s))
    return where(inside, jnp.maximum(end, polynomial_value(v, top * s)), end)


def closing_speed_after(expansion: TaylorExpansion, order: int, s: Scalar) -> Scalar:
    """The rate of the penetration after `s` radians [m/s]."""
    return polynomial_value_and_rate(expansion.v.coefficients(order - 1), s)[1] / expansion.unit


def midpoint_magnitudes(expansion: TaylorExpansion, order: int, s: Scalar) -> Displacements:
    """The magnitudes of the displacements in the middle of `s` radians."""
    # a node of the power's quadrature
    size = lambda a: a if is_absent(a) else jnp.abs(polynomial_value(a.coefficients(order), s * 0.5))
    x, y, theta = (tuple(map(size, pair)) for pair in displacements_of(expansion.motion))
    return x, y, theta  # pyright: ignore[reportReturnType]


def taylor_range(expansion: TaylorExpansion, order: int, s: Scalar) -> DisplacementRange:
    """The range of the displacements within `s` radians."""
    within = lambda a: a if is_absent(a) else _polynomial_extent_of(a.coefficients(order), s)
    return _range_of(tuple(tuple(map(within, pair)) for pair in displacements_of(expansion.motion)))


def _polynomial_extent_of(c: Coefficients, s: Scalar) -> _Extent:
    """The interval of a polynomial's values within `s`; in each part it turns once at most."""
    width, values = s / TRIAL_PARTS, [c[0]]
    end = c[0], c[1]
    for part in range(TRIAL_PARTS):
        low, start = part * width, end
        end = polynomial_value_and_rate(c, low + width)
        cubic = HermiteCubic(start[0], end[0], start[1] * width, end[1] * width)
        at, turns = _turning_point(cubic)
        at = low + at * width
        slope, bend = polynomial_value_and_rate(_derivative(c), at)
        at = jnp.clip(at - slope / where(turns & (bend != 0), bend, jnp.inf), low, low + width)
        values += [end[0], where(turns, polynomial_value(c, at), end[0])]
    return _extent_of(*values)


def taylor_peaks(expansion: TaylorExpansion, order: int, s: Scalar, state: State, spring: Springs) -> ContactPeaks:
    """The largest forces within `s` radians [N]."""
    N = normal_force(_polynomial_maximum(expansion.v.coefficients(order - 1), s), state.mode, spring)
    if is_absent(spring.lag):
        return ContactPeaks(N, jnp.zeros_like(N))
    w = (expansion.u - state.u_s).coefficients(order - 1)
    stuck = spring.k_d * jnp.maximum(_polynomial_maximum(w, s), _polynomial_maximum(_negated(w), s))
    return ContactPeaks(N, where(state.mode == Mode.STICK, stuck, spring.mu * N))


def taylor_extrema(
    expansion: TaylorExpansion, order: int, s: Scalar, apart: Bool[Array, ""], onset: Bool[Array, ""]
) -> StepExtrema:
    """The extremes within `s` radians, at whose end there may be an `onset`."""
    v, unit = expansion.v.coefficients(order - 1), expansion.unit
    rate, end = _derivative(v), closing_speed_after(expansion, order, s)
    missed = jnp.full_like(end, jnp.inf)
    for there, top in _polynomial_crests(v, s):
        missed = where(there & apart & (top < 0), jnp.minimum(missed, -top), missed)
    return StepExtrema(
        v_max=where(apart, 0.0, _polynomial_maximum(v, s)),
        fastest=jnp.maximum(_polynomial_maximum(rate, s), _polynomial_maximum(_negated(rate), s)) / unit,
        slowest_onset=where(onset, end, jnp.inf),
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
