"""A tuned design, with its search and its robustness."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.scene_numbers import layout_in
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import Result
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.quantities import is_reduction, unit_of
from jaxshroud.scene.typed import typed
from jaxshroud.signals.effects import between, flat_text, mean_shift_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PENALTY = 100.0  # percentage points for exceeding a limit by its own size
PATHS = ("update", "start")
ENDED_BY = ("bound", "loss", "limit", "stop")  # the bound is permitted; P_d is lost, a limit exceeded, a run stopped
ROBUST = (
    *("nominal_P_d", "nominal_ci", "nominal_force", "nominal_v_max", "sampled_P_d", "scattered_force"),
    *("scattered_v_max", "at_least", "probability", "probability_low", "probability_high"),
    *("motions", "motions_worst", "motions_undecided"),
)
SCAN = "scanned", "scanned_scores", "scanned_ci"
SEARCH = ("points", "scores", "polished", "polished_scores", *SCAN)  # the data of the picture
END_FLAGS = {"flag_meanings": " ".join(ENDED_BY)}


class DesignJudgement(NamedTuple):
    """The simulated performance of some designs; where numbers scatter, each draw counts as a condition of its own."""

    score: np.ndarray  # (n,) objective less the penalties [%]
    objective: np.ndarray  # (n,) mean or smallest P_d over the conditions [%]
    P_d: np.ndarray  # (n, conditions) [%]
    ci: np.ndarray  # (n, conditions) half widths of 95 % intervals [percentage points]
    v_max: np.ndarray  # (n,) largest penetration in any condition [m]; within steps too where there is a limit
    force: np.ndarray  # (n,) largest normal force in any condition [N]
    period_number: np.ndarray  # (n, conditions); 0: aperiodic

    def keeps(self, margin: float = 0.0) -> np.ndarray:
        """Whether each design ran to its end in every condition and exceeds its limits by `margin` at most, (n,)."""
        return np.isfinite(self.objective) & (self.score >= self.objective - PENALTY * margin)


class DesignInterval(NamedTuple):
    """The interval of permissible values of one number while the others are fixed, in SI units."""

    at: float  # its value in the best design
    low: float
    high: float
    ended_by: tuple[str, ...]  # for each end one of `ENDED_BY`
    beyond: tuple[float, float]  # the next values tried, which are not permissible; NaN at a bound
    apart: float  # largest distance between neighbouring values tried within: losses between them are not detected


class HalfWidth(NamedTuple):
    """The half width of the interval in which a number scatters."""

    size: float  # [SI], or over the number itself
    relative: bool  # whether it is over the number itself

    def around(self, value: float) -> tuple[float, float]:
        """The smallest and the largest value that a number takes by its scatter."""
        half_width = self.size * abs(value) if self.relative else self.size
        return value - half_width, value + half_width


class Tuned(Result):
    """A tuned design, its search, its checks and its robustness.

    The panels of its picture are "designs" and "scores", and "robust" where robustness was requested.
    """

    stored_as = "tuned"

    best = Variable("the tuned design, in SI units", None, ("key",))
    bound = Variable("at a bound of its key: -1 lower, 1 upper; beyond may be better", None, ("key",), stored=np.int8)
    ends = Variable("bounds of each key", None, ("key", "end"))
    objective = Variable("by the search's own short runs", "percent", alone=True)
    points = Variable("designs along each path, the starts first", None, (*PATHS, "key"))
    scores = Variable("objective less the penalties along each path", "percent", PATHS)
    exact = Variable("whether the slope was exact", None, PATHS, stored=np.int8, kind=bool)
    place = Variable("the nearest values looked at that are worse, or bounds; of one number", None, ("key", "end"))
    polished = Variable("the best path's design after each round of samples around its end", None, ("round", "key"))
    polished_scores = Variable("objective less the penalties of these", "percent", ("round",))
    scanned = Variable("designs of the scan", None, ("scan", "key"))
    scanned_scores = Variable("objective less the penalties of the scan", "percent", ("scan",))
    scanned_ci = Variable("half width of the 95 % interval of the scan's objectives", "percent", ("scan",))
    periods = Attribute(int)  # drive periods simulated in total, each tangent counted as one more run
    confirmed = Variable(
        "all checks agree with the search and one another, and keep the limits", alone=True, kind=bool, stored=np.int8
    )
    feasible = Variable(
        "from the scene's own start it runs to its end and keeps the limits", alone=True, kind=bool, stored=np.int8
    )
    goal = Attribute(str)  # "mean" or "worst" of P_d over the conditions
    of = Attribute(str)  # what is tuned; if not "P_d", its reduction below `free` in percent is called P_d here
    free = Attribute()  # the size of `of` at a reduction of 0; NaN for P_d and P_d_worst
    start = Attribute(str)  # of every run: "scene", or "given" by an argument, which files do not hold
    most_penetration = Attribute()  # [m]
    most_force = Attribute()  # [N]
    conditions_json = Attribute(str, name="conditions_asked")  # key -> values, as JSON
    best_P_d = Variable("P_d of the best design", "percent", ("condition",))
    best_P_d_vibration = Variable("that of the vibration about the mean position alone", "percent", ("condition",))
    check_score = Variable("of each check: objective less the penalties", "percent", ("check",))
    check_objective = Variable("of each check: mean or least P_d over the conditions", "percent", ("check",))
    check_P_d = Variable("of each check: P_d", "percent", ("check", "condition"))
    check_ci = Variable("of each check: half width of the 95 % interval of P_d", "percent", ("check", "condition"))
    check_v_max = Variable("of each check: largest penetration in any condition", "m", ("check",))
    check_force = Variable("of each check: largest normal force in any condition", "N", ("check",))
    check_period_number = Variable("of each check: period number; 0: aperiodic", None, ("check", "condition"))

    # Where numbers scatter. Every draw is a condition of its own above, and those of one condition follow each other.
    half_width = Variable("half width of the scatter: in SI units, or over the number", None, ("scattered",))
    relative = Variable("whether it is over the number", None, ("scattered",), stored=np.int8, kind=bool)
    places = Variable("draws of the search, from -1 to 1 within the scatter", "1", ("draw", "scattered"))
    sampled = Variable("independent draws around the best design, likewise", "1", ("sample", "scattered"))
    sampled_P_d = Variable("least P_d over the conditions of each of them", "percent", ("sample",))
    scattered_force = Attribute()  # largest normal force of any of them [N]
    scattered_v_max = Attribute()  # largest penetration, likewise [m]
    at_least = Attribute()  # required P_d [percent]
    probability = Attribute()  # that it is met in every condition, by the independent draws
    probability_low = Attribute()  # ends of its 95 % interval, Clopper and Pearson
    probability_high = Attribute()
    # Where numbers scatter or a loss is given: the best design itself, without scatter.
    loss = Attribute()  # the P_d that may be lost in any condition [percentage points]
    nominal_P_d = Variable("P_d in each condition", "percent", ("operation",))
    nominal_ci = Variable("half width of its 95 % interval", "percent", ("operation",))
    nominal_force = Attribute()  # [N]
    nominal_v_max = Attribute()  # [m]
    nominal = Variable("each number in the best design", None, ("number",))
    interval = Variable("outermost values, the others fixed, that lose no more than `loss`", None, ("number", "end"))
    beyond = Variable("the next values looked at, which lose more; NaN at a bound", None, ("number", "end"))
    ended_by = Variable("what ends the interval", None, ("number", "end"), stored=np.int8, kind=int, more=END_FLAGS)
    apart = Variable("largest distance between neighbours looked at within the interval", None, ("number",))
    looked = Variable("values looked at", None, ("number", "probe"))
    looked_loss = Variable("loss of P_d there in the condition that loses most", "percent", ("number", "probe"))
    motions = Variable("coexisting motions found from random starts", None, ("operation",))
    motions_worst = Variable("P_d of the worst of them", "percent", ("operation",))
    motions_undecided = Variable("share of the starts that were left undecided, or stopped", "1", ("operation",))

    _problem: Any = None  # in memory, unless read from a file

    @property
    def problem(self) -> Any:
        """The optimisation problem that `tune` solved, a `Problem` of `verbs.design_problem`.

        Raises:
            ValueError: The result was read from a file.
        """
        if self._problem is None:
            raise InputError("A stored tuning does not hold its problem; `objective_map` makes it anew from the scene.")
        return self._problem

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the tuned numbers."""
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
    def quantity(self) -> str:
        """What is tuned, `of`; P_d in files of versions that tuned nothing else."""
        return self.of or "P_d"

    def levels(self, reduction: Any) -> Any:
        """The size of `of`, in SI units (P_d in percent), at reductions in percent."""
        return reduction if is_reduction(self.quantity) else self.free * (1 - np.asarray(reduction) / 100)

    @property
    def level(self) -> float:
        """The mean, or the worst value, of `of` over the conditions in the best design."""
        return float(self.levels(self.objective))

    @property
    def conditions(self) -> dict[str, list[float]]:
        """The operating conditions, key -> values; the design has to do in every combination."""
        return json.loads(self.conditions_json)

    @property
    def at_bounds(self) -> dict[str, str]:
        """The keys whose best value is at its "lower" or "upper" bound, beyond which there may be a better one."""
        names = {-1: "lower", 1: "upper"}
        return {key: names[side] for key, side in zip(self.keys, self.bound.tolist(), strict=True) if side}

    @property
    def best_between(self) -> dict[str, tuple[float, float]]:
        """Between which values the best one of the tuned number lies, as far as intervals show; of several: empty.

        They are the nearest ones on either side that were looked at and are worse by more than both intervals, or
        the bounds.
        """
        ends = [] if self.place is None else self.place.tolist()
        return {key: (low, high) for key, (low, high) in zip(self.keys, ends, strict=False)}

    @property
    def flat(self) -> str:
        """What to say where the scan's scores move less than their intervals; else empty."""
        return flat_text(self.scanned_scores, self.scanned_ci)

    @property
    def checks(self) -> dict[str, DesignJudgement]:
        """The best design simulated again in other ways."""
        names = map(str, self.data["check"].to_numpy())
        fields = [getattr(self, f"check_{name}") for name in DesignJudgement._fields]
        return {name: DesignJudgement._make(field[i : i + 1] for field in fields) for i, name in enumerate(names)}

    @property
    def intervals(self) -> dict[str, DesignInterval]:
        """The interval of each number in which no condition loses more than `loss` percentage points of P_d.

        Tuned numbers are varied between their bounds, others within their scatter. Empty if no loss was given.
        """
        if self.interval is None:
            return {}
        intervals = {}
        for i, key in enumerate(map(str, self.data["number"].to_numpy())):
            low, high = self.interval[i].tolist()
            beyond = tuple(self.beyond[i].tolist())
            ended_by = tuple(ENDED_BY[end] for end in self.ended_by[i])
            intervals[key] = DesignInterval(float(self.nominal[i]), low, high, ended_by, beyond, float(self.apart[i]))
        return intervals

    @property
    def scatters(self) -> dict[str, HalfWidth]:
        """The half widths of the numbers that scatter."""
        if self.half_width is None:
            return {}
        keys = map(str, self.data["scattered"].to_numpy())
        return dict(zip(keys, map(HalfWidth, self.half_width.tolist(), self.relative.tolist()), strict=True))

    def ends_of_scatter(self, values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The smallest and the largest value that the scatter gives to numbers with these values."""
        return {key: width.around(values[key]) for key, width in self.scatters.items()}

    @property
    def chance(self) -> str:
        """The probability that `at_least` is met, and its 95 % interval, as text."""
        return between(self.probability, self.probability_low, self.probability_high)

    @property
    def robust(self) -> dict[str, object] | None:
        """The robustness of the best design, as `tune.json` holds it; None if it was not requested."""
        if self.loss is None:
            return None
        names = ("loss", *(name for name in ROBUST if getattr(self, name) is not None))
        tried = zip(self.intervals.items(), self.looked, self.looked_loss, strict=True)
        intervals = {
            key: {**interval._asdict(), "looked": values[np.isfinite(values)], "loss": losses[np.isfinite(values)]}
            for (key, interval), values, losses in tried
        }
        scatter = {key: {"half_width": half, "relative": relative} for key, (half, relative) in self.scatters.items()}
        more = {} if self.places is None else {"draws": len(self.places), "samples": len(self.sampled)}
        more |= ({} if self.quantity == "P_d" else {"of": self.of}) | {"blades": self._blades}
        return {**{name: getattr(self, name) for name in names}, "intervals": intervals, "scatter": scatter, **more}

    @property
    def _blades(self) -> tuple[str, ...]:
        """The names of the blades, for the labels of pictures."""
        return layout_in(self.data).names

    def summary(self, drawn: Mapping[str, object] | None = None) -> dict[str, JSONValue]:
        """The design, its checks and its search in plain numbers, as `tune.json` holds them.

        Args:
            drawn: The map, as `objective_map` gives it.
        """
        outcome = ("feasible", "design", "best_between", "objective", "at_bounds", "confirmed", "periods", "best_P_d")
        request = ("best_P_d_vibration", "over", "conditions", "goal", "most_penetration", "most_force")
        tuned = {} if self.quantity == "P_d" else {name: getattr(self, name) for name in ("of", "free", "level")}
        search = (*SEARCH, "exact")
        return json_values(
            {
                **{name: getattr(self, name) for name in (*outcome, *request)},
                **tuned,
                "blades": self._blades,
                "method": str(self.method),
                "steps_per_period": self.steps_per_period,
                **({"flat": self.flat} if self.flat else {}),
                **({"mean position": self.mean_shift} if self.mean_shift else {}),
                **({} if self.robust is None else {"robust": self.robust}),
                "checks": {name: judgement._asdict() for name, judgement in self.checks.items()},
                "map": drawn,
                **{name: getattr(self, name) for name in search},
                **self.origin,
            }
        )

    @property
    def mean_shift(self) -> str:
        """One sentence where contact shifts the mean position of the best design; else empty."""
        if self.best_P_d is None:
            return ""
        return mean_shift_text(self.best_P_d, self.best_P_d_vibration, self.quantity, "--of ")

    @property
    def failed(self) -> int:
        """1 if the best design exceeds a limit or stops, else 0."""
        return int(not self.feasible)

    @typed
    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        drawn: Mapping[str, object] | None = None,
        **options: Any,
    ) -> "Figure":
        """The paths of the search on the map of the objective, or key by key without a map, and their scores.

        Args:
            ax: Draw one panel there, by default the first.
            panel: "designs" or "scores"; "robust" for the interval of each number.
            drawn: The map, as `objective_map` gives it.
            options: The options of `Result.plot`.

        Raises:
            ValueError: There is no such panel, or robustness was not requested.
        """
        from jaxshroud.plotting.pictures import picture

        names = (*SEARCH, "goal", "over", "design", "best_between")
        content = {name: getattr(self, name) for name in names} | {"map": drawn, "robust": self.robust}
        content |= {"of": self.quantity, "blades": self._blades}
        content["title"] = self.data.attrs.get("title") or "tuning"
        if panel == "robust" and self.robust is not None:
            return picture("robustness", content, ax, **options)
        return picture("tuned", content, ax, panel, **options)

    def __repr__(self) -> str:
        design = ", ".join(f"{key} = {value:.6g}" for key, value in self.design.items())
        level = f"{self.goal} {self.quantity} {self.level:.4g} {unit_of(self.quantity)}"
        return (
            f"Tuned: {design}; {level} over {self.check_P_d.shape[1]} conditions, "
            f"{'' if self.confirmed else 'not '}confirmed; {self.periods} periods simulated{self._robust_in_words}"
        )

    @property
    def _robust_in_words(self) -> str:
        """The robustness as text; empty if it was not requested."""
        if self.loss is None:
            return ""
        ends = (f"{key} {interval.low:.4g} to {interval.high:.4g}" for key, interval in self.intervals.items())
        requirement = "" if self.at_least is None else f"; at least {self.at_least:g} % with probability {self.chance}"
        return f"; at most {self.loss:g} points lost for {', '.join(ends)}{requirement}"
