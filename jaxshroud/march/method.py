"""Static choices of the march: those that a user makes, and all that the engine needs."""

import warnings
from typing import Any, NamedTuple

import equinox as eqx

from jaxshroud.march.tableau import RK4, Tableau, tableau
from jaxshroud.march.taylor import Taylor, named_taylor
from jaxshroud.march.words import Locate
from jaxshroud.scene.checks import Precision, checked, type_argument, word_argument


@checked
class Choices(NamedTuple):
    """Static choices of the march; ValueError for a word that is not known."""

    tableau: Tableau | Taylor = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs
    precision: Precision = "float64"
    derivative: bool = False  # instants of events are differentiable, at the price of one more trial for each
    within: bool = False  # log what happens between the ends of steps too

    def __check_init__(self):
        word_argument("locate", self.locate, Locate)
        word_argument("precision", self.precision, Precision)

    @property
    def taylor(self) -> Taylor | None:
        """The march by power series, if it is one."""
        return self.tableau if isinstance(self.tableau, Taylor) else None

    @property
    def rk(self) -> Tableau:
        """The Runge-Kutta method, if it is one."""
        assert not isinstance(self.tableau, Taylor)
        return self.tableau

    def __str__(self) -> str:
        return f"{self.tableau.name}, events by {self.locate}, {self.precision}"


REFERENCE = Choices()
FAST_WITH_LEDGER = Choices(locate="cubic")  # the same errors in less time
FAST = FAST_WITH_LEDGER._replace(ledger=False)  # no energy residual either


class Method(eqx.Module):
    """How scenes are marched: a Runge-Kutta method, how events are located inside its steps, and the precision.

    Args:
        tableau: "rk4" (the reference), "tsit5", "dop853" or "dopri8"; or a `Tableau`.
        locate: "bisection" (the reference), "cubic" (fewer trials), or "none": events where steps end.
        ledger: Deprecated; verbs that can keep an energy balance have an argument of that name.
        precision: "float64" or "float32".
        derivative: Deprecated, without effect.
        within: Deprecated, without effect.

    Raises:
        ValueError: A word is not known; the message names what may have been meant.

    Example:
        >>> import jaxshroud as js
        >>> print(js.Method("dopri8", locate="cubic"))
        dopri8, events by cubic, float64
    """

    tableau: Tableau = eqx.field(static=True)
    locate: Locate = eqx.field(static=True)
    precision: Precision = eqx.field(static=True)
    _ledger: bool | None = eqx.field(static=True, repr=False)  # asked for in the deprecated way

    def __init__(
        self,
        tableau: str | Tableau = "rk4",
        locate: Locate = "bisection",
        ledger: bool | None = None,
        precision: Precision = "float64",
        derivative: bool | None = None,
        within: bool | None = None,
    ):
        for name, value in {"ledger": ledger, "derivative": derivative, "within": within}.items():
            if value is not None:
                type_argument(name, value, bool, "True")
                warnings.warn(f"Method: argument `{name}` is deprecated", DeprecationWarning, stacklevel=2)
        word_argument("locate", locate, Locate)
        word_argument("precision", precision, Precision)
        self.tableau, self.locate, self.precision, self._ledger = as_tableau(tableau), locate, precision, ledger

    def replace(self, **changes: Any) -> "Method":
        """The same method with some of its arguments replaced."""
        return Method(**{"tableau": self.tableau, "locate": self.locate, "precision": self.precision, **changes})

    _replace = replace  # as it was called

    def __str__(self) -> str:
        return str(choices(self))


def as_tableau(given: str | Tableau) -> Tableau:
    """A Runge-Kutta method by its name or as it is.

    Raises:
        ValueError: It is neither.
    """
    if isinstance(given, str):
        return tableau(given)
    type_argument("tableau", given, Tableau, '"dopri8" or tableau("dopri8")')
    return given


def choices(method: Method | Choices, *, ledger: bool = False) -> Choices:
    """All choices of the march for a `method`, with a `ledger` unless the method itself says otherwise."""
    if isinstance(method, Choices):
        return method
    asked = method._ledger if method._ledger is not None else ledger
    return Choices(method.tableau, method.locate, asked, method.precision)


def named_choices(text: str) -> Choices:
    """The choices, without a ledger, that `str` of them names."""
    name, located, precision = text.split(", ")
    return Choices(tableau(name), located.removeprefix("events by "), False, precision)  # type: ignore[arg-type]
