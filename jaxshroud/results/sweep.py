"""What a sweep gives."""

from dataclasses import dataclass

import numpy as np

from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.scene.motion import Motion


@dataclass(frozen=True)
class SweepResult:
    """A sweep's stroboscopic samples and statistics.

    Arrays start with one dimension per axis of the sweep. Samples have a dimension `period` after these, and a last one
    for the blade where each blade has its own value. Statistics are over the kept periods.
    """

    axes: dict[str, np.ndarray]  # key -> values, in SI
    period: np.ndarray  # absolute count of each kept period
    motion: Motion  # at the drive phase `phase` of each kept period (..., period, 2); NaN after a lane has stopped
    phase: float  # [rad]
    gap: np.ndarray  # [m]
    P: np.ndarray  # (..., 2) [m^4], Eq. (23)
    P_0: np.ndarray  # (..., 2) [m^4]
    P_d: np.ndarray  # left blade, Eq. (24) [%]
    P_d_ci: np.ndarray  # half width of its 95 % interval [percentage points]
    P_d_settled: np.ndarray  # True: on evidence
    period_number: np.ndarray  # 0: aperiodic
    settled: np.ndarray  # True: the transient is over, on evidence
    period_tol: float
    status: np.ndarray
    energy_residual: np.ndarray | None  # largest of any kept period over the drive's mean work; None without a ledger
    time_apart: np.ndarray  # fractions of the time
    time_stick: np.ndarray
    time_slip: np.ndarray
    v_max: np.ndarray  # largest penetration, of the whole run [m]
    counters: dict[str, np.ndarray]
    steps_per_period: int
    method: Choices
    settling: np.ndarray  # 0: the transient is not over, 1: it is, 2: unknown
    periods_more: np.ndarray  # of transient until it is; NaN if unknown
    P_d_settling: np.ndarray  # 0: P_d still drifts, 1: it does not, 2: unknown
    P_d_periods_more: np.ndarray  # of transient until it no longer does; NaN if unknown
    P_d_ci_short: np.ndarray  # True: fewer than 30 correlation times, too few to trust the interval
    energy_dropped: np.ndarray | None = None  # by flat contact, largest of any kept period over the drive's gross work
    chatter: str | None = None  # what alternated in the first lane that stopped with TOO_MANY_EVENTS

    @property
    def complete(self) -> bool:
        """Whether all lanes were run; False only in the result that an interruption leaves."""
        return not np.any(self.status == Status.NOT_RUN)

    def __repr__(self) -> str:
        along = " x ".join(f"{key} ({len(v)}: {v[0]:g} to {v[-1]:g})" for key, v in self.axes.items())
        ended = ", ".join(
            f"{n} {Status(s).name}" for s, n in zip(*np.unique(self.status, return_counts=True), strict=True)
        )
        best = np.nanmax(self.P_d, initial=-np.inf, where=self.status == Status.OK)
        return (
            f"SweepResult along {along}: {len(self.period)} periods kept of each lane; {ended}; "
            f"largest P_d {best:.4g} %; {self.method}, {self.steps_per_period} steps a period"
        )
