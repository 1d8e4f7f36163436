"""The motions that a row of blades settles on from random starts, told apart by their points at the strobe."""

from collections.abc import Mapping

import jax
import numpy as np

from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import final_states
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.orbit_distance import SweptMotion, number_motions, set_distance
from jaxshroud.motion.random_starts import START_SPREAD, random_row_starts
from jaxshroud.results.attractors import ATTRACTOR_KINDS, STOPPED, UNDECIDED, Attractors, share_interval
from jaxshroud.results.sweep import SweepResult, swept_motions
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.asked import MarchPlan
from jaxshroud.verbs.sweep import sweep


def row_motions(scene: Scene, starts: int, seed: int, march: MarchPlan, transient: int, n_periods: int) -> Attractors:
    """The motions on which a row settles from random starts, and the share of starts that lead to each.

    Starts are at rest, with random rates. A start that has not settled after the transient is undecided.

    Args:
        scene: A row of blades.
        starts: The number of starts.
        seed: Of the starts.
        march: How to march.
        transient: Drive periods run first, at least one.
        n_periods: Drive periods over which motions are compared and averaged.
    """
    lanes = in_precision(without_given(repeat_lane(scene, starts)), march.method.precision)
    states = random_row_starts(jax.tree.map(lambda a: a[0], lanes), starts, seed, START_SPREAD)
    before = Plan(max(transient - 1, 0), 1, march.steps, 0.0, march.method)
    last = run_lanes(lanes, states, before, lambda _: None).last
    status = np.asarray(last.status)
    running = np.flatnonzero(status == Status.OK)
    label = np.where(status == Status.OK, UNDECIDED, STOPPED)
    attrs = march.attributes
    of_starts = {"label": label, "status": status, "spread": START_SPREAD, "seed": seed}
    if not running.size:
        return _found(of_starts | dict.fromkeys(("share", "P_d_least"), np.empty(0)), scene, attrs)
    arrived: State = jax.tree.map(lambda a: np.asarray(a)[running], final_states(last.state))
    settled = repeat_lane(scene, len(running))
    how = {"n_periods": n_periods, "transient": 0, "method": march.again}
    run = sweep(settled, state=arrived, forces=True, amplitudes=True, **how)
    motions = swept_motions(run.data)
    numbers = _most_frequent_first(np.where(run.status == Status.OK, number_motions(motions), UNDECIDED))
    label[running] = np.where(run.status == Status.OK, numbers, STOPPED)
    return _found(of_starts | {"label": label} | _motion_values(run, motions, numbers, starts), scene, attrs)


def _found(values: Mapping[str, object], scene: Scene, attrs: dict[str, int | str]) -> Attractors:
    return Attractors.of_values(values, ("start",), attrs, {"blade": range(len(scene.initial.x))})


def _most_frequent_first(numbers: np.ndarray) -> np.ndarray:
    """The numbers of motions, renumbered by how many lanes have them."""
    known, counts = np.unique(numbers[numbers >= 0], return_counts=True)
    rank = {int(number): i for i, number in enumerate(known[np.argsort(-counts, kind="stable")])}
    return np.array([rank.get(int(number), UNDECIDED) for number in numbers])


def _motion_values(run: SweepResult, motions: list[SweptMotion], numbers: np.ndarray, starts: int) -> dict[str, object]:
    """The values of each motion, by the names of `Attractors`."""
    groups = [np.flatnonzero(numbers == number) for number in range(numbers.max(initial=-1) + 1)]
    first = [int(group[0]) for group in groups]
    over = lambda reduce, values: np.array([reduce(np.asarray(values)[group]) for group in groups])
    counts = over(len, numbers)
    low, high = share_interval(counts, starts)
    period_number = np.asarray(run.period_number)[first]
    return {
        "kind": np.where(period_number > 0, *map(ATTRACTOR_KINDS.index, ("periodic", "aperiodic"))),
        "period_number": period_number,
        "starts": counts,
        "share": counts / starts,
        "share_low": low,
        "share_high": high,
        "P_d": over(np.mean, run.P_d),
        "P_d_ci": over(np.max, run.P_d_ci),
        "P_d_vibration": over(np.mean, run.P_d_vibration),
        "P_d_least": over(np.min, run.P_d),
        "P_d_most": over(np.max, run.P_d),
        "P_d_worst": over(np.min, run.P_d_worst),
        "distance": _distances([motions[i].orbit for i in first]),
        "x_peak": run.x_peak[first],
        "x_free": run.x_free[first],
        "N_max": over(np.max, run.N_max),
        "v_max": over(np.max, run.v_max),
    }


def _distances(orbits: list[np.ndarray]) -> np.ndarray:
    """The distance of each motion from the nearest other one; infinite where it is alone."""
    others = lambda i: (set_distance(orbits[i], orbit) for j, orbit in enumerate(orbits) if j != i)
    return np.array([min(others(i), default=np.inf) for i in range(len(orbits))])
