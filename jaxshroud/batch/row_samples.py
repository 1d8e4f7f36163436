"""Samples of rows of blades: states and contact forces of many lanes at instants, in compiled functions."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.periods import CallLimits, Clock, Interim, first_passes, select_tree
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.rows import (
    begin_rows,
    energies_in_rows,
    lanes_first,
    lanes_last,
    march_rows,
    row_models,
    updated_slider,
)
from jaxshroud.batch.sampling import SampleGrid, Stretch, sampled_in_calls
from jaxshroud.batch.states import events_at_start, next_at_start
from jaxshroud.batch.stretches import SampledAmplitudes, SampledLanes, march_in_stretches, values_by_name
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.carry import EachLane, Fixed, Lane, TimeGrid, running
from jaxshroud.march.forces_and_energy import ContactForces, stacked_point_forces
from jaxshroud.march.method import Choices
from jaxshroud.march.row_guards import interface_view, row_contact_forces, row_torques
from jaxshroud.model.arithmetic import ZERO, filled, sincos_turns
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.model.prepared import State
from jaxshroud.model.row import RowModel, over, pair_states
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


class RowSamples(NamedTuple):
    """States of rows at instants, with the contact forces: motion (..., N), contact (..., E)."""

    state: State
    forces: ContactForces


@compiled("method", "block", "each")
def _row_samples(
    scenes: Scene,
    begin: Interim,
    clock: Clock,
    every: Int[Array, ""],
    limits: CallLimits,
    method: Choices,
    block: int,
    each: EachLane,
) -> tuple[Interim, Int[Array, ""], RowSamples]:
    """The next samples (leading axis, then the lanes), `every` steps apart, after how many there are."""
    model, period = row_models(scenes)
    grids = clock.grids(period)

    def one(carry, i):
        (lanes, stops, inside), passes = carry
        on = (i < limits.most) & (passes > 0)
        stops = jnp.where(on & ~inside, lanes.step + every, stops)
        fixed = Fixed(model, grids, jnp.where(on, stops, 0))
        lanes, passes = march_rows(lanes, fixed, method, each, passes)
        over = on & ~jnp.any(running(lanes, stops))
        ended, sample = _row_sample(lanes, model, clock, grids, each)
        return (Interim(select_tree(over, ended, lanes), stops, (on | inside) & ~over), passes), (
            lanes_first(sample),
            over,
        )

    first = begin._replace(lanes=lanes_last(begin.lanes)), limits.passes
    (end, _), (samples, over) = lax.scan(one, first, jnp.arange(block, dtype=jnp.int32))
    return end._replace(lanes=lanes_first(end.lanes)), jnp.sum(over, dtype=jnp.int32), samples


def next_row_sample(
    lanes: Lane,
    every: Int[Array, ""],
    model: RowModel,
    period: Float[Array, " lanes"],
    clock: Clock,
    method: Choices,
    each: EachLane,
) -> tuple[Lane, RowSamples]:
    """The rows `every` steps later, and their states and forces there; lanes last."""
    grids = clock.grids(period)
    lanes = march_rows(lanes, Fixed(model, grids, lanes.step + every), method, each)
    return _row_sample(lanes, model, clock, grids, each)


def _row_sample(lanes: Lane, model: RowModel, clock: Clock, grids: TimeGrid, each: EachLane) -> tuple[Lane, RowSamples]:
    """The rows as they continue after a sample, and the sample."""
    turns = grids.start + lanes.step.astype(grids.start.dtype) * grids.turn
    lanes = eqx.tree_at(lambda lane: lane.step, lanes, lanes.step % clock.steps)
    return lanes, _sampled(lanes, turns, model, each)


def _sampled(lanes: Lane, turns: Float[Array, " lanes"], model: RowModel, each: EachLane) -> RowSamples:
    forces = row_contact_forces(lanes.state, each(sincos_turns, turns), model, each)
    zero = jnp.zeros(lanes.state.case.shape, turns.dtype)
    lost = lanes.status != Status.OK
    point, of_points = forces.contact_point, stacked_point_forces(forces.points, zero, -2)
    forces = filled(forces._replace(contact_point=ZERO, points=None), zero)
    forces = forces._replace(contact_point=point, points=of_points)
    return RowSamples(
        updated_slider(lanes.state, lanes.status, model, each),
        jax.tree.map(lambda a: jnp.where(lost, jnp.nan, a), forces),
    )


@compiled("each")
def _first_sample(scenes: Scene, lanes: Lane, start: Any, each: EachLane) -> RowSamples:
    model, period = row_models(scenes)
    return lanes_first(_sampled(lanes_last(lanes), jnp.broadcast_to(start, period.shape), model, each))


@compiled("each")
def _rows_once_begun(scenes: Scene, lanes: Lane, start: Any, each: EachLane) -> Lane:
    """The rows (leading axis) once all has happened that happens at the instant of their start."""
    model, period = row_models(scenes)
    lanes = lanes_last(lanes)
    wave, now = each(sincos_turns, jnp.broadcast_to(start, period.shape)), lanes.state

    def pairs(state):
        return pair_states(state, model)

    def at_interface(torque: Any, now: State, start: State, model: Any) -> tuple[Any, Any, Any]:
        after = next_at_start(now, start, interface_view(torque, now, model), model)
        return after.u_s, after.mode, after.case

    for _ in range(events_at_start(model.interfaces)):
        torque, _ = row_torques(now, wave, model, each)
        u_s, mode, case = over(each, at_interface, torque, pairs(now), pairs(lanes.state), model.interfaces)
        now = State(now.motion, u_s, mode, case)
    return lanes_first(eqx.tree_at(lambda lanes: lanes.state, lanes, now))


@compiled("each")
def stored_energies_of_rows(scenes: Scene, lanes: Lane, each: EachLane) -> Float[Array, " lanes"]:
    """The energies stored in blades and contact springs of rows (leading axis) [J]."""
    return energies_in_rows(lanes_last(lanes).state, row_models(scenes)[0], each)


ROW_SAMPLES_PER_CALL = 256


class SampledRows(NamedTuple):
    """Marched rows (leading axis) with samples."""

    samples: RowSamples  # (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    last: Lane
    energies: tuple[np.ndarray, np.ndarray]  # stored before and after [J]


def march_row_samples(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Any) -> SampledRows:
    """March rows (leading axis) and keep samples.

    Args:
        scenes: The scenes.
        states: The states in which they start.
        grid: The time grid, and which states are kept.
        method: The options of the march.
        tick: Called with the number of further steps.
    """
    each, host, clock = best_mapping(), lambda tree: jax.tree.map(np.asarray, tree), grid.clock(scenes, method)
    lanes = begin_rows(scenes, states, method)
    before = np.asarray(stored_energies_of_rows(scenes, lanes, each))
    first = host(_first_sample(scenes, lanes, clock.start, each))
    apart = np.asarray(interface_mode(by_point(first.state.mode, first.state.case))) == Mode.APART
    if np.any(apart & (first.forces.v >= 0)):
        begun = _rows_once_begun(scenes, lanes, clock.start, each)
        first = host(_first_sample(scenes, begun, clock.start, each))

    def march(lanes: Lane, stretch: Stretch) -> tuple[Lane, RowSamples, None]:
        def block(interim: Interim, limits: CallLimits) -> tuple[Interim, Any, RowSamples]:
            every = jnp.int32(stretch.apart)
            return _row_samples(scenes, interim, clock, every, limits, method, ROW_SAMPLES_PER_CALL, each)

        pace = CallPace(first_passes(len(lanes.status), scenes.layout))
        begin = Interim(lanes, np.zeros(lanes.status.shape, np.int32), np.bool_(False))
        end, samples = sampled_in_calls(block, begin, stretch, ROW_SAMPLES_PER_CALL, pace, tick)
        return end.lanes, samples, None

    run = march_in_stretches(march, scenes, lanes, first, grid, lambda samples: samples.state.motion)
    energies = before, np.asarray(stored_energies_of_rows(scenes, run.lanes, each))
    return SampledRows(run.samples, run.amplitudes, host(run.lanes), energies)


def sampled_rows(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> SampledLanes:
    """March rows (leading axis) and keep samples with the loads; `tick` gets the number of further steps."""
    marched = march_row_samples(scenes, states, grid, method._replace(loads=True), tick)
    values = values_by_name(*marched.samples)
    return SampledLanes(values, marched.amplitudes, marched.last, marched.energies, None)


def motions_of_rows(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Motion:
    """The motion of the samples of rows (leading axis) alone."""
    return march_row_samples(scenes, states, grid, method, tick).samples.state.motion
