"""What a long run will take, from a few of its lanes."""

from dataclasses import replace
from time import process_time

import jax
import numpy as np

from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.scene.scene import Scene

PERIODS = 16  # that lanes are run for before those that are kept, and then
PLACES = 16  # of chunks


def projected_seconds(scenes: Scene, plan: Plan, seed: int = 0) -> float:
    """Processor time that independent lanes will take [s], from chunks of them that are drawn by chance.

    Chunks are those of the run: lanes of one wait for each other, and neighbours less than others. A first run compiles
    the program that all lanes are run by.
    """
    count = len(scenes.drive.omega)
    starting = np.arange(0, count, CHUNK)
    drawn = np.random.default_rng(seed).choice(starting, min(len(starting), PLACES), replace=False)
    some = np.concatenate([np.arange(first, min(first + CHUNK, count)) for first in np.sort(drawn)])
    brief = replace(plan, transient=PERIODS, kept=PERIODS)
    _seconds(scenes, some[: min(count, 2)], replace(plan, transient=1, kept=1))
    each = _seconds(scenes, some, brief) / (len(some) * (brief.transient + brief.kept))
    return each * count * (plan.transient + plan.kept)


def _seconds(scenes: Scene, some: np.ndarray, plan: Plan) -> float:
    """Processor time that some of the lanes take."""
    lanes = jax.tree.map(lambda a: np.asarray(a)[some], scenes)
    began = process_time()
    run_lanes(lanes, starts(lanes), plan, lambda _: None)
    return process_time() - began
