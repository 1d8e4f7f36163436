"""Power series in time that behave like numbers, so that the physics is written once for both.

Where x'' = f(x, x', t), coefficient n + 2 of x follows from coefficient n of f, which depends only on earlier
coefficients of x. A series here computes its coefficients lazily, one by one and each once. The right-hand side of
Eq. (1), called with series that begin with a position and a rate and continue with its own result, is the recurrence
for all of them.

As in M. D. McIlroy, "Squinting at power series" (1990), but unrolled while a function is traced.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any

import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Symbolic, is_zero, minus, plus, sine_versine, times, where


class Series(Symbolic):
    """A power series by a `rule` for the coefficients, which may use earlier ones; ZERO is an exact zero."""

    def __init__(self, rule: Callable[[int], Any]):
        self._rule = rule
        self._known = []
        self._rotation = None

    def __getitem__(self, n: int) -> Any:
        """Coefficient `n`."""
        while len(self._known) <= n:
            self._known.append(self._rule(len(self._known)))
        return self._known[n]

    def coefficients(self, n: int) -> tuple:
        """Coefficients 0 to `n`."""
        return tuple(self[k] for k in range(n + 1))

    def go_on(self, rule: Callable[[int], Any]) -> None:
        """Let the coefficients that are not known yet follow another rule."""
        self._rule = rule

    @property
    def dtype(self) -> Any:
        """The type of the coefficients."""
        return self[0].dtype

    @property
    def rate(self) -> "Series":
        """The derivative."""
        return Series(lambda n: times(n + 1, self[n + 1]))

    def sine_versine(self) -> tuple[Any, Any]:
        """The series of (sin x, 1 - cos x) of an angle x, from the values at the start: s' = c x', (1 - c)' = s x'."""
        if self._rotation is None:
            self._rotation = self._sine_versine()
        return self._rotation

    def _sine_versine(self) -> tuple[Any, Any]:
        rate = self.rate
        start = sine_versine(self[0])
        sine = Series(lambda n: times(_product(rate, cosine, n - 1), 1 / n) if n else start[0])
        versine = Series(lambda n: times(_product(rate, sine, n - 1), 1 / n) if n else start[1])
        cosine = 1 - versine
        return sine, versine

    def moved(self, move: Callable[..., Any], *others: Any) -> "Series":
        """The series of what `move` makes of coefficients; sine and versine are those of the original, moved."""
        result = Series(lambda n: move(self[n], *(as_series(a)[n] for a in others)))
        if not others:
            result._sine_versine = lambda: tuple(a.moved(move) for a in self.sine_versine())
        return result

    def __neg__(self) -> "Series":
        """The negative."""
        return Series(lambda n: -self[n])

    def __add__(self, other: Any) -> Any:
        """The sum."""
        if is_zero(other):
            return self
        other = as_series(other)
        return Series(lambda n: plus(self[n], other[n]))

    def __sub__(self, other: Any) -> Any:
        """The difference."""
        if is_zero(other):
            return self
        other = as_series(other)
        return Series(lambda n: minus(self[n], other[n]))

    def __rsub__(self, other: Any) -> "Series":
        """The difference."""
        return as_series(other) - self

    def __mul__(self, other: Any) -> Any:
        """The product."""
        if is_zero(other):
            return other
        if isinstance(other, Series):
            return Series(lambda n: _square(self, n) if other is self else _product(self, other, n))
        return Series(lambda n: times(other, self[n]))

    def __pow__(self, power: int) -> "Series":
        """The square."""
        assert power == 2
        return self * self

    def __truediv__(self, other: Any) -> "Series":
        """The quotient."""
        if not isinstance(other, Series):
            return (1 / other) * self
        inverse = 1 / other[0]
        quotient = Series(
            lambda n: (self[n] - chained_sum([times(other[k], quotient[n - k]) for k in range(1, n + 1)])) * inverse
        )
        return quotient

    __radd__, __rmul__ = __add__, __mul__

    def __abs__(self) -> Any:
        """The magnitude at the start."""
        return abs(self[0])

    def __gt__(self, other: Any) -> Any:
        """Whether it is larger than a number at the start."""
        return self[0] > other

    @staticmethod
    def chosen(condition: Any, yes: Any, no: Any) -> "Series":
        """`yes` where the `condition`, which does not change with time, else `no`."""
        yes, no = as_series(yes), as_series(no)
        return Series(lambda n: where(condition, yes[n], no[n]))


def rate_of(value: Any) -> Any:
    """The derivative of a series, or of an absent number."""
    return value.rate if isinstance(value, Series) else value


def coefficients(value: Any, n: int) -> tuple:
    """Coefficients 0 to `n` of a series, or of an absent number."""
    return (value,) * (n + 1) if is_zero(value) else as_series(value).coefficients(n)


def polynomial(coefficients: tuple) -> Any:
    """The series with these coefficients, and no others; absent if all of them are."""
    if all(map(is_zero, coefficients)):
        return ZERO
    return Series(lambda n: coefficients[n] if n < len(coefficients) else ZERO)


def as_series(value: Any) -> Series:
    """A series or a constant as a series."""
    return value if isinstance(value, Series) else Series(lambda n: ZERO if n else value)


def chained_sum(terms: list) -> Any:
    """The sum of terms in two chains, which halves the latency."""
    present = [t for t in terms if not is_zero(t)]
    chains = [present[i::2] for i in (0, 1)]
    sums = [reduce(plus, chain) for chain in chains if chain]
    return reduce(plus, sums) if sums else ZERO


def _product(a: Series, b: Series, n: int) -> Any:
    """Coefficient `n` of a product; the latest coefficients are added last."""
    inner = chained_sum([times(a[k], b[n - k]) for k in range(1, n)])
    outer = times(a[0], b[n])
    return plus(inner, plus(outer, times(a[n], b[0])) if n else outer)


def _square(a: Series, n: int) -> Any:
    half = chained_sum([times(a[k], a[n - k]) for k in range((n + 1) // 2)])
    return plus(plus(half, half), ZERO if n % 2 else times(a[n // 2], a[n // 2]))


def polynomial_value(coefficients: tuple, x: Any) -> Any:
    """The value of a polynomial."""
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = plus(times(value, x), c)
    return value


def polynomial_value_and_rate(coefficients: tuple, x: Any) -> tuple[Any, Any]:
    """The value and the derivative of a polynomial."""
    value = coefficients[-1]
    rate = ZERO
    for c in reversed(coefficients[:-1]):
        rate = plus(times(rate, x), value)
        value = plus(times(value, x), c)
    return value, jnp.zeros_like(x) + rate
