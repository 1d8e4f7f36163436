"""A table of designs with the numbers of each, ranked."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.io.convert import columns_by_place
from jaxshroud.io.files import write
from jaxshroud.io.lane_status import count_by_status, status_name
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import WithAmplitudes, WithLoads
from jaxshroud.results.base import Result
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.quantities import is_reduction
from jaxshroud.scene.typed import typed
from jaxshroud.signals.effects import mean_shift_text, too_few_periods_text
from jaxshroud.signals.period import MIN_APERIODIC_PERIODS

if TYPE_CHECKING:
    import pandas as pd

RANK, ROW = "rank", "row"
UNDECIDED_MOTION = "undecided"  # a verdict


class DesignTable(WithAmplitudes, WithLoads, Result):
    """A table of designs: what was given, and the numbers of each row, in the order of the rows.

    Rows that are wrong have the status BAD_INPUT and a `reason`; their numbers are NaN. With rows that stopped they
    have no rank (0) and come last. Blades come last in arrays that have a value for each: two, or those of a row;
    so do interfaces in the loads of a row.
    """

    stored_as = "table"
    required = ("status", "rank", "cells")

    cells = Variable("the table as it was given, as texts", None, ("column",))
    rank = Variable("place of the design, from 1; equal designs share one; 0: none")
    status = Variable(
        "how each row ended",
        stored=np.int8,
        kind=np.int32,
        more={"flag_values": [int(s) for s in Status], "flag_meanings": " ".join(s.name for s in Status)},
    )
    reason = Variable("why a row is wrong")
    verdict = Variable("the motion in words: its period, aperiodic, transient not over, undecided, stopped, not run")
    P_d = SweepResult.P_d
    P_d_worst = SweepResult.P_d_worst
    P_d_ci = SweepResult.P_d_ci
    P_d_vibration = SweepResult.P_d_vibration
    P_d_vibration_ci = SweepResult.P_d_vibration_ci
    P_d_ci_short = SweepResult.P_d_ci_short
    P_d_settled = SweepResult.P_d_settled
    stable = Variable(
        "P_d is known to 0.1 percentage points: settled, and its interval is as short", stored=np.int8, kind=bool
    )
    n = Variable("periods averaged over")
    period_number = SweepResult.period_number
    settled = SweepResult.settled
    periods_more = SweepResult.periods_more
    P = SweepResult.P
    P_0 = SweepResult.P_0
    v_max = SweepResult.v_max
    time_apart = SweepResult.time_apart
    time_stick = SweepResult.time_stick
    time_slip = SweepResult.time_slip
    inaccurate = SweepResult.inaccurate
    energy_residual = SweepResult.energy_residual
    by = Attribute(str)  # the number by which designs are ranked

    @property
    def ranked(self) -> "pd.DataFrame":
        """The table in the order of the ranks, then the rows without one."""
        return self._in_order(self.to_pandas())

    @typed
    def to_pandas(self) -> "pd.DataFrame":
        """The table with the numbers of each row: given columns as numbers where all of their cells are, else texts.

        The index is the number of the row, from 1; heads have units. Numbers per blade or interface have a column for
        each.
        """
        import pandas as pd

        frame = self._frame()
        for head in self.heads:
            try:
                frame[head] = pd.to_numeric(frame[head])
            except ValueError:
                continue
        return frame

    @property
    def heads(self) -> tuple[str, ...]:
        """The heads of the columns that were given."""
        return tuple(map(str, self.data["column"].to_numpy()))

    def _in_order(self, frame: "pd.DataFrame") -> "pd.DataFrame":
        return frame.iloc[np.argsort(np.where(self.rank > 0, self.rank, np.inf), kind="stable")]

    def _frame(self) -> "pd.DataFrame":
        """The rows with the cells as they were given."""
        import pandas as pd

        rank = pd.array(self.rank, dtype="Int64")
        rank[self.rank == 0] = pd.NA
        columns: dict[str, Any] = {RANK: rank, **dict(zip(self.heads, self.cells.T, strict=True))}
        ordered = [name for name in {**vars(DesignTable), **self.variables} if name in self.data.data_vars]
        for name in (name for name in ordered if name not in (RANK, "cells")):
            columns |= {head: column.to_numpy() for head, column in columns_by_place(name, self.data[name])}
        columns["status"] = np.array([status_name(code) for code in self.status.tolist()])
        return pd.DataFrame(columns, index=pd.Index(self.data[ROW].to_numpy(), name=ROW))

    @typed
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the ranked table as .csv, given cells as they were, or the dataset as .nc; completely or not at all.

        Raises:
            InputError: The suffix is neither.
            WriteError: The place cannot be written.
        """
        path = Path(path)
        if path.suffix == ".nc":
            super().save(path)
        elif path.suffix == ".csv":
            ends = (
                "\r\n" if np.any(np.char.find(self.cells.astype(str), "\r") >= 0) else "\n"
            )  # which quotes those cells
            write(path, self._in_order(self._frame()).to_csv(lineterminator=ends).encode())
        else:
            raise InputError(f"{path}: must end in .csv, the ranked table, or in .nc")

    def summary(self) -> dict[str, JSONValue]:
        """The counts of rows, statuses and verdicts, and the best row."""
        words, counts = np.unique(self.verdict.astype(str), return_counts=True)
        return json_values(
            {
                "rows": len(self.rank),
                "status": count_by_status(self.status),
                "verdicts": dict(zip(words.tolist(), counts.tolist(), strict=True)),
                **({"too few periods": self.too_few_periods} if self.too_few_periods else {}),
                "ranked by": str(self.by),
                "best": self._best_row(),
                **({"mean position": self.mean_shift} if self.mean_shift else {}),
                "method": f"{self.method}, {self.steps_per_period} steps a period",
                **self.origin,
            }
        )

    @property
    def too_few_periods(self) -> str:
        """What to say where too few periods are kept to judge whether aperiodic motions have settled; else empty."""
        ok = self.status == Status.OK
        undecided = ok & (self.period_number == 0) & (self.verdict == UNDECIDED_MOTION)
        return too_few_periods_text(int(np.sum(undecided & (self.n < MIN_APERIODIC_PERIODS))), f"of {ok.sum()} runs")

    @property
    def mean_shift(self) -> str:
        """One sentence where contact shifts the mean position of a row's design; else empty."""
        P_d = np.where(self.status == Status.OK, self.P_d, np.nan)
        counted = str(self.by)
        counted = counted if is_reduction(counted) else "P_d"
        return mean_shift_text(P_d, self.P_d_vibration, counted, "--by ", lambda at: f"row {at + 1}")

    def _best_row(self) -> dict[str, object] | None:
        """The first row in rank, by its heads; None where no row has one."""
        if not (self.rank == 1).any():
            return None
        first = int(np.argmax(self.rank == 1))
        given = dict(zip(self.heads, self.cells[first].tolist(), strict=True))
        names = dict.fromkeys((str(self.by), "P_d"))  # of what has a value for each blade the largest
        numbers = {name: float(np.max(getattr(self, name)[first])) for name in names}
        return {ROW: first + 1, **given, **numbers, "verdict": str(self.verdict[first])}

    @property
    def wrong(self) -> list[str]:
        """The reason of each row that is wrong, with its number."""
        return [f"row {i + 1}: {reason}" for i, reason in enumerate(self.reason.tolist()) if reason]

    def __repr__(self) -> str:
        statuses = ", ".join(f"{n} {name}" for name, n in count_by_status(self.status).items())
        return f"DesignTable of {np.size(self.rank)} rows ranked by {self.by}: {statuses}; {self.method}"
