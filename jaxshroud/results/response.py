"""The response of a scene over one of its numbers: sweeps both ways, branches of orbits, and peaks."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.scene_numbers import dimension, key_attrs, layout_in
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.plotting.run_data import (
    BETWEEN_MEMBERS,
    BRANCH_ENDS,
    BRANCH_KIND,
    BRANCH_PREFIX,
    MEMBER,
    joined_points,
    points_of_member,
)
from jaxshroud.results.base import Result, result_from_dataset
from jaxshroud.results.branch import Branch
from jaxshroud.results.extremes import (
    ExtremeAmplitude,
    largest_amplitude,
    largest_blades,
    passed_sides,
    smallest_reduction,
)
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.quantities import unit_of
from jaxshroud.signals.period import SETTLED

if TYPE_CHECKING:
    from jaxshroud.orbits.peaks import Peak


class Member(NamedTuple):
    """The response at one value of the second number, or the whole response where there is none."""

    sweep: SweepResult
    branch: Branch | None  # None where no periodic orbit was found
    peaks: "Sequence[Peak]"
    free: tuple[float, float]  # of the peak without contact: value of the first number, amplitude
    reason: str  # why there is no branch; empty if there is one


class Response(Result):
    """An amplitude over one number of a scene: sweeps in both directions and from rest, branches, and peaks.

    Arrays of sweeps start with `member`, one for each value of the second number (one where there is none), followed by
    `direction` and the first number. The peaks of all members have the dimension `peak`. The amplitude of a row is that
    of the blade that swings most.

    Panels of its picture: "amplitude" and "P_d", of preloaded blades that of the vibration alone; sweeps are points,
    branches lines, the free response dotted, and broken waves of rings in another colour from a mark on.
    """

    stored_as = "response"

    status = Variable("", stored=np.int8, kind=np.int32, more=FLAGS)
    peak_member = Variable("the member that a peak belongs to")
    peak_value = Variable("where the peak is: value of the first number")
    peak_amplitude = Variable("amplitude at the peak")
    peak_q = Variable("period number at the peak")
    peak_stable = Variable("the orbit at the peak is stable", stored=np.int8, kind=bool)
    peak_low = Variable("where the amplitude is 1/sqrt(2) of the peak, below it; NaN if there is no such place")
    peak_high = Variable("where the amplitude is 1/sqrt(2) of the peak, above it; NaN if there is no such place")
    peak_zeta = Variable("damping ratio that the width means, half the width over the value; NaN without a width", "1")
    peak_blades = Variable("amplitude of each blade at the peak, where several blades count", dims=("blade",))
    free_value = Variable("where the peak without contact is: value of the first number", dims=(MEMBER,))
    free_amplitude = Variable("amplitude of the peak without contact", dims=(MEMBER,))
    along = Attribute(str)
    over = Attribute(str)
    of = Attribute(str)
    reduction = Attribute(str)  # that the picture shows: P_d, or P_d_vibration where loads are held at rest

    @classmethod
    def of_members(
        cls,
        members: Sequence[Member],
        along: str,
        of: str,
        over: Mapping[str, np.ndarray],
        reduction: str,
        attrs: Mapping[str, object],
    ) -> "Response":
        """The result from its members.

        Args:
            members: One for each value of the second number.
            along: The first number.
            of: The amplitude whose peaks were found.
            over: The second number with its values; empty if there is none.
            reduction: The reduction of power that counts.
            attrs: The attributes of the dataset.
        """
        import xarray as xr

        sweeps = xr.concat([m.sweep.data for m in members], MEMBER, combine_attrs="drop", data_vars="all")
        rows = [(i, peak) for i, member in enumerate(members) for peak in member.peaks]
        layout = layout_in(members[0].sweep.data)
        data = sweeps.assign(_peak_variables(rows, along, of))
        if layout.counted > 1:
            data = data.assign(peak_blades=_amplitudes_of_blades(rows, of, layout.blades))
        data = data.assign(
            free_value=(MEMBER, [m.free[0] for m in members]), free_amplitude=(MEMBER, [m.free[1] for m in members])
        )
        data = data.merge(joined_points([None if m.branch is None else m.branch.data for m in members]))
        for key, values in over.items():
            data = data.assign_coords({dimension(key, layout.names): (MEMBER, values, key_attrs(key, layout.names))})
        words = {
            "along": along,
            "over": next(iter(over), ""),
            "of": of,
            "reduction": reduction,
            "peak_reasons": "; ".join(peak.reason for _, peak in rows),
            "branch_reasons": "; ".join(m.reason for m in members),
            BRANCH_ENDS: BETWEEN_MEMBERS.join(m.branch.ends_of_branches if m.branch else "" for m in members),
            BRANCH_KIND: next((m.branch.stored_as for m in members if m.branch), Branch.stored_as),
        }
        marched = {n: members[0].sweep.data.attrs[n] for n in MARCH_ATTRS if n in members[0].sweep.data.attrs}
        data.attrs = {**attrs, **marched, **words, "kind": cls.stored_as}
        return cls(data)

    @property
    def values(self) -> np.ndarray:
        """The values of the first number in the sweeps, in SI units."""
        return self.data[self._dim].to_numpy()

    @property
    def _dim(self) -> str:
        return dimension(self.along, layout_in(self.data).names)

    def sweep(self, member: int = 0) -> SweepResult:
        """The sweep of a member."""
        data = self.data.isel({MEMBER: member})
        own = [name for name in data.data_vars if not str(name).startswith((BRANCH_PREFIX, "peak_", "free_"))]
        attrs = {"axes": self._dim, "complete": 1, "kind": SweepResult.stored_as}
        return SweepResult(data[own].drop_vars([BRANCH_PREFIX + "point"], errors="ignore").assign_attrs(attrs))

    def branch(self, member: int = 0) -> Any:  # a `Branch`, or None
        """The branches of a member, a `Branch`; None where no periodic orbit was found to begin with."""
        points = points_of_member(self.data, member)
        return None if points is None else result_from_dataset(points, "response")

    @property
    def peaks(self) -> list[dict[str, Any]]:
        """Each peak as a dictionary: member, value, amplitude, q, stable, low, high, zeta, shift, ratio and reason.

        `shift` is the relative distance of its value from that of the peak without contact, `ratio` the amplitude over
        that of the peak without contact; NaN where that is 0. Of rows `blades` are those that swing most, to 1e-6.
        """
        names: tuple[str, ...] = ("member", "value", "amplitude", "q", "stable", "low", "high", "zeta")
        columns = [getattr(self, f"peak_{name}") for name in names]
        reasons = str(self.data.attrs["peak_reasons"]).split("; ")
        rows: list[dict[str, Any]] = [
            dict(zip(names, row, strict=True)) for row in zip(*(a.tolist() for a in columns), strict=True)
        ]
        for row, reason in zip(rows, reasons, strict=False):
            row["shift"] = row["value"] / float(self.free_value[row["member"]]) - 1
            free = float(self.free_amplitude[row["member"]])
            row["ratio"] = row["amplitude"] / free if free else np.nan
            row["reason"] = reason
        for row, levels in zip(rows, () if self.peak_blades is None else self.peak_blades, strict=False):
            row["blades"] = largest_blades(levels)
        return rows

    @property
    def jumps(self) -> list[dict[str, list[float]]]:
        """For each member, direction -> the values before which the motion of the sweep jumps, in SI units."""
        return [self.sweep(member).jumps for member in range(self.data.sizes[MEMBER])]

    @property
    def messages(self) -> list[str]:
        """What is missing, and why."""
        reasons = str(self.data.attrs["branch_reasons"]).split("; ")
        members = range(self.data.sizes[MEMBER])
        branches = [branch for i in members if (branch := self.branch(i)) is not None]
        return [
            *super().messages,
            *(text for i in members if (text := self.sweep(i).too_few_periods)),
            *(f"no branch: {reason}" for reason in reasons if reason),
            *(line for branch in branches for line in branch.unfinished),
            *dict.fromkeys(line for member in members for line in passed_sides(self.sweep(member))),
        ]

    def largest(self, member: int = 0) -> ExtremeAmplitude | None:
        """The largest amplitude of a member's sweeps and stable peaks, beside the peak without contact.

        It is None where no lane has come to its end.
        """
        layout = layout_in(self.data)
        found = largest_amplitude(self.sweep(member), self.of, layout.counting)
        if found is None:
            return None
        found = found._replace(
            free=float(self.free_amplitude[member]), free_place={self.along: float(self.free_value[member])}
        )
        stable = [peak for peak in self.peaks if peak["member"] == member and peak["stable"]]
        top = max(stable, key=lambda peak: peak["amplitude"], default=None)
        if top is None or top["amplitude"] <= found.value:
            return found
        blades = tuple(layout.names[i] for i in top.get("blades", [0]))
        settled = {"value": top["amplitude"], "place": {self.along: top["value"]}, "blades": blades}
        return found._replace(**settled, settling=SETTLED, direction="")

    @property
    def extremes(self) -> list[dict[str, Any]]:
        """Of each member the largest amplitude and the smallest reduction of power, as `summary.json` holds them."""
        members = range(self.data.sizes[MEMBER])
        name = self.reduction or "P_d"
        found = [(self.largest(i), smallest_reduction(self.sweep(i), name)) for i in members]
        return [
            ({} if largest is None else {largest.name: largest.numbers()})
            | ({} if least is None else {f"smallest {name}": least})
            for largest, least in found
        ]

    def summary(self) -> dict[str, JSONValue]:
        """The peaks with and without contact, the jumps and the statuses, as `summary.json` holds them."""
        free = [
            {"value": float(v), "amplitude": float(a)}
            for v, a in zip(self.free_value, self.free_amplitude, strict=True)
        ]
        numbers = {"along": self.along, "over": self.over, "of": self.of, "peaks": self.peaks, "without contact": free}
        others = {"largest and smallest": self.extremes, "jumps": self.jumps, "status": self.ended}
        return json_values({**numbers, **others, **self.source})

    def __repr__(self) -> str:
        tallest = max(self.peaks, key=lambda row: row["amplitude"], default=None)
        top = "no peak" if tallest is None else f"largest {tallest['amplitude']:.4g} at {tallest['value']:.6g}"
        members = self.data.sizes[MEMBER]
        return f"Response of {self.of} along {self.along}: {members} member{'s' * (members > 1)}, {top}; {self.ended}"


MARCH_ATTRS = (
    "method",
    "march",
    "steps_per_period",
    "accuracy",
    "drive_phase",
    "period_tol",
    "title",
    "scene",
    "source",
)


def _amplitudes_of_blades(rows: Sequence[tuple[int, "Peak"]], of: str, blades: int) -> tuple[Any, ...]:
    """The amplitude of each blade at each peak, as xarray takes a variable."""
    attrs = Response.variables["peak_blades"].attributes | {"units": unit_of(of)}
    return ("peak", "blade"), np.reshape([peak.of_blades for _, peak in rows], (len(rows), blades)), attrs


def _peak_variables(rows: Sequence[tuple[int, "Peak"]], along: str, of: str) -> dict[str, Any]:
    """The variables of all peaks."""

    def field(name):
        return np.array([getattr(peak, name) for _, peak in rows])

    place = {"key": along, "units": key_attrs(along)["units"]}
    unit = {"units": unit_of(of)}
    low, high, value = (field(name).astype(float) for name in ("low", "high", "value"))
    columns = {
        "member": (np.array([i for i, _ in rows], int), {}),
        "value": (value, place),
        "amplitude": (field("amplitude").astype(float), unit),
        "q": (field("q").astype(int), {}),
        "stable": (field("stable").astype(np.int8), {}),
        "low": (low, place),
        "high": (high, place),
        "zeta": ((high - low) / (2 * value), {"units": "1"}),
    }
    return {
        f"peak_{name}": ("peak", a, Response.variables[f"peak_{name}"].attributes | attrs)
        for name, (a, attrs) in columns.items()
    }
