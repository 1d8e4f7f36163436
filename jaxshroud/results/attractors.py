"""The coexisting attractors of a scene, and the basins of attraction in a plane of starts."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, ComplexVariable, Entry, MotionVariable, Variable
from jaxshroud.results.amplitudes import AT_POINTS, EACH, OF_MODES, contact_values
from jaxshroud.results.base import Result
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Layout
from jaxshroud.signals.effects import between, with_interval

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.model.prepared import State
    from jaxshroud.orbits.attractors import Attractor, FoundAttractors
    from jaxshroud.orbits.starts import LaneEnds

ATTRACTOR_KINDS = ("periodic", "family", "aperiodic")
UNDECIDED, STOPPED = -1, -2
LETTERS = [chr(ord("A") + i) for i in range(26)] + [str(i) for i in range(26, 4096)]
PATH_POINTS = 2048  # at most, of a stored path
ATTRACTOR_NUMBERS = (
    *(
        "kind",
        "period_number",
        "starts",
        "P_d",
        "P_d_ci",
        "P_d_vibration",
        "P_d_least",
        "P_d_most",
        "residual",
    ),
)


class InitialMotion(MotionVariable):
    """Displacements and rates at the start, with names that distinguish them from another motion."""

    def entries(self, values: Motion, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each field."""
        for name, (_, array, attributes) in super().entries(values, lanes):
            yield f"initial_{name}", ((*lanes, "blade"), array, attributes)

    def read(self, data: "xr.Dataset") -> Motion:
        """A `Motion` of arrays."""
        return Motion._make(data[f"initial_{name}"].to_numpy() for name in Motion._fields)


