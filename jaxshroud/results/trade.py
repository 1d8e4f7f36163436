"""The accuracy and the cost of settings of the march."""

from typing import NamedTuple

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import Result


class MeasuredSetting(NamedTuple):
    """The cost and the errors of one setting, measured on lanes around a scene; that of a stopped lane is infinite."""

    setting: str
    kind: str  # the options that are not numbers
    steps_per_period: float  # on average; 1 for the closed form
    cost: float  # processor time per lane and period [s]
    state_error: float  # after the horizon, over the largest number of the state; 95 % of the lanes stay below it
    state_error_median: float
    P_d: float  # median error of P_d over the kept periods [percentage points]
    ci: float  # median half width of the 95 % interval of the true P_d [percentage points]
    period: float  # share of lanes with the true period number
    gradient: float  # median relative error of d(power)/d(gap) over the horizon; NaN where there is none


class Trade(Result):
    """Accuracy against cost of settings: a sequence of `MeasuredSetting`, and a dataset with a dimension `setting`.

    The panels of its picture are "state_error", "P_d", "gradient" and "period", all against the cost.
    """

    stored_as = "trade"

    kind = Variable("the choices that are no numbers")
    steps_per_period = Variable("steps per period, on average; 1 for the closed form")
    cost = Variable("processor time per lane and period", "s")
    state_error = Variable("error of the state after the horizon, below which 95 % of the lanes stay", "1")
    state_error_median = Variable("median error of the state after the horizon", "1")
    P_d = Variable("median error of P_d over the kept periods", "percent")
    ci = Variable("median half width of the 95 % interval of the true P_d", "percent")
    period = Variable("share of lanes with the true period number", "1")
    gradient = Variable("median relative error of d(power)/d(gap) over the horizon", "1")
    horizon = Attribute(int)  # drive periods

    def __len__(self) -> int:
        return len(self.cost)

    def __getitem__(self, i: int) -> MeasuredSetting:
        return MeasuredSetting(**{name: self.data[name].to_numpy().tolist()[i] for name in MeasuredSetting._fields})

    @property
    def front(self) -> list[int]:
        """The indices of the Pareto front of cost and error, the cheapest setting first."""
        order = np.argsort(self.cost, kind="stable")
        errors = self.state_error[order]
        return order[errors < np.minimum.accumulate([np.inf, *errors[:-1]])].tolist()

    def cheapest(self, level: float) -> MeasuredSetting | None:
        """The cheapest setting whose error is at most `level` for 95 % of the lanes; None if there is none."""
        return min((one for one in self if one.state_error <= level), key=lambda one: one.cost, default=None)

    @property
    def failed(self) -> int:
        """The number of settings of which more than 5 % of the lanes stopped."""
        return int(np.isinf(self.state_error).sum())

    def summary(self) -> dict[str, JSONValue]:
        """The settings in plain numbers, as `trade.json` holds them."""
        settings = [{**self[i]._asdict(), "front": i in self.front} for i in range(len(self))]
        return json_values({"settings": settings, "horizon": self.horizon, **self.origin})

    def _drawn(self) -> tuple[str, object]:
        return self.stored_as, self.summary()

    def __repr__(self) -> str:
        front = ", ".join(f"{self[i].setting} ({self[i].state_error:.1e})" for i in self.front)
        return f"Trade of {len(self)} settings; from the cheapest to the best: {front}"
