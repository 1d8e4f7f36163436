"""The samples and the statistics of a sweep, in one direction or in several, with jumps and coexisting motions."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.scene_numbers import dimension, key_attrs
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, CountsVariable, MotionVariable, Variable
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import (
    ENERGY_DROPPED,
    WithAmplitudes,
    WithLoads,
    amplitude_numbers,
    largest_of_lanes,
    load_numbers,
)
from jaxshroud.results.base import Result
from jaxshroud.results.extremes import (
    lane_place,
    largest_amplitude,
    passed_sides,
    place_numbers,
    place_words,
    smallest_reduction,
)
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction, Layout
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.signals.effects import flat_text, mean_shift_text, too_few_periods_text
from jaxshroud.signals.orbit_distance import NEIGHBOURING_STEPS, SweptMotion, motions_differ, steep_steps
from jaxshroud.signals.period import UNKNOWN_IF_SETTLED

if TYPE_CHECKING:
    import xarray as xr

DIRECTION = "direction"  # dimension of sweeps in several directions
GAP_ATTRS = {"units": "m", "long_name": "initial gap"}
SETTLING_FLAGS = {"flag_values": [0, 1, 2], "flag_meanings": "no yes unknown"}
MORE_PERIODS = "drive periods of transient to add until {}; NaN if unknown"
VALUES_AT_ONCE = 4096  # of the axis, whose samples are in memory together
LONGER = 4  # times the periods that are kept are advised for an interval of P_d: its width is half of that
UNSETTLED = 0  # verdict of `settling`: the transient is not over


class SweepResult(WithAmplitudes, WithLoads, Result):
    """The stroboscopic samples and the statistics of a sweep.

    Arrays start with the axes of the scenes, followed by one dimension per axis of the sweep. Samples have a dimension
    `period` after these, and the blade comes last where each blade has a value of its own. Powers, amplitudes, loads
    and shares of the time are over the latest whole orbits of the kept periods, or over all of these where the motion
    is aperiodic.

    Panels of its picture: "samples" and "P_d" over one axis; "P_d" and "motions" over two; "lyapunov" over either,
    where exponents were computed.
    """

    stored_as = "sweep"
    required = ("status", "P_d", "period_number")

    motion = MotionVariable(
        "at the drive phase `phase` of each kept period; NaN after a lane has stopped", dims=("period",)
    )
    P = Variable("average power, Eq. (23)", "m4", ("blade",))
    P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, Eq. (24), or of all blades of a row", "percent")
    P_d_worst = Variable("reduction of the blade of a row that gains the least; in rows only", "percent")
    P_d_ci = Variable("half width of the 95 % interval of P_d, batch means", "percent")
    P_d_vibration = Variable("reduction of the vibration about the mean position alone", "percent")
    P_d_vibration_ci = Variable("half width of the 95 % interval of P_d_vibration, batch means", "percent")
    P_d_ci_short = Variable("too few correlation times for P_d_ci", stored=np.int8, kind=bool)
    P_d_settled = Variable("P_d no longer drifts, on evidence", stored=np.int8, kind=bool)
    P_d_settling = Variable("P_d no longer drifts", more=SETTLING_FLAGS)
    P_d_periods_more = Variable(MORE_PERIODS.format("P_d no longer drifts"), "1")
    period_number = Variable("period of the orbit in drive periods; 0: aperiodic")
    settled = Variable("the transient is over, on evidence", stored=np.int8, kind=bool)
    settling = Variable("the transient is over", more=SETTLING_FLAGS)
    periods_more = Variable(MORE_PERIODS.format("it is over"), "1")
    periods_to_keep = Variable("periods to keep until an aperiodic motion can be judged; 0: enough, NaN: unknown", "1")
    status = Variable("", stored=np.int8, kind=np.int32, more=FLAGS)
    v_max = Variable("largest penetration", "m")
    time_apart = Variable("fraction of the time of whole orbits: apart", "1")
    time_stick = Variable("fraction of the time of whole orbits: stick", "1")
    time_slip = Variable("fraction of the time of whole orbits: slip", "1")
    lyapunov = Variable("largest Lyapunov exponent per drive period; -inf: forgotten altogether", "1")
    lyapunov_ci = Variable("half width of its 95 % interval", "1")
    interface_v_max = Variable("largest penetration at each interface; in rows only", "m", ("interface",))
    energy_residual = Variable("largest energy residual of a period over the drive's mean work", "1")
    energy_dropped = Variable(ENERGY_DROPPED, "1")
    counters = CountsVariable("events in the kept periods")
    phase = Attribute(name="drive_phase")  # of the samples [rad]
    period_tol = Attribute()  # of the period number
    jump = Variable(
        "the motion jumps between this value and the one before it in the direction", stored=np.int8, kind=bool
    )  # this and the next two: only in sweeps in several directions; `jump` once the steep steps were halved
    steep = Variable("", stored=np.int8, kind=bool)
    coexisting = Variable("", stored=np.int8, kind=bool)
    inaccurate = Variable("estimated to miss the requested accuracy", stored=np.int8, kind=bool)
    unconfirmed = Variable("settled elsewhere than a finer march", stored=np.int8, kind=bool)

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """Key -> values (n,) in SI units, for each axis of the sweep."""
        axes = [self.data[dim] for dim in self.dims if "key" in self.data[dim].attrs]
        return {str(axis.attrs["key"]): axis.to_numpy() for axis in axes}

    @property
    def dims(self) -> tuple[str, ...]:
        """The names of the leading dimensions."""
        return tuple(map(str, self.data["status"].dims))

    @property
    def period(self) -> np.ndarray:
        """The number of each kept period, counted from t = 0, (period,)."""
        return self.data["period"].to_numpy()

    @property
    def gap(self) -> np.ndarray:
        """The initial gap of each lane, in a row at each interface where they differ (..., interface) [m]."""
        return self.data["gap"].broadcast_like(self.data["status"]).transpose(*self.dims, ...).to_numpy()

    @property
    def penetrations(self) -> np.ndarray:
        """The largest penetration of each lane, in a row at each interface (..., interface) [m]."""
        return self.v_max if self.interface_v_max is None else self.interface_v_max

    @property
    def complete(self) -> bool:
        """Whether all lanes were run; False only in the result of an interrupted sweep."""
        return not np.any(self.status == Status.NOT_RUN)

    @property
    def jumps(self) -> dict[str, list[float]]:
        """Direction -> the values before which the motion jumps, in SI units; empty if there is no such direction."""
        return self._marked_values(self.jump)

    @property
    def steep_places(self) -> dict[str, list[float]]:
        """Direction -> the values before which the motion may jump; empty where `jumps` has the answer."""
        return {} if self.jump is not None else self._marked_values(self.steep)

    def _marked_values(self, marks: np.ndarray | None) -> dict[str, list[float]]:
        """Direction -> the values at which there are marks (direction, values)."""
        if marks is None:
            return {}
        ((_, values),) = self.axes.items()
        rows = zip(self.data[DIRECTION].to_numpy().tolist(), marks, strict=True)
        return {direction: values[row].tolist() for direction, row in rows if row.any()}

    @property
    def flat(self) -> str:
        """What to say where P_d moves less than its intervals over the range requested; else empty."""
        return flat_text(np.where(self.status == Status.OK, self.P_d, np.nan), self.P_d_ci)

    @property
    def unjudged(self) -> np.ndarray:
        """Which lanes keep too few periods to judge whether their motion, which is aperiodic, has settled."""
        aperiodic = (self.status == Status.OK) & (self.period_number == 0)
        return aperiodic & (self.settling == UNKNOWN_IF_SETTLED) & (self.periods_to_keep > 0)

    @property
    def too_few_periods(self) -> str:
        """What to say where too few periods are kept to judge whether aperiodic motions have settled; else empty."""
        unjudged = self.unjudged
        of_runs = f"of {np.sum(self.status == Status.OK)} runs"
        return too_few_periods_text(int(unjudged.sum()), of_runs, np.max(self.periods_to_keep[unjudged], initial=0.0))

    @property
    def mean_shift(self) -> str:
        """One sentence where contact shifts the mean position, which P_d counts as vibration; else empty."""
        P_d = np.where(self.status == Status.OK, self.P_d, np.nan)

        def place(at):
            return place_words(lane_place(self, np.unravel_index(at, P_d.shape))).lstrip()

        return mean_shift_text(P_d, self.P_d_vibration, place=place)

    def summary(self) -> dict[str, JSONValue]:
        """The sweep in a few numbers, as `summary.json` holds them."""
        ok = self.status == Status.OK
        residual = self.energy_residual
        dropped = self.energy_dropped
        P_d = np.where(ok, self.P_d, np.nan)
        positive = None if self.lyapunov is None else int((self.lyapunov - self.lyapunov_ci > 0).sum())
        best = None
        if np.isfinite(P_d).any():
            lane = np.unravel_index(np.nanargmax(P_d), P_d.shape)
            best = {"P_d": float(P_d[lane]), "ci": float(self.P_d_ci[lane]), **place_numbers(lane_place(self, lane))}
        return json_values(
            {
                **_direction_numbers(self),
                "runs": int(ok.size),
                "periods kept": len(self.period),
                "status": {s.name: int((self.status == s).sum()) for s in Status if (self.status == s).any()},
                "motions": _motion_numbers(self.period_number[ok]),
                **_settling_numbers(self, ok),
                **({"too few periods": self.too_few_periods} if self.too_few_periods else {}),
                "largest P_d": best,
                **({"flat": self.flat} if self.flat else {}),
                **({"mean position": self.mean_shift} if self.mean_shift else {}),
                **({} if positive is None else {"positive exponents": positive}),
                **largest_of_lanes(ok, {"largest energy residual": residual, "largest energy dropped": dropped}),
                **load_numbers(self, ok),
                **amplitude_numbers(self, ok, self.period_number == 0, len(self.period)),
                **self._extremes(),
                "method": f"{self.method}, {self.steps_per_period} steps a period",
                **self.source,
            }
        )

    def _extremes(self) -> dict[str, object]:
        """Of a sweep with amplitudes the largest ones with their places, and the smallest P_d."""
        kept = [f"{name}_peak" for name in DISPLACEMENTS if getattr(self, f"{name}_peak") is not None]
        largest = [one for of in kept if (one := largest_amplitude(self, of)) is not None]
        least = smallest_reduction(self, "P_d") if kept else None
        numbers: dict[str, object] = {one.name: one.numbers() for one in largest}
        return numbers | ({} if least is None else {"smallest P_d": least})

    @property
    def messages(self) -> list[str]:
        """What to do about lanes that are not OK, and which amplitudes are beyond the model."""
        return [*super().messages, *passed_sides(self)]

    def __repr__(self) -> str:
        lanes = [f"{dim} ({self.data.sizes[dim]})" for dim in self.dims if "key" not in self.data[dim].attrs]
        along = " x ".join([*lanes, *(f"{key} ({len(v)}: {v[0]:g} to {v[-1]:g})" for key, v in self.axes.items())])
        best = np.nanmax(self.P_d, initial=-np.inf, where=self.status == Status.OK)
        place = f"along {along}" if along else "of one lane"
        periods = f"{len(self.period)} period" + "s" * (len(self.period) != 1)
        return (
            f"SweepResult {place}: {periods} kept of each lane; {self.ended}; "
            f"largest P_d {best:.4g} %; {self.method}, {self.steps_per_period} steps a period"
        )


def _direction_numbers(result: SweepResult) -> dict[str, object]:
    """Where the motion jumps and where motions coexist, of a sweep in several directions."""
    if result.coexisting is None:
        return {}
    jumps = {f"jumps {direction}": values for direction, values in result.jumps.items()}
    steep = {f"steep {direction}": values for direction, values in result.steep_places.items()}
    return {"values with coexisting motions": int(result.coexisting.sum()), **jumps, **steep}


def _motion_numbers(period_numbers: np.ndarray) -> dict[str, int | str]:
    """How many runs have settled on each period, aperiodic ones last."""
    numbers, counts = np.unique(np.where(period_numbers == 0, np.inf, period_numbers), return_counts=True)
    names = [f"period {n:g}" if np.isfinite(n) else "aperiodic" for n in numbers]
    runs = dict(zip(names, counts.tolist(), strict=True))
    return {**runs, "words": ", ".join(f"{name}: {n}" for name, n in runs.items()).replace(",", " runs,", 1)}


def _settling_numbers(result: SweepResult, ok: np.ndarray) -> dict[str, dict[str, float | str]]:
    """The numbers of runs that are not settled, and of those that are too short for an interval of P_d."""
    of_runs = f"of {ok.sum()} runs"
    unsettled = int((~result.settled & ok).sum())
    unknown = int(((result.settling == UNKNOWN_IF_SETTLED) & ok).sum())
    more = math.ceil(np.max(result.periods_more, where=ok & np.isfinite(result.periods_more), initial=0.0))
    transient = int(result.period[0]) - 1 + more
    unsettled_text = f"{unsettled} {of_runs}" + (f" ({unknown} cannot be told)" if unknown else "")
    drifting = int((~result.P_d_settled & ok).sum())
    short = int((result.P_d_ci_short & ok).sum())
    keep = f": --periods {LONGER * len(result.period)}" if short else ""
    return {
        "transient not over": {
            "runs": unsettled,
            "cannot be told": unknown,
            "periods more": more,
            "words": unsettled_text + (f"; {more} periods more would do: --transient {transient}" if more else ""),
        },
        "P_d still drifts": {"runs": drifting, "words": f"in {drifting} {of_runs}"},
        "too few periods for the interval of P_d": {"runs": short, "words": f"in {short} {of_runs}{keep}"},
    }


def sweep_coordinates(axes: Mapping[str, np.ndarray], period: np.ndarray, layout: Layout) -> dict[str, object]:
    """The coordinates of a sweep as xarray takes them.

    Args:
        axes: Key -> values of each axis.
        period: The number of each kept period, counted from t = 0.
        layout: The layout of the scenes.
    """
    dims = {key: dimension(key, layout.names) for key in axes}
    swept = {dims[key]: (dims[key], values, key_attrs(key, layout.names)) for key, values in axes.items()}
    return {
        **swept,
        "period": ("period", period, {"long_name": "drive periods since t = 0"}),
        **layout.coords,
    }


def overlay_directions(results: Mapping[str, SweepResult]) -> SweepResult:
    """The results of sweeps along the same values as one result, with a leading dimension `direction`.

    Directions without a result are filled with lanes that have not run.
    """
    import xarray as xr

    first = next(iter(results.values())).data
    names = _variables_by_direction(first)
    directions = xr.DataArray(list(SINGLE_DIRECTIONS), dims=DIRECTION, name=DIRECTION)
    parts = [results[way].data[names] if way in results else _not_run_data(first[names]) for way in SINGLE_DIRECTIONS]
    data = first.drop_vars(names).merge(xr.concat(parts, dim=directions, combine_attrs="override"))
    complete = len(results) == len(SINGLE_DIRECTIONS) and all(result.complete for result in results.values())
    data.attrs = {**first.attrs, "complete": int(complete)}
    chatter = next((result.chatter for result in results.values() if result.chatter), None)
    if chatter is not None:
        data.attrs["chatter"] = chatter
    return SweepResult(data.assign(compare_directions(data)) if complete else data)


def _not_run_data(like: "xr.Dataset") -> "xr.Dataset":
    """A dataset with the same lanes, none of which has run."""
    import xarray as xr

    fill = {str(name): np.nan if a.dtype.kind == "f" else 0 for name, a in like.data_vars.items()}
    return like.map(lambda a: xr.full_like(a, {**fill, "status": Status.NOT_RUN}[str(a.name)]))


def in_direction(data: "xr.Dataset", direction: Direction) -> "xr.Dataset":
    """The result of one direction, with the dimension `direction` of a sweep in several directions."""
    names = _variables_by_direction(data)
    return data.assign({name: data[name].expand_dims({DIRECTION: [direction]}) for name in names})


def _variables_by_direction(data: "xr.Dataset") -> list[str]:
    """The names of the variables of which each direction has values of its own."""
    lanes = set(data["status"].dims)
    common = {"gap", *(str(n) for n, a in data.data_vars.items() if "key" in a.attrs)}
    return [str(n) for n, a in data.data_vars.items() if lanes <= set(a.dims) and n not in common]


def compare_directions(data: "xr.Dataset") -> "dict[str, xr.Variable]":
    """Where motions are steep and where they coexist, from sweeps along one number in all directions; else empty."""
    import xarray as xr

    dims = data["status"].dims
    if DIRECTION not in dims or len(dims) > 2 or not set(Motion._fields) <= set(data):
        return {}
    (dim,) = set(dims) - {DIRECTION}
    n = data.sizes[dim]
    windows = [(first, min(first + VALUES_AT_ONCE, n)) for first in range(0, n, VALUES_AT_ONCE)]
    parts = [data.isel({dim: slice(*ends)}) for ends in windows]
    sizes = [max(_size(part[name]) for part in parts) or 1.0 for name in Motion._fields]
    steep, coexist = np.zeros((len(SINGLE_DIRECTIONS), n), np.int8), np.zeros(n, np.int8)
    for first, last in windows:
        # The neighbours on both sides show how large a usual step is.
        before, after = min(first, NEIGHBOURING_STEPS), min(n - last, NEIGHBOURING_STEPS + 1)
        window = data.isel({dim: slice(first - before, last + after)})
        rows = [lane_motions(window.sel({DIRECTION: way}), sizes) for way in SINGLE_DIRECTIONS]
        columns = list(zip(*rows, strict=True))[before : before + last - first]
        coexist[first:last] = [any(motions_differ(a, b) for a, b in combinations(column, 2)) for column in columns]
        for row, way in enumerate(SINGLE_DIRECTIONS):
            if way != "independent":
                large = steep_steps(rows[row])[before : before + last - first]  # between each value and the next
                begin = first + (way == "forward")
                steep[row, begin : begin + len(large)] = large
    steep_attrs = {"long_name": "a large step between this value and the one before it in the direction: it may jump"}
    coexisting_attrs = {"long_name": "motions from different directions differ: they coexist"}
    return {
        "steep": xr.Variable((DIRECTION, dim), steep, steep_attrs),
        "coexisting": xr.Variable((dim,), coexist, coexisting_attrs),
    }


def _size(part: "xr.DataArray") -> float:
    """The largest magnitude."""
    return float(np.nanmax(np.abs(part.to_numpy()), initial=0.0))


def swept_motions(data: "xr.Dataset") -> list[SweptMotion]:
    """The motions of the lanes of a sweep with one leading axis, each quantity relative to its largest value."""
    return lane_motions(data, motion_sizes(data))


def motion_sizes(data: "xr.Dataset") -> list[float]:
    """The largest magnitude of each quantity of the motion."""
    return [_size(data[name]) or 1.0 for name in Motion._fields]


def lane_motions(data: "xr.Dataset", sizes: Sequence[float]) -> list[SweptMotion]:
    """The motions of one direction, each quantity relative to its largest value in all directions."""
    order = data.transpose(*data["status"].dims, "period", "blade", ...)
    scaled = [order[name].to_numpy() / size for name, size in zip(Motion._fields, sizes, strict=True)]
    points = np.concatenate(scaled, axis=-1)
    numbers = data["period_number"].to_numpy()
    settling = data["settling"].to_numpy()
    return [SweptMotion(p, int(q), bool(v != UNSETTLED)) for p, q, v in zip(points, numbers, settling, strict=True)]
