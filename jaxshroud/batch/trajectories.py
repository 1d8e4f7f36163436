"""Trajectories: the samples, the events and the energies of many lanes through their start-up."""

import jax
import numpy as np

from jaxshroud.batch.marches import march_of
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import chunk_by_chunk
from jaxshroud.batch.stretches import Trajectories
from jaxshroud.march.method import Choices
from jaxshroud.model.prepared import State
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


def trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """The trajectories of lanes (leading axis), by the march of their scenes.

    Args:
        scenes: The scenes.
        states: The states in which they start.
        grid: The time grid, and which states are kept.
        method: The options of the march.
        ticker: Called with the number of steps done, if there are steps.

    Raises:
        Interrupted: On Ctrl-C, without results.
    """
    march = march_of(scenes)
    return march.trajectories(march, scenes, states, grid, method, ticker)


def sampled_motions(scenes: Scene, states: State, grid: SampleGrid, method: Choices) -> Motion:
    """The motions of `trajectories` alone, (lanes, 1 + samples, blades) each, which takes fewer compiled programs.

    They are marched step by step without contact too.
    """
    run = lambda chunk, tick: march_of(scenes).motions(chunk[0], chunk[1], grid, method, tick)
    motions = chunk_by_chunk(run, (scenes, states), lambda _: None, lanes_per_call(scenes.layout))
    return jax.tree.map(lambda a: np.asarray(a, float), motions)
