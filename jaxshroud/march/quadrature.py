"""Integrals of squares over a trial by power series: Lobatto's rule, whose ends and middle are looked at anyway.

A product of two series costs as many operations as the squares of their values at a dozen places.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import Legendre

SMALL = 0.1  # of the tolerance, which the rule's error stays below
MOST = 25


class Rule(NamedTuple):
    """Nodes and weights on 0 to 1: the ends are the first and the last node, and the one in the middle is 1/2."""

    nodes: tuple[float, ...]
    weights: tuple[float, ...]


@cache
def rule(order: int, tolerance: float) -> Rule:
    """The shortest one that integrates squares as exactly as the series are, in trials as long as these allow.

    The fastest vibration that a motion holds decides on its trials: there the last term is the tolerance.
    """
    turn = 2 * (math.factorial(order) * tolerance) ** (1 / order)  # of its square, in a trial [rad]
    enough = (n for n in range(3, MOST, 2) if lobatto_error(n, turn) <= SMALL * tolerance)
    return lobatto(next(enough, MOST))


def lobatto(n: int) -> Rule:
    """Lobatto's rule of an odd number `n` of nodes, exact up to degree 2 n - 3."""
    last = Legendre.basis(n - 1)
    nodes = np.concatenate([[-1.0], np.sort(last.deriv().roots().real), [1.0]])
    weights = 1 / (n * (n - 1) * last(nodes) ** 2)
    nodes = (1 + nodes) / 2
    nodes[n // 2] = 0.5
    return Rule(tuple(nodes.tolist()), tuple(weights.tolist()))


def lobatto_error(n: int, turn: float) -> float:
    """Bound of the rule's error on the mean of a wave of amplitude 1 that turns by so many radians.

    Source:
        The remainder of Lobatto's rule: M. Abramowitz and I. A. Stegun (eds.), Handbook of Mathematical Functions,
        Eq. 25.4.32.
    """
    f = math.factorial
    return n * (n - 1) ** 3 * f(n - 2) ** 4 / ((2 * n - 1) * f(2 * n - 2) ** 3) * turn ** (2 * n - 2)
