"""Vibration-power reduction of one scene, averaged over as many periods as it takes (Sec. 3.2, Fig. 15)."""

from typing import Any

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.periods import BLOCK, Sample
from jaxshroud.batch.runs import Plan, Progress, Ticker, run_lanes, starts, stepper, told_chatter
from jaxshroud.batch.states import final_states
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import FAST_WITH_LEDGER, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.linear import area
from jaxshroud.model.modes import Status
from jaxshroud.motion.averages import averages, relative_residual
from jaxshroud.motion.interval import interval
from jaxshroud.motion.period import PERIOD_TOLERANCE
from jaxshroud.motion.power import Reduction
from jaxshroud.motion.settling import NO
from jaxshroud.results.power import PowerResult
from jaxshroud.scene.checks import count_argument, tolerance_argument
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of

FIRST = 2 * BLOCK  # periods before the first look


def near_enough(now: Reduction, change: np.ndarray | float, tolerance: float) -> Any:
    """Whether P_d of lanes, and its `change` since half as many periods, may count as known to `tolerance`."""
    return (now.ci <= tolerance) & (change <= tolerance) & ~now.ci_short & (now.settling != NO)


def _summary(scenes: Scene, samples: list[Sample], period_tol: float, tolerance: float, earlier: dict) -> dict:
    """The answer from the periods run so far, with the `series` of P_d of each period."""
    whole = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *samples)
    orbit, now, P_0 = jax.tree.map(lambda a: a[0], averages(scenes, whole, period_tol))
    A = float(area(jax.tree.map(lambda a: a[0], scenes.shroud)))
    with np.errstate(divide="ignore", invalid="ignore"):
        series = 100 * (1 - A * whole.power[0][0] / P_0[0])
    series = np.where(P_0[0] > 0, series, np.nan)
    q = max(int(orbit.number), 1)
    half = max(len(series) // (2 * q) * q, q)
    change = abs(float(series[:half].mean() - now.P_d))
    close = bool(near_enough(now, change, tolerance))
    return {
        "n": int(now.n),
        "P_d": float(now.P_d),
        "ci": float(now.ci),
        "change": change,
        "tolerance": tolerance,
        "close": close,
        "stable": close and bool((now.settled and orbit.number > 0) or earlier.get("close", False)),
        "settled": bool(now.settled),
        "settling": int(now.settling),
        "periods_more": float(now.periods_more),
        "ci_short": bool(now.ci_short),
        "period_number": int(orbit.number),
        "P": now.P.tolist(),
        "P_0": P_0.tolist(),
        "energy_residual": float("nan") if whole.residual is None else float(relative_residual(whole)[0]),
        "series": series,
    }


def _convergence(summary: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """n, average of P_d over the first n periods, its interval; n spaced evenly on a logarithmic scale."""
    series, q = summary["series"], max(summary["period_number"], 1)
    orbits = max(len(series) // q, 1)
    n = q * np.unique(np.geomspace(1, orbits, 200).astype(int))
    n = n[n <= len(series)]
    return n, np.cumsum(series)[n - 1] / n, np.array([interval(series[:m], q) for m in n])


def power(
    scene: Scene,
    *,
    most_periods: int,
    transient: int = 0,
    steps_per_period: Steps = 400,
    tolerance: float = 0.1,
    period_tol: float = PERIOD_TOLERANCE,
    method: Method | Choices = FAST_WITH_LEDGER,
    progress: Progress | None = None,
) -> PowerResult:
    """Average P_d over more and more periods until it is stable.

    Args:
        scene: The scene, started from its initial motion.
        most_periods: Stop here even if P_d is not stable yet.
        transient: Drive periods run and discarded first.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        tolerance: P_d counts as stable when its 95 % half width, and its change since half as many periods, are both
            at most this [percentage points]: at once on an orbit that P_d has settled on, else over at least 30
            correlation times and at two looks in succession, the second after twice as many periods. (Stopping at the
            first interval that is short enough would choose those that are too short.)
        period_tol: Tolerance of the period number.
        method: Static choices of the march.
        progress: Called with (periods done, periods at most).

    Returns:
        The convergence of P_d in n and its final value; for a periodic orbit n runs over multiples of its period.

    Raises:
        ValueError: A count or the tolerance is not positive, or the run would be too long or too large.
    """
    method = choices(method, ledger=True)
    count_argument("most_periods", most_periods, 1)
    count_argument("transient", transient, 0)
    fits(1, transient, most_periods)
    steps_per_period = steps_for(scene, 0, steps_per_period, stepper(scene, method))
    if not tolerance > 0:
        raise ValueError(f"Argument `tolerance` must be positive, but is {tolerance}.")
    tolerance_argument("period_tol", period_tol)
    scenes = in_precision(alone(scene), method.precision)
    ticker = Ticker(transient + most_periods, progress)
    state, lead, samples = starts(scenes), transient, []
    done, status, summary, alternating = 0, Status.OK, {}, None
    while done < most_periods and status == Status.OK and not summary.get("stable"):
        n = min(max(FIRST, done), most_periods - done)  # doubles what there is
        runs = run_lanes(scenes, state, Plan(lead, n, steps_per_period, 0.0, method), ticker)
        alternating = told_chatter(scenes, runs, Plan(transient + done, n, steps_per_period, 0.0, method))
        samples.append(runs.samples)
        state, lead, done, status = final_states(runs.last.state), 0, done + n, int(runs.last.status[0])
        summary = _summary(scenes, samples, period_tol, tolerance, summary)
    n, P_d, ci = _convergence(summary)
    final = {f"final_{name}": value for name, value in summary.items() if name not in ("series", "close")}
    run = {"periods": most_periods, "transient": transient, "steps_per_period": steps_per_period}
    values = {
        "n": n,
        "P_d": P_d,
        "P_d_ci": ci,
        "status": status,
        **final,
        "method": str(method),
        "steps_per_period": steps_per_period,
        "chatter": alternating,
    }
    return PowerResult.from_values(values, coords={"blade": [0, 1]}, attrs={"title": "", "scene": text_of(scene, run)})
