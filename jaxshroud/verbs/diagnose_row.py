"""The kind of motion that one row of blades settles on, with the evidence for it."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Progress, Runs, Ticker, run_lanes
from jaxshroud.batch.states import final_states
from jaxshroud.march.method import FOR_P_D_WITH_LEDGER, Method
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.averages import Reduction, averages
from jaxshroud.motion.nearby_run import ALIGNED, NearbyGrowth, nearby_growth
from jaxshroud.motion.period import SETTLED, Repetition
from jaxshroud.motion.waves import RowWave
from jaxshroud.results.row_diagnosis import RowDiagnosis
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.options import MarchPlan, check_row, plan_march, resolve_options
from jaxshroud.verbs.simulate import simulate

FIRST_STRETCH, ROUNDS = 64, 3  # of the evidence; each round is twice as long
GROWTH_PERIODS = 64  # of the nearby run
LEAST_SHOWN, SHOWN_ORBITS = 8, 2  # at least
WAVE = 1e-6  # of the square of the motion outside a travelling wave: less is one


class RowEvidence(NamedTuple):
    """What a verdict on a row rests on."""

    status: int
    orbit: Repetition
    power: Reduction
    P_0: np.ndarray  # (1, N) [m^4]
    periods: int  # run in all
    last: State  # one lane (leading axis)
    growth: NearbyGrowth


def row_diagnosis(
    scene: Scene | SceneFile,
    transient: int | None,
    method: Method | str | float | None,
    state: State | None,
    progress: Progress | None,
    throw: bool,
) -> RowDiagnosis:
    """`diagnose` of a row: its period number, waves, P_d, and the growth of a nearby run."""
    resolved = resolve_options(scene, transient=transient, method=method, verb="diagnose")
    check_row(resolved.scene)
    march = plan_march(resolved, resolved.lanes, FOR_P_D_WITH_LEDGER)
    march = march._replace(method=march.method._replace(ledger=True))
    scenes = in_precision(without_given(resolved.lanes), march.method.precision)
    start = resolved.states(state, scenes)
    found = _evidence(scenes, start, march, resolved.transient, progress)
    stopped = found.status != Status.OK
    q = int(found.orbit.number[0])
    shown = found.periods if stopped else max(LEAST_SHOWN, SHOWN_ORBITS * q)
    begin = jax.tree.map(lambda a: np.asarray(a)[0], start if stopped else found.last)
    run = simulate(scene, n_periods=shown, method=march.as_method, state=begin, throw=throw)
    return _with_verdict(run, found)


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
    return RowEvidence(status, orbit, power, P_0, done, states, growth)


def _after_a_period(scenes: Scene, march: MarchPlan, ticker: Ticker, states: State) -> tuple[State, bool]:
    runs = run_lanes(scenes, states, Plan(0, 1, march.steps, 0.0, march.method), ticker)
    return final_states(runs.last.state), bool(np.asarray(runs.last.status)[0] == Status.OK)


def _sizes(scenes: Scene, runs: Runs) -> Motion:
    """The largest displacements of any blade, and the rates that the drive frequency gives them."""
    x, y, theta = (float(np.max(np.abs(a))) for a in runs.samples.largest)
    omega = float(np.asarray(scenes.drive.omega)[0])
    return Motion(x, y, theta, omega * x, omega * y, omega * theta)


def _with_verdict(run: Trajectory, found: RowEvidence) -> RowDiagnosis:
    """The run, with the verdict and what it rests on."""
    wave = RowDiagnosis(run.data.assign_attrs(period_number=int(found.orbit.number[0]))).wave
    verdict, reasons = _verdict(wave if run.closed else None, found)
    values = {
        "verdict": verdict,
        "evidence": f"{verdict}: {'; '.join(reasons)}",
        "period_number": int(found.orbit.number[0]),
        "periods": found.periods,
        "largest_exponent": found.growth.exponent,
        "largest_exponent_ci": found.growth.ci,
        "P_d": float(found.power.P_d[0]),
        "P_d_ci": float(found.power.ci[0]),
        "P_d_vibration": float(found.power.P_d_vibration[0]),
        "P_d_vibration_ci": float(found.power.vibration_ci[0]),
        "P_d_worst": float(power_reduction(found.power.P, found.P_0).min()),
        "P": found.power.P[0],
        "P_0": found.P_0[0],
    }
    told = RowDiagnosis.from_values(values).data
    data = run.data.assign(told.data_vars).assign_attrs(told.attrs)
    return RowDiagnosis(data)


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
