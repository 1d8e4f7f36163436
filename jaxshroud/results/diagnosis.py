"""What is known of one scene's motion: a stretch of its run, the verdict on its kind, and the evidence."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.gathered import Complex
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.results.variable import Attribute, Variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Diagnosis(Trajectory):
    """A run of settled motion, and the verdict on it.

    The samples are those of the periods after all that the evidence comes from; of a scene that stops, of its start.
    """

    stored_as = "diagnosis"

    verdict = Attribute(str)  # "period 2", "quasi-periodic", "chaotic", "transient not over", "undecided", "stopped"
    evidence = Attribute(str)  # the verdict with what speaks for it, a sentence
    period_number = Attribute(int)  # 0 where the motion is not periodic
    periods = Attribute(int)  # run before the samples
    return_error = Attribute()  # how nearly samples return, of their size
    largest_exponent = Attribute()  # per drive period, from one tangent of a stretch of its own
    largest_exponent_ci = Attribute()
    K = Attribute()  # of the 0-1 test
    exponents = Variable("Lyapunov exponents per drive period; -inf: forgotten altogether", "1", ("direction",))
    exponents_ci = Variable("half width of the 95 % interval", "1", ("direction",))
    multipliers = Complex("Floquet multipliers, largest first, the slider's own among them", "1", ("multiplier",))
    n = Variable("number of periods averaged over", None, ("curve",))
    P_d = Variable("vibration-power reduction over the first n periods", "percent", ("curve",))
    P_d_ci = Variable("half width of its 95 % interval; NaN below two batches", "percent", ("curve",))
    P_d_settled = Attribute(bool)

    @property
    def largest_force(self) -> float:
        """Largest resultant of normal and friction force among the samples [N]; NaN of a model without contact."""
        if self.N is None:
            return float("nan")
        return float(np.nanmax(np.hypot(self.N, self.F)))

    @property
    def powers(self) -> dict[str, float]:
        """Mean powers over the samples [W]: of the drive, lost in the dampers, lost in friction."""
        names = {"drive": self.work_drive, "viscous": self.loss_viscous, "friction": self.loss_friction}
        return {name: work / float(self.t[-1] - self.t[0]) for name, work in names.items() if work is not None}

    @property
    def summary(self) -> dict[str, Any]:
        """Everything but the samples, as plain numbers."""
        final = {} if self.P_d is None else {"P_d": float(self.P_d[-1]), "P_d_ci": float(self.P_d_ci[-1])}
        names = ("verdict", "evidence", "period_number", "periods", "return_error", "K")
        return {
            **{name: getattr(self, name) for name in names},
            "largest_exponent": [self.largest_exponent, self.largest_exponent_ci],
            "exponents": _rows(self.exponents, self.exponents_ci),
            "multipliers": [] if (mu := self.multipliers) is None else _rows(mu.real, mu.imag),
            **final,
            "P_d_settled": self.P_d_settled,
            "time": {name: getattr(self, f"time_{name}") for name in ("apart", "stick", "slip")},
            "largest_force": self.largest_force,
            "power": self.powers,
            "energy_residual": self.energy_residual,
            "energy_dropped": self.energy_dropped,
            "status": self.status,
        }

    @property
    def has_multipliers(self) -> bool:
        """Whether a stable orbit was closed."""
        return "multipliers_real" in self.data

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """The whole as one page, or a panel of the run.

        Args:
            ax: Draw there, and only the panel named by `panel`, as for a run.
            options: As for a run; with `kind` a picture of the run in place of the page.
        """
        from jaxshroud.results.plot_diagnosis import page

        return page(self) if ax is None and "kind" not in options else super().plot(ax, **options)

    def __repr__(self) -> str:
        return f"Diagnosis: {self.evidence}"


def _rows(*columns: np.ndarray | None) -> list[list[float]]:
    """Numbers of columns, row by row."""
    known = [np.asarray(column, float).tolist() for column in columns if column is not None]
    return [list(row) for row in zip(*known, strict=True)]
