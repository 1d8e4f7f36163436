"""Runs from random starts, in the range of the motion without contact, until each lane has settled."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import carried_state, final_states, motion_rows, states_apart
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.cache.programs import kept
from jaxshroud.march.log import penetrations
from jaxshroud.model.linear import free_reach, steady_amplitudes
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State, initial_state
from jaxshroud.model.row import alone, prepared_row
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import T
from jaxshroud.signals.averages import averages, half_diagonal, period_maxima
from jaxshroud.signals.period import SETTLED

START_SPREAD = 2.0  # contact can double the range of the free motion
MAX_DRAWS = 64  # for each start, after which overlap is accepted


def start_range(scene: Scene) -> Motion:
    """The range of initial states to either side, fields (blades,): the steady amplitude without contact plus the gap.

    For angles the gap counts as the turn that moves a corner by it; rates are the frequency of the highest harmonic
    times displacements. Of the gaps of a row the largest counts.

    Raises:
        InputError: The amplitude is infinite.
    """
    free = steady_amplitudes(scene)
    gap = float(np.abs(scene.running_shroud.gap).max())
    omega = float(scene.drive.frequency(max(free)))
    amplitudes = [np.asarray(free_reach(free, name), float) for name in DISPLACEMENTS]
    lever = float(half_diagonal(scene.shroud))
    if not np.isfinite(amplitudes).all():
        raise InputError(
            "The drive meets an undamped natural frequency: without contact the amplitude is infinite, and so is the "
            "range of random starts; change drive.omega or give the blades a damping."
        )
    blades = range(len(amplitudes[0]))
    movable = [np.array([scene.parts.has(name, blade) for blade in blades]) for name in ("x", "y", "theta")]
    ranges = [(p + g) * m for p, g, m in zip(amplitudes, (gap, gap, gap / lever), movable, strict=True)]
    return Motion._make([*ranges, *(omega * w for w in ranges)])


def random_starts(scene: Scene, n: int, seed: int, spread: float) -> State:
    """States (n,) apart at drive phase 0, uniform within `spread` times the `start_range`.

    Those of a pair with overlapping blocks are drawn again, as they would begin with spurious elastic energy. Rows
    start at rest, with random rates: the gaps of a ring add up to what they are, and displaced blades would overlap.
    """
    rng = np.random.default_rng(seed)
    ranges = start_range(scene)
    if scene.row is not None:
        rates = np.moveaxis(rng.uniform(-spread, spread, (n, 3, len(ranges.x))) * np.stack(ranges[3:]), 1, 0)
        return states_apart(repeat_lane(scene, n), Motion._make([*np.zeros_like(rates), *rates]))
    starts = np.empty((0, 6, 2))
    draws = starts
    for _ in range(MAX_DRAWS):
        draws = rng.uniform(-spread, spread, (n, 6, 2)) * np.stack(ranges)
        is_apart = np.asarray(_overlap(scene, Motion._make(np.moveaxis(draws, 1, 0))) < 0)
        starts = np.concatenate([starts, draws[is_apart]])
        if len(starts) >= n:
            break
    starts = np.concatenate([starts, draws])[:n]  # with interference nearly all overlap
    return states_apart(repeat_lane(scene, n), Motion._make(np.moveaxis(starts, 1, 0)))


def _overlap(scene: Scene, motions: Motion):
    """The overlap of the blocks (n,); -1 m where the model has no contact."""
    if scene.parts.contact == "none":
        return -np.ones(len(motions.x))
    return _overlaps(scene, motions)


@kept()
def _overlaps(scene: Scene, motions: Motion):
    model = prepared_row(scene)

    def depth(motion: Motion):
        return penetrations(carried_state(initial_state(motion, scene.points), model), model, alone)[0]

    return jax.vmap(depth)(motions)


KEPT_PERIODS = 64  # latest periods of a lane, which are compared
FIRST_ROUND_PERIODS = 192  # periods of the first round; each round doubles them


class LaneEnds(NamedTuple):
    """The final states of lanes (leading axis), and their motion in the latest periods."""

    state: State
    status: np.ndarray
    number: np.ndarray  # period number, 0: aperiodic or not settled
    samples: np.ndarray  # (lanes, KEPT_PERIODS, 6 blades) at the strobe
    sizes: np.ndarray  # (lanes, 3 blades) largest magnitudes of displacements
    P_d: np.ndarray  # [%]
    ci: np.ndarray  # half width of its 95 % interval
    P_d_vibration: np.ndarray  # that of the vibration about the mean position alone; NaN where it was not integrated


def run_until_settled(scene: Scene, states: State, max_periods: int, steps: int, method, ticker: Tick) -> LaneEnds:
    """Run lanes until they repeat and are settled, for `max_periods` periods at most.

    The ticker counts what lanes that end before that need not run as done.
    """
    ends = _run_round(
        scene,
        states,
        Plan(max(min(FIRST_ROUND_PERIODS, max_periods) - KEPT_PERIODS, 0), KEPT_PERIODS, steps, 0.0, method),
        ticker,
    )
    simulated = max(FIRST_ROUND_PERIODS, KEPT_PERIODS)
    running = len(ends.status)
    while simulated < max_periods:
        pending = np.flatnonzero((ends.number == 0) & (ends.status == Status.OK))
        ticker((running - len(pending)) * (max_periods - simulated))
        running = len(pending)
        if not running:
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
    status = np.asarray(runs.last.status)
    sizes = period_maxima(samples).max(axis=1)
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
