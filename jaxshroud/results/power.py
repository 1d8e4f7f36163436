"""The convergence of P_d with the number of averaged periods."""

from typing import Any

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Variable
from jaxshroud.motion.effects import told_difference, with_interval
from jaxshroud.results.amplitudes import WithAmplitudes, WithLoads
from jaxshroud.results.base import Result
from jaxshroud.results.equivalent import WithEquivalent, sentences_of
from jaxshroud.scene.checks import InputError


class FinalNumber(Variable):
    """A number of the final answer: a plain number for a single scene."""

    def __init__(self, long_name: str, units: str | None = None, kind: type = float):
        super().__init__(long_name, units, kind=kind, stored=np.int8 if kind is bool else None, alone=True)


class PowerResult(WithAmplitudes, WithLoads, WithEquivalent, Result):
    """P_d of the left blade, or of all blades of a row, against the number of averaged periods.

    Arrays start with the axes of the scenes. The curves of lanes with fewer points are filled up with n = 0 and NaN.
    The picture of a single scene has one panel, "P_d".
    """

    stored_as = "power"

    n = Variable("number of periods averaged over", None, ("curve",))
    P_d = Variable("average of P_d over the first n kept periods", "percent", ("curve",))
    P_d_ci = Variable("half width of its 95 % interval; NaN below two batches", "percent", ("curve",))
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    final_n = FinalNumber("periods averaged over", kind=int)
    final_P_d = FinalNumber(
        "vibration-power reduction of the left blade, Eq. (24), or of all blades of a row", "percent"
    )
    final_P_d_worst = FinalNumber("reduction of the blade of a row that gains the least; in rows only", "percent")
    final_ci = FinalNumber("half width of its 95 % interval", "percent")
    final_P_d_vibration = FinalNumber("reduction of the vibration about the mean position alone", "percent")
    final_P_d_vibration_ci = FinalNumber("half width of its 95 % interval", "percent")
    final_change = FinalNumber("change of P_d since half as many periods", "percent")
    final_tolerance = FinalNumber("at which P_d counts as stable", "percent")
    final_stable = FinalNumber("P_d is known to the tolerance", kind=bool)
    final_settled = FinalNumber("P_d no longer drifts, on evidence", kind=bool)
    final_settling = FinalNumber("P_d no longer drifts; 0: no, 1: yes, 2: unknown", kind=int)
    final_periods_more = FinalNumber(
        "drive periods of transient to add until P_d no longer drifts; NaN if unknown", "1"
    )
    final_ci_short = FinalNumber("too few correlation times for the interval", kind=bool)
    final_period_number = FinalNumber("period of the orbit in drive periods; 0: aperiodic", kind=int)
    final_P = Variable("average power, Eq. (23)", "m4", ("blade",))
    final_P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    final_energy_residual = FinalNumber("largest energy residual of a period over the drive's mean work", "1")

    @property
    def final(self) -> dict[str, Any]:
        """The final answer: n, P_d, ci, settled, settling, stable, period_number, P, P_0, status, method and more.

        The values are plain numbers for a single scene and arrays for many.
        """
        names = [name for name in self.variables if name.startswith("final_")]
        values = {name.removeprefix("final_"): getattr(self, name) for name in names}
        if values["P_d_worst"] is None:
            del values["P_d_worst"]
        if not np.ndim(self.status):
            values |= {name: values[name].tolist() for name in ("P", "P_0")}
        return {**values, "status": self.status, "method": self.method, "chatter": self.chatter}

    @property
    def static_deflection(self) -> str:
        """One sentence where a static deflection makes P_d differ from that of the vibration alone; else empty."""
        return told_difference(self.final_P_d, self.final_P_d_vibration)

    @property
    def mechanism(self) -> str:
        """What contact does to the vibration of a single scene, in words with numbers.

        Raises:
            ValueError: There are many scenes.
        """
        self._check_single("The mechanism is told of one scene")
        return sentences_of(self)

    def summary(self) -> dict[str, JSONValue]:
        """The curve and the final answer in plain numbers, as `power.json` holds them."""
        numbers = {"n": self.n, "P_d": self.P_d, "P_d_ci": self.P_d_ci, "final": self.final}
        numbers |= {"static_deflection": self.static_deflection} if self.static_deflection else {}
        kinds = {"equivalent": WithEquivalent, "amplitudes": WithAmplitudes, "loads": WithLoads}
        return json_values({**self.origin, **numbers, **{name: self._kept(one) for name, one in kinds.items()}})

    def _kept(self, kind: type) -> dict[str, Any]:
        """The variables of a kind that the run was asked for."""
        values = {name: getattr(self, name) for name, one in vars(kind).items() if isinstance(one, Variable)}
        return {name: np.asarray(value).tolist() for name, value in values.items() if value is not None}

    def _check_single(self, what: str) -> None:
        """Raise InputError if there are many scenes."""
        if np.ndim(self.status):
            raise InputError(f"{what} of many: choose it by `lane`.")

    def _picture_content(self) -> dict[str, object]:
        self._check_single("A picture shows one scene")
        curve = {"n": self.n, "P_d": self.P_d, "P_d_ci": self.P_d_ci}
        return {"title": self.data.attrs.get("title", ""), **curve, "final": self.final}

    def __repr__(self) -> str:
        final = self.final
        if np.ndim(self.status):
            lanes = " x ".join(map(str, np.shape(self.status)))
            return f"PowerResult of {lanes} lanes: {np.sum(final['stable'])} stable; {self.ended}; {self.method}"
        motion = f"period {final['period_number']}" if final["period_number"] else "aperiodic"
        return (
            f"PowerResult: P_d {with_interval(final['P_d'], final['ci'], '%')} over {final['n']} periods, {motion}, "
            f"{'' if final['stable'] else 'not '}stable; {self.ended.split(maxsplit=1)[1]}; {final['method']}"
        )
