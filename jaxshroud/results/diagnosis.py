"""Lyapunov exponents, and the diagnosis of the motion of a scene with its evidence."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from jaxshroud.io.lane_status import FLAGS, status_name
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, ComplexVariable, MotionVariable, Variable, lanes_in_shape, lanes_in_words
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import AT_POINTS, OF_MODES, contact_values, stored_state
from jaxshroud.results.base import Labels, Result
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.typed import typed
from jaxshroud.signals.effects import NOT_RESOLVED, STUCK_SLIDER, exponent_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.prepared import State
    from jaxshroud.orbits.lyapunov import Exponents
    from jaxshroud.plotting.style import AppearanceOptions
    from jaxshroud.scene.scene import Scene

EXPONENTS = "Lyapunov exponents per drive period; -inf: forgotten altogether, NaN: not resolved"
NO_INTERVAL = "half width of the 95 % interval; NaN where there is none"


class Lyapunov(Result):
    """The Lyapunov exponents per drive period, the largest first: as many as the scene has states.

    Arrays start with the axes of the scenes; a single scene has none. Panels of its picture: "exponents" and
    "averages".
    """

    stored_as = "lyapunov"

    exponents = Variable(EXPONENTS, "1", ("direction",))
    ci = Variable(NO_INTERVAL, "1", ("direction",))
    growth = Variable(
        "exponents of each period; NaN where not resolved, or once a lane has stopped", "1", ("period", "direction")
    )
    stuck = Variable("whether the slider sticks for good: one exponent is 0", alone=True, kind=bool, stored=np.int8)
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    motion = MotionVariable("at the end")
    u_s = Variable("slider at the end", "m", ("interface",))
    mode = Variable("contact mode at the end", None, ("interface",))
    case = Variable("contact case at the end", None, ("interface",))
    point_u_s = Variable("slider of each point at the end", "m", AT_POINTS)
    point_mode = Variable("contact mode of each point at the end", None, AT_POINTS)
    modal = Variable("coordinates of modes and their rates at the end", None, OF_MODES)

    @classmethod
    def of_exponents(
        cls,
        exponents: "Sequence[Exponents]",
        shape: tuple[int, ...],
        scenes: "Sequence[Scene]",
        **labels: Unpack[Labels],
    ) -> "Lyapunov":
        """The result from the exponents of each lane.

        Args:
            exponents: The exponents of each lane.
            shape: The leading axes of the result.
            scenes: That of each lane.
            labels: Further arguments of `from_values`.
        """
        longest = max(len(lane.growth) for lane in exponents)
        rows = [_exponents_row(lane, longest, scene) for lane, scene in zip(exponents, scenes, strict=True)]
        layout = scenes[0].layout
        values = {name: lanes_in_shape([row[name] for row in rows], shape) for name in rows[0]}
        return cls.from_values(values, coords={"blade": np.arange(layout.blades)}, layout=layout, **labels)

    @property
    def last(self) -> "State":
        """The state at the end, from which a run can go on."""
        return stored_state(self, self.motion)

    def summary(self) -> dict[str, JSONValue]:
        """The exponents with their half widths in plain numbers, as `summary.json` holds them; of many scenes few."""
        if np.ndim(self.status):
            return super().summary()
        sticks = {"slider": STUCK_SLIDER} if self.stuck else {}
        values = {"exponents": _exponent_values(self.exponents, self.status), "ci": self.ci}
        return {"unit": "per drive period", **json_values(values), **sticks, **super().summary()}

    def __repr__(self) -> str:
        n = self.growth.shape[-2]
        if np.ndim(self.status):
            chaotic = np.sum(self.exponents[..., 0] - self.ci[..., 0] > 0)
            return (
                f"Lyapunov of {lanes_in_words(self.status, self.failed)}: {chaotic} chaotic; {n} periods; {self.ended}"
            )
        texts = [exponent_text(*pair, self.stuck) for pair in zip(self.exponents[:3], self.ci, strict=False)]
        words = ", ".join([*texts, "..."] if len(self.exponents) > len(texts) else texts)
        return f"Lyapunov exponents per drive period: {words}; {n} periods; {status_name(self.status)}"


def _exponent_values(exponents: np.ndarray, status: int) -> list[float | str]:
    """The exponents of a lane as JSON holds them: texts where one is -inf, or rounding hides it; NaN if it stopped."""

    def as_json(value: float) -> float | str:
        if np.isneginf(value):
            return str(value)
        return NOT_RESOLVED if np.isnan(value) and status == Status.OK else value

    return [as_json(value) for value in exponents.tolist()]


def _exponents_row(lane: "Exponents", periods: int, scene: "Scene") -> dict[str, Any]:
    """The values of one lane, with its growth filled up to the number of periods of the longest lane."""
    from jaxshroud.batch.lanes import shroud_motion

    growth = np.full((periods, len(lane.exponents)), np.nan, lane.growth.dtype)
    growth[: len(lane.growth)] = lane.growth
    state = {"motion": shroud_motion(lane.last.motion, scene), **contact_values(lane.last)}
    numbers = {"exponents": lane.exponents, "ci": lane.ci, "growth": growth}
    return {**numbers, "stuck": lane.stuck, "status": np.int32(lane.status), **state}


class Diagnosis(Trajectory):
    """A run of settled motion, and the verdict on it.

    The samples are those of the periods that follow the ones that gave the evidence; for a scene that stops they are
    those of its start. P_d is that of the left blade, or of a row; the largest exponent of a row is that of a nearby
    run, and it has neither multipliers nor a K.
    """

    stored_as = "diagnosis"

    # "period 2", "travelling wave of period 1", "quasi-periodic", "chaotic", "transient not over", "undecided" or
    # "stopped"
    verdict = Attribute(str)
    evidence = Attribute(str)  # the verdict with its reasons, a sentence
    period_number = Attribute(int)  # 0 where the motion is not periodic
    periods = Attribute(int)  # that were run before the samples
    return_error = Attribute()  # how far samples are from their return, relative to their size
    largest_exponent = Attribute()  # per drive period, from one tangent over periods of its own
    largest_exponent_ci = Attribute()
    K = Attribute()  # of the 0-1 test
    exponents = Variable(EXPONENTS, "1", ("direction",))
    exponents_ci = Variable(NO_INTERVAL, "1", ("direction",))
    slider_stuck = Attribute(bool)  # whether the slider sticks for good: one exponent is 0
    multipliers = ComplexVariable(
        "Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",)
    )
    n = Variable("number of periods averaged over", None, ("curve",))
    P_d = Variable("vibration-power reduction over the first n periods", "percent", ("curve",))
    P_d_ci = Variable("half width of its 95 % interval; NaN below two batches", "percent", ("curve",))
    P_d_settled = Attribute(bool)
    P_d_vibration = Attribute()  # of the vibration about the mean position alone, over all periods [percent]
    P_d_vibration_ci = Attribute()
    P_d_worst = Attribute()  # of the blade of a row that gains the least [percent]
    P = Variable("average power of each blade, Eq. (23); in rows only", "m4", ("blade",))
    P_0 = Variable("average power of each blade without contact, closed form; in rows only", "m4", ("blade",))

    @property
    def _repeats(self) -> int:
        return self.period_number

    @property
    def largest_force(self) -> float:
        """The largest resultant of normal and friction force among the samples [N]; NaN for a model without contact."""
        if self.N is None:
            return float("nan")
        return float(np.nanmax(np.hypot(self.N, self.F)))

    @property
    def powers(self) -> dict[str, float]:
        """The mean powers over the samples [W]: of the drive, and those lost in the dampers and in friction."""
        works = {"drive": self.work_drive, "viscous": self.loss_viscous, "friction": self.loss_friction}
        return {
            name: float(np.sum(work)) / float(self.t[-1] - self.t[0])
            for name, work in works.items()
            if work is not None
        }

    def summary(self) -> dict[str, JSONValue]:
        """Everything but the samples, in plain numbers, as `diagnosis.json` holds it."""
        final = {} if self.P_d is None else {"P_d": float(self.P_d[-1]), "P_d_ci": float(self.P_d_ci[-1])}
        final |= {name: getattr(self, name) for name in ("P_d_vibration", "P_d_vibration_ci") if final}
        names = ("verdict", "evidence", "period_number", "periods", "return_error", "K")
        numbers = {
            **{name: getattr(self, name) for name in names},
            "largest_exponent": [self.largest_exponent, self.largest_exponent_ci],
            "exponents": [] if self.exponents is None else self._exponent_rows(),
            **({"slider": STUCK_SLIDER} if self.slider_stuck else {}),
            "multipliers": [] if (mu := self.multipliers) is None else _column_rows(mu.real, mu.imag),
            **final,
            "P_d_settled": self.P_d_settled,
            "time": {name: getattr(self, f"time_{name}") for name in ("apart", "stick", "slip")},
            "largest_force": self.largest_force,
            "power": self.powers,
            "energy_residual": self.energy_residual,
            "energy_dropped": self.energy_dropped,
            "status": self.status,
            "method": str(self.method),
            "steps_per_period": self.steps_per_period,
        }
        return json_values({**numbers, **self._row_numbers(), **self.origin})

    def _row_numbers(self) -> dict[str, object]:
        """What a row has beside: its worst blade, the power, amplitude and slip of each, and its waves."""
        if self.P_d_worst is None:
            return {}
        names = "P_d_worst", "P", "P_0", "x_peak", "slip", "loss_friction"
        return {
            **{name: getattr(self, name) for name in names},
            "wave_distance": self.wave.distance.share,
            "wave": self.wave.words,
            "participation_ratio": float(self.participation_ratio),
        }

    def _exponent_rows(self) -> list[list[float | str]]:
        """Each exponent with the half width of its interval."""
        values = _exponent_values(self.exponents, Status.OK)
        return [[value, half] for value, half in zip(values, self.exponents_ci.tolist(), strict=True)]

    @property
    def has_multipliers(self) -> bool:
        """Whether a stable orbit was found, which has multipliers."""
        return "multipliers_real" in self.data

    @typed
    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        over: Result | None = None,
        kind: str | None = None,
        settled_from: float = 0.5,
        **options: "Unpack[AppearanceOptions]",
    ) -> "Figure":
        """The diagnosis as one page, or a picture of the run.

        Args:
            ax: Draw one panel of the run there.
            panel: Draw only this panel, of the page or of the run.
            over: Another run, drawn behind a picture of the run in grey.
            kind: The kind of a picture of the run, which is drawn in place of the page.
            settled_from: The share of the run that a picture of the run leaves out as its transient.
            options: The options of `Result.plot`.
        """
        from jaxshroud.plotting.pictures import picture

        if ax is None and kind is None and over is None:
            return picture("diagnosis", self, None, panel, **options)
        return super().plot(ax, panel=panel, over=over, kind=kind, settled_from=settled_from, **options)

    def __repr__(self) -> str:
        return f"Diagnosis: {self.evidence}"


def _column_rows(*columns: np.ndarray | None) -> list[list[float]]:
    """The numbers of the columns that are not None, row by row."""
    numbers = [np.asarray(column, float).tolist() for column in columns if column is not None]
    return [list(row) for row in zip(*numbers, strict=True)]
