"""Sampled motions of any number of lanes with one tangent each, outside JAX's transformations."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.differentiable_samples import Schedule, samples_with_tangents
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.size_limits import check_memory
from jaxshroud.batch.states import by_blade, initial_states, motion_rows, to_vector
from jaxshroud.batch.threads import Check, in_chunks
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State

LANES_PER_CHUNK = 16  # that share one compiled function
SAMPLE_NUMBERS = 32  # of a sample and its tangent


class SampledMotions(NamedTuple):
    """Displacements and their rates at samples, the start included; NaN once a lane has stopped."""

    place: np.ndarray  # (lanes, 1 + samples, 6): x, y, theta, left before right [m, rad]
    rate: np.ndarray  # their rates
    place_by: np.ndarray  # tangents of the same
    rate_by: np.ndarray
    end_by: np.ndarray  # (lanes, 13) tangent of the state at the end


def motions_with_tangents(scenes: Dual, states: Dual, schedule: Schedule, wanted: int | None = None) -> SampledMotions:
    """The sampled motions of lanes from their states, with tangents along the direction of each lane.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        states: The initial states and their directions, likewise.
        schedule: How far they are run.
        wanted: The samples that are wanted, of which there are so many; None: all. They do not depend on it.

    Raises:
        InputError: The samples would not fit into memory.
    """
    lanes = len(scenes.value.drive.omega)
    check_memory("what is sampled of the motions", lanes * schedule.samples * SAMPLE_NUMBERS * 8)

    def run(check: Check, at: np.ndarray) -> SampledMotions:
        check()
        scene, state = jax.tree.map(lambda a: np.asarray(a)[at], (scenes, states))
        return _sampled_chunk(scene, state, schedule, schedule.samples if wanted is None else wanted)

    return in_chunks(run, lanes, LANES_PER_CHUNK)


def _sampled_chunk(scenes: Dual, states: Dual, schedule: Schedule, wanted: int) -> SampledMotions:
    flow = samples_with_tangents(scenes, states, schedule, wanted)
    value, slope = by_blade(jax.tree.map(lambda a: a[:, :wanted], flow))
    stopped = (value.status != Status.OK)[..., None]
    first = np.concatenate([*states.value.motion], axis=-1), np.concatenate([*states.tangent.motion], axis=-1)
    rows = [motion_rows(flow.state.motion) for flow in (value, slope)]
    rows = [np.where(stopped, np.nan, row) for row in rows]
    (place, rate), (place_by, rate_by) = (
        np.split(np.concatenate([start[:, None], row], axis=1), 2, axis=-1)
        for start, row in zip(first, rows, strict=True)
    )
    last = jax.tree.map(lambda a: a[:, -1], slope.state)
    return SampledMotions(place, rate, place_by, rate_by, to_vector(last))


def start_duals(scenes: Dual) -> Dual:
    """The initial states of scenes with directions, with the directions of their numbers `initial`."""
    moved = initial_states(scenes.tangent)
    return Dual(initial_states(scenes.value), State(moved.motion, moved.u_s, None, None))
