"""What looking for coexisting motions gives."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.gathered import Complex
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Attribute, Moving, Variable
from jaxshroud.scene.motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.motion.attractors import Attractor, Found

KINDS = ("periodic", "family", "aperiodic")
UNDECIDED, STOPPED = -1, -2
PATH = 2048  # points of a path that are kept at most


class Initial(Moving):
    """Displacements and rates at the start, stored beside others of their kind."""

    def entries(self, values: Motion, lanes: tuple[str, ...]):
        """One variable for each field."""
        for name, (_, array, told) in super().entries(values, lanes):
            yield f"initial_{name}", ((*lanes, "blade"), array, told)

    def read(self, data: Any) -> Motion:
        """A `Motion` of arrays."""
        return Motion(*(data[f"initial_{name}"].to_numpy() for name in Motion._fields))


class Attractors(Result):
    """The motions that starts lead to, the most frequent first.

    `kind` of an attractor is 0 for a periodic orbit, 1 for a family of orbits that differ by the place of a slider that
    never slips (one attractor: permanent stick keeps wherever it came to), 2 for aperiodic motion.
    """

    stored_as = "attractors"

    kind = Variable("of the attractor", stored=np.int8, kind=int, more={"flag_meanings": " ".join(KINDS)})
    period_number = Variable("period of the orbit in drive periods; 0: aperiodic")
    starts = Variable("starts that end there")
    share = Variable("of all starts", "1")
    share_low = Variable("lower end of its 95 % interval, Clopper and Pearson", "1")
    share_high = Variable("upper end of its 95 % interval", "1")
    P_d = Variable("vibration-power reduction of the left blade; of several starts the mean", "percent")
    P_d_ci = Variable("half width of its 95 % interval; 0 on an orbit", "percent")
    P_d_least = Variable("least of any start, where they differ", "percent")
    P_d_most = Variable("largest of any start, where they differ", "percent")
    distance = Variable("from the nearest other attractor, in sizes of the motion; inf where it is alone", "1")
    multipliers = Complex("Floquet multipliers of a periodic one, largest first", "1", ("multiplier",))
    residual = Variable("closing error of a periodic one", "1")
    motion = Moving("on the attractor at drive phase 0")
    u_s = Variable("slider there", "m")
    mode = Variable("contact mode there")
    case = Variable("contact case there")
    path_x = Variable("x of the left blade along it", "m", ("along",))
    path_v_x = Variable("v_x of the left blade along it", "m s-1", ("along",))
    gap = Attribute()  # of the scene [m]
    label = Variable("the attractor that a start ends on; -1: undecided, -2: its run stopped")
    status = Variable("how each start's run ended", stored=np.int8, kind=np.int32, more=FLAGS)
    initial = Initial("at each start")
    spread = Attribute()  # of the starts, in what they would reach without contact
    seed = Attribute(int)

    @classmethod
    def of_values(
        cls, values: Mapping[str, Any], lanes: Sequence[str], attrs: Mapping[str, Any], coords: Any = None
    ) -> Self:
        """The result from numbers of attractors, and from those of starts with axes `lanes`."""
        of_starts = {"label", "status", "initial"}
        split = [{n: v for n, v in values.items() if (n in of_starts) is here} for here in (True, False)]
        made = cls.from_values(split[0], lanes=lanes, coords={"blade": [0, 1], **(coords or {})}, attrs=attrs)
        rest = cls.from_values(split[1], lanes=("attractor",))
        made.data = made.data.merge(rest.data, combine_attrs="override").assign_attrs(
            {**rest.data.attrs, **made.data.attrs}
        )
        return made

    @property
    def undecided(self) -> float:
        """Share of starts that are assigned to no attractor."""
        return float(np.mean(self.label < 0))

    @property
    def worst(self) -> int | None:
        """The attractor with the least P_d; None where there is none."""
        P_d = self.P_d_least
        return int(np.nanargmin(P_d)) if np.isfinite(P_d).any() else None

    @property
    def names(self) -> list[str]:
        """What the attractors are called."""
        return [
            {0: f"period {q}", 1: f"family of period {q}", 2: "aperiodic"}[kind]
            for kind, q in zip(self.kind.tolist(), self.period_number.tolist(), strict=True)
        ]

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Orbits of the left blade in the plane of x and v_x, shares with intervals, and P_d.

        Args:
            ax: Draw there, and only one panel.
            options: `panel`: "orbits" (the default), "shares" or "P_d"; a title, width [mm] and matplotlib style.

        Raises:
            ValueError: There is no such panel.
        """
        from jaxshroud.results import plot_attractors
        from jaxshroud.results.drawing import Look

        return plot_attractors.attractors(self, ax, options.pop("panel", None), look=Look(**options))

    def __repr__(self) -> str:
        told = ", ".join(
            f"{name} {share:.3g} [{low:.3g}, {high:.3g}] P_d {P_d:.4g} %"
            for name, share, low, high, P_d in zip(
                self.names, self.share, self.share_low, self.share_high, self.P_d, strict=True
            )
        )
        worst = "" if self.worst is None else f"; worst P_d {self.P_d_least[self.worst]:.4g} %"
        return (
            f"{type(self).__name__} of {self.label.size} starts: {told}; "
            f"{self.undecided:.3g} undecided or stopped{worst}; {self.method}, {self.steps_per_period} steps a period"
        )


