"""Accuracies, and the settings of methods that they stand for."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.march.method import FLAT_RETURN, Choices
from jaxshroud.march.method_names import Locate
from jaxshroud.march.tableau import MIN_STEPS, TaylorOptions, tableau
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.scene import Scene

LEVELS = tuple(10.0**-n for n in range(2, 11))
NAMED = {"fast": 1e-3, "balanced": 1e-6, "reference": 1e-10}
MIN_SERIES_STEPS = 200  # per period; they cost power series nothing, and trajectories are sampled at them


def accuracy_level(accuracy: Any) -> float:
    """The accuracy that a name or a number stands for.

    Raises:
        ValueError: It is neither one of `NAMED` nor a number from 1e-10 to 1e-2.
    """
    try:
        value = NAMED[accuracy] if isinstance(accuracy, str) and accuracy in NAMED else float(accuracy)
    except (TypeError, ValueError):  # of an array of many numbers, or of one that is traced
        value = np.nan
    if not LEVELS[-1] * 0.999 <= value <= LEVELS[0] * 1.001:
        raise InputError(f"must be {', '.join(NAMED)} or a number from 1e-10 to 1e-2, but is {accuracy!r}")
    return value


def flat_return_for(accuracy: float) -> float:
    """The share of a drive period within which rocking faces return that count as flat: enough for an accuracy.

    1/2400, 1/38400 and 1/610000 for 1e-3, 1e-6 and 1e-9. A ring of three light blades was 7e-6 off after three periods
    with any share from 1/2400 to 1/19200, and 1e-8 with 1/38400.
    """
    return FLAT_RETURN * (accuracy / NAMED["balanced"]) ** 0.4


class Setting(NamedTuple):
    """A method with its step or tolerance; the steps of power series only count time."""

    tableau: str
    locate: Locate
    precision: str
    product: float  # omega_max h
    width: float = 0.0  # of smooth contact in place of the spring, see `softened`; 0: the contact of the scene
    order: int = 0  # of power series; 0: a Runge-Kutta method
    tolerance: float = 0.0  # of power series
    flat_return: float = FLAT_RETURN

    @property
    def method(self) -> Choices:
        """The static choices of the march, without the step."""
        stepping = TaylorOptions(self.order, self.tolerance) if self.order else tableau(self.tableau)
        return Choices(stepping, self.locate, False, self.precision, flat_return=self.flat_return)  # type: ignore[arg-type]

    def finer(self, n: int) -> "Setting":
        """The setting with half the step of the finer method, `n` times; see `Choices.finer`."""
        method = self.method.finer(n)
        tolerance = method.taylor.tolerance if self.order else 0.0
        return self._replace(product=self.product / 2**n, tolerance=tolerance, flat_return=method.flat_return)

    @property
    def exact(self) -> "Setting":
        """The setting with the most accurate locator, in float64."""
        return self._replace(locate="series" if self.order else "cubic", precision="float64")

    @property
    def kind(self) -> str:
        """The method in words, without its numbers."""
        located = {"cubic": "", "bisection": ", bisection", "none": ", not located", "series": ""}[self.locate]
        single = ", float32" if self.precision == "float32" else ""
        return f"{self.tableau}{single}{located}{', smooth' if self.width else ''}"

    def steps(self, omega_max: float, period: float) -> int:
        """The steps per period for a scene with that largest frequency."""
        least = MIN_SERIES_STEPS if self.order else MIN_STEPS
        return max(int(np.ceil(omega_max * period / self.product)), least)

    def __str__(self) -> str:
        if self.order:
            return f"{self.kind}, order {self.order} to {self.tolerance:.0e}"
        width = f", width {self.width:.3g}" if self.width else ""
        return f"{self.kind}{width}, {self.product:.3g}"


def by_series(order: int, tolerance: float, product: float = 1.0) -> Setting:
    """A setting of power series; their steps only serve to count events and flat contact."""
    return Setting("taylor", "series", "float64", product, order=order, tolerance=tolerance)


class SettingTrial(NamedTuple):
    """What a trial of a setting has shown."""

    scenes: Scene  # (lanes,)
    ends: Callable[..., Any]  # by which they were marched
    errors: np.ndarray  # (lanes,); NaN where a lane stops
    own_work: int  # trial steps by the setting
    work: int  # with those by the finer one


@dataclass(frozen=True)
class Choice:
    """A setting chosen for an accuracy."""

    accuracy: float  # error of the state after three periods, see `state_errors`, that 95 % of lanes keep
    setting: Setting
    steps: int  # per period
    promised: bool | None  # False: the accuracy cannot be reached, and this setting is about the best; None: not tried
    reached: float = np.nan  # error that 95 % of the probed lanes keep, by comparison with a finer march
    why: str = ""  # it is not tried
    curtailed: bool = False  # not promised, and no finer setting was tried, as that would have taken too long
    trial: SettingTrial | None = field(default=None, compare=False, repr=False)  # by which it was chosen

    @property
    def method(self) -> Choices:
        """The static choices of the march, without a ledger."""
        return self.setting.method

    def __str__(self) -> str:
        product = "" if self.setting.order else " (omega_max h)"
        text = f"accuracy {self.accuracy:.0e}: {self.setting}{product}, {self.steps} steps a period"
        if self.promised is None:
            return f"{text}; not examined, and maybe missed, as {self.why}"
        if self.promised:
            return text
        if self.curtailed:
            known = f"95 % of runs keep {self.reached:.0e}"
            return (
                f"{text}; not confirmed: {known}, and trials of finer settings would take more than a tenth of the run"
            )
        best = f"{self.reached:.0e} is the best for 95 % of runs"
        return f"{text}; not to be had: {best}, as impacts multiply errors and flat contact drops its rocking"
