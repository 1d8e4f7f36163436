"""What a sweep gives."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.results.base import Result
from jaxshroud.results.dimension import about, dimension
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Attribute, Counts, Moving, Variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIRECTION = "direction"  # dimension of sweeps in several directions
GAP = {"units": "m", "long_name": "initial gap"}
VERDICT = {"flag_values": [0, 1, 2], "flag_meanings": "no yes unknown"}
MORE = "drive periods of transient to add until {}; NaN if unknown"


class SweepResult(Result):
    """A sweep's stroboscopic samples and statistics.

    Arrays start with the axes of the scenes, then one dimension per axis of the sweep. Samples have a dimension
    `period` after these, and a last one for the blade where each blade has its own value. Statistics are over the kept
    periods.
    """

    stored_as = "sweep"
    never_without = ("status", "P_d", "period_number")

    motion = Moving("at the drive phase `phase` of each kept period; NaN after a lane has stopped", dims=("period",))
    P = Variable("average power, Eq. (23)", "m4", ("blade",))
    P_0 = Variable("average power without contact, closed form", "m4", ("blade",))
    P_d = Variable("vibration-power reduction of the left blade, Eq. (24)", "percent")
    P_d_ci = Variable("half width of the 95 % interval of P_d, batch means", "percent")
    P_d_ci_short = Variable("too few correlation times for P_d_ci", stored=np.int8, kind=bool)
    P_d_settled = Variable("P_d no longer drifts, on evidence", stored=np.int8, kind=bool)
    P_d_settling = Variable("P_d no longer drifts", more=VERDICT)
    P_d_periods_more = Variable(MORE.format("P_d no longer drifts"), "1")
    period_number = Variable("period of the orbit in drive periods; 0: aperiodic")
    settled = Variable("the transient is over, on evidence", stored=np.int8, kind=bool)
    settling = Variable("the transient is over", more=VERDICT)
    periods_more = Variable(MORE.format("it is over"), "1")
    status = Variable("", stored=np.int8, kind=np.int32, more=FLAGS)
    v_max = Variable("largest penetration", "m")
    time_apart = Variable("fraction of the time: apart", "1")
    time_stick = Variable("fraction of the time: stick", "1")
    time_slip = Variable("fraction of the time: slip", "1")
    lyapunov = Variable("largest Lyapunov exponent per drive period; -inf: forgotten altogether", "1")
    lyapunov_ci = Variable("half width of its 95 % interval", "1")
    energy_residual = Variable("largest energy residual of a period over the drive's mean work", "1")
    energy_dropped = Variable(
        "largest energy dropped in a period by beginnings of flat contact, over the drive's gross work", "1"
    )
    N_max = Variable("largest normal force of contact", "N")
    F_max = Variable("largest magnitude of the friction force", "N")
    friction_work = Variable("work that friction takes in a drive period, on average", "J")
    counters = Counts("events in the kept periods")
    phase = Attribute(name="drive_phase")  # of the samples [rad]
    period_tol = Attribute()  # of the period number
    jump = Variable("", stored=np.int8, kind=bool)  # of sweeps in several directions, like the next
    coexisting = Variable("", stored=np.int8, kind=bool)
    inaccurate = Variable("estimated to miss the accuracy asked for", stored=np.int8, kind=bool)

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """Key -> values (n,) in SI, of each axis of the sweep."""
        named = [self.data[dim] for dim in self.dims if "key" in self.data[dim].attrs]
        return {str(axis.attrs["key"]): axis.to_numpy() for axis in named}

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the leading dimensions."""
        return tuple(map(str, self.data["status"].dims))

    @property
    def period(self) -> np.ndarray:
        """Absolute count of each kept period, (period,)."""
        return self.data["period"].to_numpy()

    @property
    def gap(self) -> np.ndarray:
        """Initial gap of each lane [m]."""
        return self.data["gap"].broadcast_like(self.data["status"]).transpose(*self.dims).to_numpy()

    @property
    def complete(self) -> bool:
        """Whether all lanes were run; False only in the result that an interruption leaves."""
        return not np.any(self.status == Status.NOT_RUN)

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Samples, period number and P_d over one axis, or a map of P_d over two.

        Args:
            ax: Draw there, and only the panel named by `panel`.
            options: `panel`: "samples" or "P_d" over one axis; "P_d" or "motions" over two; "lyapunov" over either,
                where exponents were computed. A title, xlabel, unit of displacements and of lengths that are swept
                ("mm", "um", "m" or "gap", for x over the gap), width [mm] and matplotlib style.

        Raises:
            ValueError: The sweep has neither one axis nor two, or no such panel.
        """
        from jaxshroud.results import plot

        return plot.sweep(self.data, ax, **options)

    def __repr__(self) -> str:
        lanes = [f"{dim} ({self.data.sizes[dim]})" for dim in self.dims if "key" not in self.data[dim].attrs]
        along = " x ".join([*lanes, *(f"{key} ({len(v)}: {v[0]:g} to {v[-1]:g})" for key, v in self.axes.items())])
        best = np.nanmax(self.P_d, initial=-np.inf, where=self.status == Status.OK)
        place = f"along {along}" if along else "of one lane"
        periods = f"{len(self.period)} period" + "s" * (len(self.period) != 1)
        return (
            f"SweepResult {place}: {periods} kept of each lane; {self.ended}; "
            f"largest P_d {best:.4g} %; {self.method}, {self.steps_per_period} steps a period"
        )


def sweep_coordinates(axes: Mapping[str, np.ndarray], period: np.ndarray) -> dict[str, Any]:
    """Coordinates of a sweep as xarray takes them.

    Args:
        axes: Key -> values of each axis.
        period: Absolute count of each kept period.
    """
    swept = {dimension(key): (dimension(key), values, about(key)) for key, values in axes.items()}
    return {**swept, "period": ("period", period, {"long_name": "drive periods since t = 0"}), "blade": [0, 1]}
