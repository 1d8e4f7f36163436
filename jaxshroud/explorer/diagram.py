"""A bifurcation diagram that becomes finer: the values of each level lie between those of the levels before."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.march.method import Method
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import Direction
from jaxshroud.verbs.sweep import sweep

COARSE_VALUES = 200
DIAGRAM_LEVELS = 3  # each with half the spacing of the one before
MAP_COARSE, MAP_LEVELS = 13, 3  # values along each key of a map
ReportPeriods = Callable[[float, int], None]  # lane-periods done, and in all


class Window(NamedTuple):
    """The part of a key's values that a diagram shows, in SI units."""

    key: str
    start: float
    stop: float

    def values(self, level: int, coarse: int = COARSE_VALUES) -> np.ndarray:
        """All values of a level, equally spaced; every second one is, to the last bit, of the level before."""
        return np.linspace(self.start, self.stop, (coarse - 1) * 2**level + 1)

    def new_values(self, level: int, coarse: int = COARSE_VALUES) -> np.ndarray:
        """The values of a level that no level before has."""
        return self.values(level, coarse)[1::2] if level else self.values(0, coarse)


class Amount(NamedTuple):
    """How much is computed: drive periods of each lane of a diagram and of a motion, values, and levels."""

    transient: int = 32
    kept: int = 32
    motion: int = 100
    values: int = COARSE_VALUES
    levels: int = DIAGRAM_LEVELS
    map_levels: int = MAP_LEVELS


OF_A_ROW = Amount(8, 8, 16, 64, 1, 1)  # a chunk of lanes, whose periods take as many times longer as it has blades


def diagram(
    file: SceneFile,
    window: Window,
    values: np.ndarray,
    direction: Direction,
    amount: Amount,
    method: Method,
    report: ReportPeriods,
) -> SweepResult:
    """A sweep over values of a key, as the command makes it."""
    return sweep(
        file,
        {window.key: values},
        direction=direction,
        n_periods=amount.kept,
        transient=amount.transient,
        method=method,
        amplitudes=True,
        progress=report,
    )


def map_piece(
    file: SceneFile, axes: dict[str, np.ndarray], amount: Amount, method: Method, report: ReportPeriods
) -> SweepResult:
    """A sweep over two keys, without samples."""
    run: dict[str, Any] = {"n_periods": amount.kept, "transient": amount.transient}
    return sweep(file, axes, method=method, keep_samples=False, amplitudes=True, progress=report, **run)


def map_axes(across: Window, up: Window, level: int) -> list[dict[str, np.ndarray]]:
    """The grids whose lanes a level of a map adds to the level before."""
    x, y = (window.values(level, MAP_COARSE) for window in (across, up))
    if not level:
        return [{across.key: x, up.key: y}]
    return [{across.key: x[1::2], up.key: y[::2]}, {across.key: x, up.key: y[1::2]}]


def joined(results: Sequence[SweepResult], dim: str | None = None) -> SweepResult:
    """Sweeps over different values of a key as one result, with the values in order.

    Args:
        results: The sweeps; of two keys, they have the same values of the other.
        dim: The dimension of the key; by default the only one.
    """
    import xarray as xr

    if len(results) == 1:
        return results[0]
    along = dim or next(name for name in results[0].dims if name != "direction")
    data = results[0].data
    of_lanes = [str(name) for name, a in data.data_vars.items() if along in a.dims]
    parts = [r.data[of_lanes] for r in results]
    lanes = xr.concat(parts, dim=along, combine_attrs="override", data_vars="all").sortby(along)
    return SweepResult(lanes.assign_attrs(data.attrs))


def joined_map(coarse: SweepResult, added: Sequence[SweepResult]) -> SweepResult:
    """A map with the lanes that the next level adds, see `map_axes`."""
    across, up = coarse.dims
    beside, between = added
    return joined([joined([coarse, beside], across), between], up)
