"""Marches with samples, stretch by stretch: what is kept of them, and where the displacements of the last steps lie."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.cubics import RunningAmplitudes, SampledAmplitudes
from jaxshroud.batch.sampling import EventStates, SampleGrid, Stretch, concatenated_events
from jaxshroud.batch.states import final_states
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


class SampledRun(NamedTuple):
    """The result of a march with samples."""

    lanes: Any  # at the end
    samples: Any  # (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    events: EventStates | None  # None unless they are kept


def march_in_stretches(
    march: Callable[[Any, Stretch], Any],
    scenes: Scene,
    lanes: Any,
    first: Any,
    grid: SampleGrid,
    motion_of: Callable[[Any], Motion] = lambda states: states.motion,
) -> SampledRun:
    """March lanes, or rows (leading axis), over the grid.

    Args:
        march: Marches lanes over a stretch: the lanes at its end, its samples, and its events.
        scenes: The scenes.
        lanes: Where they start.
        first: The first sample.
        grid: The time grid, and what is kept.
        motion_of: The motion in samples.
    """
    blocks, events, running = [jax.tree.map(lambda a: np.asarray(a)[:, None], first)], [], None
    for stretch in grid.stretches(len(lanes.status)):
        counts = stretch.first >= grid.length - grid.counted
        if counts and running is None:
            running = RunningAmplitudes(final_states(lanes.state).motion, grid.step_lengths(scenes))
        lanes, states, some = march(lanes, stretch)
        if running is not None:
            running.add(motion_of(states))
        kept = stretch.kept(grid)
        blocks.append(jax.tree.map(lambda a, kept=kept: a if len(kept) == a.shape[1] else a[:, kept], states))
        events += [] if some is None else [some]
    samples = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    amplitudes = None if running is None else running.amplitudes
    return SampledRun(lanes, samples, amplitudes, concatenated_events(events) if events else None)
