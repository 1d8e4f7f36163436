"""Static choices of the march: those that a user makes, and all that the engine needs."""

import warnings
from typing import Any, NamedTuple

import equinox as eqx

from jaxshroud.march.tableau import RK4, Tableau, tableau
from jaxshroud.march.taylor import Taylor, named_taylor
from jaxshroud.march.words import METHODS, Locate
from jaxshroud.scene.checks import Precision, checked, type_argument, word_argument
from jaxshroud.scene.errors import InputError


def as_tableau(
    given: str | Tableau | Taylor, order: int | None = None, tolerance: float | None = None
) -> Tableau | Taylor:
    """A method by its name or as it is; the numbers are those of "taylor".

    Raises:
        ValueError: It is neither, or a number is out of range or has no use.
    """
    numbers = {name: a for name, a in {"order": order, "tolerance": tolerance}.items() if a is not None}
    if given == "taylor":
        return Taylor(**numbers)  # pyright: ignore[reportArgumentType]
    if numbers and not isinstance(given, Taylor):
        raise InputError(f"Argument `{next(iter(numbers))}` is of the method taylor only.")
    if isinstance(given, str):
        word_argument("tableau", given, METHODS)
        return tableau(given)
    if isinstance(given, Taylor):
        return given._replace(**numbers)
    type_argument("tableau", given, Tableau, '"dopri8" or tableau("dopri8")')
    return given


def located(method: Tableau | Taylor, locate: Locate | None, usual: Locate = "bisection") -> Locate:
    """How a method locates events: as asked, or as is usual.

    Raises:
        ValueError: It has no such way.
    """
    if locate is None:
        return "series" if isinstance(method, Taylor) else usual
    word_argument("locate", locate, Locate)
    if (locate == "series") != isinstance(method, Taylor):
        raise InputError('Argument `locate` must be "series" with the method taylor, and with no other.')
    return locate


@checked
class Choices(NamedTuple):
    """Static choices of the march; ValueError for a word that is not known."""

    tableau: Tableau | Taylor = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs
    precision: Precision = "float64"
    derivative: bool = False  # instants of events are differentiable, at the price of one more trial for each
    within: bool = False  # log what happens between the ends of steps too
    forces: bool = False  # log the largest forces of contact

    def __check_init__(self):
        located(self.tableau, self.locate)
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
    """How scenes are marched: by which method, how events are located inside its steps, and the precision.

    Args:
        tableau: "rk4" (the reference), "tsit5", "dop853" or "dopri8"; or a `Tableau`. "taylor": by power series, whose
            steps are as long as their `tolerance` allows. The steps per period then count time: for samples, for what
            is told per step, and for flat contact, which begins where a rocking would return within 1/24 of a step.
            Where that happens, an error of that size is left at any tolerance, and falls with more steps.
        locate: "bisection" (the reference), "cubic" (fewer trials), or "none": events where steps end. Power series
            locate their events themselves.
        ledger: Deprecated; verbs that can keep an energy balance have an argument of that name.
        precision: "float64" or "float32".
        derivative: Deprecated, without effect.
        within: Deprecated, without effect.
        order: Of "taylor", 4 to 24; by default 12.
        tolerance: Of "taylor": the last terms of the speeds over the largest speed, by default 1e-9. The error after a
            few periods is about as large.

    Raises:
        ValueError: A word is not known; the message names what may have been meant. Or a number is out of range.

    Example:
        >>> import jaxshroud as js
        >>> print(js.Method("dopri8", locate="cubic"))
        dopri8, events by cubic, float64
        >>> print(js.Method("taylor", order=14, tolerance=1e-10))
        taylor 14 1e-10, events by series, float64
    """

    tableau: Tableau | Taylor = eqx.field(static=True)
    locate: Locate = eqx.field(static=True)
    precision: Precision = eqx.field(static=True)
    _ledger: bool | None = eqx.field(static=True, repr=False)  # asked for in the deprecated way

    def __init__(
        self,
        tableau: str | Tableau | Taylor = "rk4",
        locate: Locate | None = None,
        ledger: bool | None = None,
        precision: Precision = "float64",
        derivative: bool | None = None,
        within: bool | None = None,
        order: int | None = None,
        tolerance: float | None = None,
    ):
        for name, value in {"ledger": ledger, "derivative": derivative, "within": within}.items():
            if value is not None:
                type_argument(name, value, bool, "True")
                warnings.warn(f"Method: argument `{name}` is deprecated", DeprecationWarning, stacklevel=2)
        word_argument("precision", precision, Precision)
        self.tableau = as_tableau(tableau, order, tolerance)
        self.locate = located(self.tableau, locate)
        self.precision, self._ledger = precision, ledger

    def replace(self, **changes: Any) -> "Method":
        """The same method with some of its arguments replaced; another kind of method locates events in its own way."""
        kept = {"tableau": self.tableau, "locate": self.locate, "precision": self.precision, **changes}
        asked = as_tableau(kept["tableau"], kept.get("order"), kept.get("tolerance"))
        if isinstance(asked, Taylor) != isinstance(self.tableau, Taylor) and "locate" not in changes:
            kept["locate"] = None
        return Method(**kept)

    _replace = replace  # as it was called

    def __str__(self) -> str:
        return str(choices(self))


def choices(method: Method | Choices, *, ledger: bool = False) -> Choices:
    """All choices of the march for a `method`, with a `ledger` unless the method itself says otherwise."""
    if isinstance(method, Choices):
        return method
    asked = method._ledger if method._ledger is not None else ledger
    return Choices(method.tableau, method.locate, asked, method.precision)


def named_choices(text: str) -> Choices:
    """The choices, without a ledger, that `str` of them names."""
    name, by, precision = text.split(", ")
    method = named_taylor(name) if name.startswith("taylor") else tableau(name)
    return Choices(method, by.removeprefix("events by "), False, precision)  # type: ignore[arg-type]
