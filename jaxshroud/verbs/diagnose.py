"""The kind of motion that one scene, a pair or a row of blades, settles on, with the evidence for it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import coordinate_sizes, final_states
from jaxshroud.batch.plan import Progress, Runs, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import one_lane
from jaxshroud.march.method import FOR_P_D_WITH_LEDGER
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import run_alone
from jaxshroud.orbits.lyapunov import ALIGNED, NearbyGrowth, lyapunov_exponents, nearby_growth
from jaxshroud.orbits.verdict import VERDICT_ROUNDS, Verdict, verdict_text, verdicts
from jaxshroud.orbits.verdict_evidence import Stretches
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import whole_ring
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.amplitudes import is_comparable
from jaxshroud.signals.averages import Reduction, averages, convergence, period_reductions
from jaxshroud.signals.period import SETTLED, Repetition
from jaxshroud.signals.waves import RowWave
from jaxshroud.verbs.accuracy import Choice
from jaxshroud.verbs.arguments import (
    Asked,
    MarchPlan,
    MethodArgument,
    ResolvedOptions,
    plan_march,
    resolve_options,
    warn_missed,
)
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.power import power
from jaxshroud.verbs.simulate import simulate
from jaxshroud.verbs.trials import missed_lanes

FIRST_STRETCH, ROUNDS = 64, 3  # of the evidence; each round is twice as long
GROWTH_PERIODS = 64  # of the nearby run
LEAST_SHOWN, SHOWN_ORBITS = 8, 2  # at least
WAVE = 1e-6  # of the square of the motion outside a travelling wave: less is one


class JudgedMotion(NamedTuple):
    """The motion that a scene settles on, and how it is shown."""

    status: int  # of the march that gave the evidence
    start: State  # of the samples
    shown: int  # periods that are sampled
    events: bool  # whether the states at events are kept too
    method: Asked
    evidence: Callable[[Trajectory], dict[str, object]]  # the verdict and its evidence, by the names of `Diagnosis`
    tried: Choice | None = None  # of the march, which is compared with a finer one


class RowEvidence(NamedTuple):
    """What a verdict on a row rests on."""

    status: int
    orbit: Repetition
    power: Reduction
    series: np.ndarray  # P_d of each of the latest whole orbits' periods [%]
    P_0: np.ndarray  # (1, N) [m^4]
    periods: int  # run in all
    last: State  # one lane (leading axis)
    growth: NearbyGrowth


def motion_of_row(
    scene: Scene | SceneFile, resolved: ResolvedOptions, state: State | None, progress: Progress | None
) -> JudgedMotion:
    """The motion of a row: by the returns of all blades, waves, and the growth of a nearby run."""
    march = plan_march(resolved, resolved.lanes, FOR_P_D_WITH_LEDGER)
    march = march._replace(method=march.method._replace(ledger=True))
    scenes = in_precision(without_given(resolved.lanes), march.method.precision)
    start = resolved.states(state, scenes)
    found = _evidence(scenes, start, march, resolved.transient, progress)
    stopped = found.status != Status.OK
    return JudgedMotion(
        status=found.status,
        start=jax.tree.map(lambda a: np.asarray(a)[0], start if stopped else found.last),
        shown=found.periods if stopped else max(LEAST_SHOWN, SHOWN_ORBITS * int(found.orbit.number[0])),
        events=False,
        method=march.untried.again,
        evidence=partial(_row_evidence, found),
    )


def _evidence(scenes: Scene, states: State, march: MarchPlan, transient: int, progress: Progress | None) -> RowEvidence:
    """Runs twice as long each until the motion has settled, and a nearby run."""
    most = transient + (2**ROUNDS - 1) * FIRST_STRETCH + 2 * (ALIGNED + GROWTH_PERIODS)
    ticker = Ticker(most, progress)
    done = 0
    plan = march.plan(transient, FIRST_STRETCH)
    while True:
        runs = run_lanes(scenes, states, plan, ticker)
        done += plan.transient + plan.kept
        states = final_states(runs.last.state)
        status = int(np.asarray(runs.last.status)[0])
        orbit, power, P_0 = averages(scenes, runs.samples)
        is_last = plan.kept == 2 ** (ROUNDS - 1) * FIRST_STRETCH
        if is_last or status != Status.OK or orbit.settling.verdict[0] == SETTLED:
            break
        plan = replace(plan, transient=0, kept=2 * plan.kept)
    growth = NearbyGrowth(np.nan, np.nan, 0)
    scene = jax.tree.map(lambda a: np.asarray(a)[0], scenes)
    if status == Status.OK:
        one = partial(_after_a_period, whole_ring(scenes), march, ticker)  # a sector lacks other patterns
        growth = nearby_growth(scene, states, _sizes(scene, runs), one, GROWTH_PERIODS)
    return RowEvidence(status, orbit, power, _latest_series(scenes, runs, orbit, P_0), P_0, done, states, growth)


def _latest_series(scenes: Scene, runs: Runs, orbit: Repetition, P_0: np.ndarray) -> np.ndarray:
    """P_d of each period of the latest whole orbits [%]."""
    series = period_reductions(scenes, runs.samples, P_0)[0]
    q = max(int(orbit.number[0]), 1)
    return series[len(series) % q :]


def _after_a_period(scenes: Scene, march: MarchPlan, ticker: Ticker, states: State) -> tuple[State, bool]:
    runs = run_lanes(scenes, states, march.plan(0, 1), ticker)
    return final_states(runs.last.state), bool(np.asarray(runs.last.status)[0] == Status.OK)


def _sizes(scene: Scene, runs: Runs) -> np.ndarray:
    """The size of each number of a state: the largest displacements of any blade, and the rates by the drive frequency.

    Sliders have that of x.
    """
    largest = [float(np.max(np.abs(a))) for a in runs.samples.largest]
    place = coordinate_sizes(np.repeat(largest, scene.layout.blades), scene)
    return np.concatenate([place, place * float(scene.drive.omega), np.full(scene.sliders, largest[0])])


def _row_evidence(found: RowEvidence, run: Trajectory) -> dict[str, object]:
    """The verdict and what it rests on; waves are those of the run that is shown."""
    q = int(found.orbit.number[0])
    power = found.power
    wave = Diagnosis(run.data.assign_attrs(period_number=q)).wave if run.closed else None
    verdict, reasons = _verdict(wave, found)
    n, P_d, ci = convergence(found.series, q)
    return {
        "verdict": verdict,
        "evidence": f"{verdict}: {'; '.join(reasons)}",
        "period_number": q,
        "periods": found.periods,
        "return_error": np.nan,
        "largest_exponent": found.growth.exponent,
        "largest_exponent_ci": found.growth.ci,
        "K": np.nan,
        "n": n,
        "P_d": P_d,
        "P_d_ci": ci,
        "P_d_settled": int(power.settled[0]),
        "P_d_vibration": float(power.P_d_vibration[0]),
        "P_d_vibration_ci": float(power.vibration_ci[0]),
        "P_d_worst": float(power_reduction(power.P, found.P_0).min()),
        "slider_stuck": 0,
        "P": power.P[0],
        "P_0": found.P_0[0],
    }


def _verdict(wave: RowWave | None, found: RowEvidence) -> tuple[str, list[str]]:
    """The kind of motion, and the reasons for it; `wave` is that of a ring."""
    growth = found.growth
    q = int(found.orbit.number[0])
    if found.status != Status.OK:
        return "stopped", [f"the run ends with {Status(found.status).name}"]
    settled = found.orbit.settling.verdict[0] == SETTLED
    exponent = f"the distance of a nearby run grows by exp({growth.exponent:.3g} +- {growth.ci:.2g}) a period"
    if np.isnan(growth.exponent):
        exponent = f"a nearby run {'is lost in rounding within a period' if growth.periods else 'stops'}"
    returns = "the blades do not return within as many periods as can be judged"
    if q:
        returns = f"all blades return after {q} period{'s' * (q > 1)}"
    reasons = [f"{returns} ({found.periods} periods run)", exponent]
    if q and wave is not None:
        reasons.append(wave.words)
        if settled and wave.distance.share < WAVE and not growth.exponent - growth.ci > 0:
            return f"travelling wave of period {q}", reasons
    if q and settled and not growth.exponent - growth.ci > 0:
        return f"period {q}", reasons
    if growth.exponent - growth.ci > 0 and not q:
        return "chaotic", reasons
    return ("undecided" if settled else "transient not over"), reasons


MIN_STORED_PERIODS, APERIODIC_PERIODS = 64, 128  # stored periods, at least, and those of aperiodic motion
MIN_STORED_ORBITS = 4
POWER_PERIODS = 256  # over which P_d is averaged


@typed
def diagnose(
    scene: Scene | SceneFile,
    *,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Diagnosis:
    """The kind of motion that a scene settles on, the evidence for it, and the samples that show it.

    The return map, the largest exponent and the 0-1 test each have their own stretch of the run, one after the other.
    Where they do not agree, or something still decays, the run continues with stretches twice as long, at most twice. A
    motion is called periodic where Newton's method closes a stable orbit and the run stays on it; chaotic where the
    whole interval of the exponent is positive and K exceeds a half; quasi-periodic where the exponent is 0 within a
    narrow interval and K is near 0.

    Of a row of blades it says whether the motion is a travelling wave, and the growth of a nearby run in place of
    exponents from tangents; there is no 0-1 test, and orbits are not closed by Newton's method.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (drive periods done, drive periods at most) until the verdict is found.
        throw: Raise where the run stops before its end, rather than warn.

    Returns:
        The diagnosis: `verdict`, `evidence`, `summary` and the samples; `plot()` draws the page.

    Raises:
        ValueError: There are many scenes, a count is too small, or JAX has no float64.
        NumericalError: With `throw`: the run stopped.

    Source:
        Stroboscopic samples, periods and spectra as in Sec. 3.1 of the article; P_d by Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.diagnose(scene, method=js.RungeKutta(steps=100)).verdict
        'period 1'
    """
    one_scene("diagnose", scene)
    resolved = resolve_options(scene, transient=transient, method=method, verb="diagnose")
    check_row(resolved.scene)
    judge = motion_of_pair if resolved.scene.layout == PAIR else motion_of_row
    found = judge(scene, resolved, state, progress)
    shown = {"n_periods": found.shown, "events": found.events, "method": found.method}
    run = simulate(scene, state=found.start, throw=throw, **shown)
    if found.tried is not None:
        warn_missed(missed_lanes(resolved.lanes, found.tried, progress), found.tried, run.energy_dropped)
    diagnosis = Diagnosis.from_values(found.evidence(run), layout=resolved.scene.layout).data
    data = run.data.assign(diagnosis.data_vars).assign_attrs(diagnosis.attrs)
    if found.status != Status.OK and run.status == Status.OK:  # the verdict's march went further than the samples
        data = data.assign_attrs(status=found.status)
    return Diagnosis(data)


def motion_of_pair(
    scene: Scene | SceneFile, resolved: ResolvedOptions, state: State | None, progress: Progress | None
) -> JudgedMotion:
    """The motion of a pair: by its returns, the exponent of a tangent, the 0-1 test and Newton's method."""
    march = plan_march(resolved, resolved.lanes, FOR_P_D_WITH_LEDGER, tangents=True)
    march = march._replace(method=march.method._replace(ledger=True))
    ((precise, initial),) = resolved.with_states(resolved.scenes, state, march)
    ticker = Ticker(resolved.transient + (2**VERDICT_ROUNDS - 1) * Stretches().all, progress)
    (verdict,) = verdicts(one_lane(precise), one_lane(initial), resolved.transient, march.shooting, tick=ticker)
    stopped = verdict.kind == "stopped"
    shown = MIN_STORED_ORBITS * verdict.q if verdict.q else APERIODIC_PERIODS
    settled = {} if stopped else _settled_evidence(scene, precise, verdict, march)
    return JudgedMotion(
        status=int(verdict.evidence.status),
        start=initial if stopped else verdict.evidence.last,
        shown=verdict.periods if stopped else max(MIN_STORED_PERIODS, shown),
        events=precise.parts.contact == "spring" and not stopped,
        method=march.untried.again,
        evidence=lambda _: _verdict_values(verdict) | settled,
        tried=march.tried,
    )


