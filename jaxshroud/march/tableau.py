"""Explicit Runge-Kutta methods of the fixed-step march.

All but the reference come from well-kept solver libraries; these are imported when such a method is asked for.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from jaxshroud.march.words import TABLEAUS
from jaxshroud.scene.checks import word_argument

LEAST_STEPS = 8  # per period: what the drive's phase gains in a step must stay within the range of `trig`


class Tableau(NamedTuple):
    """Butcher tableau with its order; `a` is strictly lower triangular, one row for each stage."""

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int


RK4 = Tableau(
    name="rk4",
    a=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    order=4,
)


@cache
def tableau(name: str) -> Tableau:
    """The Runge-Kutta method of that name.

    Args:
        name: "rk4", the reference; "tsit5" (6 stages) and "dopri8" (13 stages) as in diffrax; "dop853" (12 stages) as
            in SciPy.

    Raises:
        ValueError: There is no such method.
    """
    word_argument("tableau", name, TABLEAUS)
    if name == "rk4":
        return RK4
    if name == "dop853":
        from scipy.integrate import DOP853

        return _explicit(name, list(DOP853.A), DOP853.B, DOP853.C)
    import diffrax

    source = {"tsit5": diffrax.Tsit5, "dopri8": diffrax.Dopri8}[name].tableau
    return _explicit(name, [(), *source.a_lower], source.b_sol, (0.0, *source.c))


def _explicit(name: str, a, b, c) -> Tableau:
    """Without the stages at the end that serve an error estimate or the next step only."""
    stages = int(np.flatnonzero(b)[-1]) + 1
    rows = tuple(tuple(float(w) for w in np.asarray(row)[:i]) for i, row in enumerate(a[:stages]))
    weights, nodes = (tuple(float(w) for w in row[:stages]) for row in (b, c))
    return Tableau(name, rows, weights, nodes, TABLEAUS[name])
