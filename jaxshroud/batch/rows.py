"""Rows of blades through time: whole drive periods of many lanes, in compiled functions, with tangents.

Outside, arrays have the axis of lanes first, as everywhere; inside the compiled functions the lanes are last, see
`model.row`. A row has kernels of blades and of interfaces with sums in between, which JAX differentiates; the kernels
compute the tangents of their values. Every lane has one direction.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.blocks import PeriodKernels
from jaxshroud.batch.duals import Dual, differentiable, with_tangent
from jaxshroud.batch.flows import FlowPrograms, FlowWithMoments, canonical_slider
from jaxshroud.batch.periods import LOGGED_BY_PERIOD, Sample, repeated_trials
from jaxshroud.batch.states import by_blade
from jaxshroud.batch.stretches import EnergyBalance
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.accumulator import Accumulator, EnergyJumps, mean_position
from jaxshroud.march.carry import EachLane, Fixed, Lane, PerLane
from jaxshroud.march.events import place_contact
from jaxshroud.march.forces_and_energy import contact_spring_energy, energy_residual, slider_position
from jaxshroud.march.log import accumulator_of_new_period
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import begin_row, row_trial
from jaxshroud.model.arithmetic import ZERO, filled, is_zero, total
from jaxshroud.model.modes import FLAT, Status
from jaxshroud.model.points_contact import points_last
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Ledger
from jaxshroud.model.row import (
    RowModel,
    blade_energies,
    blade_positions,
    clusters,
    coupling_energies,
    over,
    pair_states,
    prepared_row,
)
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def lanes_last(tree: Tree) -> Tree:
    """A tree of arrays (lanes, ...) with the lanes last."""
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), tree)


def lanes_first(tree: Tree) -> Tree:
    """A tree of arrays (..., lanes) with the lanes first."""
    return jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), tree)


def row_models(scenes: Scene) -> tuple[RowModel, Float[Array, " lanes"]]:
    """The constants of rows, lanes last, and their drive periods."""
    return lanes_last(jax.vmap(prepared_row)(scenes)), scenes.drive.period


def begin_rows(scenes: Scene, states: State, method: Choices) -> Lane:
    """The rows at their start from `states`, whose motion is (lanes, N), and whose contact is (lanes, E)."""
    return _begin_rows(scenes, states, method, best_mapping())


@compiled("method", "each")
def _begin_rows(scenes: Scene, states: State, method: Choices, each: EachLane) -> Lane:
    return lanes_first(rows_at_start(states, row_models(scenes)[0], method, each))


def rows_at_start(states: State, model: RowModel, method: Choices, each: EachLane) -> Lane:
    """The rows, lanes last, at their start from `states`, lanes first."""
    if model.is_pair:
        carried = state_of_row(jax.vmap(carried_state)(states, model.pair))
    else:
        carried = carried_row(lanes_last(states), model)
    return stepper_for(method).begin(carried, model, method, each)


def carried_row(state: State, model: RowModel) -> State:
    """A user's state in the form that compiled loops carry."""
    motion = state.motion
    if isinstance(motion, Motion):

        def moves(name):
            return name.removeprefix("v_") in model.parts.motion

        motion = Motion._make(a if moves(name) else ZERO for name, a in zip(Motion._fields, motion, strict=True))
        motion = model.blades.carried(motion)
    law = model.interfaces.law
    u_s, mode = state.u_s, state.mode
    if law.has_points and not isinstance(mode, tuple):
        u_s, mode = (jnp.moveaxis(a, 1, 0) for a in (u_s, mode))  # the axis of points first
    return State(motion, law.carried_slider(u_s, mode), law.carried_mode(mode), state.case)


def march_rows(lanes: Lane, fixed: Fixed, method: Choices, each: EachLane, passes: Int[Array, ""] | None = None) -> Any:
    """Run every row to the start of step `stop`, or until its status is not OK; `passes` as in `periods.march`."""
    trial = stepper_for(method).trial
    once = jax.jit(lambda lanes: trial(lanes, fixed, method, each))  # traced once
    return repeated_trials(once, lanes, fixed.stop, not fixed.model.is_pair or has_several_kernels(method), passes)


