"""Explicit Runge-Kutta methods of the fixed-step march."""

from typing import NamedTuple


class Tableau(NamedTuple):
    """Butcher tableau with its order; `a` is strictly lower triangular."""

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int


RK4 = Tableau(
    a=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    order=4,
)
