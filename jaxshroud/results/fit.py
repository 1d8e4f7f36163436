"""The numbers of a scene from measurements, with their intervals and what stays unknown."""

import json
import math
from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import Result


class FittedNumber(NamedTuple):
    """A fitted number with its 95 % interval, in SI units."""

    value: float
    low: float  # NaN where the data do not determine the number; see `Fit.notes`
    high: float
    by: Literal["jacobian", "profile"]  # of the fit made linear, or where chi^2 rises above its limit

    def holds(self, value: float) -> bool:
        """Whether the interval holds a value; without one it holds none."""
        return self.low <= value <= self.high

    @property
    def is_determined(self) -> bool:
        """Whether the data determine the number, so that it has an interval."""
        return not math.isnan(self.low)


class Fit(Result):
    """The best fit of a scene to measurements.

    The panels of its picture are those of the measured quantities, "x", "y" or "theta", "residuals", and for each
    number "valleys KEY", the minima that were found, and "profile KEY", how chi^2 rises away from it.
    """

    stored_as = "fit"
    required = ("best", "measured")

    best = Variable("fitted number, in SI units", None, ("key",))
    low = Variable("lower end of its 95 % interval; NaN where the data do not determine it", None, ("key",))
    high = Variable("upper end of its 95 % interval; NaN where the data do not determine it", None, ("key",))
    by_profile = Variable("whether the interval is found by profile", None, ("key",), stored=np.int8, kind=bool)
    bound_low = Variable("lower bound of the number", None, ("key",))
    bound_high = Variable("upper bound of the number", None, ("key",))
    correlation = Variable("correlation of two fitted numbers", "1", ("key", "other"))
    at = Variable("time [s], or circular frequency of the drive [rad/s]", None, ("row",))
    measured = Variable("measured value, in SI units", None, ("row", "channel"))
    fitted = Variable("the same of the fitted scene; NaN where it has none", None, ("row", "channel"))
    sigma = Variable("standard deviation of the noise, given or estimated", None, ("row", "channel"))
    curve_at = Variable("places of the curve that is drawn, as `at`", None, ("point",))
    curve = Variable("the fitted scene at these places", None, ("point", "channel"))
    minima = Variable("chi^2 of each minimum that was found, that of the fit first", None, ("start",))
    minima_at = Variable("numbers of these, in SI units", None, ("start", "key"))
    profile_at = Variable("values of each number on its profile, growing, in SI units", None, ("key", "node"))
    profile_chi2 = Variable("least chi^2 that the other numbers permit there", None, ("key", "node"))
    profile_limit = Attribute()  # chi^2 at the ends of intervals
    chi2 = Attribute()  # sum of squares of residuals over their noise
    freedom = Attribute(int)  # values less numbers
    evaluations = Attribute(int)  # of the model with its derivatives
    data_kind = Attribute(str)  # "history" or "response"
    notes_json = Attribute(str, name="notes")
    _sigma_is_known = Attribute(int, name="sigma_is_known")
    seed = Attribute(int)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the fitted numbers."""
        return tuple(map(str, self.data["key"].to_numpy()))

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the measured channels."""
        return tuple(map(str, self.data["channel"].to_numpy()))

    @property
    def numbers(self) -> dict[str, FittedNumber]:
        """The fitted numbers by their keys, with their intervals."""
        rows = zip(self.keys, self.best, self.low, self.high, self.by_profile, strict=True)
        return {
            key: FittedNumber(float(value), float(low), float(high), "profile" if profile else "jacobian")
            for key, value, low, high, profile in rows
        }

    @property
    def value(self) -> dict[str, float]:
        """The fitted numbers by their keys, in SI units."""
        return {key: number.value for key, number in self.numbers.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What should be known before the numbers are used: what the data do not determine, and doubts."""
        return tuple(json.loads(self.notes_json or "[]"))

    @property
    def sigma_is_known(self) -> bool:
        """Whether the noise was given; else it is estimated, see `noise_from`."""
        return bool(self._sigma_is_known)

    @property
    def noise_from(self) -> str:
        """What the noise is estimated from, where it is not given."""
        return "neighbouring residuals" if self.data_kind == "history" else "the residuals"

    @property
    def noise(self) -> dict[str, float]:
        """The root mean square of each channel's noise, given or estimated, in SI units."""
        return dict(zip(self.channels, np.sqrt(np.mean(self.sigma**2, axis=0)).tolist(), strict=True))

    @property
    def failed(self) -> int:
        """The number of measured values of which the fitted scene says nothing."""
        return int(np.sum(~np.isfinite(self.fitted)))

    def summary(self) -> dict[str, JSONValue]:
        """The numbers with their intervals, their correlations, and the notes, as `summary.json` holds them."""
        names = ("chi2", "freedom", "evaluations", "data_kind", "sigma_is_known", "seed", "steps_per_period")
        bounds = zip(self.bound_low, self.bound_high, strict=True)
        over = {
            key: {**number._asdict(), "bounds": list(ends)}
            for (key, number), ends in zip(self.numbers.items(), bounds, strict=True)
        }
        plain = {name: getattr(self, name) for name in names}
        plain |= {
            "correlation": self.correlation,
            "noise": self.noise,
            "minima": self.minima,
            "values": self.measured.size,
        }
        return json_values(
            {"over": over, "notes": list(self.notes), **plain, "method": str(self.method), **self.source}
        )

    def __repr__(self) -> str:
        def ends(n):
            return f"{n.low:.5g} to {n.high:.5g}" if n.is_determined else "not determined"

        numbers = ", ".join(f"{key} {n.value:.5g} ({ends(n)})" for key, n in self.numbers.items())
        notes = f"; {'; '.join(self.notes)}" if self.notes else ""
        return (
            f"Fit: {numbers}; chi2 {self.chi2:.4g} for {self.freedom} degrees of freedom{notes}; "
            f"{self.method}, {self.steps_per_period} steps a period"
        )
