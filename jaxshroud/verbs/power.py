"""Vibration-power reduction of one scene, averaged over as many periods as it takes (Sec. 3.2, Fig. 15)."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.periods import BLOCK, Sample
from jaxshroud.batch.runs import Plan, Progress, Runs, Ticker, run_lanes, told_chatter
from jaxshroud.batch.states import final_states
from jaxshroud.march.method import FAST_WITH_LEDGER, Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.linear import area, power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import averages, relative_residual
from jaxshroud.motion.interval import interval
from jaxshroud.motion.period import PERIOD_TOLERANCE, Repetition
from jaxshroud.motion.power import Reduction
from jaxshroud.motion.settling import NO
from jaxshroud.results.power import PowerResult
from jaxshroud.results.status import tell_failures
from jaxshroud.scene.checks import tolerance_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.door import Asked, Marched, asked, in_shape, marched

FIRST = 2 * BLOCK  # periods before the first look


def near_enough(now: Reduction, change: np.ndarray | float, tolerance: float) -> Any:
    """Whether P_d of lanes, and its `change` since half as many periods, may count as known to `tolerance`."""
    return (now.ci <= tolerance) & (change <= tolerance) & ~now.ci_short & (now.settling != NO)


def _summaries(scenes: Scene, samples: list[Sample], period_tol: float, tolerance: float, earlier: list[dict]):
    """The answer of each lane (leading axis) from the periods run so far, with the `series` of P_d of each period."""
    whole = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *samples)
    orbit, now, P_0 = averages(scenes, whole, period_tol)
    A = np.asarray(jax.vmap(area)(scenes.shroud), float)
    series = power_reduction(A[:, None] * whole.power[0], P_0[:, :1])
    residual = np.full(len(A), np.nan) if whole.residual is None else relative_residual(whole)
    found = []
    for i, told in enumerate(earlier):
        one, at_last = jax.tree.map(lambda a, i=i: a[i], (orbit, now))
        found.append(_summary(one, at_last, P_0[i], series[i], residual[i], tolerance, told))
    return found


def _summary(orbit: Repetition, now: Reduction, P_0, series, residual, tolerance: float, earlier: dict) -> dict:
    """The answer of one lane."""
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
        "energy_residual": float(residual),
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
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    tolerance: float = 0.1,
    period_tol: float = PERIOD_TOLERANCE,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
    most_periods: int | None = None,
) -> PowerResult:
    """Average P_d over more and more periods until it is stable.

    Args:
        scene: One scene; or many, with leading axes, which come first in all results: each lane goes on until it is
            stable itself; or a scene file, whose [run] counts where an argument is not given.
        n_periods: Stop here even if P_d is not stable yet; by default after 64.
        transient: Drive periods run and discarded first; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        tolerance: P_d counts as stable when its 95 % half width, and its change since half as many periods, are both
            at most this [percentage points]: at once on an orbit that P_d has settled on, else over at least 30
            correlation times and at two looks in succession, the second after twice as many periods. (Stopping at the
            first interval that is short enough would choose those that are too short.)
        period_tol: Tolerance of the period number.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, see `choose`.
        state: Where to start, at drive phase 0: one state, or one for each of the scenes.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.
        most_periods: Deprecated name of `n_periods`.

    Returns:
        The convergence of P_d in n and its final value; for a periodic orbit n runs over multiples of its period.

    Raises:
        ValueError: A count or the tolerance is not positive, or the run would be too long or too large.
        NumericalError: With `throw`: a lane stopped.

    Source:
        Sec. 3.2 and Fig. 15 of the article, Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.power(scene, n_periods=64, transient=32, steps_per_period=200).final["stable"]
        True
    """
    if most_periods is not None:
        warnings.warn("power: argument `most_periods` is called `n_periods` now", DeprecationWarning, stacklevel=2)
        n_periods = most_periods if n_periods is None else n_periods
    door = asked(
        scene,
        n_periods=n_periods,
        transient=transient,
        steps_per_period=steps_per_period,
        method=method,
        accuracy=accuracy,
        dims=dims,
    )
    given = door.lanes
    fits(len(given.drive.omega), door.transient, door.n_periods)
    if not tolerance > 0:
        raise InputError(f"Argument `tolerance` must be positive, but is {tolerance}.")
    tolerance_argument("period_tol", period_tol)
    how = marched(door, given, FAST_WITH_LEDGER)
    scenes = in_precision(given, how.method.precision)
    lanes, chatter = _run(door, scenes, door.states(state, scenes), how, tolerance, period_tol, progress)
    found = _result(door, lanes, how, chatter)
    tell_failures(found.status, chatter, throw=throw)
    return found


def _run(
    door: Asked, scenes: Scene, state: State, how: Marched, tolerance: float, period_tol: float, progress
) -> tuple[list[dict], str | None]:
    """The answer of each lane (leading axis), with its status; and what alternated."""
    count, lead, done = len(scenes.drive.omega), door.transient, 0
    ticker = Ticker(count * (door.transient + door.n_periods), progress)
    answers: list[dict] = [{} for _ in range(count)]
    on, samples, chatter = np.arange(count), [], None
    while done < door.n_periods and len(on):
        n = min(max(FIRST, done), door.n_periods - done)  # doubles what there is
        plan = Plan(lead, n, how.steps, 0.0, how.method)
        runs = _march(scenes, state, plan, ticker, count > 1)
        chatter = chatter or told_chatter(scenes, runs, replace(plan, transient=door.transient + done))
        samples = [*samples, runs.samples]
        known = _summaries(scenes, samples, period_tol, tolerance, [answers[i] for i in on])
        for i, told, status in zip(on, known, runs.last.status, strict=True):
            answers[i] = {**told, "status": int(status)}
        going = np.array([answers[i]["status"] == Status.OK and not answers[i]["stable"] for i in on])
        left = (scenes, final_states(runs.last.state), samples, on)
        scenes, state, samples, on = jax.tree.map(lambda a, going=going: np.asarray(a)[going], left)
        lead, done = 0, done + n
    return answers, chatter


def _march(scenes: Scene, state: State, plan: Plan, ticker: Ticker, of_many: bool) -> Runs:
    """Lanes (leading axis); the last one of many runs twice, in the program of many, which is compiled."""
    if not of_many or len(scenes.drive.omega) > 1:
        return run_lanes(scenes, state, plan, ticker)
    twice = jax.tree.map(lambda a: np.repeat(np.asarray(a), 2, axis=0), (scenes, state))
    runs = run_lanes(twice[0], twice[1], plan, lambda lane_periods: ticker(lane_periods // 2))
    return jax.tree.map(lambda a: a[:1], runs)


def _result(door: Asked, answers: list[dict], how: Marched, chatter: str | None) -> PowerResult:
    curves = [_convergence(answer) for answer in answers]
    longest = max(len(n) for n, _, _ in curves)
    rest = lambda values, of: np.append(values, np.full(longest - len(values), of, values.dtype))  # noqa: E731
    n, P_d, ci = (np.stack([rest(curve[k], of) for curve in curves]) for k, of in enumerate((0, np.nan, np.nan)))
    names = [name for name in answers[0] if name not in ("series", "close", "status")]
    final = {f"final_{name}": np.array([answer[name] for answer in answers]) for name in names}
    lanes = {"n": n, "P_d": P_d, "P_d_ci": ci, "status": np.array([a["status"] for a in answers]), **final}
    told, differing = door.about(door.transient, how.steps)
    values = {**in_shape(lanes, door.shape), "chatter": chatter, **how.told}
    return PowerResult.from_values(values, lanes=door.dims, coords={"blade": [0, 1]}, attrs=told, more=differing)
