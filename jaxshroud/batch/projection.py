"""What a long run will take, projected from short trials of some of its lanes."""

from contextlib import suppress
from dataclasses import replace
from time import perf_counter, process_time

import jax
import numpy as np

from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Plan, Progress, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import initial_states
from jaxshroud.scene.scene import Scene

PROJECTED_PERIODS = 16  # of the transient, and of the kept part, of the sampled lanes
MAX_SAMPLED_CHUNKS = 16  # that are timed
TRIAL_SECONDS = 10.0  # after which a trial ends wherever it is: of rows a single period may take longer
TRIAL_SHARE = 0.1  # of a run, after which its trial ends as well


class _EnoughError(Exception):
    """A trial has run for long enough."""


def projected_seconds(
    scenes: Scene, plan: Plan, seed: int = 0, *, beside: int | None = None, progress: Progress | None = None
) -> float:
    """The processor time that lanes will take [s], from randomly drawn chunks.

    The chunks are those of the run: the lanes of a chunk wait for each other, and neighbours do so less than others. A
    first run compiles the program of all lanes.

    Args:
        scenes: The lanes.
        plan: The plan of the run.
        seed: The seed of the draw.
        beside: How many lanes are run at once where values are continued one by one; None: all.
        progress: Called with (lane-periods done, lane-periods in all) of this measurement.
    """
    count, chunk = len(scenes.drive.omega), lanes_per_call(scenes.layout)
    width = beside or chunk
    starting = np.arange(0, count, width)
    brief = replace(plan, transient=PROJECTED_PERIODS, kept=PROJECTED_PERIODS)
    places = min(len(starting), MAX_SAMPLED_CHUNKS, max(MAX_SAMPLED_CHUNKS * chunk // width, 1))
    firsts = np.random.default_rng(seed).choice(starting, places, replace=False)
    some = [np.arange(first, min(first + width, count)) for first in firsts]
    pieces = [np.concatenate(some)] if beside is None else some
    whole = count * (plan.transient + plan.kept)
    ticker = Ticker(sum(map(len, pieces)) * (brief.transient + brief.kept), progress)
    _processor_seconds(scenes, pieces[0][:2], replace(plan, transient=0, kept=1), Ticker(0, None), 0.0, 0.0)
    taken = 0.0
    for i, piece in enumerate(pieces, 1):
        most = TRIAL_SECONDS / len(pieces), TRIAL_SHARE * whole * i / len(pieces)
        taken += _processor_seconds(scenes, piece, brief, ticker, *most)
    return taken / ticker.done * whole


def _processor_seconds(
    scenes: Scene, some: np.ndarray, plan: Plan, ticker: Ticker, seconds: float, lane_periods: float
) -> float:
    """The processor time that some of the lanes take [s], in so many seconds at most, or until so much is done."""
    lanes = jax.tree.map(lambda a: np.asarray(a)[some], scenes)
    began, end = process_time(), perf_counter() + seconds

    def tick(more: int | float) -> None:
        ticker(more)
        if ticker.done > 0 and (perf_counter() > end or ticker.done >= lane_periods):
            raise _EnoughError

    with suppress(_EnoughError):
        run_lanes(lanes, initial_states(lanes), plan, tick)
    return process_time() - began
