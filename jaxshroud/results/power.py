"""The convergence of P_d with the number of averaged periods, and what contact does to the vibration.

The latter are losses and equivalents of the first harmonic.
"""

from typing import Any

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Variable
from jaxshroud.results.amplitudes import ENERGY_DROPPED, WithAmplitudes, WithLoads
from jaxshroud.results.base import Result
from jaxshroud.scene.checks import InputError
from jaxshroud.signals.effects import mean_shift_text, with_interval

STIFFNESS = "first-harmonic equivalent stiffness of contact along the {} of the faces; NaN if unknown"
DAMPING = "first-harmonic equivalent damping of contact along the {} of the faces; NaN if unknown"
RATIO = "damping ratio that it adds to the relative motion along the {} of the faces; NaN if unknown"


LEAST_TOLD = 0.005  # percent of the drive's work: less is not reported


class LaneNumber(Variable):
    """A number of each lane: a plain number for a single scene."""

    def __init__(self, long_name: str, units: str):
        super().__init__(long_name, units, kind=float, alone=True)


class WithEquivalent:
    """Where the drive's work goes, and the spring and damper to which contact amounts in the first harmonic."""

    work_drive = LaneNumber("work of the drive in a period, on average", "J")
    loss_viscous = LaneNumber("lost in the dampers in a period, on average", "J")
    loss_friction = LaneNumber("lost in friction in a period, on average", "J")
    work_switches = LaneNumber("given to the contact springs by case switches under load in a period, on average", "J")
    loss_flat = LaneNumber("dropped where face-to-face contact begins in a period, on average", "J")
    k_n = LaneNumber(STIFFNESS.format("normal"), "N m-1")
    k_t = LaneNumber(STIFFNESS.format("tangent"), "N m-1")
    c_n = LaneNumber(DAMPING.format("normal"), "N s m-1")
    c_t = LaneNumber(DAMPING.format("tangent"), "N s m-1")
    zeta_n = LaneNumber(RATIO.format("normal"), "1")
    zeta_t = LaneNumber(RATIO.format("tangent"), "1")
    touches = LaneNumber("whether the faces touch: 1, or 0 where they never do; NaN if unknown", "1")
    P_d_stiffness = LaneNumber("P_d of the linear blades with the equivalent stiffness alone", "percent")


RESONANCE = "Undamped at resonance, the blade alone would move without end: P_d is 100 % of any motion."


def sentences_of(result: Any) -> str:
    """What contact of one scene does, in words with numbers."""
    gained = result.work_switches
    dropped = result.loss_flat
    work = result.loss_friction + result.loss_viscous + dropped - gained  # of the drive, where nothing is stored
    if not work > 0:
        return "The losses are unknown." if np.isnan(work) else "Nothing is lost."

    def share(part):
        return 100 * part / work

    friction, viscous = share(result.loss_friction), share(result.loss_viscous)
    losses = [f"{friction:.3g} % is lost in friction", f"{viscous:.3g} % in the dampers"]
    if abs(share(dropped)) >= LEAST_TOLD:
        losses.append(f"{share(dropped):.2g} % where face-to-face contact begins")
    words = f"Of the drive's work {', '.join(losses)}"
    if abs(share(gained)) >= LEAST_TOLD:
        does = "give" if gained > 0 else "take"
        words += f"; case switches under load {does} {abs(share(gained)):.2g} %"
    words += "."
    if result.P_d_stiffness is None:  # of a row
        return words
    if np.isinf(result.final_P_0[0]):
        words = f"{RESONANCE} {words}"
    if not np.isfinite(result.P_d_stiffness):
        return f"{words} No equivalent of contact: {_unknown_because(result)}."
    numbers = {name: (getattr(result, f"k_{a}"), getattr(result, f"zeta_{a}")) for name, a in DIRECTIONS}
    along = [_direction(name, *values) for name, values in numbers.items() if np.isfinite(values[0])]
    still = [f"; what vibrates does not move along the {name}" for name, (k, _) in numbers.items() if np.isnan(k)]
    alone = f"that stiffness alone would give P_d = {result.P_d_stiffness:.4g} %"
    return f"{words} In the first harmonic contact acts as {' and '.join(along)}{''.join(still)}; {alone}."


DIRECTIONS = (("normal", "n"), ("tangent", "t"))


def _direction(name: str, stiffness: float, ratio: float) -> str:
    damping = f"a damping ratio of {100 * ratio:.3g} %" if np.isfinite(ratio) else "a damping of unknown ratio"
    return f"{stiffness:.4g} N/m with {damping} along the {name} of the faces"


def _unknown_because(result: Any) -> str:
    """Why the first harmonic gives no equivalent."""
    if not result.final["settling"]:
        return "the motion has not settled; give a longer transient"
    if result.touches == 0:
        return "the faces never touch"
    if result.touches == 1:
        return "the blocks do not move against each other"
    return "it takes contact, and lumped blades that move along x and y"


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
    final_energy_dropped = FinalNumber(ENERGY_DROPPED, "1")

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
    def mean_shift(self) -> str:
        """One sentence where contact shifts the mean position, which P_d counts as vibration; else empty."""
        return mean_shift_text(self.final_P_d, self.final_P_d_vibration)

    @property
    def mechanism(self) -> str:
        """What contact does to the vibration of a single scene, in words with numbers.

        Raises:
            ValueError: There are many scenes.
        """
        self._check_single("The mechanism is that of one scene")
        return sentences_of(self)

    def summary(self) -> dict[str, JSONValue]:
        """The curve and the final answer in plain numbers, as `power.json` holds them."""
        numbers = {"n": self.n, "P_d": self.P_d, "P_d_ci": self.P_d_ci, "final": self.final}
        numbers |= {"mean position": self.mean_shift} if self.mean_shift else {}
        kinds = {"equivalent": WithEquivalent, "amplitudes": WithAmplitudes, "loads": WithLoads}
        return json_values({**self.origin, **numbers, **{name: self._kept(one) for name, one in kinds.items()}})

    def _kept(self, kind: type) -> dict[str, Any]:
        """The variables of a kind that were requested of the run."""
        values = {name: getattr(self, name) for name, one in vars(kind).items() if isinstance(one, Variable)}
        return {name: np.asarray(value).tolist() for name, value in values.items() if value is not None}

    def _check_single(self, what: str) -> None:
        """Raise InputError if there are many scenes."""
        if np.ndim(self.status):
            raise InputError(f"{what} of many: choose it by `lane`.")

    def _drawn(self) -> tuple[str, object]:
        self._check_single("A picture shows one scene")
        curve = {"n": self.n, "P_d": self.P_d, "P_d_ci": self.P_d_ci}
        return self.stored_as, {"title": self.data.attrs.get("title", ""), **curve, "final": self.final}

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
