"""What a long run will take, from a few of its lanes."""

from dataclasses import replace
from time import process_time

import jax
import numpy as np

from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.runs import Plan, Progress, Ticker, run_lanes, starts
from jaxshroud.scene.scene import Scene

PERIODS = 16  # that lanes are run for before those that are kept, and then
PLACES = 16  # of chunks


def projected_seconds(
    scenes: Scene, plan: Plan, seed: int = 0, *, beside: int | None = None, progress: Progress | None = None
) -> float:
    """Processor time that lanes will take [s], from chunks of them that are drawn by chance.

    Chunks are those of the run: lanes of one wait for each other, and neighbours less than others. A first run compiles
    the program that all lanes are run by.

    Args:
        scenes: The lanes.
        plan: How they are run.
        seed: Of the chance.
        beside: How many are run at once where others follow them, value by value; None: all.
        progress: Called with (lane-periods done, lane-periods in all) of the trial.
    """
    count, width = len(scenes.drive.omega), beside or CHUNK
    starting = np.arange(0, count, width)
    places = min(len(starting), PLACES, max(PLACES * CHUNK // width, 1))
    firsts = np.sort(np.random.default_rng(seed).choice(starting, places, replace=False))
    some = [np.arange(first, min(first + width, count)) for first in firsts]
    pieces = [np.concatenate(some)] if beside is None else some
    brief, lanes = replace(plan, transient=PERIODS, kept=PERIODS), sum(map(len, pieces))
    ticker = Ticker(lanes * (brief.transient + brief.kept), progress)
    _seconds(scenes, pieces[0][:2], replace(plan, transient=1, kept=1), Ticker(0, None))
    taken = sum(_seconds(scenes, piece, brief, ticker) for piece in pieces)
    return taken / (lanes * (brief.transient + brief.kept)) * count * (plan.transient + plan.kept)


def _seconds(scenes: Scene, some: np.ndarray, plan: Plan, ticker: Ticker) -> float:
    """Processor time that some of the lanes take."""
    lanes = jax.tree.map(lambda a: np.asarray(a)[some], scenes)
    began = process_time()
    run_lanes(lanes, starts(lanes), plan, ticker)
    return process_time() - began
