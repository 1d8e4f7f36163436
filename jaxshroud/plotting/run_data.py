"""A stored run, or the branches of a response, prepared for pictures: in the units of the picture, finite parts."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxshroud.io.variable import with_events
from jaxshroud.model.modes import Mode
from jaxshroud.plotting.page import Scale, scale_of
from jaxshroud.plotting.style import BoolArray, IntegerArray, PlotArray
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.point_numbers import evenly_spaced
from jaxshroud.signals.spectrum import amplitude_spectrum, repeats_after, whole_periods

CONTACT = ("N", "F", "v", "u", "contact_point", "mode", "case", "point_mode", "point_F")
FEWEST_SAMPLES = 20  # samples of a period in which contact can be seen
APERIODIC = 4  # drive periods shown of a motion that does not repeat


@dataclass(frozen=True)
class RunData:
    """A run in the units of the picture."""

    ds: xr.Dataset  # its samples up to the last finite one
    scale: Scale
    t: PlotArray  # [drive periods]
    x: PlotArray  # (n, blades)
    v: PlotArray  # of the left blade [m/s]
    mode: IntegerArray  # (n,), in a row (n, interfaces)
    settled: BoolArray  # samples after the transient
    ends: BoolArray  # those of them that are at the end of a period
    rate: Fraction  # samples per period

    @cached_property
    def repeats(self) -> int:
        """The number of drive periods after which the motion repeats; 0 if it does not."""
        return repeats_after(self.x[self.settled, 0], self.rate)

    @cached_property
    def spectrum(self) -> tuple[PlotArray, PlotArray] | None:
        """The frequencies and amplitudes of x_1 after the transient; None without an oscillation over a whole period.

        Where the motion repeats they are lines, from a multiple of the period number; else a Hann-windowed curve.
        """
        x = self.x[self.settled, 0]
        n_periods = whole_periods(x.size, self.rate)
        if n_periods < 1 or np.ptp(x) == 0:
            return None
        if q := self.repeats:
            x = x[x.size - int(n_periods // q * q * self.rate) :]
        return amplitude_spectrum(x, self.rate, "rectangular" if q or n_periods < 3 else "hann")


def run_data(ds: xr.Dataset, settled_from: float = 0.5, scale: Scale | None = None) -> RunData | None:
    """The finite part of a run; None if that is less than two samples.

    Args:
        ds: A stored run of a single scene. The samples from the first that is not finite are left out.
        settled_from: The share of the run that counts as its transient.
        scale: The scale of displacements; by default relative to the gap, or in mm where that is not positive.
    """
    not_finite = ~np.isfinite(ds["x"].to_numpy() + ds["v_x"].to_numpy()).all(axis=1)
    ds = ds.isel(time=slice(0, int(not_finite.argmax()) if not_finite.any() else None))
    if ds.sizes["time"] < 2:
        return None
    scale = scale or scale_of(mean_gap(ds))
    steps = int(ds.attrs["steps_per_period"])
    t = _in_periods(ds, ds["time"].to_numpy())
    settled = t > t[0] + settled_from * (t[-1] - t[0]) + 1e-9  # without the sample that ends the transient
    ends = settled & (np.rint(t * steps) % steps == 0)
    x = ds["x"].to_numpy() * scale.factor
    v = ds["v_x"].to_numpy()[:, 0]
    return RunData(ds, scale, t, x, v, ds["mode"].to_numpy(), settled, ends, Fraction(steps, int(ds.attrs["every"])))


def mean_gap(ds: xr.Dataset) -> PlotArray:
    """The gap of a single run, that of a row on average [m]."""
    return np.array(float(np.mean(ds["gap"] if "gap" in ds else ds.attrs["gap"])))


def _in_periods(ds: xr.Dataset, time: PlotArray) -> PlotArray:
    """Times in drive periods."""
    return time * float(ds.attrs["omega"]) / (2 * np.pi)


class ContactData(NamedTuple):
    """The contact over the last drive periods of a run, with both sides of events where they are stored."""

    t: PlotArray  # since these periods began [drive periods]
    N: PlotArray  # [N]
    F: PlotArray
    v: PlotArray  # [m]
    u: PlotArray
    contact_point: PlotArray | None
    mode: IntegerArray
    case: IntegerArray
    point_mode: IntegerArray | None = None  # (n, points) of faces that touch at several, and so is the next
    point_F: PlotArray | None = None
    places: PlotArray | None = None  # of these points, up the face from its middle [m]

    @property
    def segments(self) -> list[slice]:
        """The parts of the time in which mode and case stay the same."""
        return _segments((np.diff(self.mode) != 0) | (np.diff(self.case) != 0))

    @property
    def pieces(self) -> list[slice]:
        """The segments, each extended to the first state of the next one unless both sides of their event are known."""
        segments, t = self.segments, self.t
        extended = [s.stop < len(t) and t[s.stop] > t[s.stop - 1] for s in segments]
        return [slice(s.start, s.stop + extra) for s, extra in zip(segments, extended, strict=True)]

    def of_point(self, m: int) -> "ContactData":
        """The contact at one of several points: its mode and its friction force."""
        assert self.point_mode is not None  # of faces that have several
        assert self.point_F is not None
        return self._replace(mode=self.point_mode[:, m], case=np.zeros_like(self.case), F=self.point_F[:, m])


def _segments(changed: BoolArray) -> list[slice]:
    """The parts of samples between those after which something has `changed`."""
    ends = [0, *(np.flatnonzero(changed) + 1).tolist(), len(changed) + 1]
    return [slice(a, b) for a, b in pairwise(ends)]


def scene_number(run: RunData, table: str, name: str) -> float | None:
    """A number of the run's scene; None if the file does not have it."""
    value = tomllib.loads(str(run.ds.attrs.get("scene", ""))).get(table, {}).get(name)
    return float(value) if isinstance(value, int | float) else None


