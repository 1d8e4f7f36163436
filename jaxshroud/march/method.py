"""The method of a march: the options that a user chooses, and those that the march itself adds."""

import json
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import numpy as np

from jaxshroud.march.event import Event, Events
from jaxshroud.march.events import BUILT_IN_EVENTS
from jaxshroud.march.method_names import TABLEAUS, Locate
from jaxshroud.march.observable import Observable
from jaxshroud.march.tableau import DEFAULT_TOLERANCE, RK4, Tableau, TaylorOptions, tableau
from jaxshroud.model.rhs import Recorded
from jaxshroud.scene.checks import InputError, Precision, checked, count_argument, type_argument, word_argument
from jaxshroud.scene.typed import is_number

FLAT_RETURN = 1 / 38400  # of a drive period: what accuracies around 1e-6 need


def flat_return_argument(given: Any) -> float:
    """A share of a drive period within which rocking faces return that count as flat.

    Raises:
        InputError: It is not a number above 0 and at most 1.
    """
    if not (is_number(given) and 0 < given <= 1):
        raise InputError(f"Argument `flat_return` must be a number above 0 and at most 1, but is {given!r}.")
    return float(given)


def as_tableau(given: str | Tableau) -> Tableau:
    """A Runge-Kutta method by its name or as it is.

    Raises:
        ValueError: It is neither.
    """
    if isinstance(given, str):
        word_argument("tableau", given, TABLEAUS)
        return tableau(given)
    type_argument("tableau", given, Tableau, '"dopri8" or tableau("dopri8")')
    return given


def locator_for(method: Tableau | TaylorOptions, locate: Locate | None) -> Locate:
    """How a method locates events: as given, or as the reference does.

    Raises:
        ValueError: The method cannot locate events that way.
    """
    if locate is None:
        return "series" if isinstance(method, TaylorOptions) else "bisection"
    word_argument("locate", locate, Locate)
    if (locate == "series") != isinstance(method, TaylorOptions):
        raise InputError('Argument `locate` must be "series" with the method taylor, and with no other.')
    return locate


@checked
class Choices(NamedTuple):
    """The static options of a march; ValueError for an unknown word."""

    tableau: Tableau | TaylorOptions = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # integrate the works of the energy balance
    precision: Precision = "float64"
    derivative: bool = False  # the times of events are differentiable, at the cost of further trials for each
    within: bool = False  # log the extremes inside the steps too
    forces: bool = False  # log the largest contact forces, the loads and the impacts
    loads: bool = False  # integrate the loads alone
    amplitudes: bool = False  # log the extremes of the displacements and integrate their moments
    margins: bool = False  # log how clearly events happened, with derivatives too
    vibration: bool = False  # integrate the position of the blocks, about which they vibrate
    observables: tuple[Observable, ...] = ()  # a user's own, logged beside the built-in ones
    events: tuple[Event, ...] = ()  # a user's own, which are counted by their names beside these observables
    flat_return: float = FLAT_RETURN  # of a drive period: faces whose rocking returns sooner become flat
    large_kernels: bool = True  # all stages of a pair's step in one, for which XLA needs options of its own

    def __check_init__(self):
        locator_for(self.tableau, self.locate)
        word_argument("precision", self.precision, Precision)
        if self.events and isinstance(self.tableau, TaylorOptions):
            raise InputError(
                f"Power series do not know the guard of the event {self.events[0].name!r}: use js.RungeKutta."
            )

    @property
    def all_events(self) -> Events:
        """The events of the march by their numbers, a user's own last."""
        return *BUILT_IN_EVENTS, *self.events

    @property
    def as_static(self) -> "Choices":
        """The method without the number that programs take beside it: the time grid has it."""
        return self._replace(flat_return=FLAT_RETURN)

    @property
    def recorded(self) -> Recorded:
        """The integrals that are computed beside the power."""
        means = self.vibration and not self.sums_positions
        return Recorded(self.ledger, self.amplitudes, self.forces or self.loads, means)

    @property
    def sums_positions(self) -> bool:
        """Whether the mean position is taken from the ends of steps, rather than integrated from stage to stage.

        Over whole periods the error falls with the fourth power of the step: up to 7e-7 of the motion at 200 steps a
        period and 4e-6 at 100, in rubbing pairs, at a fifth of the cost. Derivatives would lose more.
        """
        return self.vibration and not self.derivative and isinstance(self.tableau, Tableau)

    @property
    def has_long_accumulator(self) -> bool:
        """Whether the accumulator is kept in a kernel of its own."""
        return (self.forces or self.amplitudes) and not self.derivative

    @property
    def taylor(self) -> TaylorOptions:
        """The options of power series, within what only they use."""
        assert isinstance(self.tableau, TaylorOptions)
        return self.tableau

    @property
    def tolerance(self) -> float | jax.Array:
        """The tolerance of power series, which compiled programs take as an argument."""
        return self.taylor.tolerance

    def with_tolerance(self, tolerance: float | jax.Array = DEFAULT_TOLERANCE) -> "Choices":
        """The same power series with another tolerance, by default that which stands for any."""
        return self._replace(tableau=self.taylor._replace(tolerance=tolerance))

    @property
    def rk(self) -> Tableau:
        """The Runge-Kutta method, within what only it uses."""
        assert isinstance(self.tableau, Tableau)
        return self.tableau

    def finer(self, n: int = 1) -> "Choices":
        """The same method with a tenth of the tolerance, if it has one, and a quarter of `flat_return`, `n` times.

        Who marches by it halves the step as well: here there is none.
        """
        return self._replace(tableau=self.tableau.finer(10.0**n), flat_return=self.flat_return / 4**n)

    @property
    def for_verification(self) -> "Choices":
        """The finer method with events located by bisection; power series with a hundredth of the tolerance instead."""
        return self.finer()._replace(tableau=self.tableau.finer(100.0), locate=locator_for(self.tableau, None))

    def __str__(self) -> str:
        return f"{self.tableau.name}, events by {self.locate}, {self.precision}"


