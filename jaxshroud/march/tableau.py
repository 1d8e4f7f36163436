"""The coefficients of the explicit Runge-Kutta methods, and the options of the power-series method."""

from functools import cache
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.scene.checks import InputError, checked, word_argument
from jaxshroud.scene.typed import is_number, typed

ORDER_RANGE = (4, 24)
TOLERANCE_RANGE = (1e-16, 1e-1)
DEFAULT_TOLERANCE = 1e-9


@checked
class TaylorOptions(NamedTuple):
    """A march by power series; ValueError for what is out of range."""

    order: int = 12
    tolerance: float | jax.Array = DEFAULT_TOLERANCE  # last terms of the speeds over the largest speed

    def __check_init__(self):
        (least, most), (finest, coarsest) = ORDER_RANGE, TOLERANCE_RANGE
        if type(self.order) is not int or not least <= self.order <= most:
            raise InputError(f"Argument `order` must be a whole number from {least} to {most}, but is {self.order!r}.")
        traced = isinstance(self.tolerance, jax.Array)
        if not traced and not (is_number(self.tolerance) and finest <= self.tolerance <= coarsest):
            bounds = f"from {finest:g} to {coarsest:g}"
            raise InputError(f"Argument `tolerance` must be a number {bounds}, but is {self.tolerance!r}.")

    @property
    def name(self) -> str:
        """The name in results."""
        return f"taylor {self.order} {self.tolerance:g}"

    @property
    def auto_steps_like(self) -> str:
        """The method whose "auto" steps are taken: for power series, steps only count time."""
        return RK4.name

    def finer(self, factor: float) -> "TaylorOptions":
        """The same order with the tolerance divided by `factor`, as far as that is possible."""
        return self._replace(tolerance=max(self.tolerance / factor, TOLERANCE_RANGE[0]))

    def trials(self, steps: int) -> int:
        """About the trials of a period between its events."""
        del steps  # trials are as long as the tolerance allows: 20 to 140 at tolerances from 1e-5 to 1e-13
        return 100

    def amplification(self, omega_h: np.ndarray) -> np.ndarray:
        """The factor of `Tableau.amplification`: the exact one, as the steps of power series only count time."""
        return np.exp(1j * omega_h)


MIN_STEPS = 8  # per period: the phase advance of a step must stay within the range of `trig`


class Tableau(NamedTuple):
    """A Butcher tableau with its order; `a` is strictly lower triangular, with one row for each stage."""

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int

    @property
    def auto_steps_like(self) -> str:
        """The method whose "auto" steps are taken."""
        return self.name

    def finer(self, factor: float) -> "Tableau":
        """The same method: only its steps can be finer."""
        del factor
        return self

    def trials(self, steps: int) -> int:
        """The trials of a period of so many steps between its events."""
        return steps

    def amplification(self, omega_h: np.ndarray) -> np.ndarray:
        """The factor by which one step multiplies an undamped oscillation; the exact factor is exp(i omega h).

        An imaginary `omega_h` stands for a decay, whose exact factor is exp(-abs(omega h)).
        """
        stages = []
        i_y = 1j * np.asarray(omega_h)
        for row in self.a:
            stages.append(1 + i_y * sum((w * k for w, k in zip(row, stages, strict=True)), 0j))
        return 1 + i_y * sum(w * k for w, k in zip(self.b, stages, strict=True))


RK4 = Tableau(
    name="rk4",
    a=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    order=4,
)


@typed
@cache
def tableau(name: str) -> Tableau:
    """The Runge-Kutta method of that name.

    Args:
        name: "rk4", the reference; "tsit5" (6 stages) and "dopri8" (13 stages) as in diffrax.

    Raises:
        ValueError: There is no such method.
    """
    word_argument("tableau", name, TABLEAUS)
    if name == "rk4":
        return RK4
    import diffrax

    source = {"tsit5": diffrax.Tsit5, "dopri8": diffrax.Dopri8}[name].tableau
    return _without_unused_stages(name, [(), *source.a_lower], source.b_sol, (0.0, *source.c))


def _without_unused_stages(name: str, a, b, c) -> Tableau:
    """The tableau without final stages that serve only an error estimate or the next step."""
    stages = int(np.flatnonzero(b)[-1]) + 1
    rows = tuple(tuple(float(w) for w in np.asarray(row)[:i]) for i, row in enumerate(a[:stages]))
    weights, nodes = (tuple(float(w) for w in row[:stages]) for row in (b, c))
    return Tableau(name, rows, weights, nodes, TABLEAUS[name])