def share_interval(count: np.ndarray, of: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the 95 % interval of a share from a count, of Clopper and Pearson: it covers at least as often."""
    from scipy.special import betaincinv

    count = np.asarray(count, float)
    inner_low, inner_high = np.maximum(count, 1), np.minimum(count, of - 1)
    low = np.where(count > 0, betaincinv(inner_low, of - inner_low + 1, 0.025), 0.0)
    high = np.where(count < of, betaincinv(inner_high + 1, of - inner_high, 0.975), 1.0)
    return low, high


def rows_of_attractors(found: "Found", paths: Sequence[np.ndarray]) -> dict[str, Any]:
    """The numbers of attractors, and where each start ends."""
    from jaxshroud.motion.attractors import nearest

    ended, of = found.ended, found.label.size
    rows = [_row(one, ended, path) for one, path in zip(found.attractors, paths, strict=True)]
    names = rows[0] if rows else _row(None, ended, np.empty((0, 2)))
    values = {
        n: np.array([row[n] for row in rows]).reshape(len(rows), *np.shape(names[n])) for n in names if n != "motion"
    }
    fields = [np.array([row["motion"][i] for row in rows]).reshape(-1, 2) for i in range(6)]
    low, high = share_interval(values["starts"], of)
    shares = {"share": values["starts"] / of, "share_low": low, "share_high": high}
    more = {
        "motion": Motion(*fields),
        "distance": nearest(found.attractors),
        "label": found.label,
        "status": ended.status,
    }
    gap = {} if not found.attractors else {"gap": float(found.gap)}
    return {**values, **shares, **more, **gap}


def _row(one: "Attractor | None", ended: Any, path: np.ndarray) -> dict[str, Any]:
    """The numbers of one attractor; without one, numbers of their shapes."""
    curve = np.full((PATH, 2), np.nan)
    thin = path[:: -(-len(path) // PATH) or 1]
    curve[: len(thin)] = thin
    if one is None:
        return {"starts": 0, "path_x": curve[:, 0], "path_v_x": curve[:, 1], "multipliers": np.zeros(13, complex)}
    P_d, ci, lanes, cycle = ended.P_d[one.lanes], ended.ci[one.lanes], one.lanes, one.cycle
    exact = cycle is not None and one.kind == "periodic"
    mean = cycle.P_d if exact else float(P_d.mean())  # type: ignore[union-attr]
    return {
        "kind": KINDS.index(one.kind),
        "period_number": one.q,
        "starts": len(lanes),
        "P_d": mean,
        "P_d_ci": 0.0 if cycle is not None else float(np.sqrt(np.nanmean(ci**2) / len(lanes))),
        "P_d_least": mean if exact or cycle is None else float(P_d.min()),
        "P_d_most": mean if exact or cycle is None else float(P_d.max()),
        "multipliers": np.full(13, np.nan + 0j) if cycle is None else cycle.multipliers,
        "residual": np.nan if cycle is None else cycle.residual,
        "motion": one.state.motion,
        **{name: np.asarray(getattr(one.state, name)) for name in ("u_s", "mode", "case")},
        "path_x": curve[:, 0],
        "path_v_x": curve[:, 1],
    }
