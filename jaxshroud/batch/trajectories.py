"""Trajectories: the samples, the events and the energies of many lanes marched through their start-up."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.batch.dense_output import march_with_dense_output
from jaxshroud.batch.periods import begin_lanes
from jaxshroud.batch.runs import Tick, chunk_by_chunk
from jaxshroud.batch.sampling import SampledMarch, SampleGrid, current_states, march_by_steps, march_by_trials
from jaxshroud.batch.states import sampled_contact_forces
from jaxshroud.march.carry import Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import total_energy
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import is_absent
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.programs.kept import kept
from jaxshroud.scene.scene import Scene


class Trajectories(NamedTuple):
    """The trajectories of lanes (leading axis)."""

    samples: dict[str, Any]  # name -> values (lanes, 1 + samples, ...)
    last: Lane
    energies: tuple[np.ndarray, np.ndarray]  # stored before and after [J]
    events: dict[str, Any] | None  # the same of both sides of every event, with `t` [steps] and `after`


def trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """March lanes (leading axis), in chunks that share one compiled function, and keep samples.

    Args:
        scenes: The scenes.
        states: The states in which they start.
        grid: The time grid, and which states are kept.
        method: The options of the march.
        ticker: Called with the number of samples done.

    Raises:
        Interrupted: On Ctrl-C, without results.
    """
    run = lambda chunk, tick: _trajectories_of_chunk(chunk[0], chunk[1], grid, method, tick)
    return chunk_by_chunk(run, (scenes, states), ticker)


def _trajectories_of_chunk(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Trajectories:
    lanes, first = _begin_sampled(scenes, states, method)
    before = stored_energies(scenes, lanes)
    lanes, blocks, events = _sampled_march(scenes, lanes, grid, method, tick)
    blocks = [jax.tree.map(lambda a: np.asarray(a)[:, None], first), *blocks]
    whole = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    samples = _values(scenes, whole, grid.turns + np.arange(grid.samples + 1) * grid.every / grid.steps)
    at_events = None
    if events is not None:
        at_events = _values(scenes, events.states, grid.turns + events.steps / grid.steps)
        at_events |= {"t": events.steps[None], "after": events.samples[None]}
    energies = np.asarray(before), np.asarray(stored_energies(scenes, lanes))
    return Trajectories(samples, jax.tree.map(np.asarray, lanes), energies, at_events)


def sampled_motions(scenes: Scene, states: State, grid: SampleGrid, method: Choices) -> np.ndarray:
    """The motions (lanes, 1 + samples, 12) of `trajectories` alone, which takes fewer compiled programs."""
    run = lambda chunk, tick: _motions_of_chunk(chunk[0], chunk[1], grid, method, tick)
    return chunk_by_chunk(run, (scenes, states), lambda _: None)


def _motions_of_chunk(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> np.ndarray:
    blocks = _sampled_march(scenes, begin_lanes(scenes, states, method), grid, method, tick).blocks
    motions = [jax.tree.map(lambda a: a[:, None], states.motion), *(block.motion for block in blocks)]
    return np.concatenate([np.concatenate(motion, axis=-1, dtype=float) for motion in motions], axis=1)


def _sampled_march(scenes: Scene, lanes: Lane, grid: SampleGrid, method: Choices, tick: Tick) -> SampledMarch:
    if stepper_for(method).dense_output is not None:
        return march_with_dense_output(scenes, lanes, grid, method, tick)
    return (march_by_trials if grid.events else march_by_steps)(scenes, lanes, grid, method, tick)


@kept("method")
def _begin_sampled(scenes: Scene, states: State, method: Choices) -> tuple[Lane, State]:
    """The lanes at their start, and their states there as samples."""
    lanes = begin_lanes(scenes, states, method)
    return lanes, current_states(scenes, lanes)


def _values(scenes: Scene, states: State, turns: np.ndarray) -> dict[str, Any]:
    """The stored values of states (lanes, samples) at phases of the drive (samples,) [turns]."""
    contact = sampled_contact_forces(scenes, states, turns)._asdict()
    return {
        "motion": states.motion,
        "u_s": np.where(states.mode == Mode.APART, np.nan, states.u_s),
        "mode": states.mode,
        "case": states.case,
        **{name: a for name, a in contact.items() if not is_absent(a)},
    }


@kept()
def stored_energies(scenes: Scene, lanes: Lane) -> Float[Array, " lanes"]:
    """The kinetic energies, and the energies of the springs, of lanes (leading axis) [J]."""
    return jax.vmap(lambda scene, lane: total_energy(lane.state, prepared_model(scene)))(scenes, lanes)