def energies_in_rows(state: State, model: RowModel, each: EachLane) -> Float[Array, " lanes"]:
    """The energy stored in blades, in the springs between them and in contact springs [J]."""
    springs = over(each, contact_spring_energy, pair_states(state, model), model.interfaces)
    own = total(blade_energies(state.motion, model, each)) + total(springs)
    between = coupling_energies(state.motion, model)
    return own if is_zero(between) else own + total(between)


def row_jumps(accumulator: Accumulator) -> EnergyJumps:
    """The energy that jumped at the events of a row, at each interface and in all."""
    assert accumulator.jumps is not None  # rows keep them
    return accumulator.jumps


def row_ledger(accumulator: Accumulator) -> Ledger:
    """The works of a row, of each blade and each interface, with zeros where there is no friction."""
    return filled(accumulator.integrals.ledger, row_jumps(accumulator).springs)


def row_energy_residual(accumulator: Accumulator, gained: Any, axis: int) -> Any:
    """The residual of the energy balance of rows [J] that have `gained` energy; blades and interfaces along an axis."""

    def total(a):
        return a.sum(axis=axis)

    jumps = EnergyJumps(total(row_jumps(accumulator).springs), row_jumps(accumulator).dropped)
    return energy_residual(jax.tree.map(total, row_ledger(accumulator)), jumps, gained)


def updated_slider(state: State, status: Int[Array, " lanes"], model: RowModel, each: EachLane) -> State:
    """A state with its sliders updated and zeros for what is absent; NaN where the status is not OK."""
    u_s = over(each, slider_position, pair_states(state, model), model.interfaces)
    z = model.blades.shroud(state.motion)
    motion, u_s = filled(z, z.x), filled(u_s, jnp.zeros(state.case.shape, z.x.dtype))
    motion, u_s = jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), (motion, u_s))
    return State(motion, points_last(u_s, -2), points_last(state.mode, -2), state.case)


def _begin_row_period(
    lanes: Lane, model: RowModel, method: Choices, each: EachLane
) -> tuple[Lane, Float[Array, " lanes"]]:
    """The rows with an empty accumulator, and the energies that they store."""
    empty = accumulator_of_new_period(lanes.accumulator, model.blades.shroud(lanes.state.motion), method)
    return eqx.tree_at(lambda lane: lane.accumulator, lanes, empty), energies_in_rows(lanes.state, model, each)


def _end_row_period(
    lanes: Lane,
    before: Float[Array, " lanes"],
    model: RowModel,
    period: Float[Array, " lanes"],
    steps: Float[Array, ""],
    each: EachLane,
    ended: Any = True,
) -> tuple[Lane, Sample]:
    """`batch.periods.ended_pairs` for rows; the works in a sample are those of each blade."""
    accumulator, log, jumps = lanes.accumulator, lanes.accumulator.log, row_jumps(lanes.accumulator)
    gain: Any = accumulator.integrals
    z = model.blades.shroud(lanes.state.motion)
    assert log is not None  # only flows with tangents have none
    gained = energies_in_rows(lanes.state, model, each) - before
    works: dict[str, Any] = {}
    if gain.ledger is not None:
        ledger = row_ledger(accumulator)
        works = {"work": ledger.drive, "gross": ledger.gross, "viscous": ledger.viscous, "friction": ledger.friction}
        works |= {
            "switched": jumps.springs,
            "dropped": jumps.dropped,
            "residual": row_energy_residual(accumulator, gained, 0),
        }
    means = mean_position(accumulator, z, period, steps, blade_positions)
    logged = {name: getattr(log, name) for name in LOGGED_BY_PERIOD}
    sums = {"moments": gain.moments, "means": means}
    of_blades = {"motion": z, "largest": logged.pop("largest"), "extent": logged.pop("extent")} | sums
    others = filled(of_blades, gain.power) | filled({"loads": gain.loads} | logged, jumps.springs)
    sample = Sample(power=gain.power / period[None], **works, **others)
    totals = (jnp.sum(jnp.atleast_2d(a), axis=0) for a in jax.tree.leaves(sample._replace(own=None)))
    overflowed = ended & (lanes.status == Status.OK) & ~jnp.isfinite(sum(totals, gained))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), sample)


