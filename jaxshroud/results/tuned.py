"""What tuning gives."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.variable import Attribute, Variable
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PENALTY = 100.0  # percentage points for exceeding a limit by its own size
PATHS = ("update", "start")


class Judged(NamedTuple):
    """What simulations say of some designs."""

    score: np.ndarray  # (n,) objective less the penalties [%]
    objective: np.ndarray  # (n,) mean or least P_d over the conditions [%]
    P_d: np.ndarray  # (n, conditions) [%]
    ci: np.ndarray  # (n, conditions) half widths of 95 % intervals [percentage points]
    v_max: np.ndarray  # (n,) largest penetration in any condition [m]; within steps too where there is a limit
    force: np.ndarray  # (n,) largest normal force, likewise [N]
    period_number: np.ndarray  # (n, conditions); 0: aperiodic

    def keeps(self, margin: float = 0.0) -> np.ndarray:
        """Whether each design ran to its end in every condition, its limits exceeded by `margin` at most, (n,)."""
        return np.isfinite(self.objective) & (self.score >= self.objective - PENALTY * margin)


class Tuned(Result):
    """A tuned design and how it was found."""

    stored_as = "tuned"

    best = Variable("the tuned design, in SI units", None, ("key",))
    bound = Variable("at a bound of its key: -1 lower, 1 upper; beyond may be better", None, ("key",), stored=np.int8)
    ends = Variable("bounds of each key", None, ("key", "end"))
    objective = Variable("by the search's own short runs", "percent", alone=True)
    points = Variable("designs along each path, the starts first", None, (*PATHS, "key"))
    scores = Variable("objective less the penalties along each path", "percent", PATHS)
    exact = Variable("whether the slope was exact", None, PATHS, stored=np.int8, kind=bool)
    scanned = Variable("designs of the scan", None, ("scan", "key"))
    scanned_scores = Variable("objective less the penalties of the scan", "percent", ("scan",))
    periods = Attribute(int)  # drive periods simulated in all, each tangent counted as one more run
    confirmed = Variable(
        "all checks agree with the search and one another, and keep the limits", alone=True, kind=bool, stored=np.int8
    )
    feasible = Variable(
        "from the scene's own start it runs to its end and keeps the limits", alone=True, kind=bool, stored=np.int8
    )
    goal = Attribute(str)  # "mean" or "worst" of P_d over the conditions
    start = Attribute(str)  # of every run: "scene", or "given" by an argument, which files do not hold
    most_penetration = Attribute()  # [m]
    most_force = Attribute()  # [N]
    conditions_asked = Attribute(str)  # keys with their values, in JSON
    check_score = Variable("of each check: objective less the penalties", "percent", ("check",))
    check_objective = Variable("of each check: mean or least P_d over the conditions", "percent", ("check",))
    check_P_d = Variable("of each check: P_d", "percent", ("check", "condition"))
    check_ci = Variable("of each check: half width of the 95 % interval of P_d", "percent", ("check", "condition"))
    check_v_max = Variable("of each check: largest penetration in any condition", "m", ("check",))
    check_force = Variable("of each check: largest normal force in any condition", "N", ("check",))
    check_period_number = Variable("of each check: period number; 0: aperiodic", None, ("check", "condition"))

    _problem: Any = None  # in memory, unless read from a file

    @property
    def problem(self) -> Any:
        """What was tuned, as `tune` had it.

        Raises:
            ValueError: The result was read from a file.
        """
        if self._problem is None:
            raise InputError("A stored tuning does not hold its problem; `objective_map` makes it anew from the scene.")
        return self._problem

    @property
    def keys(self) -> tuple[str, ...]:
        """What was tuned."""
        return tuple(map(str, self.data["key"].to_numpy()))

    @property
    def design(self) -> dict[str, float]:
        """The tuned numbers, in SI units."""
        return dict(zip(self.keys, self.best.tolist(), strict=True))

    @property
    def over(self) -> dict[str, tuple[float, float]]:
        """The bounds of each key."""
        return {key: (low, high) for key, (low, high) in zip(self.keys, self.ends.tolist(), strict=True)}

    @property
    def conditions(self) -> dict[str, list[float]]:
        """Operating conditions: keys with their values; every combination counts."""
        return json.loads(self.conditions_asked)

    @property
    def at_bounds(self) -> dict[str, str]:
        """Keys whose best value is at its "lower" or "upper" bound: beyond may be better."""
        ends = {-1: "lower", 1: "upper"}
        return {key: ends[at] for key, at in zip(self.keys, self.bound.tolist(), strict=True) if at}

    @property
    def checks(self) -> dict[str, Judged]:
        """The winner simulated again in other ways."""
        names = map(str, self.data["check"].to_numpy())
        fields = [getattr(self, f"check_{name}") for name in Judged._fields]
        return {name: Judged(*(field[i : i + 1] for field in fields)) for i, name in enumerate(names)}

    @property
    def failed(self) -> int:
        """1 where the best design does not keep the limits, or stops."""
        return int(not self.feasible)

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Paths over the map of the objective, or key by key without a map, and the paths' scores.

        Args:
            ax: Not for this picture, which has two panels.
            options: `drawn`: the map, as `objective_map` gives it; a title, xlabel, unit of lengths, width [mm] and
                matplotlib style.

        Raises:
            ValueError: An `ax` is given.
        """
        from jaxshroud.results import plot_design
        from jaxshroud.results.drawing import Look

        if ax is not None:
            raise InputError("A tuning is drawn in two panels; leave `ax` out and take the figure's axes.")
        drawn: Mapping[str, Any] | None = options.pop("drawn", None)
        told = {name: getattr(self, name) for name in ("points", "scores", "goal", "over", "design")}
        return plot_design.tuning(
            {**told, "map": drawn, "title": self.data.attrs.get("title") or "tuning"}, look=Look(**options)
        )

    def __repr__(self) -> str:
        design = ", ".join(f"{key} = {value:.6g}" for key, value in self.design.items())
        return (
            f"Tuned: {design}; {self.goal} P_d {self.objective:.4g} % over {self.check_P_d.shape[1]} conditions, "
            f"{'' if self.confirmed else 'not '}confirmed; {self.periods} periods simulated"
        )
