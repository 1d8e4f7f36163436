"""What shooting gives: periodic orbits with their multipliers."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.gathered import Complex, Flags, in_shape, lanes_in_words, picked, taken
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Moving, Variable
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from jaxshroud.batch.tangents import Tangents
    from jaxshroud.march.method import Choices
    from jaxshroud.model.state import State
    from jaxshroud.motion.orbit import Cycle
    from jaxshroud.scene.scene import Scene

SIDES = ("left", "right")
COMPONENTS = [f"{name}_{side}" for name in ("x", "y", "theta", "v_x", "v_y", "v_theta") for side in SIDES] + ["slider"]
COORDS = {"blade": [0, 1], "component": COMPONENTS, "by_component": COMPONENTS}
TOLD = ("aperiodic", "stopped", "not converged", "unstable", "not unique", "ill conditioned", "failed", "not run")
NUMBERS = ("q", "P_d", "residual", "conditioning", "doubt", "updates", "periods", "status")


class Orbit(Result):
    """Periodic orbits, or what was found in place of them.

    Arrays start with the axes of the scenes; a single scene has none, and plain numbers where it has one of a kind.

    `flags` of a lane is empty for an orbit that can be relied upon. Else it holds any of "aperiodic" (the motion never
    nearly repeated), "not converged" (Newton's method did not close it), "unstable" (a multiplier outside the unit
    circle), "not unique" (permanent stick: the slider stays wherever it starts, one orbit for each of its places;
    derivatives are those with the slider held in its place), "ill conditioned" (`doubt` exceeds 1e-6), "stopped" (the
    march ended with a status other than OK) and "failed" (its equations could not be solved).
    """

    stored_as = "orbit"

    motion = Moving("at the start of the orbit, drive phase 0")
    u_s = Variable("slider at the start", "m")
    mode = Variable("contact mode at the start")
    case = Variable("contact case at the start")
    q = Variable("period number; 0: no orbit", alone=True, kind=int)
    P = Variable("average power, Eq. (23); NaN without an orbit", "m4", ("blade",))
    P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, Eq. (24)", "percent", alone=True)
    residual = Variable("closing error relative to the largest value of each quantity", "1", alone=True)
    multipliers = Complex("Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",))
    conditioning = Variable("how far a push of the map moves the orbit: norm of (I - M)^-1", "1", alone=True)
    doubt = Variable("relative error that derivatives may have", "1", alone=True)
    flags = Flags("what to know before relying on the orbit", TOLD, "orbit_flag")
    updates = Variable("updates of Newton's method", alone=True, kind=int)
    periods = Variable("drive periods simulated, each Jacobian counted as one run", alone=True, kind=int)
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    M = Variable("d end / d start of the map at the orbit, in SI units", None, ("component", "by_component"))
    power_by_start = Variable("d mean square displacement / d start", None, ("blade", "by_component"))
    mean_square = Variable("mean square displacement over block and time", "m2", ("blade",))
    end = Variable("state at the end of the orbit, in SI units", None, ("component",))
    end_mode = Variable("contact mode at the end")
    end_case = Variable("contact case at the end")

    scenes: "Scene | None" = None  # in memory, unless read from a file
    choices: "Choices | None" = None

    @classmethod
    def of_cycles(cls, cycles: "Sequence[Cycle]", shape: tuple[int, ...] = (), **about: Any) -> "Orbit":
        """The result from each lane's orbit; there are lanes of that shape."""
        import jax

        rows = [_row(cycle) for cycle in cycles]
        values = {name: in_shape([row[name] for row in rows], shape) for name in rows[0]}
        first = cycles[0]
        values |= {"method": str(first.method), "steps_per_period": first.steps_per_period}
        made = cls.from_values(values, coords=COORDS, **about)
        made.scenes = jax.tree.map(lambda *a: in_shape(a, shape), *(cycle.scene for cycle in cycles))
        made.choices = first.method
        return made

    @property
    def scene(self) -> "Scene":  # type: ignore[override]
        """The scene, or all of them with leading axes."""
        from jaxshroud.results.scenes import scenes_of

        shape, precision = np.shape(self.q), self.method.precision
        return scenes_of(self.data, shape, precision) if self.scenes is None else self.scenes

    @property
    def method(self) -> "Choices":  # type: ignore[override]
        """The static choices of the march."""
        from jaxshroud.march.method import named_choices

        return named_choices(self.data.attrs["method"]) if self.choices is None else self.choices

    @property
    def start(self) -> "State":
        """The state at drive phase 0."""
        from jaxshroud.model.state import State

        return State(self.motion, self.u_s, self.mode, self.case)

    @property
    def jacobian(self) -> "Tangents | None":
        """The map at the orbit and its derivatives; None where a single scene has no orbit."""
        from jaxshroud.batch.states import from_vector
        from jaxshroud.batch.tangents import Tangents

        if not np.any(self.found):
            return None
        lanes, end = np.shape(self.q), from_vector(self.end, self.end_mode, self.end_case)
        none = np.empty((*lanes, len(COMPONENTS), 0)), np.empty((*lanes, 2, 0))
        return Tangents(end, self.end, self.mean_square, self.status, self.M, self.power_by_start, *none)

    @property
    def found(self) -> Any:
        """Whether there is a periodic orbit, stable or not."""
        return self.q > 0

    @property
    def slider_is_free(self) -> Any:
        """Whether the slider stays wherever it starts (permanent stick)."""
        return self._of_each(lambda cycle: cycle.slider_is_free)

    @property
    def others(self) -> np.ndarray:
        """The multipliers of a single scene without that of a free slider."""
        return self.cycle().others

    @property
    def bifurcation(self) -> Any:
        """The bifurcation that the leading multiplier is on its way to, and its distance 1 - abs(multiplier)."""
        return self._of_each(lambda cycle: cycle.bifurcation)

    def cycle(self, *lane: int) -> "Cycle":
        """The orbit of one lane, as algorithms take it; of a single scene without an index.

        Raises:
            ValueError: There are other numbers of axes.
        """
        from jaxshroud.motion.orbit import Cycle

        axes = np.ndim(self.q)
        if len(lane) != axes:
            raise InputError(f"An orbit of scenes with {axes} axes is chosen by {axes} indices, not by {len(lane)}.")
        at, flags = self.jacobian, self.flags
        return Cycle(
            scene=picked(self.scene, lane) if lane else self.scene,
            start=picked(self.start, lane),
            **{name: np.asarray(getattr(self, name))[lane].item() for name in NUMBERS},
            **{name: getattr(self, name)[lane] for name in ("P", "P_0", "multipliers")},
            flags=flags[lane] if lane else flags,
            steps_per_period=self.steps_per_period,
            method=self.method,
            jacobian=None if at is None or not np.asarray(self.q)[lane] else taken(at, lane),
        )

    @property
    def cycles(self) -> "list[Cycle]":
        """The orbits of all lanes, one after the other."""
        return [self.cycle(*lane) for lane in np.ndindex(np.shape(self.q))]

    def _of_each(self, f: "Callable[[Cycle], Any]") -> Any:
        """What `f` gives for a single scene, or an array of it for many."""
        if not np.ndim(self.q):
            return f(self.cycle())
        out = np.empty(np.shape(self.q), object)
        for lane in np.ndindex(out.shape):
            out[lane] = f(self.cycle(*lane))
        return out

    @property
    def failed(self) -> int:
        """How many lanes stopped, or could not be solved."""
        return sum(
            bool({"stopped", "failed"} & set(flags))
            for flags in (self.flags.ravel() if np.ndim(self.q) else [self.flags])
        )

    def __repr__(self) -> str:
        how = f"{self.method}, {self.steps_per_period} steps a period"
        if np.ndim(self.q):
            return f"Orbit of {lanes_in_words(self.q, self.failed)}: {np.sum(self.found)} found; {how}"
        motion = f"period {self.q}, P_d {self.P_d:.6g} %" if self.found else "none found"
        largest = f"largest multiplier {abs(self.multipliers[0]):.3g}"
        closed = f"closed to {self.residual:.1e}, {largest}; " if self.found else ""
        flags = f"flags: {', '.join(self.flags) or 'none'}"
        return f"Orbit: {motion}; {closed}{flags}; {self.periods} periods simulated; {how}"


def _row(cycle: "Cycle") -> dict[str, Any]:
    """One lane's numbers, NaN where there is no orbit."""
    start, at = cycle.start, cycle.jacobian
    size, dtype = len(COMPONENTS), np.asarray(start.u_s).dtype
    none = lambda *shape: np.full(shape, np.nan, dtype)  # noqa: E731
    plain = {name: getattr(cycle, name) for name in (*NUMBERS, "P", "P_0", "multipliers", "flags")}
    return {
        **plain,
        **{"motion": start.motion, "u_s": start.u_s, "mode": start.mode, "case": start.case},
        "M": none(size, size) if at is None else at.by_state,
        "power_by_start": none(2, size) if at is None else at.power_by_state,
        "mean_square": none(2) if at is None else at.power,
        "end": none(size) if at is None else at.vector,
        "end_mode": start.mode if at is None else at.end.mode,
        "end_case": start.case if at is None else at.end.case,
    }
