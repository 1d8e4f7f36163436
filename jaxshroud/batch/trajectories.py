"""Trajectories: the samples, the events and the energies of many lanes marched through their start-up."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.batch.cubics import SampledAmplitudes
from jaxshroud.batch.dense_output import march_with_dense_output
from jaxshroud.batch.periods import begin_lanes, lanes_per_call
from jaxshroud.batch.row_samples import march_row_samples
from jaxshroud.batch.rows import row_energy_residual, row_jumps, row_ledger
from jaxshroud.batch.runs import Tick, chunk_by_chunk
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
from jaxshroud.batch.stretches import march_in_stretches
from jaxshroud.march.carry import Lane
from jaxshroud.march.events import evaluate_guards
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import ContactForces, energy_residual, total_energy
from jaxshroud.march.start import EVENTS_AT_START, next_at_start
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tally import Tally
from jaxshroud.model.arithmetic import filled, is_absent, sincos_turns
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.model.rhs import Ledger, drive_wave
from jaxshroud.programs.kept import kept
from jaxshroud.scene.scene import Scene


class EnergyBalance(NamedTuple):
    """The energy balance of lanes (leading axis) over a run [J]."""

    works: Ledger  # of all blades; friction of each interface, where users see an axis of them
    of_blades: dict[str, np.ndarray]  # works on each blade of a row, (lanes, blades), by the names of results
    residual: np.ndarray
    dropped: np.ndarray  # by beginnings of flat contact


class Trajectories(NamedTuple):
    """The trajectories of lanes (leading axis)."""

    samples: dict[str, Any]  # name -> values (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    last: Any  # lanes, or rows
    energies: tuple[np.ndarray, np.ndarray]  # stored before and after [J]
    events: dict[str, Any] | None  # the same of both sides of every event, with `t` [steps] and `after`
    balance: EnergyBalance | None = None  # None without a ledger


def trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """March lanes (leading axis), in chunks that share one compiled function, and keep samples.

    Args:
        scenes: The scenes.
        states: The states in which they start.
        grid: The time grid, and which states are kept.
        method: The options of the march.
        ticker: Called with the number of steps done.

    Raises:
        Interrupted: On Ctrl-C, without results.
    """
    of_chunk, balance = (_of_pairs, _balance_of_pairs) if scenes.row is None else (_of_rows, _balance_of_rows)
    run = lambda chunk, tick: of_chunk(chunk[0], chunk[1], grid, method, tick)
    marched = chunk_by_chunk(run, (scenes, states), ticker, lanes_per_call(scenes.layout))
    before, after = marched.energies
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        return marched._replace(balance=balance(marched.last.tally, after - before))


def _balance_of_pairs(tally: Tally, gained: np.ndarray) -> EnergyBalance | None:
    gain, jumps = tally.integrals.ledger, tally.jumps
    if gain is None or jumps is None:
        return None
    residual = np.asarray(energy_residual(*jax.tree.map(jnp.asarray, (gain, jumps, gained))))
    return EnergyBalance(filled(gain, gain.drive), {}, residual, np.asarray(filled(jumps.dropped, gain.gross)))


def _balance_of_rows(tally: Tally, gained: np.ndarray) -> EnergyBalance | None:
    if tally.integrals.ledger is None:
        return None
    works = row_ledger(tally)
    of_blades = {"blade_work_drive": np.asarray(works.drive), "blade_loss_viscous": np.asarray(works.viscous)}
    in_all = Ledger(*(np.asarray(a).sum(axis=-1) for a in works))._replace(friction=works.friction)
    residual = np.asarray(row_energy_residual(jax.tree.map(jnp.asarray, tally), jnp.asarray(gained), -1))
    return EnergyBalance(in_all, of_blades, residual, np.asarray(row_jumps(tally).dropped, float))


def _of_rows(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Trajectories:
    marched = march_row_samples(scenes, states, grid, method._replace(loads=True), tick)
    state, forces = marched.samples
    return Trajectories(_by_name(state, forces), marched.amplitudes, marched.last, marched.energies, None)


def _of_pairs(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Trajectories:
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
    return Trajectories(samples, amplitudes, jax.tree.map(np.asarray, lanes), energies, at_events)


def _begun(scenes: Scene, first: State, turns: float) -> State:
    """The states (leading axis) once all has happened that happens at the instant of their start."""
    forces = sampled_contact_forces(scenes, jax.tree.map(lambda a: np.asarray(a)[:, None], first), np.array([turns]))
    overlap = (np.asarray(first.mode) == Mode.APART) & (forces.v[:, 0] >= 0)
    return _states_once_begun(scenes, first, np.asarray(turns, first.u_s.dtype)) if overlap.any() else first


@kept()
def _states_once_begun(scenes: Scene, states: State, turns) -> State:
    def one(scene: Scene, state: State) -> State:
        model = prepared_model(scene)
        start = now = carried_state(state, model)
        wave = drive_wave(*sincos_turns(turns), model.drive)
        for _ in range(EVENTS_AT_START):
            now = next_at_start(now, start, evaluate_guards(now.motion, wave, now, model), model)
        return with_slider_updated(now, jnp.int32(Status.OK), model)

    return jax.vmap(one)(scenes, states)


def sampled_motions(scenes: Scene, states: State, grid: SampleGrid, method: Choices) -> np.ndarray:
    """The motions (lanes, 1 + samples, 12) of `trajectories` alone, which takes fewer compiled programs."""
    run = lambda chunk, tick: _motions_of_chunk(chunk[0], chunk[1], grid, method, tick)
    return chunk_by_chunk(run, (scenes, states), lambda _: None)


def _motions_of_chunk(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> np.ndarray:
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    marched = march_in_stretches(march, scenes, begin_lanes(scenes, states, method), states, grid)
    return np.concatenate(marched.samples.motion, axis=-1, dtype=float)


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
    return _by_name(states, sampled_contact_forces(scenes, states, turns))


def _by_name(states: State, forces: ContactForces) -> dict[str, Any]:
    """What is told of states and forces, by the names of results; what a model lacks is left out."""
    return {
        "motion": states.motion,
        "u_s": np.where(states.mode == Mode.APART, np.nan, states.u_s),
        "mode": states.mode,
        "case": states.case,
        **{name: a for name, a in forces._asdict().items() if not is_absent(a)},
    }


@kept()
def stored_energies(scenes: Scene, lanes: Lane) -> Float[Array, " lanes"]:
    """The kinetic energies, and the energies of the springs, of lanes (leading axis) [J]."""
    return jax.vmap(lambda scene, lane: total_energy(lane.state, prepared_model(scene)))(scenes, lanes)
