"""Branches of periodic orbits with their special points."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.scene_numbers import key_attrs
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, ComplexVariable, MotionVariable, Variable
from jaxshroud.model.modes import BIFURCATION_KINDS, MULTIPLIER_KINDS, WAVE_RESIDUAL
from jaxshroud.results.amplitudes import OF_MODES, WithAmplitudes, contact_values, stored_state
from jaxshroud.results.base import Result
from jaxshroud.results.orbit import component_names
from jaxshroud.scene.keys import Motion

if TYPE_CHECKING:
    from jaxshroud.model.prepared import State
    from jaxshroud.orbits.branch_continuation import ContinuedBranch
    from jaxshroud.orbits.travelling_wave import TravellingWave

BRANCH_NUMBERS = ("q", "P", "P_d", "P_d_vibration", "multipliers", "residual", "conditioning", "status")
BRANCH_GAP = {"units": "m", "long_name": "initial gap"}
SHORT_OF_POINTS, LOST = "most points", "lost"
END_REASONS = {
    "start": "the range begins there",
    "stop": "the range ends there",
    "closed": "it closes upon itself",
    "flip": "it is born in a flip there",
    "localisation": "it leaves the travelling waves there, whose shift breaks",
    SHORT_OF_POINTS: "it has as many points as `most_points` allows; give more",
    LOST: "no orbit is near on the other side: the map jumps there, or contact changes by grazing",
}
SURE_VALUE = 1e-4  # relative error above which the place of a special point is doubtful


class Special(NamedTuple):
    """A special point of a branch."""

    kind: str  # see `Branch`
    value: float  # of the number along which the branch is followed, in SI units
    q: int  # period number of the orbit
    multiplier: complex  # the one that is nearest to where a multiplier passes the unit circle
    branch: int
    point: int  # its index among all points
    error: float | None = None  # of the value, by a finer march; None if that found no such point or was not made


OF_CONTACT_POINTS = ("interface", "contact_point")  # of quantities of each; points are those of the branch


class Branch(WithAmplitudes, Result):
    """Branches of periodic orbits, point by point in order of arc length, one branch after the other.

    The `kind` of a point is 0 for a regular one, else its index in `BIFURCATION_KINDS`: a fold, a flip, a
    Neimark-Sacker point or a branch point, where a multiplier passes the unit circle; a corner, where a multiplier
    jumps across it; a jump, where the orbit itself jumps between the previous point and this one (stick or a case
    switch appears or disappears under load); a grazing, where contact appears or disappears with zero closing speed;
    in rings a localisation, where the shift of a travelling wave breaks: there a multiplier of the reduced map of the
    wave leaves the unit circle elsewhere than at 1.

    In a row of blades what is known of contact ends with the interface, and P_d is that of all blades together.
    Waves are described of rings alone.

    Panels of its picture, with unstable orbits dashed and special points marked: "samples", x_1 at the strobe (of rows
    "amplitude", that of every blade), "multiplier" and "P_d".
    """

    stored_as = "branch"

    value = Variable("the number followed")
    branch = Variable("which branch; 0: that of the orbit begun with")
    value_error = Variable("how far a finer march places a special point from here; NaN of others")
    kind = Variable("of the point", stored=np.int8, kind=int, more={"flag_meanings": ", ".join(BIFURCATION_KINDS)})
    stable = Variable("all multipliers are within the unit circle", stored=np.int8, kind=bool)
    q = Variable("period number")
    motion = MotionVariable("at drive phase 0")
    u_s = Variable("slider at drive phase 0", "m", ("interface",))
    mode = Variable("contact mode at drive phase 0", None, ("interface",))
    case = Variable("contact case at drive phase 0", None, ("interface",))
    point_u_s = Variable("slider of each point of contact at drive phase 0", "m", OF_CONTACT_POINTS)
    point_mode = Variable("contact mode of each point of contact at drive phase 0", None, OF_CONTACT_POINTS)
    modal = Variable("coordinates of modes and their rates at drive phase 0", None, OF_MODES)
    samples = Variable("x, y [m] and theta [rad] at the end of each period", None, ("turn", "displacement"))
    P = Variable("average power, Eq. (23)", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, or of a row, Eq. (24)", "percent")
    P_d_worst = Variable("that of the blade of a row that gains the least", "percent")
    P_d_vibration = Variable("that of the vibration about the mean position alone", "percent")
    multipliers = ComplexVariable(
        "Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",)
    )
    slider_is_free = Variable("the slider stays wherever it starts", stored=np.int8, kind=bool)
    residual = Variable("closing error relative to the largest value of each quantity", "1")
    conditioning = Variable("how far a push of the map moves the orbit: norm of (I - M)^-1", "1")
    onsets = Variable("beginnings of contact in an orbit")
    slowest_onset = Variable("closing speed at the gentlest onset; inf without contact", "m s-1")
    nearest_miss = Variable("least distance that corners come to without touching; inf where there is none", "m")
    wave_parts = Variable("parts of the period over which a travelling wave repeats; 0: no alike blades", kind=int)
    wave_residual = Variable("distance from a travelling wave, relative to the largest of each quantity", "1")
    wave_multipliers = ComplexVariable(
        "multipliers of the map over a part and the shift back, free sliders left out (NaN)", "1", ("multiplier",)
    )
    status = Variable("how the march ended", stored=np.int8, kind=np.int32, more=FLAGS)
    along = Attribute(str)
    ends_of_branches = Attribute(str, "ends")

    @classmethod
    def of_branches(
        cls,
        branches: "Sequence[ContinuedBranch]",
        along: str,
        limits: tuple[float, float],
        attrs: Mapping[str, object],
    ) -> "Branch":
        """The result from branches that were followed along a number within limits."""
        turns = max(point.cycle.q for branch in branches for point in branch.points)
        layout = branches[0].points[0].cycle.scene.layout
        rows = [_branch_row(b, i, one, turns) for b, one in enumerate(branches) for i in range(len(one.points))]
        values: dict[str, Any] = {
            name: np.stack([np.asarray(row[name]) for row in rows]) for name in rows[0] if name != "motion"
        }
        values["motion"] = Motion._make(np.stack(field) for field in zip(*(row["motion"] for row in rows), strict=True))
        gap = values.pop("gap")
        values |= {"along": along, "ends_of_branches": "; ".join(", ".join(branch.ends) for branch in branches)}
        coords = {"blade": np.arange(layout.blades), "displacement": component_names(layout)[: 3 * layout.blades]}
        attributes = {**attrs, "start": limits[0], "stop": limits[1]}
        more = {"gap": (("point", "interface")[: gap.ndim], gap, BRANCH_GAP)}
        result = cls.from_values(values, lanes=("point",), coords=coords, attrs=attributes, more=more, layout=layout)
        for name in ("value", "value_error"):
            result.data[name].attrs |= {"key": along, "units": key_attrs(along)["units"]}
        return result

    @property
    def ends(self) -> list[tuple[str, str]]:
        """Why each branch ended, at its first point and at its last one; `messages` explains the words."""
        pairs = [reasons.split(", ") for reasons in self.ends_of_branches.split("; ")]
        return [(first, last) for first, last in pairs]

    @property
    def special(self) -> list[Special]:
        """The special points."""
        return list(self._special())

    def _special(self) -> Iterator[Special]:
        errors = np.full(len(self.value), np.nan) if self.value_error is None else self.value_error
        for i in np.flatnonzero(self.kind):
            kind = BIFURCATION_KINDS[self.kind[i]]
            nearest = self._crossing_multiplier(kind, int(i))
            error = float(errors[i]) if np.isfinite(errors[i]) else None
            yield Special(kind, float(self.value[i]), int(self.q[i]), nearest, int(self.branch[i]), int(i), error)

    def _crossing_multiplier(self, kind: str, point: int) -> complex:
        """The multiplier that is nearest to where those of special points of that kind pass the unit circle."""
        multipliers = self.multipliers[point]
        crossing = {"flip": -1.0, "fold": 1.0, "branch point": 1.0}.get(kind)
        is_left_out = self.slider_is_free[point] & (np.abs(multipliers - 1) < 1e-9)
        if kind == "localisation":
            from jaxshroud.orbits.travelling_wave import keeps_shift

            multipliers = self.wave_multipliers[point]
            is_left_out = keeps_shift(multipliers) | np.isnan(multipliers)
        distances = np.abs(np.abs(multipliers) - 1) if crossing is None else np.abs(multipliers - crossing)
        return complex(multipliers[np.argmin(np.where(is_left_out, np.inf, distances))])

    @property
    def is_wave(self) -> np.ndarray:
        """Whether each orbit is a travelling wave, (points,)."""
        if self.wave_residual is None:
            return np.zeros(len(self.value), bool)
        return self.wave_residual <= WAVE_RESIDUAL

    @property
    def doubts(self) -> list[str]:
        """Special points that a finer march places off by more than `SURE_VALUE` of their value, or nowhere near."""
        lines = []
        for one in self.special if self.value_error is not None else ():
            if one.kind in MULTIPLIER_KINDS and (one.error is None or one.error > SURE_VALUE * abs(one.value)):
                distance = "nowhere near" if one.error is None else f"{one.error:.1g} away"
                lines.append(f"{one.kind} at {self.along} = {one.value:.6g}: a finer march places it {distance}")
        return [f"{line}; give more steps, or an accuracy" for line in lines]

    def start(self, point: int) -> "State":
        """The state of a point at drive phase 0, from which a run can start."""
        return stored_state(self, Motion._make(field[point] for field in self.motion), point)

    @property
    def messages(self) -> list[str]:
        """How each branch ended, and what to do."""
        return [line for _, line in self._end_lines()]

    @property
    def unfinished(self) -> list[str]:
        """Where a branch ended although it may go on, and what to do."""
        return [line for end, line in self._end_lines() if end in (SHORT_OF_POINTS, LOST)]

    def _end_lines(self) -> Iterator[tuple[str, str]]:
        for b, ends in enumerate(self.ends):
            points = np.flatnonzero(self.branch == b)
            for i, end in zip((points[0], points[-1]), ends, strict=True):
                place = f"{self.along} = {self.value[i]:.6g}"
                yield end, f"branch {b} (period {self.q[points[0]]}) at {place}: {END_REASONS[end]}"

    def summary(self) -> dict[str, JSONValue]:
        """The number of points of each kind, and the special points, as `summary.json` holds them."""
        special = self.special
        rows = [
            {
                "kind": one.kind,
                "value": one.value,
                "error": one.error,
                "period": one.q,
                "branch": one.branch,
                "multiplier": [one.multiplier.real, one.multiplier.imag],
            }
            for one in special
        ]
        numbers = {
            "points": len(self.value),
            "unstable": int((~self.stable).sum()),
            "branches": len(self.ends),
            **{kind: n for kind in BIFURCATION_KINDS[1:] if (n := sum(one.kind == kind for one in special))},
            "closed to": self.residual.max(),
            "method": f"{self.method}, {self.steps_per_period} steps a period",
        }
        numbers |= {"along": self.along, "special": rows, "ends": self.ends, **self.source}
        return json_values(self._row_numbers() | numbers)

    def _row_numbers(self) -> dict[str, object]:
        """The number of travelling waves of a ring of alike blades, and the range of P_d of a row's worst blade."""
        is_alike = self.wave_parts is not None and self.wave_parts.any()
        waves: dict[str, object] = {"travelling waves": int(self.is_wave.sum())} if is_alike else {}
        if self.P_d_worst is None:
            return waves
        return waves | {"P_d of the worst blade": [float(self.P_d_worst.min()), float(self.P_d_worst.max())]}

    def __repr__(self) -> str:
        n = len(self.ends)
        kinds = [one.kind for one in self.special]
        counts = [(kinds.count(kind), kind) for kind in BIFURCATION_KINDS[1:]]
        special = ", ".join(f"{count} {kind}" for count, kind in counts if count) or "no special point"
        return (
            f"Branch along {self.along}: {n} branch{'es' * (n > 1)}, {len(self.value)} points, "
            f"{int((~self.stable).sum())} of them unstable; {special}; closed to {self.residual.max():.1e}; "
            f"{self.method}, {self.steps_per_period} steps a period"
        )


