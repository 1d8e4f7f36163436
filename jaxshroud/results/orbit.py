"""Periodic orbits with their Floquet multipliers, as found by shooting."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import (
    ComplexVariable,
    FlagsVariable,
    MotionVariable,
    Variable,
    jax_lane_arrays,
    lane_arrays,
    lanes_in_shape,
    lanes_in_words,
)
from jaxshroud.results.amplitudes import AT_POINTS, OF_MODES, WithAmplitudes, contact_values, stored_state
from jaxshroud.results.base import Labels, Result
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import PAIR, Layout

if TYPE_CHECKING:
    from jaxshroud.batch.tangents import Tangents
    from jaxshroud.march.method import Choices, Method
    from jaxshroud.model.prepared import State
    from jaxshroud.orbits.orbit import PeriodicOrbit
    from jaxshroud.scene.scene import Scene

OfOrbit = TypeVar("OfOrbit")
ORBIT_FLAGS = (
    "aperiodic",
    "stopped",
    "not converged",
    "unstable",
    "not unique",
    "ill conditioned",
    "failed",
    "not run",
)
ORBIT_NUMBERS = ("q", "P_d", "P_d_vibration", "residual", "conditioning", "doubt", "updates", "periods", "status")


def component_names(layout: Layout = PAIR, points: int = 0, modes: int = 0) -> list[str]:
    """The names of the numbers of a state, in the order of vectors: of sliders with interface and point.

    With so many `modes` of a blade its coordinates are theirs.
    """
    numbers = [f"{name}{j}" for name in ("q", "v_q") for j in range(modes)] or Motion._fields
    sliders = [f"slider_{j}" for j in range(*layout.interface_shape)] if layout.interface_shape else ["slider"]
    sliders = [f"{name}_{m}" for name in sliders for m in range(points)] if points else sliders
    return [f"{name}_{blade}" for name in numbers for blade in layout.names] + sliders


class Orbit(WithAmplitudes, Result):
    """Periodic orbits, or for lanes without one the reason.

    Arrays start with the axes of the scenes. In a row what is known of contact ends with the interface, P_d is
    that of all blades together, and "not unique" is said where any slider stays wherever it starts. A single scene has
    no leading axes, and a plain number for every quantity that each orbit has one value of.

    The `flags` of a lane are empty for an orbit that can be relied upon. Else they are some of "aperiodic" (the motion
    never nearly repeated), "not converged" (Newton's method did not close the orbit), "unstable" (a multiplier is
    outside the unit circle), "not unique" (permanent stick: the slider stays wherever it starts, with one orbit for
    each of its places; derivatives are those with the slider fixed), "ill conditioned" (`doubt` exceeds 1e-6),
    "stopped" (the march ended with a status other than OK) and "failed" (the equations could not be solved).

    Panels of the picture of a single scene: "multipliers" and "magnitudes".
    """

    stored_as = "orbit"

    motion = MotionVariable("at the start of the orbit, drive phase 0")
    u_s = Variable("slider at the start", "m", ("interface",))
    mode = Variable("contact mode at the start", None, ("interface",))
    case = Variable("contact case at the start", None, ("interface",))
    point_u_s = Variable("slider of each point at the start", "m", AT_POINTS)
    point_mode = Variable("contact mode of each point at the start", None, AT_POINTS)
    modal = Variable("coordinates of modes and their rates at the start", None, OF_MODES)
    q = Variable("period number; 0: no orbit", alone=True, kind=int)
    P = Variable("average power, Eq. (23); NaN without an orbit", "m4", ("blade",))
    P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, or of a row, Eq. (24)", "percent", alone=True)
    P_d_vibration = Variable("that of the vibration about the mean position alone", "percent", alone=True)
    residual = Variable("closing error relative to the largest value of each quantity", "1", alone=True)
    multipliers = ComplexVariable(
        "Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",)
    )
    conditioning = Variable("how far a push of the map moves the orbit: norm of (I - M)^-1", "1", alone=True)
    doubt = Variable("relative error that derivatives may have", "1", alone=True)
    flags = FlagsVariable("what to know before relying on the orbit", ORBIT_FLAGS, "orbit_flag")
    updates = Variable("updates of Newton's method", alone=True, kind=int)
    periods = Variable("drive periods simulated, each Jacobian counted as one run", alone=True, kind=int)
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    M = Variable("d end / d start of the map at the orbit, in SI units", None, ("component", "by_component"))
    power_by_start = Variable("d mean square displacement / d start", None, ("blade", "by_component"))
    mean_square = Variable("mean square displacement over block and time", "m2", ("blade",))
    end = Variable("state at the end of the orbit, in SI units", None, ("component",))
    end_mode = Variable("contact mode at the end", None, ("interface",))
    end_case = Variable("contact case at the end", None, ("interface",))
    end_point_mode = Variable("contact mode of each point at the end", None, AT_POINTS)
    wave_parts = Variable(
        "parts of the period over which a travelling wave repeats; 0: no ring of alike blades", kind=int, alone=True
    )
    wave_residual = Variable(
        "distance from a travelling wave, relative to the largest of each quantity", "1", alone=True
    )
    wave_multipliers = ComplexVariable("multipliers of the map over a part and the shift back", "1", ("multiplier",))

    scenes: "Scene | None" = None  # in memory, unless read from a file
    choices: "Choices | None" = None

    @classmethod
    def of_cycles(
        cls,
        cycles: "Sequence[PeriodicOrbit]",
        shape: tuple[int, ...] = (),
        amplitudes: Mapping[str, np.ndarray] | None = None,
        **labels: Unpack[Labels],
    ) -> "Orbit":
        """The result from the orbit of each lane.

        Args:
            cycles: The orbits.
            shape: The leading axes of the result.
            amplitudes: The values of `WithAmplitudes`, and of rows those of travelling waves, (lanes, ...) each.
            labels: Further arguments of `from_values`.
        """
        import jax

        from jaxshroud.march.method import method_as_json, method_of

        rows = [_orbit_row(cycle) for cycle in cycles]
        values = {name: lanes_in_shape([row[name] for row in rows], shape) for name in rows[0]}
        first = cycles[0]
        values |= {name: lanes_in_shape([*a], shape) for name, a in (amplitudes or {}).items()}
        values |= {"method": str(first.method), "steps_per_period": first.steps_per_period}
        values |= {"march": method_as_json(method_of(first.steps_per_period, first.method))}
        layout = first.scene.layout
        by_modes = first.scene.mode_numbers is not None
        names = component_names(layout, first.scene.points, first.scene.coordinates if by_modes else 0)
        coords = {"blade": np.arange(layout.blades), "component": names, "by_component": names}
        result = cls.from_values(values, coords=coords, layout=layout, **labels)
        result.scenes = jax.tree.map(lambda *a: lanes_in_shape(a, shape), *(cycle.scene for cycle in cycles))
        result.choices = first.method
        return result

    @property
    def scene(self) -> "Scene":  # type: ignore[override]
        """The scene, or all scenes with leading axes."""
        from jaxshroud.io.scene_numbers import scenes_from_dataset

        shape = np.shape(self.q)
        precision = self.march_choices.precision
        return scenes_from_dataset(self.data, shape, precision) if self.scenes is None else self.scenes

    @property
    def method(self) -> "Method":  # type: ignore[override]
        """The method of the march with its steps, as other verbs take it."""
        from jaxshroud.march.method import method_of

        return method_of(self.steps_per_period, self.march_choices)

    @property
    def march_choices(self) -> "Choices":
        """The static options of the march."""
        from jaxshroud.march.method import choices

        return choices(self.march) if self.choices is None else self.choices

    @property
    def start(self) -> "State":
        """The state at drive phase 0."""
        return stored_state(self, self.motion)

    @property
    def jacobian(self) -> "Tangents | None":
        """The map at the orbit and its derivatives; None if no lane has an orbit."""
        from jaxshroud.batch.lanes import from_vector
        from jaxshroud.batch.tangents import Tangents

        if not np.any(self.found):
            return None
        lanes = np.shape(self.q)
        modes = self.end_mode if self.end_point_mode is None else self.end_point_mode
        end = from_vector(self.end, modes, self.end_case, self.scene)
        return Tangents(
            end=end,
            vector=self.end,
            power=self.mean_square,
            status=self.status,
            by_state=self.M,
            power_by_state=self.power_by_start,
            by_parameter=np.empty((*lanes, self.data.sizes["component"], 0)),
            power_by_parameter=np.empty((*lanes, self.data.sizes["blade"], 0)),
        )

    @property
    def found(self) -> bool | np.ndarray:
        """Whether there is a periodic orbit, stable or not."""
        return self.q > 0

    @property
    def slider_is_free(self) -> bool | np.ndarray:
        """Whether the slider stays wherever it starts (permanent stick)."""
        return self._of_each(lambda cycle: cycle.slider_is_free)

    @property
    def others(self) -> np.ndarray:
        """The multipliers of a single scene without that of a free slider."""
        return self.cycle().others

    @property
    def bifurcation(self) -> tuple[str, float] | np.ndarray:
        """The bifurcation that the leading multiplier approaches, and its distance 1 - abs(multiplier)."""
        return self._of_each(lambda cycle: cycle.bifurcation)

    @property
    def wave_bifurcation(self) -> tuple[str, float]:
        """What the leading multiplier of the reduced map of a single ring approaches, and its distance from it.

        At a "fold" the motion stays a travelling wave; elsewhere on the unit circle begins its "localisation", except
        for -1 in a ring of an odd number of blades, a "flip".
        """
        from jaxshroud.orbits.travelling_wave import wave_bifurcation

        return wave_bifurcation(self.wave_multipliers, self.data.sizes["blade"])

    def cycle(self, *lane: int) -> "PeriodicOrbit":
        """The orbit of one lane, as the algorithms take it; a single scene has no index.

        Raises:
            ValueError: The number of indices is not that of the leading axes.
        """
        from jaxshroud.orbits.orbit import PeriodicOrbit

        axes = np.ndim(self.q)
        if len(lane) != axes:
            raise InputError(f"An orbit of scenes with {axes} axes is chosen by {axes} indices, not by {len(lane)}.")
        jacobian, flags = self.jacobian, self.flags
        return PeriodicOrbit(
            scene=jax_lane_arrays(self.scene, lane) if lane else self.scene,
            start=jax_lane_arrays(self.start, lane),
            **{name: np.asarray(getattr(self, name))[lane].item() for name in ORBIT_NUMBERS},
            **{name: getattr(self, name)[lane] for name in ("P", "P_0", "multipliers")},
            flags=flags[lane] if lane else flags,
            steps_per_period=self.steps_per_period,
            method=self.march_choices,
            jacobian=None if jacobian is None or not np.asarray(self.q)[lane] else lane_arrays(jacobian, lane),
        )

    @property
    def cycles(self) -> "list[PeriodicOrbit]":
        """The orbits of all lanes, one after the other."""
        return [self.cycle(*lane) for lane in np.ndindex(np.shape(self.q))]

    def _of_each(self, f: "Callable[[PeriodicOrbit], OfOrbit]") -> "OfOrbit | np.ndarray":
        """`f` of the orbit of a single scene, or an array of its values for many."""
        if not np.ndim(self.q):
            return f(self.cycle())
        values = np.empty(np.shape(self.q), object)
        for lane in np.ndindex(values.shape):
            values[lane] = f(self.cycle(*lane))
        return values

    @property
    def failed(self) -> int:
        """The number of lanes that stopped or could not be solved."""
        flags = self.flags.ravel() if np.ndim(self.q) else [self.flags]
        return sum(bool({"stopped", "failed"} & set(of_lane)) for of_lane in flags)

    def summary(self) -> dict[str, JSONValue]:
        """The orbit with its multipliers in plain numbers, as `summary.json` holds them; of many scenes few."""
        if np.ndim(self.q):
            return super().summary()
        multipliers = [[mu.real, mu.imag] for mu in self.multipliers] if self.found else []
        numbers = super().summary()
        numbers |= {"period_number": numbers.pop("q")}
        return {**json_values({"flags": self.flags, "multipliers": multipliers}), **numbers}

    def __repr__(self) -> str:
        method = str(self.method)
        if np.ndim(self.q):
            return f"Orbit of {lanes_in_words(self.q, self.failed)}: {np.sum(self.found)} found; {method}"
        motion = f"period {self.q}, P_d {self.P_d:.6g} %" if self.found else "none found"
        largest = f"largest multiplier {abs(self.multipliers[0]):.3g}"
        closed = f"closed to {self.residual:.1e}, {largest}; " if self.found else ""
        flags = f"flags: {', '.join(self.flags) or 'none'}"
        return f"Orbit: {motion}; {closed}{flags}; {self.periods} periods simulated; {method}"


def _orbit_row(cycle: "PeriodicOrbit") -> dict[str, Any]:
    """The values of one lane, NaN where there is no orbit."""
    from jaxshroud.batch.lanes import shroud_motion

    start, jacobian = cycle.start, cycle.jacobian
    end = start if jacobian is None else jacobian.end
    size = len(cycle.multipliers)
    blades = len(cycle.P)
    dtype = np.asarray(start.u_s).dtype

    def nans(*shape):
        return np.full(shape, np.nan, dtype)

    numbers = {name: getattr(cycle, name) for name in (*ORBIT_NUMBERS, "P", "P_0", "multipliers", "flags")}
    return {
        **numbers,
        "motion": shroud_motion(start.motion, cycle.scene),
        **contact_values(start),
        "M": nans(size, size) if jacobian is None else jacobian.by_state,
        "power_by_start": nans(blades, size) if jacobian is None else jacobian.power_by_state,
        "mean_square": nans(blades) if jacobian is None else jacobian.power,
        "end": nans(size) if jacobian is None else jacobian.vector,
        **{name: value for name, value in contact_values(end, "end_").items() if name.endswith(("mode", "case"))},
    }