class Attractors(Result):
    """The attractors that starts lead to, in the order of their period, then of P_d from the largest; aperiodic last.

    Both `attractors` and `basins` order them so, whatever the shares: where both find the same motions, a letter names
    the same one.

    The `kind` of an attractor is 0 for a periodic orbit, 1 for a family of orbits that differ in the place of a slider
    that never slips (permanent stick keeps the slider wherever it is, so the family counts as one attractor), and 2
    for aperiodic motion.

    In a report, motions of a row are distinguished by their Poincaré points over the kept periods: no orbit is closed,
    nothing is said of their stability except that runs stay on them, and they are in the order of their shares. In a
    ring the copies of a motion that begin at another blade are motions of their own.

    The panels of its picture are "orbits", "shares" and "P_d", of the motions in a report of a row "amplitudes".
    """

    stored_as = "attractors"

    kind = Variable("of the attractor", stored=np.int8, kind=int, more={"flag_meanings": " ".join(ATTRACTOR_KINDS)})
    period_number = Variable("period of the orbit in drive periods; 0: aperiodic")
    starts = Variable("starts that end there")
    share = Variable("of all starts", "1")
    share_low = Variable("lower end of its 95 % interval, Clopper and Pearson", "1")
    share_high = Variable("upper end of its 95 % interval", "1")
    P_d = Variable("vibration-power reduction, of a pair that of the left blade; of several starts the mean", "percent")
    P_d_ci = Variable("half width of its 95 % interval; 0 on an orbit", "percent")
    P_d_vibration = Variable(
        "that of the vibration about the mean position alone; of several starts the mean", "percent"
    )
    P_d_least = Variable("least of any start, where they differ", "percent")
    P_d_most = Variable("largest of any start, where they differ", "percent")
    distance = Variable("from the nearest other attractor, in sizes of the motion; inf where it is alone", "1")
    multipliers = ComplexVariable("Floquet multipliers of a periodic one, largest first", "1", ("multiplier",))
    residual = Variable("closing error of a periodic one", "1")
    motion = MotionVariable("on the attractor at drive phase 0")
    u_s = Variable("slider there", "m", EACH)
    mode = Variable("contact mode there", None, EACH)
    case = Variable("contact case there", None, EACH)
    point_u_s = Variable("slider of each point there", "m", AT_POINTS)
    point_mode = Variable("contact mode of each point there", None, AT_POINTS)
    modal = Variable("coordinates of modes and their rates there", None, OF_MODES)
    path_x = Variable("x of the first blade along it", "m", ("along",))
    path_v_x = Variable("v_x of the first blade along it", "m s-1", ("along",))
    P_d_worst = Variable("least reduction of any blade of a row, of any start", "percent")
    x_peak = Variable("amplitude of x of each blade of a row, from the first of the starts", "m", ("blade",))
    x_free = Variable("amplitude of x of each blade of a row without contact, closed form", "m", ("blade",))
    N_max = Variable("largest normal force of a row over the kept periods, from any start", "N")
    v_max = Variable("largest penetration of a row from any start, at events and ends of steps", "m")
    gap = Attribute()  # of the scene [m]
    label = Variable("the attractor that a start ends on; -1: undecided, -2: its run stopped")
    status = Variable("how each start's run ended", stored=np.int8, kind=np.int32, more=FLAGS)
    initial = InitialMotion("at each start")
    spread = Attribute()  # half range of the random starts, relative to the amplitudes without contact
    seed = Attribute(int)

    @classmethod
    def of_values(
        cls,
        values: Mapping[str, object],
        lanes: Sequence[str],
        attrs: Mapping[str, object],
        layout: Layout,
        coords: Mapping[str, object] | None = None,
    ) -> Self:
        """The result from the values of attractors and from those of starts, whose axes are `lanes`."""
        of_starts = {name: values[name] for name in ("label", "status", "initial") if name in values}
        of_attractors = {name: value for name, value in values.items() if name not in of_starts}
        result = cls.from_values(
            of_starts, lanes=lanes, coords={"blade": range(layout.blades), **(coords or {})}, attrs=attrs
        )
        other = cls.from_values(of_attractors, lanes=("attractor",), layout=layout).data
        merged = result.data.merge(other, combine_attrs="override")
        result.data = merged.assign_attrs({**other.attrs, **result.data.attrs})
        return result

    @property
    def undecided(self) -> float:
        """The share of starts that are assigned to no attractor."""
        return float(np.mean(self.label < 0))

    @property
    def worst(self) -> int | None:
        """The index of the attractor with the smallest P_d; None if there is none."""
        P_d = self.P_d_least
        return int(np.nanargmin(P_d)) if np.isfinite(P_d).any() else None

    @property
    def names(self) -> list[str]:
        """The names of the attractors: a letter each, by which tables and pictures name them, and its motion."""
        motions = zip(LETTERS, self.kind.tolist(), self.period_number.tolist(), strict=False)
        return [
            f"{letter}: {(f'period {q}', f'family of period {q}', 'aperiodic')[kind]}" for letter, kind, q in motions
        ]

    @property
    def worst_text(self) -> str:
        """The attractor with the smallest P_d in words; "none" if there is none."""
        return "none" if self.worst is None else f"{self.names[self.worst]}, P_d {self.P_d_least[self.worst]:.1f} %"

    def summary(self) -> dict[str, JSONValue]:
        """The shares and P_d of the attractors in plain numbers, as `summary.json` holds them."""
        rows = [
            {
                "attractor": name,
                "share": self.share[i],
                "share_95": [self.share_low[i], self.share_high[i]],
                "P_d": self.P_d[i],
                "P_d_ci": self.P_d_ci[i],
                "P_d_vibration": self.P_d_vibration[i],
                "P_d_range": [self.P_d_least[i], self.P_d_most[i]],
                "distance": self.distance[i],
            }
            for i, name in enumerate(self.names)
        ]
        worst = None if self.worst is None else {"attractor": self.names[self.worst], "P_d": self.P_d_least[self.worst]}
        numbers = {
            "starts": self.label.size,
            "undecided or stopped": self.undecided,
            "worst": worst,
            "method": f"{self.method}, {self.steps_per_period} steps a period",
        }
        names = "P_d_worst", "x_peak", "N_max", "v_max"
        of_row = {name: a for name in names if (a := getattr(self, name)) is not None}
        return json_values({**numbers, "attractors": rows, **self.source, **of_row})

    def _drawn(self) -> tuple[str, object]:
        return self.stored_as, self

    def __repr__(self) -> str:
        motions = ", ".join(
            f"{name} {between(share, low, high)} P_d {with_interval(P_d, ci, '%')}"
            for name, share, low, high, P_d, ci in zip(
                self.names, self.share, self.share_low, self.share_high, self.P_d, self.P_d_ci, strict=True
            )
        )
        worst = "" if self.worst is None else f"; worst {self.worst_text}"
        return (
            f"{type(self).__name__} of {self.label.size} starts: {motions}; "
            f"{self.undecided:.3g} undecided or stopped{worst}; {self.method}, {self.steps_per_period} steps a period"
        )