REFERENCE = Choices()
FAST_WITH_LEDGER = Choices(locate="cubic")  # same errors, less time
FAST = FAST_WITH_LEDGER._replace(ledger=False)  # no energy residual either
FOR_P_D_WITH_LEDGER = FAST_WITH_LEDGER._replace(vibration=True)  # where P_d is given, and that of the vibration alone
FOR_P_D = FAST._replace(vibration=True)


StepCount = int | Literal["auto"]


def steps_argument(steps: Any) -> StepCount | None:
    """Steps as they were given; InputError unless they are a whole number, "auto" or None."""
    if steps is None or (isinstance(steps, str) and steps == "auto"):
        return steps
    if not isinstance(steps, int | np.integer) or isinstance(steps, bool):
        raise InputError(f'Argument `steps` must be a whole number or "auto", but is {steps!r}.')
    count_argument("steps", int(steps), 1)
    return int(steps)


class _Replaceable(eqx.Module):
    def replace(self, **changes: Any) -> Any:
        """The same method with some of its arguments replaced."""
        return type(self)(**vars(self) | changes)


class RungeKutta(_Replaceable):
    """A march in steps of equal length by a Runge-Kutta method, with events located inside the steps.

    Args:
        tableau: "rk4" (the reference), "tsit5" or "dopri8"; or a `Tableau`.
        steps: Steps in one drive period; "auto": as many as the stiffest lane needs. By default those of the scene
            file, else "auto".
        locate: "cubic" (few trials), "bisection" (the reference), or "none": events where steps end.
        precision: "float64" or "float32".
        flat_return: Share of a drive period: parallel faces whose rocking would return sooner become flat, and what is
            left of it is dropped. Where that happens an error stays that falls with this share. 1/24 of a step, if that
            is shorter.

    Raises:
        ValueError: A word is unknown, in which case the message suggests one, or a number is out of range.

    Example:
        >>> import jaxshroud as js
        >>> print(js.RungeKutta("dopri8", steps=100))
        dopri8, events by cubic, float64, 100 steps a period
    """

    tableau: Tableau = eqx.field(static=True)
    steps: StepCount | None = eqx.field(static=True)
    locate: Locate = eqx.field(static=True)
    precision: Precision = eqx.field(static=True)
    flat_return: float = eqx.field(static=True)

    def __init__(
        self,
        tableau: str | Tableau = "rk4",
        steps: StepCount | None = None,
        locate: Locate = "cubic",
        precision: Precision = "float64",
        flat_return: float = FLAT_RETURN,
    ):
        self.tableau = as_tableau(tableau)
        self.steps = steps_argument(steps)
        word_argument("locate", locate, get_args(Locate)[:-1])
        word_argument("precision", precision, Precision)
        self.locate, self.precision = locate, precision
        self.flat_return = flat_return_argument(flat_return)

    def __str__(self) -> str:
        return in_words(self)


