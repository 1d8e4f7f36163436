"""Vibration-power reduction of one scene, averaged over as many periods as it takes (Sec. 3.2, Fig. 15)."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.analysis.period import PERIOD_TOLERANCE, periodicity
from jaxshroud.analysis.power import interval, reduction
from jaxshroud.checks import count_argument, in_precision
from jaxshroud.extent import fits
from jaxshroud.integrate import FAST_WITH_LEDGER, Method
from jaxshroud.lanes import alone
from jaxshroud.linear import area, free_power
from jaxshroud.periods import BLOCK, Sample
from jaxshroud.scene import Scene
from jaxshroud.stability import Steps, steps_for
from jaxshroud.state import Status
from jaxshroud.sweep import Plan, Progress, Ticker, final_states, relative_residual, run_lanes, starts, stepper


class PowerResult(NamedTuple):
    """P_d of the left blade against the number of averaged periods."""

    n: np.ndarray  # (m,) numbers of periods
    P_d: np.ndarray  # (m,) average over the first n kept periods [%]
    P_d_ci: np.ndarray  # (m,) half width of its 95 % interval [percentage points]; NaN below two batches
    final: dict  # the answer: n, P_d, ci, settled, stable, period_number, P, P_0, status, energy_residual, method


def _summary(samples: list[Sample], A: float, P_0: np.ndarray, period_tol: float, tolerance: float) -> dict:
    """The answer from the periods run so far, with the `series` of P_d of each period."""
    x = np.concatenate([s.motion.x[0][0] for s in samples])
    P = A * np.stack([np.concatenate([s.power[i][0] for s in samples]) for i in (0, 1)], axis=-1)
    orbit = periodicity(x, period_tol)
    q = max(int(orbit.number), 1)
    now, before = (reduction(p, P_0, orbit.number) for p in (P, P[: max(len(P) // (2 * q) * q, q)]))
    change = abs(float(now.P_d - before.P_d))
    return {
        "n": int(now.n),
        "P_d": float(now.P_d),
        "ci": float(now.ci),
        "change": change,
        "tolerance": tolerance,
        "stable": bool(now.ci <= tolerance and change <= tolerance),
        "settled": bool(now.settled),
        "period_number": int(orbit.number),
        "P": now.P.tolist(),
        "P_0": P_0.tolist(),
        "energy_residual": _residual(samples),
        "series": 100 * (1 - P[:, 0] / P_0[0]) if P_0[0] > 0 else np.full(len(P), np.nan),
    }


def _residual(samples: list[Sample]) -> float:
    if samples[0].residual is None:
        return float("nan")
    whole = jax.tree.map(lambda *a: np.concatenate(a, axis=-1), *samples)
    return float(relative_residual(whole)[0])


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
    method: Method = FAST_WITH_LEDGER,
    progress: Progress | None = None,
) -> PowerResult:
    """Average P_d over more and more periods until it is stable.

    Args:
        scene: The scene, started from its initial motion.
        most_periods: Stop here even if P_d is not stable yet.
        transient: Drive periods run and discarded first.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        tolerance: P_d counts as stable when its 95 % half width, and its change since half as many periods, are both
            at most this [percentage points].
        period_tol: Tolerance of the period number.
        method: Static choices of the march.
        progress: Called with (periods done, periods at most).

    Returns:
        The convergence of P_d in n and its final value; for a periodic orbit n runs over multiples of its period.

    Raises:
        ValueError: A count or the tolerance is not positive, or the run would be too long or too large.
    """
    count_argument("most_periods", most_periods, 1)
    count_argument("transient", transient, 0)
    fits(1, transient, most_periods)
    steps_per_period = steps_for(scene, 0, steps_per_period, stepper(scene, method))
    if not tolerance > 0:
        raise ValueError(f"Argument `tolerance` must be positive, but is {tolerance}.")
    scenes = in_precision(alone(scene), method.precision)
    ticker = Ticker(transient + most_periods, progress)
    state, lead, samples = starts(scenes), transient, []
    A, P_0 = float(area(scene.shroud)), np.asarray(free_power(scene), float)
    done, status, summary = 0, Status.OK, {}
    while done < most_periods and status == Status.OK and not summary.get("stable"):
        n = min(max(2 * BLOCK, done), most_periods - done)  # doubles what there is
        runs = run_lanes(scenes, state, Plan(lead, n, steps_per_period, 0.0, method), ticker)
        samples.append(runs.samples)
        state, lead, done, status = final_states(runs.last), 0, done + n, int(runs.last.status[0])
        summary = _summary(samples, A, P_0, period_tol, tolerance)
    n, P_d, ci = _convergence(summary)
    final = {name: value for name, value in summary.items() if name != "series"}
    return PowerResult(n, P_d, ci, {**final, "status": status, "method": str(method)})
