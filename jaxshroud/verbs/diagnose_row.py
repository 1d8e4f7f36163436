"""The kind of motion that one row of blades settles on, with the evidence for it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.plan import Plan, Progress, Runs, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import final_states
from jaxshroud.march.method import FOR_P_D_WITH_LEDGER
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.averages import Reduction, averages, convergence, period_reductions
from jaxshroud.motion.nearby_run import ALIGNED, NearbyGrowth, nearby_growth
from jaxshroud.motion.period import SETTLED, Repetition
from jaxshroud.motion.waves import RowWave
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.asked import Asked, MarchPlan
from jaxshroud.verbs.options import ResolvedOptions
from jaxshroud.verbs.plan import plan_march

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
    told: Callable[[Trajectory], dict[str, object]]  # the verdict and its evidence, by the names of `Diagnosis`


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
        found.status,
        jax.tree.map(lambda a: np.asarray(a)[0], start if stopped else found.last),
        found.periods if stopped else max(LEAST_SHOWN, SHOWN_ORBITS * int(found.orbit.number[0])),
        False,
        march.untried.again,
        partial(_row_evidence, found),
    )


def _evidence(scenes: Scene, states: State, march: MarchPlan, transient: int, progress: Progress | None) -> RowEvidence:
    """Runs twice as long each until the motion has settled, and a nearby run."""
    most = transient + (2**ROUNDS - 1) * FIRST_STRETCH + 2 * (ALIGNED + GROWTH_PERIODS)
    ticker, done = Ticker(most, progress), 0
    plan = Plan(transient, FIRST_STRETCH, march.steps, 0.0, march.method)
    while True:
        runs = run_lanes(scenes, states, plan, ticker)
        done += plan.transient + plan.kept
        states, status = final_states(runs.last.state), int(np.asarray(runs.last.status)[0])
        orbit, power, P_0 = averages(scenes, runs.samples)
        is_last = plan.kept == 2 ** (ROUNDS - 1) * FIRST_STRETCH
        if is_last or status != Status.OK or orbit.settling.verdict[0] == SETTLED:
            break
        plan = replace(plan, transient=0, kept=2 * plan.kept)
    growth = NearbyGrowth(np.nan, np.nan, 0)
    if status == Status.OK:
        one = partial(_after_a_period, scenes, march, ticker)
        growth = nearby_growth(states, _sizes(scenes, runs), one, GROWTH_PERIODS)
    return RowEvidence(status, orbit, power, _latest_series(scenes, runs, orbit, P_0), P_0, done, states, growth)


def _latest_series(scenes: Scene, runs: Runs, orbit: Repetition, P_0: np.ndarray) -> np.ndarray:
    """P_d of each period of the latest whole orbits [%]."""
    series, q = period_reductions(scenes, runs.samples, P_0)[0], max(int(orbit.number[0]), 1)
    return series[len(series) % q :]


def _after_a_period(scenes: Scene, march: MarchPlan, ticker: Ticker, states: State) -> tuple[State, bool]:
    runs = run_lanes(scenes, states, Plan(0, 1, march.steps, 0.0, march.method), ticker)
    return final_states(runs.last.state), bool(np.asarray(runs.last.status)[0] == Status.OK)


def _sizes(scenes: Scene, runs: Runs) -> Motion:
    """The largest displacements of any blade, and the rates that the drive frequency gives them."""
    x, y, theta = (float(np.max(np.abs(a))) for a in runs.samples.largest)
    omega = float(np.asarray(scenes.drive.omega)[0])
    return Motion(x, y, theta, omega * x, omega * y, omega * theta)


def _row_evidence(found: RowEvidence, run: Trajectory) -> dict[str, object]:
    """The verdict and what it rests on; waves are those of the run that is shown."""
    q, power = int(found.orbit.number[0]), found.power
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
    growth, q = found.growth, int(found.orbit.number[0])
    if found.status != Status.OK:
        return "stopped", [f"the run ends with {Status(found.status).name}"]
    settled = found.orbit.settling.verdict[0] == SETTLED
    exponent = f"the distance of a nearby run grows by exp({growth.exponent:.3g} +- {growth.ci:.2g}) a period"
    if np.isnan(growth.exponent):
        exponent = f"a nearby run {'is lost in rounding within a period' if growth.periods else 'stops'}"
    returns = "the blades do not return within as many periods as can be told"
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
