"""Integrals over a trial by power series: the mean squares of the displacements, and the works."""

import math
from functools import cache
from itertools import count
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.polynomial.legendre import Legendre

from jaxshroud.march.tableau import TOLERANCE_RANGE
from jaxshroud.march.taylor_expansion import TaylorExpansion
from jaxshroud.model.arithmetic import ABSENT, Pair, Scalar, is_absent, where
from jaxshroud.model.contact_law import ContactLoads, LinearLaw
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Ledger, Means, Moments, mean_square
from jaxshroud.model.series import Series, polynomial_value

EXTRA_WORK_TERMS = 4  # further terms of the works: without them the error of squares is 100 times the tolerance
TESTED_TOLERANCES = np.geomspace(*TOLERANCE_RANGE, 16)


def integrated_squares(expansion: TaylorExpansion, order: int, s: Scalar, model: Model) -> Pair:
    """The mean squares of the displacements, integrated over `s` radians."""
    pose, total = expansion.pose, (ABSENT, ABSENT)
    mean = lambda a: a if is_absent(a) else polynomial_value(_integrated(a, order), s) / where(s > 0, s, 1.0)
    versine = tuple(map(mean, pose.versine))  # which enters linearly, as the sine does
    sine = pose.sin if model.static is None else tuple(map(mean, pose.sin))
    for t, weight in zip(*lobatto_rule_for(order), strict=True):
        x, y = (tuple(_at_node(a, order, s, t) for a in pair) for pair in (pose.x, pose.y))
        at = pose._replace(x=x, y=y, sin=sine, versine=versine)
        squares = mean_square(at, model.gyration, model.static)
        total = total[0] + weight * squares[0], total[1] + weight * squares[1]
    left, right = (a if is_absent(a) else a * s * expansion.unit for a in total)
    return left, right


def _at_node(a: Any, order: int, s: Scalar, t: float) -> Scalar:
    """A series at the node `t` of a rule over `s` radians."""
    return a if is_absent(a) else polynomial_value(a.coefficients(order), s * t) if t else a[0]


def integrated_means(expansion: TaylorExpansion, order: int, s: Scalar) -> Means:
    """The position of the left block over `s` radians; x and y at the nodes at which their squares are needed."""
    (x, _), (y, _) = expansion.pose.x, expansion.pose.y
    rule, seconds = list(zip(*lobatto_rule_for(order), strict=True)), s * expansion.unit
    at_nodes = lambda a: a if is_absent(a) else seconds * sum(w * _at_node(a, order, s, t) for t, w in rule)
    gained = lambda a: a if is_absent(a) else polynomial_value(_integrated(a, order), s) * expansion.unit
    return Means(at_nodes(x), at_nodes(y), gained(expansion.pose.sin[0]), gained(expansion.pose.versine[0]))


def integrated_works(expansion: TaylorExpansion, order: int, s: Scalar) -> Ledger | None:
    """The works over `s` radians."""
    if expansion.works is None:
        return None
    gained = lambda rate, at=s: polynomial_value(_integrated(rate, order + EXTRA_WORK_TERMS), at)
    half = gained(expansion.works.drive, s / 2)
    parts = (expansion.works.drive, expansion.works.viscous, expansion.works.friction)
    drive, viscous, friction = (a if is_absent(a) else gained(a) for a in parts)
    gross = jnp.abs(half) + jnp.abs(drive - half)
    joules = 1 / (expansion.unit * expansion.unit)
    return Ledger(*(a * joules for a in (drive, gross, viscous, friction)))


def integrated_moments(expansion: TaylorExpansion, order: int, s: Scalar) -> Moments:
    """The moments of the displacements over `s` radians."""
    z, unit = expansion.motion, expansion.unit
    each = lambda f: tuple(tuple(a if is_absent(a) else f(a) * unit for a in pair) for pair in (z.x, z.y, z.theta))
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
        return ContactLoads(N, ABSENT, ABSENT, ABSENT)
    gained = lambda a: polynomial_value(a.coefficients(order - 1), s) - a[0]
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
    exact = lambda n: all(lobatto_error(n, _trial_turn(order, at)) <= at for at in TESTED_TOLERANCES)
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
