"""Tables of designs: all rows marched as one batch, their numbers appended and ranked."""

import warnings
from typing import Any

import numpy as np

from jaxshroud.batch.plan import Progress
from jaxshroud.io.lane_status import LaneWarning, warn_failures
from jaxshroud.io.variable import Attribute
from jaxshroud.linear.held_contact import LinearState
from jaxshroud.march.method_names import LARGEST_FIRST, RANKED_BY
from jaxshroud.march.stability import lanes_that_auto_steps_follow
from jaxshroud.model.modes import Status
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.table import ROW, UNDECIDED_MOTION, DesignTable
from jaxshroud.scene.checks import InputError, SceneError, did_you_mean
from jaxshroud.scene.designs import Designs, read_designs
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import Layout, require_capability
from jaxshroud.scene.quantities import STRESSES, check_quantity
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.typed import typed
from jaxshroud.signals.amplitudes import check_vibration, counted_reduction
from jaxshroud.signals.period import NOT_SETTLED, SETTLED
from jaxshroud.verbs.arguments import MethodArgument, resolve_options
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.settled import default_state, in_state
from jaxshroud.verbs.sweep import sweep

STABLE_WITHIN = 0.1  # half width at which P_d counts as known [percentage points]


@typed
def table(
    scene: Scene | SceneFile,
    designs: object,
    *,
    by: str | None = None,
    linear: LinearState | None = None,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> DesignTable:
    """The numbers of many designs, and their ranks.

    Args:
        scene: The scene that has what the columns do not give, or a scene file, whose [run] counts where an argument is
            not given.
        designs: A mapping of heads to columns (n,), a pandas DataFrame, a structured array or an xarray Dataset. A head
            is a key and, in brackets, a unit: "shroud.gap [mm]", "drive.speed [rpm]", "blades.m[0] [g]"; without one
            numbers are in SI units. Cells are numbers, or texts with a unit of their own. A variable of a Dataset may
            have its unit as attribute `units`. Other columns, such as names, are carried along.
        by: The number by which designs are ranked; by default P_d, and where there is a mean load or interference
            P_d_vibration: the largest of these (in rows of blades also `P_d_worst`), or the smallest amplitude
            (`x_peak`, `theta_rms` and so on, `sigma_a` and `goodman` of the stress; the largest one of all blades) or
            load (`N_max`, `v_max`, `friction_work`, `slip`, `archard`, `impacts`, `F_max`, `approach_max`,
            `impulse_max`; of rows of blades the largest one of all interfaces).
        linear: "apart" or "stuck": in closed form, of contact that stays in this state; by default where that of all
            designs does, see `power`.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one for all rows; see `method_for`.
        progress: Called with (lane-periods done, lane-periods in all).

    Returns:
        The table. A row that is wrong (no number, an unknown unit, out of its range, too stiff to be followed) has the
        status BAD_INPUT and a reason; a row that stopped has its status. Neither has a rank, and no other row is
        affected. Rows run some thousands at a time, without samples. Where the scene has a row of N blades, powers and
        amplitudes have N columns each, and loads one for each interface; `v_max` and the shares of the time are those
        of all interfaces together; P_d is that of all blades, beside that of the worst one.

    Raises:
        SceneError: A head is wrong, two columns give one number, or no row is right.
        ValueError: There is no such number to rank by, no row has one, or a count is too small.
        Interrupted: Ctrl-C.

    Source:
        Eqs. (22) to (24) of the article; see `sweep`.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> short = dict(n_periods=2, transient=1, method=js.RungeKutta(steps=200))
        >>> found = js.table(scene, {"name": ["a", "b"], "shroud.gap [um]": [10, 20]}, **short)
        >>> found.rank.shape, found.x_peak.shape
        ((2,), (2, 2))
    """
    scene = in_state(scene, linear)
    base = one_scene("table", scene)
    by = by or counted_reduction(base)
    if by not in RANKED_BY:
        known = ", ".join(RANKED_BY)
        raise InputError(f"Argument `by` must be one of {known}, but is {by!r}{did_you_mean(by, RANKED_BY)}")
    check_ranking(by, base)
    rows = designs if isinstance(designs, Designs) else checked_designs(designs, base)
    scenes = rows.scenes(base)
    if by in ("P_d", "P_d_worst"):
        check_vibration(by, scenes, np.all)
    if linear is None:
        linear = default_state(scenes, method)
        scene, scenes = in_state(scene, linear), in_state(scenes, linear)
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method)
    with warnings.catch_warnings(action="ignore", category=LaneWarning):  # given below, of all rows
        swept = sweep(
            scenes,
            n_periods=resolved.n_periods,
            transient=resolved.transient,
            method=resolved.asked,
            forces=True,
            amplitudes=True,
            keep_samples=False,
            progress=progress,
            dims=(ROW,),
        )
    result = _table_of(rows, swept, by, base.layout)
    warn_failures(result.status, result.chatter)
    return result


