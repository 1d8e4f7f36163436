"""What a gradient gives."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.effects import Effect, effects
from jaxshroud.results.gathered import Flags, in_shape, lanes_in_words
from jaxshroud.results.orbit import TOLD, Orbit
from jaxshroud.results.variable import Attribute, Variable
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.motion.gradient import Slope

KINDS = ("none", "periodic", "smoothed")
BEFORE = "orbit_"  # the names of the orbit's variables and attributes
OWN = ("level", "level_ci", "conditioning", "sigma", "flags")


class Gradient(Result):
    """Derivatives of `of` with respect to some numbers of a scene, in SI units (P_d in percentage points).

    Arrays start with the axes of the scenes; a single scene has none, and plain numbers. `flags` are those of the
    orbit, "structured" where the neighbourhood is not smooth, "lanes stopped" where some of its samples stopped, and
    "failed" where there is nothing to differentiate.
    """

    stored_as = "gradient"

    of = Attribute(str)
    number = Variable("value of each number, in SI units", None, ("wrt",))
    derivative = Variable("derivative with respect to each number, in SI units", None, ("wrt",))
    derivative_ci = Variable("half width of its 95 % interval; 0 where it is exact", None, ("wrt",))
    level = Variable("what is differentiated: on the orbit, or averaged over the neighbourhood", None, alone=True)
    level_ci = Variable("half width of its 95 % interval", None, alone=True)
    conditioning = Variable("how far a push of the map moves the orbit; NaN if smoothed", "1", alone=True)
    sigma = Variable("relative width of the neighbourhood; 0 on an orbit", "1", alone=True)
    flags = Flags("what to know before relying on the derivative", (*TOLD, "structured", "lanes stopped"), "flag")
    number_of_kind = Variable(
        "", alone=True, kind=int, more={"flag_values": [0, 1, 2], "flag_meanings": " ".join(KINDS)}
    )

    orbits: Orbit | None = None  # in memory, unless read from a file

    @classmethod
    def of_slopes(
        cls,
        slopes: "Sequence[Slope]",
        wrt: Sequence[str],
        of: str,
        orbit: Orbit,
        numbers: Sequence[Sequence[float]],
        **about: Any,
    ) -> "Gradient":
        """The result from each lane's slope, the orbits of all, and the values of the numbers in each."""
        rows = [_row(slope) | {"number": np.array(at)} for slope, at in zip(slopes, numbers, strict=True)]
        values = {name: in_shape([row[name] for row in rows], np.shape(orbit.q)) for name in rows[0]}
        values |= {"of": of, "method": str(orbit.method), "steps_per_period": orbit.steps_per_period}
        made = cls.from_values(values, coords={"wrt": list(wrt)}, **about)
        held = orbit.data.drop_vars([name for name, a in orbit.data.variables.items() if "key" in a.attrs])
        axes = zip(
            orbit.data["P"].dims, about.get("lanes", ()), strict=False
        )  # the orbits may have named them otherwise
        held = held.rename({name: f"{BEFORE}{name}" for name in held.data_vars} | {a: b for a, b in axes if a != b})
        attrs = {f"{BEFORE}{name}": value for name, value in orbit.data.attrs.items()}
        made.data = made.data.merge(held).assign_attrs({**attrs, **made.data.attrs})
        made.orbits = orbit
        return made

    @property
    def kind(self) -> Any:
        """Either "periodic" or "smoothed"; "none" of a lane that failed."""
        kinds = np.array(KINDS)[np.asarray(self.number_of_kind)]
        return kinds if kinds.ndim else str(kinds)

    @property
    def wrt(self) -> tuple[str, ...]:
        """The keys of the numbers."""
        return tuple(map(str, self.data["wrt"].to_numpy()))

    @property
    def value(self) -> dict[str, Any]:
        """The derivative with respect to each number: plain numbers of a single scene, arrays of many."""
        return self._by_key(self.derivative)

    @property
    def ci(self) -> dict[str, Any]:
        """The half widths of their 95 % intervals; 0 where the derivative is exact."""
        return self._by_key(self.derivative_ci)

    @property
    def effects(self) -> list[Effect]:
        """What 1 % more of each number changes, or 1 degree of an angle: of one scene, the largest first.

        Raises:
            InputError: There are many scenes, or the file was written before the numbers were kept.
        """
        if self.number is None or self.number.ndim > 1:
            cure = "compute it again" if self.number is None else "pick a lane"
            raise InputError(f"Effects are of the numbers of one scene; {cure}.")
        return effects(self.value, self.ci, self._by_key(self.number))

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """The effects of the numbers of one scene, the largest on top.

        Args:
            ax: There is no panel to draw alone.
            options: `title`, `xlabel`, `width`, `style` of the picture.

        Raises:
            InputError: There are many scenes, or `ax` is given.
        """
        from jaxshroud.results import plot_effects
        from jaxshroud.results.drawing import Look

        if ax is not None:
            raise InputError("Argument `ax` is not for the picture of a Gradient.")
        told = {e.key: e.number for e in self.effects}
        data = {"of": self.of, "value": self.value, "ci": self.ci, "number": told}
        data |= {"title": self.data.attrs.get("title", "")}
        return plot_effects.tornado(data, look=Look(**options))

    def _by_key(self, values: np.ndarray) -> dict[str, Any]:
        columns = np.moveaxis(values, -1, 0)
        return dict(zip(self.wrt, columns if values.ndim > 1 else columns.tolist(), strict=True))

    @property
    def orbit(self) -> Orbit:
        """The orbit or orbits; see their flags, multipliers and bifurcation."""
        if self.orbits is not None:
            return self.orbits
        named = {str(n): str(n).removeprefix(BEFORE) for n in self.data.data_vars if str(n).startswith(BEFORE)}
        others = {n: n for n, a in self.data.variables.items() if "key" in a.attrs}
        attrs = {str(n).removeprefix(BEFORE): v for n, v in self.data.attrs.items() if str(n).startswith(BEFORE)}
        data = self.data[[*named, *others]].rename(named)
        data.attrs = attrs
        return Orbit(data)

    @property
    def status(self) -> Any:
        """How the march of each lane's orbit ended."""
        return self.orbit.status

    @property
    def failed(self) -> int:
        """How many lanes have no derivative."""
        return int(np.sum(np.equal(self.number_of_kind, 0)))

    def __repr__(self) -> str:
        unit = "%" if self.of == "P_d" else "m^4"
        if np.ndim(self.level):
            kinds = ", ".join(f"{np.sum(self.kind == kind)} {kind}" for kind in KINDS[1:])
            told = f"of {self.of} with respect to {', '.join(self.wrt)}"
            return f"Gradient of {lanes_in_words(self.level, self.failed)} {told}: {kinds}"
        slopes = ", ".join(f"d{self.of}/d {key} = {v:.6g} +- {self.ci[key]:.2g}" for key, v in self.value.items())
        return (
            f"Gradient, {self.kind}: {slopes}; {self.of} {self.level:.6g} +- {self.level_ci:.2g} {unit}; "
            f"flags: {', '.join(self.flags) or 'none'}"
        )


def _row(slope: "Slope") -> dict[str, Any]:
    """One lane's numbers."""
    numbers = {name: getattr(slope, name) for name in OWN}
    kind = np.int8(KINDS.index(slope.kind))
    return {**numbers, "derivative": slope.value, "derivative_ci": slope.ci, "number_of_kind": kind}
