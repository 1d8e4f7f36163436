"""The motion of one lane as power series while its mode and case are fixed, and integrals over a trial.

The integrals are the mean squares of the displacements, and the works.
"""

import math
from functools import cache
from itertools import count
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int
from numpy.polynomial.legendre import Legendre

from jaxshroud.march.carry import Fixed, Lane
from jaxshroud.march.event import switch_guards
from jaxshroud.march.events import HEIGHT, LIFT, RUB, TURN, number_of, place_contact
from jaxshroud.march.tableau import TOLERANCE_RANGE
from jaxshroud.model.arithmetic import ZERO, Pair, Scalar, is_zero, sincos_turns, where
from jaxshroud.model.contact_law import ContactLoads, LinearLaw, linear_law
from jaxshroud.model.drive import Waves, drive_wave_rates, drive_wave_series, drive_waves
from jaxshroud.model.geometry import Kinematics, Pose, contact_rates
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import (
    EndTorques,
    Ledger,
    Means,
    Moments,
    Placement,
    Recorded,
    end_torques_under,
    mean_square,
    placement,
    rhs,
    rhs_at,
)
from jaxshroud.model.series import Series, of_each, polynomial_value, rate_of, truncated
from jaxshroud.scene.keys import Motion

RADIANS_PER_TURN = 2 * math.pi
# The number of an event, and a `Series`, which stands for a Scalar in the model's equations.
GuardSeries = tuple[int, Any]


class TaylorExpansion(NamedTuple):
    """Power series in the drive phase since the start of a trial [rad]."""

    motion: Motion  # rates are per radian
    v: Any  # a `Series`, as is the next
    u: Any
    guards: list[GuardSeries]  # negative while the mode lasts
    pose: Pose
    works: Ledger | None  # their rates per radian, from the motion up to its order, in `unit ** 2` joules
    case: Int[Array, ""]  # the current case; when apart, that of the position at the start
    unit: Scalar  # seconds per radian


def taylor_expansion(lane: Lane, fixed: Fixed[Model], order: int, ledger: bool) -> TaylorExpansion:
    """The Taylor expansion of a lane's motion, guards and works.

    The motion is expanded up to an `order`, the accelerations to two orders less, and the guards to one order less.
    """
    grid, start = fixed.grid, lane.state
    unit = grid.h / (RADIANS_PER_TURN * grid.turn)
    model = per_radian(fixed.model, unit)
    s, c = sincos_turns(grid.start + (lane.step.astype(unit.dtype) + lane.search.done) * grid.turn)
    Q = drive_wave_series(drive_waves(s, c, model.drive), drive_wave_rates(c, -s, model.drive), model.drive)
    case = place_contact(start.motion, start, model)[1]

    accelerations: list = []  # filled once they are known as series
    x, y, theta = (
        _displacement_series(getattr(start.motion, name), getattr(start.motion, f"v_{name}"), unit, k, accelerations)
        for k, name in enumerate(("x", "y", "theta"))
    )
    v_x, v_y, v_theta = (tuple(map(rate_of, pair)) for pair in (x, y, theta))
    motion = Motion(x=x, y=y, theta=theta, v_x=v_x, v_y=v_y, v_theta=v_theta)
    now = State(motion, start.u_s, start.mode, case)
    place = placement(now, model)
    accelerations.extend(rhs_at(place, Q, now, model, Recorded())[0].acceleration)
    # Products have twice the frequency: their integrals need more terms of the truncated motion.
    truncated_motion = jax.tree.map(lambda a: truncated(a, order), now.motion)
    works = rhs(Q, State(truncated_motion, start.u_s, start.mode, case), model, Recorded(ledger))[1].ledger

    at = place.at._replace(v=truncated(place.at.v, order - 1), u=truncated(place.at.u, order - 1))
    lift = number_of(LIFT), where(start.mode == Mode.APART, 1.0, -1.0) * at.v
    guards = [lift, *_switch_series(Q, place, now, model, order), *_friction_series(at, now, model)]
    return TaylorExpansion(now.motion, at.v, at.u, guards, place.pose, works, case, unit)