def balance_of_rows(accumulator: Accumulator, gained: np.ndarray) -> EnergyBalance | None:
    """The energy balance of rows that have `gained` energies [J]; None without a ledger."""
    if accumulator.integrals.ledger is None:
        return None
    works = row_ledger(accumulator)
    of_blades = {"blade_work_drive": np.asarray(works.drive), "blade_loss_viscous": np.asarray(works.viscous)}
    in_all = Ledger._make(np.asarray(a).sum(axis=-1) for a in works)._replace(friction=works.friction)
    residual = np.asarray(row_energy_residual(jax.tree.map(jnp.asarray, accumulator), jnp.asarray(gained), -1))
    return EnergyBalance(in_all, of_blades, residual, np.asarray(row_jumps(accumulator).dropped, float))


ROW_KERNELS = PeriodKernels(lanes_last, lanes_first, row_models, march_rows, _begin_row_period, _end_row_period)


def row_sample(row: Sample) -> Sample:
    """Samples of rows, in which the works on their blades are added up."""

    def total(a):
        return None if a is None else a.sum(axis=-1)

    row = jax.tree.map(np.asarray, row)
    return row._replace(work=total(row.work), gross=total(row.gross), viscous=total(row.viscous))


ROW_LANES_PER_FLOW = (16, 16)  # of rows, whose kernels have as many numbers again for each blade


@compiled("method")
def begin_row_flows(scenes: Dual, states: Dual, method: Choices) -> Dual:
    """`begin_flows` for rows; the lanes are last."""
    each = differentiable(best_mapping())

    def begin(scenes: Scene, states: State) -> Lane:
        model = row_models(scenes)[0]
        return begin_row(canonical_row(carried_row(lanes_last(states), model), model, each), model, method, each)

    return with_tangent(begin, scenes, states)


@compiled()
def end_row_flows(scenes: Dual, lanes: Dual, n: Int[Array, ""], turns: PerLane | None) -> Dual:
    """`end_flows` for rows; powers and moments are tuples of all blades."""
    each = differentiable(best_mapping())

    def end(scenes: Scene, lanes: Lane) -> FlowWithMoments:
        model, period = row_models(scenes)
        time = n.astype(period.dtype) * (period if turns is None else turns * period)
        flow = lanes_first(_end_of_rows(lanes, model, time, each))
        sums = flow.power, flow.moments, flow.means
        power, moments, means = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), sums)
        return flow._replace(power=power, moments=moments, means=means)

    return with_tangent(end, scenes, lanes)


def _end_of_rows(lanes: Lane, model: RowModel, time: Any, each: EachLane) -> FlowWithMoments:
    """The flow of rows, lanes last, after `time` seconds."""
    gain: Any = lanes.accumulator.integrals

    def mean(tree):
        return jax.tree.map(lambda a: a / lax.broadcast_to_rank(time, a.ndim), filled(tree, gain.power))

    power = mean(gain.power)
    overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(jnp.sum(power, axis=0))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    end = canonical_row(lanes.state, model, each)
    motion, u_s = filled(end.motion, end.motion.x), filled(end.u_s, jnp.zeros(end.case.shape, power.dtype))
    return FlowWithMoments(State(motion, u_s, end.mode, end.case), power, status, mean(gain.moments), mean(gain.means))


def canonical_row(state: State, model: RowModel, each: EachLane) -> State:
    """The state of rows, lanes last, with the numbers that its modes determine, as `canonical` of the pair."""
    motion, u_s = state.motion, state.u_s
    if model.turns_by_events:
        cluster = clusters(state.case, model)
        flat = jnp.any(state.case == FLAT, axis=0)

        def level(a):
            return jnp.where(flat, cluster.mean(a), a)

        motion = motion._replace(theta=level(motion.theta), v_theta=level(motion.v_theta))
    state = State(motion, u_s, state.mode, state.case)
    if is_zero(u_s) or model.interfaces.law.flows:
        return state

    def slider(state: State, model: Model) -> Any:
        return canonical_slider(place_contact(state.motion, state, model)[2], state, model)

    u_s = over(each, slider, pair_states(state, model), model.interfaces)
    return State(motion, u_s, state.mode, state.case)


ROW_FLOWS = FlowPrograms(begin_row_flows, end_row_flows, by_blade, ROW_LANES_PER_FLOW)