class Taylor(_Replaceable):
    """A march by power series, in steps as long as their tolerance allows; their roots locate the events.

    Args:
        order: 4 to 24.
        tolerance: Of the last terms of the speeds over the largest speed. The error after a few periods is about as
            large.
        steps: Steps in one drive period, which count time: for samples, and for quantities per step. By default as
            of `RungeKutta`.
        precision: "float64" or "float32".
        flat_return: As of `RungeKutta`; where faces become flat, an error of that size is left at any tolerance.

    Raises:
        ValueError: A number is out of range, or a word is not known.

    Example:
        >>> import jaxshroud as js
        >>> print(js.Taylor(order=14, tolerance=1e-10))
        taylor 14 1e-10, events by series, float64
    """

    order: int = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    steps: StepCount | None = eqx.field(static=True)
    precision: Precision = eqx.field(static=True)
    flat_return: float = eqx.field(static=True)

    def __init__(
        self,
        order: int = 12,
        tolerance: float = DEFAULT_TOLERANCE,
        steps: StepCount | None = None,
        precision: Precision = "float64",
        flat_return: float = FLAT_RETURN,
    ):
        TaylorOptions(order, tolerance)
        word_argument("precision", precision, Precision)
        self.order = order
        self.tolerance = float(tolerance)
        self.steps = steps_argument(steps)
        self.precision = precision
        self.flat_return = flat_return_argument(flat_return)

    def __str__(self) -> str:
        return in_words(self)


Method = RungeKutta | Taylor


def in_words(method: Method) -> str:
    """A method as results call it, with its steps where they are known."""
    steps = f", {method.steps} steps a period" if isinstance(method.steps, int) else ""
    return f"{choices(method)}{steps}"


def choices(method: Method, *, ledger: bool = False) -> Choices:
    """All choices of the march for a `method`, with a `ledger` or without."""
    if isinstance(method, Taylor):
        found = Choices(TaylorOptions(method.order, method.tolerance), "series", ledger, method.precision)
    else:
        found = Choices(method.tableau, method.locate, ledger, method.precision)
    return found._replace(flat_return=method.flat_return)


def explicit(method: Method) -> tuple[int, Choices]:
    """Steps per period and choices of a method for a pure function, which cannot look at the scene's numbers.

    Raises:
        InputError: Its steps are left to the scene.
    """
    if not isinstance(method.steps, int):
        raise InputError(
            "Argument `method` needs a number of `steps` here; js.method_for chooses a method for a scene."
        )
    return method.steps, choices(method)


def method_of(steps: StepCount, chosen: Choices) -> Method:
    """The method that such choices belong to."""
    if isinstance(chosen.tableau, TaylorOptions):
        order, tolerance = chosen.taylor
        return Taylor(order, float(tolerance), steps, chosen.precision, chosen.flat_return)
    return RungeKutta(chosen.rk, steps, chosen.locate, chosen.precision, chosen.flat_return)


def method_as_json(method: Method) -> str:
    """A method as files hold it; of a tableau of the user's own they hold the name alone."""
    name = "taylor" if isinstance(method, Taylor) else method.tableau.name
    return json.dumps({"tableau": name, **{key: value for key, value in vars(method).items() if key != "tableau"}})


def method_from_json(text: str) -> Method:
    """The method of a text of `method_as_json`.

    Raises:
        InputError: It is no such text, or names a tableau of the user's own.
    """
    try:
        options = json.loads(text)
        return Taylor(**options) if options.pop("tableau") == "taylor" else RungeKutta(**json.loads(text))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"The file does not say by which method it was marched: {error}") from None


EXPLICIT = RungeKutta(steps=400)  # of pure functions, by default