class Basins(Attractors):
    """The attractor on which each start of a plane ends; `share` is the share of the starts in the plane."""

    stored_as = "basins"

    @property
    def plane(self) -> tuple[str, str]:
        """The keys of the two numbers of the start that span the plane."""
        first, second = (str(self.data[dim].attrs["key"]) for dim in self.data["label"].dims)
        return first, second

    @property
    def at_strobe(self) -> np.ndarray:
        """The place of each attractor in the plane at drive phase 0, (attractors, 2), in SI units."""
        places = []
        for key in self.plane:
            name, _, blade = key.removeprefix("initial.").partition("[")
            places.append(getattr(self.motion, name)[:, int(blade.rstrip("]") or 0)])
        return np.stack(places, axis=-1)


def share_interval(count: np.ndarray, total: int) -> tuple[np.ndarray, np.ndarray]:
    """The ends of the Clopper-Pearson 95 % interval of a share from a count; its coverage is 95 % or more."""
    from scipy.special import betaincinv

    count = np.asarray(count, float)
    inner_low = np.maximum(count, 1)
    inner_high = np.minimum(count, total - 1)
    low = np.where(count > 0, betaincinv(inner_low, total - inner_low + 1, 0.025), 0.0)
    high = np.where(count < total, betaincinv(inner_high + 1, total - inner_high, 0.975), 1.0)
    return low, high


def attractor_values(found: "FoundAttractors", paths: Sequence[np.ndarray]) -> dict[str, object]:
    """The values of all attractors, and the attractor on which each start ends."""
    from jaxshroud.batch.lanes import shroud_motion
    from jaxshroud.orbits.attractors import nearest_distances

    ends, starts = found.ended, found.label.size
    size = found.scene.state_size
    rows = [_attractor_row(one, ends, path, size) for one, path in zip(found.attractors, paths, strict=True)]
    template = rows[0] if rows else _empty_row(ends.state, size)
    shapes = {name: np.shape(value) for name, value in template.items()}
    values = {name: np.array([row[name] for row in rows]).reshape(len(rows), *shapes[name]) for name in shapes}
    blades = found.units.size // 6
    motions = [shroud_motion(attractor.state.motion, found.scene) for attractor in found.attractors]
    fields = [np.array([motion[i] for motion in motions]).reshape(-1, blades) for i in range(6)]
    low, high = share_interval(values["starts"], starts)
    return {
        **values,
        "share": values["starts"] / starts,
        "share_low": low,
        "share_high": high,
        "motion": Motion._make(fields),
        "distance": nearest_distances(found.attractors),
        "label": found.label,
        "status": ends.status,
        "gap": float(np.max(found.scene.running_shroud.gap)) if found.attractors else None,
    }


def _attractor_row(attractor: "Attractor", ends: "LaneEnds", path: np.ndarray, size: int) -> dict[str, Any]:
    """The values of one attractor of a scene whose state has so many numbers."""
    lanes, cycle = attractor.lanes, attractor.cycle
    P_d, ci = ends.P_d[lanes], ends.ci[lanes]
    mean, vibration = float(P_d.mean()), float(ends.P_d_vibration[lanes].mean())
    if cycle is not None and attractor.kind == "periodic":
        mean, vibration = cycle.P_d, cycle.P_d_vibration
    is_family = cycle is not None and attractor.kind != "periodic"
    return {
        "kind": ATTRACTOR_KINDS.index(attractor.kind),
        "period_number": attractor.q,
        "starts": len(lanes),
        "P_d": mean,
        "P_d_vibration": vibration,
        "P_d_ci": 0.0 if cycle is not None else float(np.sqrt(np.nanmean(ci**2) / len(lanes))),
        "P_d_least": float(P_d.min()) if is_family else mean,
        "P_d_most": float(P_d.max()) if is_family else mean,
        "multipliers": np.full(size, np.nan + 0j) if cycle is None else cycle.multipliers,
        "residual": np.nan if cycle is None else cycle.residual,
        **contact_values(attractor.state),
        **_path_columns(path),
    }


def _empty_row(states: "State", size: int) -> dict[str, Any]:
    """Values of the shapes that those of an attractor have, by the states of starts (leading axis)."""
    numbers = dict.fromkeys(ATTRACTOR_NUMBERS, 0)
    of_contact = {name: a[0] for name, a in contact_values(states).items()}
    return {**numbers, **of_contact, **_path_columns(np.empty((0, 2))), "multipliers": np.zeros(size, complex)}


def _path_columns(path: np.ndarray) -> dict[str, np.ndarray]:
    """A path (points, 2) thinned out, or filled up with NaN, to `PATH_POINTS`."""
    thinned = path[:: -(-len(path) // PATH_POINTS) or 1]
    columns = np.full((PATH_POINTS, 2), np.nan)
    columns[: len(thinned)] = thinned
    return {"path_x": columns[:, 0], "path_v_x": columns[:, 1]}
