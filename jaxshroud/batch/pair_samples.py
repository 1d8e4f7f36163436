"""Samples of pairs of blades at instants: their states, their contact forces, and the states around their events."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.batch.dense_output import march_with_dense_output
from jaxshroud.batch.periods import begin_lanes
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.sampling import (
    SampledMarch,
    SampleGrid,
    Stretch,
    current_states,
    march_by_steps,
    march_by_trials,
    with_slider_updated,
)
from jaxshroud.batch.states import carried_state, sampled_contact_forces
from jaxshroud.batch.stretches import EnergyBalance, SampledLanes, march_in_stretches, values_by_name
from jaxshroud.march.carry import Lane
from jaxshroud.march.events import evaluate_guards
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import energy_residual, total_energy
from jaxshroud.march.start import events_at_start, next_at_start
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tally import Tally
from jaxshroud.model.arithmetic import filled, sincos_turns
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.programs.kept import kept
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


def sampled_pairs(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> SampledLanes:
    """March pairs (leading axis) and keep samples; `tick` gets the number of further steps."""
    lanes, first = _begin_sampled(scenes, states, method)
    first = _begun(scenes, first, grid.turns)
    before = stored_energies(scenes, lanes)
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    lanes, whole, amplitudes, events = march_in_stretches(march, scenes, lanes, first, grid)
    samples = _values(scenes, whole, grid.turns + np.arange(grid.samples + 1) * grid.every / grid.steps)
    at_events = None
    if events is not None:
        at_events = _values(scenes, events.states, grid.turns + events.steps / grid.steps)
        after = np.where(events.steps == 0, -1, events.samples)  # the first sample comes after what happens at once
        at_events |= {"t": events.steps[None], "after": after[None]}
    energies = np.asarray(before), np.asarray(stored_energies(scenes, lanes))
    return SampledLanes(samples, amplitudes, jax.tree.map(np.asarray, lanes), energies, at_events)


def _begun(scenes: Scene, first: State, turns: float) -> State:
    """The states (leading axis) once all has happened that happens at the instant of their start."""
    forces = sampled_contact_forces(scenes, jax.tree.map(lambda a: np.asarray(a)[:, None], first), np.array([turns]))
    apart = np.asarray(interface_mode(by_point(first.mode, first.case))) == Mode.APART
    overlap = apart & (forces.v[:, 0] >= 0)
    return _states_once_begun(scenes, first, np.asarray(turns, first.u_s.dtype)) if overlap.any() else first


@kept()
def _states_once_begun(scenes: Scene, states: State, turns) -> State:
    def one(scene: Scene, state: State) -> State:
        model = prepared_model(scene)
        start = now = carried_state(state, model)
        wave = drive_waves(*sincos_turns(turns), model.drive)
        for _ in range(events_at_start(model)):
            now = next_at_start(now, start, evaluate_guards(now.motion, wave, now, model), model)
        return with_slider_updated(now, jnp.int32(Status.OK), model)

    return jax.vmap(one)(scenes, states)


def motions_of_pairs(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Motion:
    """The motion of the samples of pairs (leading axis) alone."""
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    return march_in_stretches(march, scenes, begin_lanes(scenes, states, method), states, grid).samples.motion


def _march_stretch(
    scenes: Scene, lanes: Lane, stretch: Stretch, *, grid: SampleGrid, method: Choices, tick: Tick
) -> SampledMarch:
    march = march_by_trials if grid.events else march_by_steps
    if stepper_for(method).dense_output is not None:
        march = march_with_dense_output
    return march(scenes, lanes, stretch, grid, method, tick)


@kept("method")
def _begin_sampled(scenes: Scene, states: State, method: Choices) -> tuple[Lane, State]:
    """The lanes at their start, and their states there as samples."""
    lanes = begin_lanes(scenes, states, method)
    return lanes, current_states(scenes, lanes)


def _values(scenes: Scene, states: State, turns: np.ndarray) -> dict[str, Any]:
    """The stored values of states (lanes, samples) at phases of the drive (samples,) [turns]."""
    return values_by_name(states, sampled_contact_forces(scenes, states, turns))


def balance_of_pairs(tally: Tally, gained: np.ndarray) -> EnergyBalance | None:
    """The energy balance of pairs that have `gained` energies [J]; None without a ledger."""
    gain, jumps = tally.integrals.ledger, tally.jumps
    if gain is None or jumps is None:
        return None
    residual = np.asarray(energy_residual(*jax.tree.map(jnp.asarray, (gain, jumps, gained))))
    return EnergyBalance(filled(gain, gain.drive), {}, residual, np.asarray(filled(jumps.dropped, gain.gross)))


@kept()
def stored_energies(scenes: Scene, lanes: Lane) -> Float[Array, " lanes"]:
    """The kinetic energies, and the energies of the springs, of lanes (leading axis) [J]."""
    return jax.vmap(lambda scene, lane: total_energy(lane.state, prepared_model(scene)))(scenes, lanes)