def _branch_row(number: int, i: int, branch: "ContinuedBranch", turns: int) -> dict[str, Any]:
    """The values of point `i` of a branch, with its samples filled up to `turns`."""
    from jaxshroud.batch.lanes import shroud_motion
    from jaxshroud.model.linear import power_reduction

    point, touch = branch.points[i], branch.touches[i]
    cycle, layout = point.cycle, point.cycle.scene.layout
    displacements = 3 * layout.blades
    samples = np.full((turns, displacements), np.nan)
    samples[: cycle.q] = touch.samples[:, :displacements]
    numbers = {name: getattr(cycle, name) for name in BRANCH_NUMBERS}
    return {
        **numbers,
        **touch.amplitudes,
        "value": point.value,
        "value_error": point.error,
        "branch": number,
        "kind": BIFURCATION_KINDS.index(point.kind or "regular"),
        "stable": bool(np.all(np.abs(point.multipliers) < 1)),
        "motion": shroud_motion(cycle.start.motion, cycle.scene),
        **contact_values(cycle.start),
        "samples": samples,
        "slider_is_free": any(point.free),
        "onsets": touch.onsets,
        "slowest_onset": touch.slowest,
        "nearest_miss": touch.miss,
        **({"P_d_worst": power_reduction(cycle.P, cycle.P_0).min()} if layout.counted > 1 else {}),
        **(_values_of_wave(point.wave, len(cycle.multipliers)) if layout.closed else {}),
        "gap": np.asarray(cycle.scene.running_shroud.gap, float),
    }


def _values_of_wave(wave: "TravellingWave | None", size: int) -> dict[str, Any]:
    """What is known of the travelling wave of a ring's orbit with so many multipliers."""
    multipliers = np.full(size, np.nan + 0j)
    if wave is None:
        return {"wave_parts": 0, "wave_residual": np.nan, "wave_multipliers": multipliers}
    multipliers[: len(wave.others)] = wave.others
    return {"wave_parts": wave.symmetry.parts, "wave_residual": wave.residual, "wave_multipliers": multipliers}
