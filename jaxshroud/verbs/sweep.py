"""Many scenes at once: bifurcation diagrams and power curves over any number of a scene."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.continuation import continued, independent
from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress, Runs, Ticker, in_full, stepper, told_chatter
from jaxshroud.batch.states import by_blade
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.events import Counters
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.absent import filled
from jaxshroud.model.modes import Status
from jaxshroud.motion.averages import averages, relative_drop, relative_residual
from jaxshroud.motion.period import PERIOD_TOLERANCE
from jaxshroud.motion.settling import YES
from jaxshroud.results.dimension import dimension
from jaxshroud.results.sweep import GAP, SweepResult, sweep_coordinates
from jaxshroud.scene.checks import count_argument, tolerance_argument, word_argument
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of


def sweep(
    scene: Scene,
    along: Mapping[str, ArrayLike | Sequence[float]],
    *,
    n_periods: int,
    transient: int = 0,
    steps_per_period: Steps = 400,
    direction: Direction = "independent",
    phase: float = 0.0,
    period_tol: float = PERIOD_TOLERANCE,
    method: Method | Choices = FAST,
    progress: Progress | None = None,
) -> SweepResult:
    """Simulate `scene` for every value (or pair of values) of one or two of its numbers.

    Args:
        scene: What all lanes have in common.
        along: One or two keys as for `vary`, each with its values (n,) in SI units; two make a grid.
        n_periods: Drive periods kept.
        transient: Drive periods run and discarded before these.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        direction: "independent": every lane starts from `scene.initial`. "forward" or "backward": along the first key
            each value starts from its neighbour's final state, slider and mode included.
        phase: Drive phase omega t at which samples are taken, 0 <= phase < 2 pi [rad].
        period_tol: Tolerance of the period number, see `periodicity`.
        method: Static choices of the march.
        progress: Called with (lane-periods done, lane-periods in all) after every block.

    Returns:
        Samples and statistics of every lane. A lane that failed has a status and NaN; the others are not affected.

    Raises:
        ValueError: A count is too small, an axis is empty, the phase or the tolerance is out of range, the direction is
            not known, the run would be too long or too large (see `extent`), or float64 is not to be had.
        KeyError: The scene has no such number.
        Interrupted: Ctrl-C; its `done` is the result with the lanes that had ended, the others with status NOT_RUN, or
            None where none had.
    """
    method = choices(method)
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    if not 0 <= phase < 2 * np.pi:
        raise ValueError(f"Argument `phase` must be in [0, 2 pi), but is {phase}.")
    tolerance_argument("period_tol", period_tol)
    word_argument("direction", direction, Direction)
    axes = {key: np.atleast_1d(np.asarray(values, dtype=float)) for key, values in along.items()}
    if not 1 <= len(axes) <= 2 or any(v.ndim != 1 or v.size == 0 for v in axes.values()):
        raise ValueError("Argument `along` must name one or two keys, each with at least one value.")
    fits(math.prod(v.size for v in axes.values()), transient, n_periods)
    scenes = in_precision(grid_of_scenes(scene, axes), method.precision)
    steps = steps_for(scenes, len(axes), steps_per_period, stepper(scene, method))
    plan = Plan(transient, n_periods, steps, phase, method)
    shape = tuple(len(v) for v in axes.values())
    total = int(np.prod(shape)) * (transient + n_periods)
    run = independent if direction == "independent" else partial(continued, direction=direction)
    try:
        runs = run(scenes, shape, plan=plan, ticker=Ticker(total, progress))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and _result(scene, scenes, axes, stopped.done, plan, period_tol)) from None
    return _result(scene, scenes, axes, runs, plan, period_tol)


def _result(scene: Scene, scenes: Scene, axes: dict[str, np.ndarray], runs: Runs, plan: Plan, period_tol: float):
    values = _numbers(scenes, axes, runs, plan, period_tol)
    coords = sweep_coordinates(axes, np.arange(plan.transient + 1, plan.transient + plan.kept + 1))
    dims = [dimension(key) for key in axes]
    more = {} if "gap" in dims else {"gap": (dims, np.asarray(scenes.shroud.gap), GAP)}
    run = {"periods": plan.kept, "transient": plan.transient, "steps_per_period": plan.steps_per_period}
    complete = int(not np.any(values["status"] == Status.NOT_RUN))
    attrs = {"title": "", "scene": text_of(scene, run), "axes": ",".join(dims), "complete": complete}
    return SweepResult.from_values(values, lanes=dims, coords=coords, attrs=attrs, more=more)


def _numbers(scenes: Scene, axes: dict[str, np.ndarray], runs: Runs, plan: Plan, period_tol: float) -> dict[str, Any]:
    shape = tuple(len(v) for v in axes.values())
    in_line = lambda tree: jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), tree)  # noqa: E731
    alternating = told_chatter(in_line(scenes), in_line(runs), plan)
    runs = jax.tree.map(in_full, runs)
    motion = by_blade(runs.samples.motion)
    got = averages(in_line(scenes), in_line(runs.samples), period_tol)
    (number, told), power, P_0 = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), got)
    log, before = runs.last.tally.log, runs.before.log
    spent = [getattr(log, n) - getattr(before, n) for n in ("time_apart", "time_stick", "time_slip")]
    whole = sum(spent)
    with np.errstate(invalid="ignore", divide="ignore"):
        times = [t / whole for t in spent]
        residual = relative_residual(runs.samples) if plan.method.ledger else None
        dropped = relative_drop(runs.samples) if plan.method.ledger else None
    counts = [filled(of.counters, runs.last.status) for of in (log, before)]
    counters = {n: np.asarray(getattr(counts[0], n) - getattr(counts[1], n)) for n in Counters.__annotations__}
    return {
        "motion": motion,
        "P": power.P,
        "P_0": P_0,
        "P_d": power.P_d,
        "P_d_ci": power.ci,
        "P_d_ci_short": power.ci_short,
        "P_d_settled": power.settled,
        "P_d_settling": power.settling,
        "P_d_periods_more": power.periods_more,
        "period_number": number,
        "settled": told.verdict == YES,
        "settling": told.verdict,
        "periods_more": told.periods_more,
        "status": runs.last.status,
        "v_max": log.v_max,
        **dict(zip(("time_apart", "time_stick", "time_slip"), times, strict=True)),
        "energy_residual": residual,
        "energy_dropped": dropped,
        "counters": counters,
        "phase": plan.phase,
        "period_tol": period_tol,
        "steps_per_period": plan.steps_per_period,
        "method": str(plan.method),
        "chatter": alternating,
    }