def check_ranking(by: str, base: Scene) -> None:
    """Raise an InputError where designs of a scene have no number `by` to be ranked by."""
    check_row(base)
    require_capability(by, base.layout, asked=f"Argument `by` = {by!r}")
    if by in STRESSES:
        check_quantity(by, base)


def checked_designs(
    table: object, base: Scene, faults: dict[int, str] | None = None, decimal_comma: bool = False
) -> Designs:
    """The designs of a table, those that cannot be marched marked.

    Raises:
        SceneError: See `read_designs`; or no row is right.
        InputError: The sector of a ring is requested, and designs have none.
    """
    designs = read_designs(table, base, faults, decimal_comma)
    appended = {name for name, variable in DesignTable.variables.items() if not isinstance(variable, Attribute)}
    for head in designs.heads:
        if head.partition("[")[0].strip() in {ROW, *appended}:
            raise SceneError(f"column `{head}` is one that the table appends; remove it, or rename it")
    if designs.right.size:
        require_sector(designs.scenes(base))
    if designs.right.size and base.parts.contact != "none":
        followed = lanes_that_auto_steps_follow(designs.scenes(base))
        designs = designs.marked(designs.right[~followed], "the design is too stiff, or too slow, to be followed")
    if not designs.right.size:
        raise SceneError(f"no row of the table is right; row 1: {designs.reasons[0]}")
    return designs


def _table_of(designs: Designs, swept: SweepResult, by: str, layout: Layout) -> DesignTable:
    """The result of all rows from the sweep of those that are right."""
    count = len(designs.reasons)
    right = designs.right
    found: dict[str, Any] = {name: getattr(swept, name, None) for name in DesignTable.variables}
    per_row = {name: a for name, a in found.items() if a is not None and np.shape(a)[:1] == right.shape}
    values: dict[str, Any] = {name: _beside_wrong(a, right, count) for name, a in (per_row | _judged(swept)).items()}
    values["status"][np.setdiff1d(np.arange(count), right)] = Status.BAD_INPUT
    values["rank"] = _ranks(values[by], by, values["status"] == Status.OK)
    values |= {"reason": np.array(designs.reasons), "cells": designs.cells, "by": by}
    values |= {
        name: swept.data.attrs.get(name) for name in ("method", "march", "steps_per_period", "accuracy", "chatter")
    }
    coords = {ROW: np.arange(1, count + 1), "column": list(designs.heads), **layout.coords}
    origin = {name: swept.data.attrs[name] for name in ("title", "scene") if name in swept.data.attrs}
    return DesignTable.from_values(values, lanes=(ROW,), coords=coords, attrs=origin, layout=layout)


def _judged(swept: SweepResult) -> dict[str, np.ndarray]:
    """What is said of each lane beyond the numbers of the sweep."""
    ok = swept.status == Status.OK
    stable = ok & swept.P_d_settled & (swept.P_d_ci <= STABLE_WITHIN) & ~swept.P_d_ci_short
    return {"stable": stable, "n": np.where(ok, len(swept.period), 0), "verdict": np.array(_verdict_words(swept))}


def _beside_wrong(values: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Values of the rows that are right among those of all: NaN, 0 or "not run" for the others."""
    fill, dtype = {"f": (np.nan, values.dtype), "U": ("not run", "<U32")}.get(values.dtype.kind, (0, values.dtype))
    full = np.full((count, *values.shape[1:]), fill, dtype)
    full[right] = values
    return full


def _verdict_words(swept: SweepResult) -> list[str]:
    """The motion of each lane in words."""

    def words(status: int, settling: int, number: int) -> str:
        if status != Status.OK:
            return "stopped"
        if settling != SETTLED:
            return "transient not over" if settling == NOT_SETTLED else UNDECIDED_MOTION
        return f"period {number}" if number else "aperiodic"

    return [*map(words, swept.status.tolist(), swept.settling.tolist(), swept.period_number.tolist())]


def _ranks(values: Any, by: str, ok: np.ndarray) -> np.ndarray:
    """The rank of each row, from 1: equal numbers share the best one; 0 where there is no number."""
    scores = -values if by in LARGEST_FIRST else values.max(axis=-1) if values.ndim > 1 else values
    counted = ok & np.isfinite(scores)
    order = np.sort(scores[counted])
    return np.where(counted, np.searchsorted(order, scores, side="left") + 1, 0)
