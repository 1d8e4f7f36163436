"""What a long run will take, from a few of its lanes."""

from dataclasses import replace
from time import process_time

import jax
import numpy as np

from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.scene.scene import Scene

PERIODS = 8  # that lanes are run for before they are timed, and then


def projected_seconds(scenes: Scene, plan: Plan, seed: int = 0) -> float:
    """Processor time that independent lanes will take [s], from some of them that are drawn by chance.

    Their first run compiles the program that all lanes are run by.
    """
    count = len(scenes.drive.omega)
    some = np.random.default_rng(seed).choice(count, min(count, CHUNK), replace=False)
    drawn = jax.tree.map(lambda a: np.asarray(a)[some], scenes)
    brief = replace(plan, transient=PERIODS, kept=PERIODS)
    seconds = 0.0
    for _ in range(2):
        began = process_time()
        run_lanes(drawn, starts(drawn), brief, lambda _: None)
        seconds = process_time() - began
    each = seconds / (len(some) * (brief.transient + brief.kept))
    return each * count * (plan.transient + plan.kept)
