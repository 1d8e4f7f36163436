"""The derivatives of P_d, of the power, or of an amplitude, with respect to numbers of a scene."""

from collections.abc import Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from jaxshroud.io.scene_numbers import layout_in
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, FlagsVariable, Variable, lanes_in_shape, lanes_in_words
from jaxshroud.results.base import Labels, Result, result_from_dataset
from jaxshroud.results.orbit import ORBIT_FLAGS, Orbit
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.quantities import unit_of
from jaxshroud.signals.effects import Effect, effects, mean_shift_text, with_interval

if TYPE_CHECKING:
    from jaxshroud.orbits.gradient import PowerGradient

ONE_SIDED = "two peaks", "blades tie"
GRADIENT_KINDS = ("none", "periodic", "smoothed")
ORBIT_PREFIX = "orbit_"  # of the names of the orbit's variables and attributes
SLOPE_NUMBERS = ("level", "level_ci", "P_d", "P_d_vibration", "conditioning", "sigma", "flags")


class Gradient(Result):
    """The derivatives of `of` with respect to some numbers of a scene, in SI units (P_d in percentage points).

    Arrays start with the axes of the scenes; a single scene has none, and plain numbers. `flags` are those of the
    orbit, "structured" where the neighbourhood is not smooth, "lanes stopped" where some of its samples stopped, "no
    width" where a number is 0 and has no relative neighbourhood, "two peaks" where an amplitude has a derivative on
    either side, "blades tie" where that of a row's worst blade has, and "failed" where there is nothing to
    differentiate. A derivative that is one-sided is that of the side on which what counts gets worse: the amplitude
    rises, or P_d of the worst blade falls.
    """

    stored_as = "gradient"

    of = Attribute(str)
    number = Variable("value of each number, in SI units", None, ("wrt",))
    derivative = Variable("derivative with respect to each number, in SI units", None, ("wrt",))
    derivative_ci = Variable("half width of its 95 % interval; 0 where it is exact", None, ("wrt",))
    level = Variable("what is differentiated: on the orbit, or averaged over the neighbourhood", None, alone=True)
    level_ci = Variable("half width of its 95 % interval", None, alone=True)
    P_d = Variable("P_d there, where `of` is a reduction; else NaN", "percent", alone=True)
    P_d_vibration = Variable("that of the vibration about the mean position alone", "percent", alone=True)
    conditioning = Variable("how far a push of the map moves the orbit; NaN if smoothed", "1", alone=True)
    sigma = Variable("relative width of the neighbourhood; 0 on an orbit", "1", alone=True)
    flags = FlagsVariable(
        "what to know before relying on the derivative",
        (*ORBIT_FLAGS, "structured", "lanes stopped", "no width", *ONE_SIDED, "linear"),
        "flag",
    )
    number_of_kind = Variable(
        "", alone=True, kind=int, more={"flag_values": [0, 1, 2], "flag_meanings": " ".join(GRADIENT_KINDS)}
    )

    orbits: Orbit | None = None  # in memory, unless read from a file

    @classmethod
    def of_slopes(
        cls,
        slopes: "Sequence[PowerGradient]",
        wrt: Sequence[str],
        of: str,
        orbit: Orbit,
        numbers: Sequence[Sequence[float]],
        **labels: Unpack[Labels],
    ) -> "Gradient":
        """The result from each lane's slope, the orbits of all lanes, and the values of the numbers in each lane.

        `labels` are further arguments of `from_values`.
        """
        rows = [_slope_row(slope) | {"number": np.array(row)} for slope, row in zip(slopes, numbers, strict=True)]
        values = {name: lanes_in_shape([row[name] for row in rows], np.shape(orbit.q)) for name in rows[0]}
        values |= {"of": of, "method": str(orbit.march_choices), "steps_per_period": orbit.steps_per_period}
        result = cls.from_values(values, coords={"wrt": list(wrt)}, **labels)
        orbit_data = orbit.data.drop_vars([name for name, a in orbit.data.variables.items() if "key" in a.attrs])
        # The orbits may have other names for the axes of the scenes.
        axes = zip(orbit.data["P"].dims, labels.get("lanes", ()), strict=False)
        names = {name: f"{ORBIT_PREFIX}{name}" for name in orbit_data.data_vars}
        orbit_data = orbit_data.rename(names | {a: b for a, b in axes if a != b})
        attrs = {f"{ORBIT_PREFIX}{name}": value for name, value in orbit.data.attrs.items()}
        result.data = result.data.merge(orbit_data).assign_attrs({**attrs, **result.data.attrs})
        result.orbits = orbit
        return result

    @property
    def kind(self) -> Any:  # a string, or an array of strings for many scenes
        """Either "periodic" or "smoothed"; "none" for a lane that failed."""
        kinds = np.array(GRADIENT_KINDS)[np.asarray(self.number_of_kind)]
        return kinds if kinds.ndim else str(kinds)

    @property
    def wrt(self) -> tuple[str, ...]:
        """The keys of the numbers."""
        return tuple(map(str, self.data["wrt"].to_numpy()))

    @property
    def value(self) -> dict[str, Any]:
        """The derivative with respect to each number: a plain number for a single scene, an array for many."""
        return self._by_key(self.derivative)

    @property
    def ci(self) -> dict[str, Any]:
        """The half width of the 95 % interval of each derivative; 0 where the derivative is exact."""
        return self._by_key(self.derivative_ci)

    @property
    def effects(self) -> list[Effect]:
        """The change of `of` by 1 % more of each number, or by 1 degree of an angle; one scene, the largest first.

        Raises:
            InputError: There are many scenes, or the file was written before the numbers were kept.
        """
        if self.number is None or self.number.ndim > 1:
            advice = "compute it again" if self.number is None else "pick a lane"
            raise InputError(f"Effects are of the numbers of one scene; {advice}.")
        return effects(self.value, self.ci, self._by_key(self.number))

    @property
    def side(self) -> str:
        """Of which side one-sided derivatives of a single scene are, in words; empty where they are of both."""
        if not set(ONE_SIDED) & set(self.flags):
            return ""
        return (
            f"the slopes are one-sided, of the side on which {self.of} {'falls' if self.of == 'P_d_worst' else 'rises'}"
        )

    @property
    def mean_shift(self) -> str:
        """One sentence where contact shifts the mean position, which P_d counts as vibration; else empty; one scene."""
        return mean_shift_text(self.P_d, self.P_d_vibration, self.of, "--of ")

    def summary(self) -> dict[str, JSONValue]:
        """The derivatives and their orbit in plain numbers, as `gradient.json` holds them; of many scenes few."""
        if np.ndim(self.level):
            return super().summary()
        cycle = self.orbit
        names = ("of", "kind", "value", "ci", "level", "level_ci", "P_d", "P_d_vibration", "sigma", "flags", "side")
        orbit = {
            "period_number": cycle.q,
            "residual": cycle.residual,
            "multipliers": [[float(m.real), float(m.imag)] for m in cycle.multipliers],
            "nearest_bifurcation": cycle.bifurcation[0] if cycle.found else None,
            "conditioning": self.conditioning,
            "periods": cycle.periods,
            "start": cycle.start.motion._asdict(),
        }
        return json_values(
            {
                **{name: getattr(self, name) for name in names},
                "number": {effect.key: effect.number for effect in self.effects},
                "blades": self._blades,
                "orbit": orbit,
                "method": str(cycle.method),
                "steps_per_period": cycle.steps_per_period,
                **self.origin,
            }
        )

    def _drawn(self) -> tuple[str, object]:
        number = {effect.key: effect.number for effect in self.effects}
        title = self.data.attrs.get("title", "")
        values = {"of": self.of, "value": self.value, "ci": self.ci, "number": number}
        return self.stored_as, {**values, "title": title, "blades": self._blades}

    @property
    def _blades(self) -> tuple[str, ...]:
        """The names of the blades, for the labels of pictures."""
        return layout_in(self.data).names

    def _by_key(self, values: np.ndarray) -> dict[str, Any]:
        columns = np.moveaxis(values, -1, 0)
        return dict(zip(self.wrt, columns if values.ndim > 1 else columns.tolist(), strict=True))

    @property
    def orbit(self) -> Any:  # an `Orbit`
        """The orbit, or the orbits of many scenes, with their flags, multipliers and bifurcations."""
        if self.orbits is not None:
            return self.orbits
        names = _without_prefix(self.data.data_vars)
        scene_numbers = [name for name, a in self.data.variables.items() if "key" in a.attrs]
        data = self.data[[*names, *scene_numbers]].rename(names)
        data.attrs = {name: self.data.attrs[stored] for stored, name in _without_prefix(self.data.attrs).items()}
        return result_from_dataset(data.assign_attrs(kind=data.attrs.get("kind", Orbit.stored_as)), "gradient")

    @property
    def status(self) -> int | np.ndarray:
        """How the march of each lane's orbit ended."""
        return self.orbit.status

    @property
    def failed(self) -> int:
        """The number of lanes without a derivative."""
        return int(np.sum(np.equal(self.number_of_kind, 0)))

    def __repr__(self) -> str:
        unit = unit_of(self.of)
        if np.ndim(self.level):
            kinds = ", ".join(f"{np.sum(self.kind == kind)} {kind}" for kind in GRADIENT_KINDS[1:])
            subject = f"of {self.of} with respect to {', '.join(self.wrt)}"
            return f"Gradient of {lanes_in_words(self.level, self.failed)} {subject}: {kinds}"
        slopes = ", ".join(f"d{self.of}/d {key} = {with_interval(v, self.ci[key])}" for key, v in self.value.items())
        return (
            f"Gradient, {self.kind}: {slopes}; {self.of} {with_interval(self.level, self.level_ci, unit)}; "
            f"flags: {', '.join(self.flags) or 'none'}{self.mean_shift and f'; {self.mean_shift}'}"
        )


def _without_prefix(names: Iterable[Hashable]) -> dict[str, str]:
    """The names of what belongs to the orbit, as they are stored -> as the orbit itself has them."""
    return {str(n): str(n).removeprefix(ORBIT_PREFIX) for n in names if str(n).startswith(ORBIT_PREFIX)}


def _slope_row(slope: "PowerGradient") -> dict[str, Any]:
    """The values of one lane."""
    numbers = {name: getattr(slope, name) for name in SLOPE_NUMBERS}
    kind = np.int8(GRADIENT_KINDS.index(slope.kind))
    return {**numbers, "derivative": slope.value, "derivative_ci": slope.ci, "number_of_kind": kind}
