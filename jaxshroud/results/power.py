"""What a convergence of P_d gives."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Variable
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Final(Variable):
    """One number of the answer."""

    def __init__(self, long_name: str, units: str | None = None, kind: type = float):
        super().__init__(long_name, units, kind=kind, stored=np.int8 if kind is bool else None, alone=True)


class PowerResult(Result):
    """P_d of the left blade against the number of averaged periods.

    Arrays start with the axes of the scenes. Lanes whose curve is shorter end with n = 0 and NaN.
    """

    stored_as = "power"

    n = Variable("number of periods averaged over", None, ("curve",))
    P_d = Variable("average of P_d over the first n kept periods", "percent", ("curve",))
    P_d_ci = Variable("half width of its 95 % interval; NaN below two batches", "percent", ("curve",))
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    final_n = Final("periods averaged over", kind=int)
    final_P_d = Final("vibration-power reduction of the left blade, Eq. (24)", "percent")
    final_ci = Final("half width of its 95 % interval", "percent")
    final_change = Final("change of P_d since half as many periods", "percent")
    final_tolerance = Final("at which P_d counts as stable", "percent")
    final_stable = Final("P_d is known to the tolerance", kind=bool)
    final_settled = Final("P_d no longer drifts, on evidence", kind=bool)
    final_settling = Final("P_d no longer drifts; 0: no, 1: yes, 2: unknown", kind=int)
    final_periods_more = Final("drive periods of transient to add until P_d no longer drifts; NaN if unknown", "1")
    final_ci_short = Final("too few correlation times for the interval", kind=bool)
    final_period_number = Final("period of the orbit in drive periods; 0: aperiodic", kind=int)
    final_P = Variable("average power, Eq. (23)", "m4", ("blade",))
    final_P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    final_energy_residual = Final("largest energy residual of a period over the drive's mean work", "1")

    @property
    def final(self) -> dict[str, Any]:
        """The answer: n, P_d, ci, settled, settling, stable, period_number, P, P_0, status, method and more.

        Plain numbers of a single scene, arrays of many.
        """
        names = [name for name in self.variables if name.startswith("final_")]
        found = {name.removeprefix("final_"): getattr(self, name) for name in names}
        if not np.ndim(self.status):
            found |= {name: found[name].tolist() for name in ("P", "P_0")}
        return {**found, "status": self.status, "method": self.method, "chatter": self.chatter}

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """P_d over the number of periods it is averaged over, of a single scene.

        Args:
            ax: Draw there.
            options: A title, xlabel, width [mm] and matplotlib style.

        Raises:
            ValueError: There are many scenes, of which `lane` gives one.
        """
        from jaxshroud.results import panels, plot_power
        from jaxshroud.results.drawing import Look
        from jaxshroud.results.look import on_axes

        if np.ndim(self.status):
            raise InputError("A picture shows one scene of many: choose it by `lane`.")
        data = {"title": self.data.attrs.get("title", ""), "n": self.n, "P_d": self.P_d, "P_d_ci": self.P_d_ci}
        data["final"] = self.final
        if ax is None:
            return plot_power.power_convergence(data, look=Look(**options))
        plot_power.draw(ax, data)
        on_axes(ax, Look(**options))
        return panels.figure_of(ax)

    def __repr__(self) -> str:
        end = self.final
        if np.ndim(self.status):
            lanes = " x ".join(map(str, np.shape(self.status)))
            return f"PowerResult of {lanes} lanes: {np.sum(end['stable'])} stable; {self.ended}; {self.method}"
        motion = f"period {end['period_number']}" if end["period_number"] else "aperiodic"
        return (
            f"PowerResult: P_d {end['P_d']:.6g} +- {end['ci']:.2g} % over {end['n']} periods, {motion}, "
            f"{'' if end['stable'] else 'not '}stable; {self.ended.split(maxsplit=1)[1]}; {end['method']}"
        )
