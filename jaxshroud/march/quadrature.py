"""Integrals of squares over a trial by power series: Lobatto's rule, whose ends and middle are looked at anyway.

A product of two series costs as many operations as the squares of their values at a dozen places.
"""

import math
from functools import cache
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import Legendre

from jaxshroud.march.taylor import TOLERANCES

ALLOWED = np.geomspace(*TOLERANCES, 16)


class Rule(NamedTuple):
    """Nodes and weights on 0 to 1: the ends are the first and the last node, and the one in the middle is 1/2."""

    nodes: tuple[float, ...]
    weights: tuple[float, ...]


@cache
def rule(order: int) -> Rule:
    """The shortest one that integrates squares as exactly as series of that order are, by whatever tolerance.

    Trials are as long as the fastest vibration in the motion allows, of which the last term is then the tolerance.
    """
    exact = lambda n: all(lobatto_error(n, _turn(order, at)) <= at for at in ALLOWED)  # noqa: E731
    return lobatto(next(n for n in count(3, 2) if exact(n)))


def _turn(order: int, tolerance: float) -> float:
    """What the square of the fastest vibration turns by in a trial [rad]."""
    return 2 * (math.factorial(order) * tolerance) ** (1 / order)


def lobatto(n: int) -> Rule:
    """Lobatto's rule of an odd number `n` of nodes, exact up to degree 2 n - 3."""
    last = Legendre.basis(n - 1)
    nodes = np.concatenate([[-1.0], np.sort(last.deriv().roots().real), [1.0]])
    weights = 1 / (n * (n - 1) * last(nodes) ** 2)
    nodes = (1 + nodes) / 2
    nodes[n // 2] = 0.5
    return Rule(tuple(nodes.tolist()), tuple(weights.tolist()))


def lobatto_error(n: int, turn: float) -> float:
    """Bound of the rule's error on the mean of a wave of amplitude 1 that turns by so many radians: its remainder."""
    f = math.factorial
    return n * (n - 1) ** 3 * f(n - 2) ** 4 / ((2 * n - 1) * f(2 * n - 2) ** 3) * turn ** (2 * n - 2)
