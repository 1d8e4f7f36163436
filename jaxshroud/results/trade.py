"""The accuracy and the cost of settings of the march."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import Result

MOST_LANES = 0.95  # share of the lanes for which the error of a setting holds


class MeasuredSetting(NamedTuple):
    """The cost and the errors of one setting, measured on lanes around a scene."""

    setting: str
    kind: str  # the options that are not numbers
    steps: float  # per period, on average; 0 for the closed form
    cost: float  # processor time per lane and period [s]
    state: np.ndarray  # (lanes,) error of the state after the horizon over its largest number; NaN if stopped
    P_d: float  # median error of P_d over the kept periods [percentage points]; NaN where that takes too long
    ci: float  # median half width of the 95 % interval of the true P_d [percentage points]
    period: float  # share of lanes with the true period number; NaN where P_d is
    gradient: float  # median relative error of d(power)/d(gap) over the horizon; NaN where there is none

    @property
    def error(self) -> float:
        """The error of the state below which 95 % of the lanes stay."""
        return float(np.quantile(np.nan_to_num(self.state, nan=np.inf), MOST_LANES, method="higher"))


class Trade(Result):
    """Accuracy against cost of settings: a sequence of `MeasuredSetting`, and a dataset with a dimension `setting`.

    The panels of its picture are "state_error", "P_d", "gradient" and "period", all against the cost.
    """

    stored_as = "trade"

    kind = Variable("the choices that are no numbers", None, ("setting",))
    steps = Variable("steps per period, on average; 0 for the closed form", None, ("setting",))
    cost = Variable("processor time per lane and period", "s", ("setting",))
    state = Variable("error of the state after the horizon over its largest number", "1", ("setting", "lane"))
    P_d = Variable("median error of P_d over the kept periods", "percent", ("setting",))
    ci = Variable("median half width of the 95 % interval of the true P_d", "percent", ("setting",))
    period = Variable("share of lanes with the true period number", "1", ("setting",))
    gradient = Variable("median relative error of d(power)/d(gap) over the horizon", "1", ("setting",))
    horizon = Attribute(int)  # drive periods

    @classmethod
    def of_settings(cls, settings: Sequence[MeasuredSetting], horizon: int, attrs: Mapping[str, object]) -> "Trade":
        """The result from the measurements of all settings."""
        columns = dict(zip(MeasuredSetting._fields, zip(*settings, strict=True), strict=True))
        names = [*columns.pop("setting")]
        values = {name: np.array(column) for name, column in columns.items()}
        return cls.from_values({**values, "horizon": horizon}, coords={"setting": names}, attrs=attrs)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the settings."""
        return tuple(map(str, self.data["setting"].to_numpy()))

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[MeasuredSetting]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, i: int) -> MeasuredSetting:
        names = ("steps", "cost", "P_d", "ci", "period", "gradient")
        numbers = {name: getattr(self, name)[i].item() for name in names}
        return MeasuredSetting(setting=self.names[i], kind=str(self.kind[i]), state=self.state[i], **numbers)

    @property
    def front(self) -> list[int]:
        """The indices of the Pareto front of cost and error, the cheapest setting first."""
        smallest = np.inf
        front = []
        errors = [one.error for one in self]
        for i in np.argsort(self.cost, kind="stable").tolist():
            if errors[i] < smallest:
                smallest = errors[i]
                front.append(i)
        return front

    def cheapest(self, level: float) -> MeasuredSetting | None:
        """The cheapest setting whose error is at most `level` for 95 % of the lanes; None if there is none."""
        accurate = [one for one in self if one.error <= level]
        return min(accurate, key=lambda one: one.cost, default=None)

    @property
    def failed(self) -> int:
        """The number of settings that have lanes that stopped."""
        return int(np.isnan(self.state).any(axis=1).sum())

    def summary(self) -> dict[str, JSONValue]:
        """The settings in plain numbers, as `trade.json` holds them."""
        front = self.front
        rows = [
            {
                "setting": one.setting,
                "kind": one.kind,
                "steps_per_period": one.steps,
                "cost": one.cost,
                "state_error": one.error,
                "state_error_median": np.nanmedian(one.state),
                **{name: getattr(one, name) for name in ("P_d", "ci", "period", "gradient")},
                "front": i in front,
            }
            for i, one in enumerate(self)
        ]
        return json_values({"settings": rows, "horizon": self.horizon, **self.origin})

    def _picture_content(self) -> dict[str, object]:
        return {"title": "", **self.summary()}

    def __repr__(self) -> str:
        front = ", ".join(f"{self.names[i]} ({self[i].error:.1e})" for i in self.front)
        return f"Trade of {len(self)} settings on {self.state.shape[1]} lanes; from the cheapest to the best: {front}"
