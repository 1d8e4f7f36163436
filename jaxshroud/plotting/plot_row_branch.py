"""Pictures of branches of rows: the amplitude of every blade, the largest multiplier, and P_d."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxshroud.model.modes import Status
from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.plot_amplitude import amplitude_unit
from jaxshroud.plotting.plot_branch import (
    BranchData,
    branch_data,
    draw_branch_lines,
    draw_multiplier,
    finish_branch,
    sweep_values,
)
from jaxshroud.plotting.scales import LEAST_SPAN, limit_zoom, title_of
from jaxshroud.plotting.style import COLUMN_WIDTH, DEFAULT_LOOK, GREY, SKY, Look, Properties

SWEEP_LOOK: Properties = {"ms": 2, "mew": 0, "color": GREY, "zorder": 1}


def row_branch_page(ds: xr.Dataset, look: Look, *, over: xr.Dataset | None = None) -> Page[BranchData]:
    """Branches of a row over the number along which they were followed.

    Args:
        ds: The branches.
        look: The appearance asked for; displacements and the number keep their units.
        over: A sweep along the same number, which is drawn behind the branches.

    Raises:
        ValueError: The sweep is along another number.
    """
    content = branch_data(ds, over)
    return Page(content, ROW_BRANCH_PANELS, title_of(ds), (COLUMN_WIDTH, 4.6), shared="x", finish=finish_branch)


def _draw_blades(panel: Axes, branches: BranchData) -> None:
    """The amplitude of each blade: one line where all are alike."""
    ds, (values, _, label), sweep = branches
    levels = ds["x_peak"].to_numpy()
    unit = amplitude_unit("x_peak", float(levels.max()), DEFAULT_LOOK)
    if sweep is not None and "x_peak" in sweep:
        _draw_sweep(panel, sweep, unit.factor * sweep["x_peak"].transpose(..., "blade").to_numpy())
    draw_branch_lines(panel, ds, values, unit.factor * levels)
    panel.set(xlabel=label, ylabel=unit.label.replace("_1", ""))


def _draw_sweep(panel: Axes, sweep: xr.Dataset, levels: np.ndarray) -> None:
    """The values (lanes, any) of a sweep whose lanes are OK."""
    ok = sweep["status"].to_numpy() == Status.OK
    panel.plot(sweep_values(sweep), np.where(ok[:, None], levels, np.nan), ".", **SWEEP_LOOK)


def _draw_reductions(panel: Axes, branches: BranchData) -> None:
    """P_d of the row, and in pale that of the worst blade where it differs."""
    ds, (values, _, label), sweep = branches
    row, worst = ds["P_d"].to_numpy(), ds["P_d_worst"].to_numpy()
    if sweep is not None:
        _draw_sweep(panel, sweep, sweep["P_d"].to_numpy()[:, None])
    if np.max(row - worst) > LEAST_SPAN:
        hidden = ds["retraced"].to_numpy() | (row - worst < 0.01 * LEAST_SPAN)
        panel.plot(values, np.where(hidden, np.nan, worst), ".", ms=2, color=SKY, label="worst blade")
        panel.legend(loc="best", frameon=False)
    draw_branch_lines(panel, ds, values, row[:, None])
    limit_zoom(panel, np.concatenate([row, worst]), LEAST_SPAN)
    panel.set(xlabel=label, ylabel="$P_d$ [%]")


ROW_BRANCH_PANELS = (
    Panel("amplitude", _draw_blades, 3),
    Panel("multiplier", draw_multiplier, 1.1),
    Panel("P_d", _draw_reductions, 1.5),
)
