"""Runs from many starts, until each lane has settled or may go on no longer."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import final_states, motion_rows
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.averages import averages, period_maxima
from jaxshroud.motion.period import SETTLED
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import T

KEPT_PERIODS = 64  # latest periods of a lane, which are compared
FIRST_ROUND_PERIODS = 192  # periods of the first round; each round doubles them


class LaneEnds(NamedTuple):
    """The final states of lanes (leading axis), and their motion in the latest periods."""

    state: State
    status: np.ndarray
    number: np.ndarray  # period number, 0: aperiodic or not settled
    samples: np.ndarray  # (lanes, KEPT_PERIODS, 12) at the strobe
    sizes: np.ndarray  # (lanes, 6) largest magnitudes of displacements
    P_d: np.ndarray  # [%]
    ci: np.ndarray  # half width of its 95 % interval
    P_d_vibration: np.ndarray  # that of the vibration about the mean position alone; NaN where it was not integrated


def run_until_settled(scene: Scene, states: State, max_periods: int, steps: int, method, ticker: Tick) -> LaneEnds:
    """Run lanes until they repeat and are settled, for `max_periods` periods at most."""
    ends = _run_round(
        scene,
        states,
        Plan(max(min(FIRST_ROUND_PERIODS, max_periods) - KEPT_PERIODS, 0), KEPT_PERIODS, steps, 0.0, method),
        ticker,
    )
    simulated = max(FIRST_ROUND_PERIODS, KEPT_PERIODS)
    while simulated < max_periods:
        pending = np.flatnonzero((ends.number == 0) & (ends.status == Status.OK))
        if not len(pending):
            break
        plan = Plan(min(simulated, max_periods - simulated) - KEPT_PERIODS, KEPT_PERIODS, steps, 0.0, method)
        if plan.transient < 0:
            break
        simulated += plan.transient + KEPT_PERIODS
        ends = replace_lanes(ends, pending, _run_round(scene, take_lanes(ends.state, pending), plan, ticker))
    return ends


def _run_round(scene: Scene, states: State, plan: Plan, ticker: Tick) -> LaneEnds:
    scenes = repeat_lane(scene, len(states.u_s))
    return lane_ends(scenes, run_lanes(scenes, states, plan, ticker))


def lane_ends(scenes: Scene, runs: Runs) -> LaneEnds:
    """The final states of runs with their latest periods."""
    samples = jax.tree.map(lambda a: a[:, -KEPT_PERIODS:], runs.samples)
    orbit, power, _ = averages(scenes, samples)
    status, sizes = np.asarray(runs.last.status), period_maxima(samples).max(axis=1)
    number = np.where((orbit.settling.verdict == SETTLED) & (status == Status.OK), orbit.number, 0)
    return LaneEnds(
        final_states(runs.last.state),
        status,
        number,
        motion_rows(samples.motion),
        sizes,
        power.P_d,
        power.ci,
        power.P_d_vibration,
    )


def replace_lanes(ends: LaneEnds, lanes: np.ndarray, new: LaneEnds) -> LaneEnds:
    """The lane ends with some lanes replaced."""

    def put(old, latest):
        copy = np.array(old)
        copy[lanes] = latest
        return copy

    return jax.tree.map(put, ends, new)


def take_lanes(tree: T, lanes: np.ndarray) -> T:
    """Some lanes of a tree of arrays."""
    return jax.tree.map(lambda a: np.asarray(a)[lanes], tree)