def without_derivatives(expansion: TaylorExpansion) -> TaylorExpansion:
    """The same numbers without derivatives."""
    return jax.tree.map(lambda a: a if isinstance(a, int) else of_each(a, lax.stop_gradient), expansion)


def per_radian(model: Model, unit: Scalar) -> Model:
    """The model with time in units of `unit` seconds: masses stay, and forces are in kg m / unit^2."""

    def between(m, kind):
        return [] if m.coupling is None else [getattr(m.coupling, f"{kind}_{name}") for name in "xyT"]

    def forces(m):
        return (m.blades.k_x, m.blades.k_y, m.blades.k_T, *m.drive.loads, *between(m, "k"))

    def dampers(m):
        return (m.blades.c_x, m.blades.c_y, m.blades.c_T, *between(m, "c"))

    def springs(m):
        return linear_law(m.law).stiffnesses

    for places, factor in ((forces, unit * unit), (dampers, unit), (springs, unit * unit)):
        scaled = jax.tree.map(lambda a, factor=factor: a * factor, places(model))
        model = eqx.tree_at(places, model, scaled, is_leaf=is_zero)
    return model


def _displacement_series(x: Pair, v: Pair, unit: Scalar, k: int, accelerations: list) -> Any:
    """The series of displacements from their values `x` and speeds `v` and the `k`-th of the accelerations."""

    def of(i: int) -> Series:
        initial = x[i], v[i] * unit
        return Series(lambda n: accelerations[k][i][n - 2] * (1 / (n * (n - 1))) if n > 1 else initial[n])

    left, right = (x[i] if is_zero(x[i]) else of(i) for i in (0, 1))
    return left, right


def _switch_series(Q: Waves, place: Placement, now: State, model: Model, order: int) -> list[GuardSeries]:
    """The guards of the case, beyond their rounding. When apart they only end a trial: the position sets the case."""
    if not has_torsion(model):
        return []
    at = place.at
    torques = end_torques_under(place.loaded, now.motion, Q, place.at, now, model)
    leans = EndTorques._make(truncated(a, order - 2) for a in torques)
    turn, height = switch_guards(at._replace(height=truncated(at.height, order - 1)), leans, now.case)
    # where contact ends, LIFT is first
    flat = now.case == FLAT
    torque = model.law.normal_stiffness * model.block.l_ab * at.rounding
    slack = where(flat, torque, 0.0), where(flat, torque, at.rounding)
    return [(number_of(TURN), turn - slack[0]), (number_of(HEIGHT), height - slack[1])]


def _friction_series(at: Kinematics, now: State, model: Model) -> list[GuardSeries]:
    """The guards of the friction element."""
    rate = contact_rates(at, now.motion, now.case, model.reading)
    guards = linear_law(model.law).friction_series(at, rate, now.u_s, now.mode)
    return [(number_of(RUB), guard) for guard in guards]


EXTRA_WORK_TERMS = 4  # further terms of the works: without them the error of squares is 100 times the tolerance
TESTED_TOLERANCES = np.geomspace(*TOLERANCE_RANGE, 16)


def integrated_squares(expansion: TaylorExpansion, order: int, s: Scalar, model: Model) -> Pair:
    """The mean squares of the displacements, integrated over `s` radians."""
    pose = expansion.pose
    total = (ZERO, ZERO)

    def mean(a):
        return a if is_zero(a) else polynomial_value(_integrated(a, order), s) / where(s > 0, s, 1.0)

    versine = tuple(map(mean, pose.versine))  # which enters linearly, as the sine does
    sine = pose.sin if model.static is None else tuple(map(mean, pose.sin))
    for t, weight in zip(*lobatto_rule_for(order), strict=True):
        x, y = (tuple(_at_node(a, order, s, t) for a in pair) for pair in (pose.x, pose.y))
        at = pose._replace(x=x, y=y, sin=sine, versine=versine)
        squares = mean_square(at, model.gyration, model.static)
        total = total[0] + weight * squares[0], total[1] + weight * squares[1]
    left, right = (a if is_zero(a) else a * s * expansion.unit for a in total)
    return left, right


