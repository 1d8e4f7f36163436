"""What tuning gives."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.variable import Attribute, Variable
from jaxshroud.results.words import between
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PENALTY = 100.0  # percentage points for exceeding a limit by its own size
PATHS = ("update", "start")
ENDED_BY = ("bound", "loss", "limit", "stop")  # the bound itself will do; P_d is lost, a limit exceeded, a run stopped
ROBUST = (
    *("nominal_P_d", "nominal_ci", "nominal_force", "nominal_v_max", "sampled_P_d", "scattered_force"),
    *("scattered_v_max", "at_least", "probability", "probability_low", "probability_high"),
    *("motions", "motions_worst", "motions_undecided"),
)
ENDS = {"flag_meanings": " ".join(ENDED_BY)}


class Judged(NamedTuple):
    """What simulations say of some designs; where numbers scatter, each draw of each condition counts as one."""

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


class Within(NamedTuple):
    """Where one number may be, the others fixed, in SI units."""

    at: float  # in the best design
    low: float
    high: float
    ended_by: tuple[str, ...]  # each one of `ENDED_BY`
    beyond: tuple[float, float]  # the next values looked at, which do not do; NaN at a bound
    apart: float  # largest distance between neighbours looked at within: losses between them are not seen


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

    # Where numbers scatter; every draw counts as a condition of its own above, those of one condition in a row.
    half_width = Variable("half width of the scatter: in SI units, or over the number", None, ("scattered",))
    relative = Variable("whether it is over the number", None, ("scattered",), stored=np.int8, kind=bool)
    places = Variable("draws of the search, from -1 to 1 within the scatter", "1", ("draw", "scattered"))
    sampled = Variable("independent draws around the best design, likewise", "1", ("sample", "scattered"))
    sampled_P_d = Variable("least P_d over the conditions of each of them", "percent", ("sample",))
    scattered_force = Attribute()  # largest normal force of any of them [N]
    scattered_v_max = Attribute()  # largest penetration, likewise [m]
    at_least = Attribute()  # P_d asked for [percent]
    probability = Attribute()  # that it is met in every condition, by the independent draws
    probability_low = Attribute()  # ends of its 95 % interval, Clopper and Pearson
    probability_high = Attribute()
    # Where numbers scatter, or a loss is stated: of the best design itself, without scatter.
    loss = Attribute()  # of P_d, that may be lost in any condition [percentage points]
    nominal_P_d = Variable("P_d in each condition", "percent", ("operation",))
    nominal_ci = Variable("half width of its 95 % interval", "percent", ("operation",))
    nominal_force = Attribute()  # [N]
    nominal_v_max = Attribute()  # [m]
    nominal = Variable("each number in the best design", None, ("number",))
    interval = Variable("outermost values, the others fixed, that lose no more than `loss`", None, ("number", "end"))
    beyond = Variable("the next values looked at, which lose more; NaN at a bound", None, ("number", "end"))
    ended_by = Variable("what ends the interval", None, ("number", "end"), stored=np.int8, kind=int, more=ENDS)
    apart = Variable("largest distance between neighbours looked at within the interval", None, ("number",))
    looked = Variable("values looked at", None, ("number", "place"))
    looked_loss = Variable("loss of P_d there in the condition that loses most", "percent", ("number", "place"))
    motions = Variable("coexisting motions found from random starts", None, ("operation",))
    motions_worst = Variable("P_d of the worst of them", "percent", ("operation",))
    motions_undecided = Variable("share of the starts that were left undecided, or stopped", "1", ("operation",))

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
    def intervals(self) -> dict[str, Within]:
        """Where each number may be before more than `loss` percentage points of P_d are lost in any condition.

        Tuned numbers are looked at between their bounds, others within their scatter. Empty where no loss was stated.
        """
        if self.interval is None:
            return {}
        found = {}
        for i, key in enumerate(map(str, self.data["number"].to_numpy())):
            (low, high), (least, most) = self.interval[i].tolist(), self.beyond[i].tolist()
            why = tuple(ENDED_BY[end] for end in self.ended_by[i])
            found[key] = Within(float(self.nominal[i]), low, high, why, (least, most), float(self.apart[i]))
        return found

    @property
    def scatters(self) -> dict[str, tuple[float, bool]]:
        """Half widths of the numbers that scatter, and whether they are over the number itself."""
        if self.half_width is None:
            return {}
        keys = map(str, self.data["scattered"].to_numpy())
        return dict(zip(keys, zip(self.half_width.tolist(), self.relative.tolist(), strict=True), strict=True))

    def ends_of_scatter(self, values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The least and the largest that numbers with these values become by the scatter."""
        ends = {}
        for key, (half, relative) in self.scatters.items():
            by = half * abs(values[key]) if relative else half
            ends[key] = values[key] - by, values[key] + by
        return ends

    @property
    def chance(self) -> str:
        """The probability that `at_least` is met with, and its 95 % interval, in words."""
        return between(self.probability, self.probability_low, self.probability_high)

    @property
    def robust(self) -> dict[str, Any] | None:
        """All that is known of the best design's robustness, as `tune.json` holds it; None where nothing was asked."""
        if self.loss is None:
            return None
        names = ("loss", *(name for name in ROBUST if getattr(self, name) is not None))
        ranges = {
            key: {**within._asdict(), "looked": looked[np.isfinite(looked)], "loss": loss[np.isfinite(looked)]}
            for (key, within), looked, loss in zip(self.intervals.items(), self.looked, self.looked_loss, strict=True)
        }
        told = {key: {"half_width": by, "relative": relative} for key, (by, relative) in self.scatters.items()}
        draws = {} if self.places is None else {"draws": len(self.places), "samples": len(self.sampled)}
        return {**{name: getattr(self, name) for name in names}, "intervals": ranges, "scatter": told, **draws}

    @property
    def failed(self) -> int:
        """1 where the best design does not keep the limits, or stops."""
        return int(not self.feasible)

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Paths over the map of the objective, or key by key without a map, and the paths' scores.

        Args:
            ax: Not for this picture, which has two panels.
            options: `drawn`: the map, as `objective_map` gives it; `panel`: "robust" for how far each number may go
                alone; a title, xlabel, unit of lengths, width [mm] and matplotlib style.

        Raises:
            ValueError: An `ax` is given, there is no such panel, or nothing is known of robustness.
        """
        from jaxshroud.results import plot_design, plot_robust
        from jaxshroud.results.drawing import Look

        if ax is not None:
            raise InputError("A tuning is drawn in two panels; leave `ax` out and take the figure's axes.")
        drawn: Mapping[str, Any] | None = options.pop("drawn", None)
        told = {name: getattr(self, name) for name in ("points", "scores", "goal", "over", "design")}
        panel = options.pop("panel", None)
        if panel not in (None, "robust") or (panel and self.robust is None):
            raise InputError(f"This tuning has no panel {panel!r}.")
        told |= {"map": drawn, "robust": self.robust, "title": self.data.attrs.get("title") or "tuning"}
        return (plot_robust.robustness if panel else plot_design.tuning)(told, look=Look(**options))

    def __repr__(self) -> str:
        design = ", ".join(f"{key} = {value:.6g}" for key, value in self.design.items())
        return (
            f"Tuned: {design}; {self.goal} P_d {self.objective:.4g} % over {self.check_P_d.shape[1]} conditions, "
            f"{'' if self.confirmed else 'not '}confirmed; {self.periods} periods simulated{self._robust_in_words}"
        )

    @property
    def _robust_in_words(self) -> str:
        """What is known of the robustness, in words."""
        if self.loss is None:
            return ""
        ends = (f"{key} {one.low:.4g} to {one.high:.4g}" for key, one in self.intervals.items())
        asked = "" if self.at_least is None else f"; at least {self.at_least:g} % with probability {self.chance}"
        return f"; at most {self.loss:g} points lost for {', '.join(ends)}{asked}"
