"""What pictures of runs and of sweeps share: scales, limits, titles and legends."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxshroud.model.modes import Status
from jaxshroud.results.drawing import LENGTHS, Floats
from jaxshroud.results.status import named
from jaxshroud.results.words import fitting
from jaxshroud.scene.checks import word_argument
from jaxshroud.scene.errors import InputError

LEAST = 0.1  # percentage points on an axis of P_d: less would show what rounding leaves of a periodic orbit
HAIR = 3e-3  # of an axis: what is narrower cannot be seen


class Scale(NamedTuple):
    """How displacements are drawn: x / gap or, where a gap is not positive, in mm."""

    factor: Any  # times x [m]; a number, or one per lane
    symbol: str  # with a place for the blade
    unit: str

    def label(self, blade: str) -> str:
        """Axis label of a displacement."""
        return f"${self.symbol.format(blade)}${self.unit}"


def scale_of(gap: Floats, unit: str | None = None) -> Scale:
    """How displacements are drawn where gaps are such, in a unit of `LENGTHS` or over the gap if that is asked for.

    Raises:
        ValueError: A gap to be divided by is not positive, or there is no such unit.
    """
    if unit in LENGTHS:
        return Scale(LENGTHS[unit][1], "x_{}", f" [{LENGTHS[unit][0]}]")
    if unit is not None:
        word_argument("unit", unit, (*LENGTHS, "gap"))
        if not (gap > 0).all():
            raise InputError("Displacements can be drawn over the gap only where it is positive; give another unit.")
    return Scale(1 / gap, r"x_{}/\Delta", "") if (gap > 0).all() else Scale(1e3, "x_{}", " [mm]")


def limits(values: Floats, least: float = 0.0) -> tuple[float, float]:
    """Ends of an axis that shows `values` with a margin and is at least `least` long."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    half = max(0.55 * (high - low), least / 2) or 1.0
    return (low + high) / 2 - half, (low + high) / 2 + half


def zoom_no_further(panel: Axes, values: Floats, least: float) -> None:
    """A vertical axis at least so long, where `values` differ by less: what settles would show its last digits."""
    values = values[np.isfinite(values)]
    if values.size and np.ptp(values) < least:
        panel.set_ylim(limits(values, least))


def interval(P_d: Floats, ci: Floats) -> tuple[Floats, Floats]:
    """Ends of the interval; none where it is not known."""
    half = np.where(np.isfinite(ci), ci, np.nan)
    return P_d - half, P_d + half


def is_seen(half: Floats, around: Floats) -> bool:
    """Whether a band of that half width around values of P_d is wider than a hair on an axis that shows them."""
    band, values = half[np.isfinite(half)], around[np.isfinite(around)]
    return bool(band.size) and bool(values.size) and float(band.max()) > HAIR * max(float(np.ptp(values)), LEAST)


def title_of(ds: xr.Dataset) -> str:
    """The title of a result if it fits what was varied, with how it ended if that was early."""
    status = int(ds.attrs.get("status", Status.OK))
    varied = [str(a.attrs["key"]) for a in ds.variables.values() if "key" in a.attrs]
    stopped = f"(stopped: {named(status)})" if status else ""
    return " ".join(filter(None, (fitting(str(ds.attrs.get("title", "")), varied), stopped)))


def legend_above(panel: Axes) -> None:
    """A legend above a panel, if it has something to tell."""
    handles = panel.get_legend_handles_labels()[0]
    style: Any = {"bbox_to_anchor": (0, 1), "borderpad": 0.2, "borderaxespad": 0}
    if handles:
        panel.legend(handles=handles, loc="lower left", ncols=2 if len(handles) == 2 else 1, **style)


def panel_of(panels: Mapping[str, Callable], asked: str | None) -> Callable:
    """The panel asked for, by default the first.

    Raises:
        ValueError: There is no such panel.
    """
    if asked is not None:
        word_argument("panel", asked, tuple(panels))
    return panels[asked or next(iter(panels))]


def figure_of(ax: Axes) -> Figure:
    """The figure that axes are in."""
    figure = ax.get_figure(root=True)
    assert figure is not None  # axes that were removed cannot be drawn in
    return figure