def _at_node(a: Any, order: int, s: Scalar, t: float) -> Scalar:
    """A series at the node `t` of a rule over `s` radians."""
    return a if is_zero(a) else polynomial_value(a.coefficients(order), s * t) if t else a[0]


def integrated_means(expansion: TaylorExpansion, order: int, s: Scalar) -> Means:
    """The position of the left block over `s` radians; x and y at the nodes at which their squares are needed."""
    (x, _), (y, _) = expansion.pose.x, expansion.pose.y
    rule = list(zip(*lobatto_rule_for(order), strict=True))
    seconds = s * expansion.unit

    def at_nodes(a):
        return a if is_zero(a) else seconds * sum(w * _at_node(a, order, s, t) for t, w in rule)

    def gained(a):
        return a if is_zero(a) else polynomial_value(_integrated(a, order), s) * expansion.unit

    return Means(at_nodes(x), at_nodes(y), gained(expansion.pose.sin[0]), gained(expansion.pose.versine[0]))


def integrated_works(expansion: TaylorExpansion, order: int, s: Scalar) -> Ledger | None:
    """The works over `s` radians."""
    if expansion.works is None:
        return None

    def gained(rate, at=s):
        return polynomial_value(_integrated(rate, order + EXTRA_WORK_TERMS), at)

    half = gained(expansion.works.drive, s / 2)
    parts = (expansion.works.drive, expansion.works.viscous, expansion.works.friction)
    drive, viscous, friction = (a if is_zero(a) else gained(a) for a in parts)
    gross = jnp.abs(half) + jnp.abs(drive - half)
    joules = 1 / (expansion.unit * expansion.unit)
    return Ledger(drive=drive * joules, gross=gross * joules, viscous=viscous * joules, friction=friction * joules)


def integrated_moments(expansion: TaylorExpansion, order: int, s: Scalar) -> Moments:
    """The moments of the displacements over `s` radians."""
    z, unit = expansion.motion, expansion.unit

    def each(f):
        return tuple(tuple(a if is_zero(a) else f(a) * unit for a in pair) for pair in (z.x, z.y, z.theta))

    first = each(lambda a: polynomial_value(_integrated(a, order), s))
    second = each(lambda a: _integrated_square(a.coefficients(order), order, s))
    return Moments(first, second)  # pyright: ignore[reportArgumentType]


def _integrated_square(coefficients: tuple[Scalar, ...], order: int, s: Scalar) -> Scalar:
    rule = zip(*lobatto_rule_for(order), strict=True)
    return s * sum(w * polynomial_value(coefficients, s * t) ** 2 for t, w in rule)


def integrated_loads(expansion: TaylorExpansion, order: int, s: Scalar, state: State, law: LinearLaw) -> ContactLoads:
    """The loads over `s` radians; in slip the slider never turns, so that its path is the distance of its ends."""
    impulse = polynomial_value(_integrated(expansion.v, order - 1), s) * expansion.unit
    N = law.normal_force(impulse, state.mode)
    if not law.has_stick:
        return ContactLoads(N, ZERO, ZERO, ZERO)

    def gained(a):
        return polynomial_value(a.coefficients(order - 1), s) - a[0]

    moved = law.slider_speed(gained(expansion.v), gained(expansion.u), state.mode)
    slips = (state.mode == Mode.SLIP_PLUS) | (state.mode == Mode.SLIP_MINUS)
    return ContactLoads(N, where(slips, N, 0.0), where(slips, s * expansion.unit, 0.0), jnp.abs(moved))


def _integrated(rate: Series, terms: int) -> tuple[Scalar, ...]:
    """The coefficients of the integral."""
    return (jnp.zeros_like(rate[0]), *(rate[n] * (1 / (n + 1)) for n in range(terms)))


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
