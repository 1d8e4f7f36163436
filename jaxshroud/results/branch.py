"""What following periodic orbits gives."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.dimension import about
from jaxshroud.results.gathered import Complex
from jaxshroud.results.kinds import KINDS
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Attribute, Moving, Variable
from jaxshroud.scene.motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.state import State
    from jaxshroud.motion.branches import Followed
    from jaxshroud.results.sweep import SweepResult

GAP = {"units": "m", "long_name": "initial gap"}
ENDS = {
    "start": "the range begins there",
    "stop": "the range ends there",
    "closed": "it closes upon itself",
    "flip": "it is born in a flip there",
    "most points": "it has as many points as were asked for; give more `most_points`",
    "lost": "no orbit is near on the other side: the map jumps there, or contact changes by grazing",
}


class Special(NamedTuple):
    """A special point of a branch."""

    kind: str  # see `Branch`
    value: float  # of the number followed, SI
    q: int  # period number of the orbit
    multiplier: complex  # that is nearest to where it passes the unit circle
    branch: int
    point: int  # its place among all points


class Branch(Result):
    """Branches of periodic orbits, point by point in order of arc length, one branch after the other.

    `kind` of a point is 0 on regular ones, else the place in `KINDS`: a fold, a flip, a Neimark-Sacker point or a
    branch point, where a multiplier passes the unit circle; a corner, where it jumps across; a jump, where the orbit
    itself jumps between the point before and this one (stick or a case switch comes or goes under load); a grazing,
    where contact comes or goes with zero closing speed.
    """

    stored_as = "branch"

    value = Variable("the number followed")
    branch = Variable("which branch; 0: that of the orbit begun with")
    kind = Variable("of the point", stored=np.int8, kind=int, more={"flag_meanings": ", ".join(KINDS)})
    stable = Variable("all multipliers are within the unit circle", stored=np.int8, kind=bool)
    q = Variable("period number")
    motion = Moving("at drive phase 0")
    u_s = Variable("slider at drive phase 0", "m")
    mode = Variable("contact mode at drive phase 0")
    case = Variable("contact case at drive phase 0")
    samples = Variable("x, y [m] and theta [rad] at the end of each period", None, ("turn", "displacement"))
    P = Variable("average power, Eq. (23)", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, Eq. (24)", "percent")
    multipliers = Complex("Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",))
    slider_is_free = Variable("the slider stays wherever it starts", stored=np.int8, kind=bool)
    residual = Variable("closing error relative to the largest value of each quantity", "1")
    conditioning = Variable("how far a push of the map moves the orbit: norm of (I - M)^-1", "1")
    onsets = Variable("beginnings of contact in an orbit")
    slowest_onset = Variable("closing speed at the gentlest onset; inf without contact", "m s-1")
    nearest_miss = Variable("least distance that corners come to without touching; inf where there is none", "m")
    status = Variable("how the march ended", stored=np.int8, kind=np.int32, more=FLAGS)
    along = Attribute(str)
    ends_of_branches = Attribute(str, "ends")

    @classmethod
    def of_branches(
        cls, followed: "Sequence[Followed]", along: str, limits: tuple[float, float], attrs: Mapping[str, Any]
    ) -> "Branch":
        """The result from branches along a number within limits."""
        turns = max(point.cycle.q for one in followed for point in one.points)
        rows = [_row(b, i, one, turns) for b, one in enumerate(followed) for i in range(len(one.points))]
        values: dict[str, Any] = {
            name: np.stack([np.asarray(row[name]) for row in rows]) for name in rows[0] if name != "motion"
        }
        values["motion"] = Motion(*(np.stack(field) for field in zip(*(row["motion"] for row in rows), strict=True)))
        gap = values.pop("gap")
        values |= {"along": along, "ends_of_branches": "; ".join(", ".join(one.ends) for one in followed)}
        coords = {"blade": [0, 1], "displacement": [f"{n}_{s}" for n in ("x", "y", "theta") for s in ("left", "right")]}
        told = {**attrs, "start": limits[0], "stop": limits[1]}
        made = cls.from_values(
            values, lanes=("point",), coords=coords, attrs=told, more={"gap": (("point",), gap, GAP)}
        )
        made.data["value"].attrs |= {"key": along, "units": about(along)["units"]}
        return made

    @property
    def ends(self) -> list[tuple[str, str]]:
        """Why each branch ended, at its first point and at its last one: see `messages`."""
        return [tuple(one.split(", ")) for one in self.ends_of_branches.split("; ")]  # type: ignore[misc]

    @property
    def special(self) -> list[Special]:
        """The special points."""
        return list(self._special())

    def _special(self) -> Iterator[Special]:
        for i in np.flatnonzero(self.kind):
            kind, multipliers = KINDS[self.kind[i]], self.multipliers[i]
            at = {"flip": -1.0, "fold": 1.0, "branch point": 1.0}.get(kind)
            off = np.abs(np.abs(multipliers) - 1) if at is None else np.abs(multipliers - at)
            off = np.where(self.slider_is_free[i] & (np.abs(multipliers - 1) < 1e-9), np.inf, off)
            nearest = complex(multipliers[np.argmin(off)])
            yield Special(kind, float(self.value[i]), int(self.q[i]), nearest, int(self.branch[i]), int(i))

    def start(self, point: int) -> "State":
        """The state of a point at drive phase 0, to go on from."""
        from jaxshroud.model.state import State

        motion = Motion(*(field[point] for field in self.motion))
        return State(motion, self.u_s[point], self.mode[point], self.case[point])

    @property
    def messages(self) -> list[str]:
        """How each branch ended, and what to do."""
        told = []
        for b, ends in enumerate(self.ends):
            at = np.flatnonzero(self.branch == b)
            for place, end in zip((at[0], at[-1]), ends, strict=True):
                why = ENDS[end]
                told.append(f"branch {b} (period {self.q[at[0]]}) at {self.along} = {self.value[place]:.6g}: {why}")
        return told

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """x_1 at the strobe and P_d over the number: stable orbits solid, unstable ones dashed, special points marked.

        Args:
            ax: Draw there, and only one panel.
            options: `over`: a sweep along the same number, drawn behind; `panel`: "samples", "multiplier" or
                "P_d"; a title, xlabel, width [mm] and matplotlib style.

        Raises:
            ValueError: There is no such panel, or the sweep is along another number.
        """
        from jaxshroud.results import plot_branch
        from jaxshroud.results.drawing import Look

        over: SweepResult | None = options.pop("over", None)
        panel, look = options.pop("panel", None), Look(**options)
        return plot_branch.branches(self.data, ax, None if over is None else over.data, panel, look=look)

    def __repr__(self) -> str:
        n, of = len(self.ends), {kind: sum(s.kind == kind for s in self.special) for kind in KINDS[1:]}
        told = ", ".join(f"{count} {kind}" for kind, count in of.items() if count) or "no special point"
        return (
            f"Branch along {self.along}: {n} branch{'es' * (n > 1)}, {len(self.value)} points, "
            f"{int((~self.stable).sum())} of them unstable; {told}; closed to {self.residual.max():.1e}; "
            f"{self.method}, {self.steps_per_period} steps a period"
        )


def _row(branch: int, i: int, followed: "Followed", turns: int) -> dict[str, Any]:
    """The numbers of one point."""
    point, touch = followed.points[i], followed.touches[i]
    cycle, samples = point.cycle, np.full((turns, 6), np.nan)
    samples[: cycle.q] = touch.samples[:, :6]
    plain = {n: getattr(cycle, n) for n in ("q", "P", "P_d", "multipliers", "residual", "conditioning", "status")}
    return {
        **plain,
        "value": point.value,
        "branch": branch,
        "kind": KINDS.index(point.kind or "regular"),
        "stable": bool(np.all(np.abs(point.multipliers) < 1)),
        "motion": cycle.start.motion,
        **{name: getattr(cycle.start, name) for name in ("u_s", "mode", "case")},
        "samples": samples,
        "slider_is_free": point.free,
        "onsets": touch.onsets,
        "slowest_onset": touch.slowest,
        "nearest_miss": touch.miss,
        "gap": float(cycle.scene.shroud.gap),
    }
