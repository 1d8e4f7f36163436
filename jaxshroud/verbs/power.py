"""The vibration-power reduction of scenes, averaged over as many periods as they need (Sec. 3.2, Fig. 15)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from jaxshroud.batch.lanes import final_states
from jaxshroud.batch.limits import check_size
from jaxshroud.batch.periods import PERIODS_PER_CALL, Sample
from jaxshroud.batch.plan import Plan, Progress, Runs, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.stepped_runs import zeno_warning
from jaxshroud.io.lane_status import warn_failures
from jaxshroud.linear.held_contact import LinearState, is_linear
from jaxshroud.march.method import FOR_P_D_WITH_LEDGER
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.power import PowerResult
from jaxshroud.scene.checks import InputError, tolerance_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.amplitudes import (
    amplitude_intervals,
    amplitude_values,
    check_vibration,
    counted_mean,
    counted_periods,
    load_values,
)
from jaxshroud.signals.averages import (
    Reduction,
    averages,
    closed_forms,
    convergence,
    period_reductions,
    relative_drop,
    relative_residual,
)
from jaxshroud.signals.equivalent import equivalent_values
from jaxshroud.signals.period import NOT_SETTLED, PERIOD_TOLERANCE, Repetition
from jaxshroud.verbs.arguments import (
    MarchPlan,
    MethodArgument,
    ResolvedOptions,
    plan_march,
    resolve_options,
    warn_missed,
)
from jaxshroud.verbs.lanes import check_row, in_shape
from jaxshroud.verbs.settled import default_state, in_state, require_state
from jaxshroud.verbs.trials import missed_lanes

FIRST_PERIODS = 2 * PERIODS_PER_CALL  # kept periods before the first test of convergence


class LaneSummary(NamedTuple):
    """P_d of one lane over the periods run so far; most fields are those of `PowerResult.final`."""

    n: int  # averaged periods
    P_d: float  # [%]
    ci: float  # half width of its 95 % interval [percentage points]
    change: float  # of P_d since half as many periods [percentage points]
    tolerance: float  # [percentage points]
    stable: bool
    settled: bool
    settling: int  # see `Reduction`
    periods_more: float  # see `Reduction`
    ci_short: bool
    period_number: int
    P: np.ndarray  # (N,) [m^4]
    P_0: np.ndarray  # (N,) [m^4]
    energy_residual: float
    series: np.ndarray  # P_d of each period [%]
    converged: bool  # in the latest test
    status: int
    more: dict[str, np.ndarray]  # works, and what rows or options add; by the names of `PowerResult`


WORKS = {  # variable -> of samples
    "work_drive": "work",
    "loss_viscous": "viscous",
    "loss_friction": "friction",
    "work_switches": "switched",
    "loss_flat": "dropped",
}
NOT_FINAL = ("series", "converged", "status", "more")


def is_converged(reduction: Reduction, change: np.ndarray | float, tolerance: float) -> NDArray[np.bool_] | np.bool_:
    """Whether P_d of lanes is known to `tolerance`, given its `change` since half as many periods."""
    settles = reduction.settling != NOT_SETTLED
    return (reduction.ci <= tolerance) & (change <= tolerance) & ~reduction.ci_short & settles


def _summaries(
    scenes: Scene, samples: list[Sample], status: np.ndarray, period_tol: float, tolerance: float, was: np.ndarray
) -> list[LaneSummary]:
    """The summaries of lanes (leading axis) after their latest periods; `was`: converged in the previous test."""
    joined = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *samples)
    orbit, reduction, P_0 = averages(scenes, joined, period_tol)
    series = period_reductions(scenes, joined, P_0)
    residual = np.full(len(series), np.nan) if joined.residual is None else relative_residual(joined)
    of_run = scenes, joined, orbit.number
    kept = amplitude_values(*of_run) | amplitude_intervals(*of_run) | load_values(*of_run)
    counted = counted_periods(joined, orbit.number)

    def total(a):
        return a.reshape(*a.shape[:2], -1).sum(axis=-1)  # of all interfaces

    kept |= {name: counted_mean(total(getattr(joined, sample)), counted) for name, sample in WORKS.items()}
    kept["final_energy_dropped"] = relative_drop(joined)
    kept |= {"final_P_d_vibration": reduction.P_d_vibration, "final_P_d_vibration_ci": reduction.vibration_ci}
    if scenes.row is not None:
        kept["final_P_d_worst"] = power_reduction(reduction.P, P_0).min(axis=-1)
    summaries = []
    for i in range(len(series)):
        lane_orbit, lane_reduction, more = jax.tree.map(lambda a, i=i: a[i], (orbit, reduction, kept))
        run = _LaneRun(
            orbit=lane_orbit,
            reduction=lane_reduction,
            P_0=P_0[i],
            series=series[i],
            residual=float(residual[i]),
            status=int(status[i]),
            was_converged=bool(was[i]),
            more=more,
        )
        summaries.append(_lane_summary(run, tolerance))
    return summaries


class _LaneRun(NamedTuple):
    """The periods of one lane run so far."""

    orbit: Repetition
    reduction: Reduction
    P_0: np.ndarray
    series: np.ndarray
    residual: float
    status: int
    was_converged: bool
    more: dict[str, np.ndarray]


def _lane_summary(run: _LaneRun, tolerance: float) -> LaneSummary:
    """The summary of one lane."""
    orbit, reduction, series = run.orbit, run.reduction, run.series
    q = max(int(orbit.number), 1)
    half = max(len(series) // (2 * q) * q, q)
    change = abs(float(series[:half].mean() - reduction.P_d))
    converged = bool(is_converged(reduction, change, tolerance))
    return LaneSummary(
        n=int(reduction.n),
        P_d=float(reduction.P_d),
        ci=float(reduction.ci),
        change=change,
        tolerance=tolerance,
        stable=converged and bool((reduction.settled and orbit.number > 0) or run.was_converged),
        settled=bool(reduction.settled),
        settling=int(reduction.settling),
        periods_more=float(reduction.periods_more),
        ci_short=bool(reduction.ci_short),
        period_number=int(orbit.number),
        P=reduction.P,
        P_0=run.P_0,
        energy_residual=run.residual,
        series=series,
        converged=converged,
        status=run.status,
        more=run.more,
    )


@typed
def power(
    scene: Scene | SceneFile,
    *,
    stable_within: float = 0.1,
    forces: bool = False,
    amplitudes: bool = False,
    linear: LinearState | None = None,
    period_tol: float = PERIOD_TOLERANCE,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> PowerResult:
    """Average P_d over more and more periods until it is stable.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results, each lane continuing until it
            is stable itself; or a scene file, whose [run] counts where an argument is not given.
        stable_within: P_d counts as stable when its 95 % half width and its change since half as many periods are both
            at most this [percentage points]: at once where P_d has settled on an orbit, else over at least 30
            correlation times and in two tests in succession, the second after twice as many periods. (Stopping at the
            first interval that is short enough would select those that are too short.)
        forces: Keep contact forces, slip, normal load and impacts too, see `sweep`.
        amplitudes: Keep amplitudes too, see `sweep`.
        linear: "apart" or "stuck": the settled motion in closed form, of contact that stays in this state; a lane whose
            contact leaves it stops. By default it is in closed form where all lanes keep one state for certain: blades
            that do not turn, from the only static equilibrium on (`initial = "static"`), and no `method` or `state`
            given. Else it is marched.
        period_tol: Tolerance of the period number, see `periodicity`.
        n_periods: Drive periods kept at most, even if P_d is not stable yet; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0: one state for all lanes, or one for each; by default `scene.initial`,
            apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The convergence of P_d in n and its final value; for a periodic orbit n runs over multiples of its period. P_d
        is that of the left blade, in a row of blades that of all blades, 100 (1 - sum P / sum P_0); of a row there is
        the reduction of the worst blade too, but there are no equivalents of contact.

    Raises:
        ValueError: A count or the tolerance is not positive, the run would be too long or too large, or no scene has a
            left blade (a row: any blade) that vibrates without contact.
        NumericalError: With `throw`: a lane stopped.

    Source:
        Sec. 3.2 and Fig. 15 of the article, Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.power(scene, n_periods=64, transient=32, method=js.RungeKutta(steps=200)).final["stable"]
        True
    """
    if linear is None and state is None:
        linear = default_state(scene, method)
    resolved = resolve_options(
        in_state(scene, linear),
        n_periods=n_periods,
        transient=transient,
        method=method,
        dims=dims,
        verb="power",
    )
    check_row(resolved.scene)
    lanes = resolved.lanes
    check_size(len(lanes.drive.omega), resolved.transient, resolved.n_periods)
    if not stable_within > 0:
        raise InputError(f"Argument `stable_within` must be positive, but is {stable_within}.")
    tolerance_argument("period_tol", period_tol)
    check_vibration("P_d", lanes, np.all)
    require_state(lanes)
    march = plan_march(resolved, lanes, FOR_P_D_WITH_LEDGER)
    march = march._replace(method=march.method._replace(forces=forces, amplitudes=amplitudes))
    scenes = in_precision(without_given(lanes), march.method.precision)
    summaries, ends, chatter = _run_longer(
        resolved, scenes, resolved.states(state, scenes), march, stable_within, period_tol, progress
    )
    if scenes.row is None and not is_linear(scenes):
        summaries = _with_equivalents(scenes, ends, summaries, march)
    result = _power_result(resolved, summaries, march, chatter)
    warn_failures(result.status, chatter, throw=throw)
    if march.tried is not None:
        warn_missed(missed_lanes(lanes, march.tried, progress), march.tried, result.final_energy_dropped)
    return result


def _run_longer(
    resolved: ResolvedOptions,
    scenes: Scene,
    state: State,
    march: MarchPlan,
    tolerance: float,
    period_tol: float,
    progress: Progress | None,
) -> tuple[list[LaneSummary], State, str | None]:
    """The summary and the last state of each lane (leading axis), and the report on events that alternate, if any."""
    count = len(scenes.drive.omega)
    transient = resolved.transient
    done = 0
    ticker = Ticker(count * (resolved.transient + resolved.n_periods), progress)
    summaries: dict[int, LaneSummary] = {}
    ends: dict[int, State] = {}
    running = np.arange(count)
    samples = []
    chatter = None
    while done < resolved.n_periods and len(running):
        n = min(max(FIRST_PERIODS, done), resolved.n_periods - done)  # doubles the number of periods
        plan = march.plan(transient, n)
        runs = _run_remaining(scenes, state, plan, ticker, count > 1)
        chatter = chatter or zeno_warning(scenes, runs, replace(plan, transient=resolved.transient + done))
        samples = [*samples, runs.samples]
        was_converged = np.array([i in summaries and summaries[i].converged for i in running.tolist()])
        latest = _summaries(scenes, samples, runs.last.status, period_tol, tolerance, was_converged)
        summaries |= zip(running.tolist(), latest, strict=True)
        last = final_states(runs.last.state)
        ends |= {lane: jax.tree.map(lambda a, i=i: np.asarray(a)[i], last) for i, lane in enumerate(running.tolist())}
        unfinished = np.array([summary.status == Status.OK and not summary.stable for summary in latest])
        remaining = (scenes, last, samples, running)
        scenes, state, samples, running = jax.tree.map(
            lambda a, unfinished=unfinished: np.asarray(a)[unfinished], remaining
        )
        transient = 0
        done = done + n
    states = jax.tree.map(lambda *a: np.stack(a), *(ends[i] for i in range(count)))
    return [summaries[i] for i in range(count)], states, chatter


def _with_equivalents(
    scenes: Scene, states: State, summaries: list[LaneSummary], march: MarchPlan
) -> list[LaneSummary]:
    """The summaries with the equivalents of contact; NaN where the motion has not settled."""
    number, settling = (np.array([getattr(one, name) for one in summaries]) for name in ("period_number", "settling"))
    P_0 = np.array([one.P_0[0] for one in summaries]) / closed_forms(scenes)[0].astype(float)
    values = equivalent_values(scenes, states, number, P_0, march.steps, march.method)
    known = (settling != NOT_SETTLED) & np.array([one.status == Status.OK for one in summaries])
    values = {name: np.where(known, a, np.nan) for name, a in values.items()}
    return [one._replace(more=one.more | {name: a[i] for name, a in values.items()}) for i, one in enumerate(summaries)]


def _run_remaining(scenes: Scene, state: State, plan: Plan, ticker: Ticker, of_many: bool) -> Runs:
    """Runs of lanes (leading axis); the last of many lanes runs twice, in the compiled program of many."""
    if not of_many or len(scenes.drive.omega) > 1:
        return run_lanes(scenes, state, plan, ticker)
    twice = jax.tree.map(lambda a: np.repeat(np.asarray(a), 2, axis=0), (scenes, state))
    runs = run_lanes(twice[0], twice[1], plan, lambda lane_periods: ticker(lane_periods // 2))
    return jax.tree.map(lambda a: a[:1], runs)


def _power_result(
    resolved: ResolvedOptions, summaries: list[LaneSummary], march: MarchPlan, chatter: str | None
) -> PowerResult:
    """The result of all lanes; curves of convergence are padded to one length."""
    curves = [convergence(summary.series, summary.period_number) for summary in summaries]
    longest = max(len(n) for n, _, _ in curves)

    def padded(values, fill):
        return np.append(values, np.full(longest - len(values), fill, values.dtype))

    n, P_d, ci = (np.stack([padded(curve[k], fill) for curve in curves]) for k, fill in enumerate((0, np.nan, np.nan)))
    columns = {
        name: np.array([getattr(one, name) for one in summaries])
        for name in LaneSummary._fields
        if name not in NOT_FINAL
    }
    final = {f"final_{name}": column for name, column in columns.items()}
    lanes = {"n": n, "P_d": P_d, "P_d_ci": ci, "status": np.array([one.status for one in summaries]), **final}
    lanes |= {name: np.stack([one.more[name] for one in summaries]) for name in summaries[0].more}
    values = {**in_shape(lanes, resolved.shape), "chatter": chatter}
    layout = resolved.scene.layout
    return PowerResult.from_values(values, coords=layout.coords, layout=layout, **resolved.labels(march))