def places_of_points(ds: xr.Dataset) -> PlotArray | None:
    """Where the faces of a stored run touch, up from their middle [m]; None where a corner touches."""
    scene = tomllib.loads(str(ds.attrs.get("scene", "")))
    points = scene.get("contact", {}).get("points")
    if points is None:
        return None
    return evenly_spaced(points) * scene["shroud"]["l_ab"] if isinstance(points, int) else np.array(points, float)


def contact_data(run: RunData, periods: int | None = None) -> ContactData:
    """The contact over the last whole drive periods.

    Args:
        run: The run.
        periods: The number of periods; by default that after which the motion repeats, or four.

    Raises:
        ValueError: The run has no contact, or has too few samples.
    """
    ds = run.ds
    if "N" not in ds.data_vars:
        raise InputError("There are no forces in this run, as of a model without contact.")
    if run.rate < FEWEST_SAMPLES:
        raise InputError(
            f"{float(run.rate):.3g} samples of a period are stored, too few to show contact; keep every "
            f"{max(int(ds.attrs['steps_per_period']) // FEWEST_SAMPLES, 1)}th step at most."
        )
    names = [name for name in CONTACT if name in ds.data_vars]
    states = with_events(ds, names)
    begin, end = _last_periods(run.t, periods or run.repeats or APERIODIC)
    t = _in_periods(ds, states["time"].to_numpy())
    shown = (t > begin - 1e-9) & (t < end + 1e-9)
    values = {name: states[name].to_numpy()[shown] for name in names}
    if (values["mode"] == Mode.SMOOTH).all():  # smooth contact has a single mode, with and without penetration
        values["mode"] = np.where(values["v"] < 0, Mode.APART, Mode.SMOOTH)
    place = values.pop("contact_point", None)
    return ContactData(t[shown] - begin, contact_point=place, places=places_of_points(ds), **values)


def _last_periods(t: PlotArray, periods: int) -> tuple[float, float]:
    """The beginning and the end of the last whole drive periods, or of the run if it is shorter than one."""
    end = np.floor(t[-1] + 1e-9)
    available = int(end - t[0] + 1e-9)
    return (end - min(periods, available), end) if available else (t[0], t[-1])


BRANCH_PREFIX, MEMBER = "branch_", "member"
BRANCH_ENDS = "branch_ends"  # the attribute with the ends of each member's branches
BRANCH_KIND = "branch_kind"  # the attribute with the kind of the branches as results
BETWEEN_MEMBERS = " | "


def joined_points(branches: "Sequence[xr.Dataset | None]") -> "xr.Dataset":
    """The points of the branches of all members that have any, under names of their own."""
    import xarray as xr

    points = [
        data.assign({MEMBER: ("point", np.full(data.sizes["point"], i))})
        for i, data in enumerate(branches)
        if data is not None
    ]
    if not points:
        return xr.Dataset()
    turns = max(data.sizes["turn"] for data in points)
    joined = xr.concat(
        [data.pad(turn=(0, turns - data.sizes["turn"])) for data in points], "point", combine_attrs="drop"
    )
    return joined.rename({str(name): f"{BRANCH_PREFIX}{name}" for name in joined.data_vars})


def points_of_member(data: "xr.Dataset", member: int) -> "xr.Dataset | None":
    """The points of a member's branches as `Branch` holds them; None where it has none."""
    ends = str(data.attrs[BRANCH_ENDS]).split(BETWEEN_MEMBERS)[member]
    if not ends:
        return None
    names = {str(n): str(n).removeprefix(BRANCH_PREFIX) for n in data.data_vars if str(n).startswith(BRANCH_PREFIX)}
    points = data[[*names]].rename(names)
    own = points.isel(point=np.flatnonzero(points[MEMBER].to_numpy() == member)).drop_vars(MEMBER)
    return own.assign_attrs(data.attrs, ends=ends, kind=data.attrs.get(BRANCH_KIND, "branch"))