def _settled_evidence(
    scene: Scene | SceneFile, precise: Scene, verdict: Verdict, march: MarchPlan
) -> dict[str, object]:
    """The exponents of all directions, the multipliers and the convergence of P_d of the settled motion."""
    periods = MIN_STORED_PERIODS if verdict.q else APERIODIC_PERIODS
    settled = verdict.evidence.last
    spectrum = run_alone(lyapunov_exponents(precise, settled, periods, 0, march.steps, march.method))
    same_march = march.untried.again
    cycle = verdict.evidence.cycle if verdict.kind == "periodic" else None
    known = {
        "exponents": spectrum.exponents,
        "exponents_ci": spectrum.ci,
        "slider_stuck": int(spectrum.stuck),
        "multipliers": None if cycle is None or not cycle.sound else cycle.multipliers,
    }
    if not is_comparable("P_d", precise):
        return known
    curve = power(scene, n_periods=POWER_PERIODS, transient=0, stable_within=1e-12, method=same_march, state=settled)
    settled_number = int(curve.final["settled"])  # files cannot hold booleans
    alone = {name: float(curve.final[name]) for name in ("P_d_vibration", "P_d_vibration_ci")}
    return {**known, **alone, "n": curve.n, "P_d": curve.P_d, "P_d_ci": curve.P_d_ci, "P_d_settled": settled_number}


def _verdict_values(verdict: Verdict) -> dict[str, object]:
    """The verdict and its first evidence, by the names of `Diagnosis`."""
    evidence = verdict.evidence
    return {
        "verdict": verdict.words,
        "evidence": verdict_text(verdict),
        "period_number": verdict.q,
        "periods": verdict.periods,
        "return_error": evidence.error,
        "largest_exponent": evidence.exponent,
        "largest_exponent_ci": evidence.ci,
        "K": evidence.K,
        "P_d_settled": 0,
        "slider_stuck": 0,
    }
