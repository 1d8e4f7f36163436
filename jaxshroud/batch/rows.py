"""Rows of blades through time: whole drive periods of many lanes, in compiled functions.

Outside, arrays have the axis of lanes first, as everywhere; inside the compiled functions the lanes are last, see
`model.row`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.batch.blocks import PeriodKernels
from jaxshroud.batch.periods import LOGGED_BY_PERIOD, Sample, repeated_trials
from jaxshroud.batch.stretches import EnergyBalance
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.carry import EachLane, Fixed, Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import contact_spring_energy, energy_residual, slider_position
from jaxshroud.march.row_log import tally_of_new_period
from jaxshroud.march.row_trial import begin_row, row_trial
from jaxshroud.march.tally import EnergyJumps, Tally, mean_position
from jaxshroud.model.arithmetic import ABSENT, filled
from jaxshroud.model.modes import Status
from jaxshroud.model.points_contact import points_last
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Ledger
from jaxshroud.model.row import RowModel, blade_energies, blade_positions, over, pair_states, prepared_row
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
    models = lanes_last(jax.vmap(prepared_row)(scenes))
    return models, scenes.drive.period


def begin_rows(scenes: Scene, states: State, method: Choices) -> Lane:
    """The rows at their start from `states`, whose motion is (lanes, N), and whose contact is (lanes, E)."""
    return _begin_rows(scenes, states, method, best_mapping())


@compiled("method", "each")
def _begin_rows(scenes: Scene, states: State, method: Choices, each: EachLane) -> Lane:
    return lanes_first(rows_at_start(states, row_models(scenes)[0], method, each))


def rows_at_start(states: State, model: RowModel, method: Choices, each: EachLane) -> Lane:
    """The rows, lanes last, at their start from `states`, lanes first."""
    return begin_row(carried_row(lanes_last(states), model), model, method, each)


def carried_row(state: State, model: RowModel) -> State:
    """A user's state in the form that compiled loops carry."""
    motion = state.motion
    if isinstance(motion, Motion):
        moves = lambda name: name.removeprefix("v_") in model.parts.motion
        motion = Motion(*(a if moves(name) else ABSENT for name, a in zip(Motion._fields, motion, strict=True)))
        motion = model.blades.carried(motion)
    law = model.interfaces.law
    u_s, mode = state.u_s, state.mode
    if law.has_points and not isinstance(mode, tuple):
        u_s, mode = (jnp.moveaxis(a, 1, 0) for a in (u_s, mode))  # the axis of points first
    return State(motion, law.carried_slider(u_s, mode), law.carried_mode(mode), state.case)


def march_rows(lanes: Lane, fixed: Fixed, method: Choices, each: EachLane, passes: Int[Array, ""] | None = None) -> Any:
    """Run every row to the start of step `stop`, or until its status is not OK; `passes` as in `periods.march`."""
    return repeated_trials(lambda lanes: row_trial(lanes, fixed, method, each), lanes, fixed.stop, True, passes=passes)


def energies_in_rows(state: State, model: RowModel, each: EachLane) -> Float[Array, " lanes"]:
    """The energy stored in blades and contact springs [J]."""
    springs = over(each, contact_spring_energy, pair_states(state, model), model.interfaces)
    return jnp.sum(blade_energies(state.motion, model, each), axis=0) + jnp.sum(springs, axis=0)


def row_jumps(tally: Tally) -> EnergyJumps:
    """The energy that jumped at the events of a row, at each interface and in all."""
    assert tally.jumps is not None  # rows keep them
    return tally.jumps


def row_ledger(tally: Tally) -> Ledger:
    """The works of a row, of each blade and each interface, with zeros where there is no friction."""
    return filled(tally.integrals.ledger, row_jumps(tally).springs)


def row_energy_residual(tally: Tally, gained: Any, axis: int) -> Any:
    """The residual of the energy balance of rows [J] that have `gained` energy; blades and interfaces along an axis."""
    total = lambda a: a.sum(axis=axis)
    jumps = EnergyJumps(total(row_jumps(tally).springs), row_jumps(tally).dropped)
    return energy_residual(jax.tree.map(total, row_ledger(tally)), jumps, gained)


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
    """The rows with an empty tally, and the energies that they store."""
    empty = tally_of_new_period(lanes.tally, model.blades.shroud(lanes.state.motion), method)
    return eqx.tree_at(lambda lane: lane.tally, lanes, empty), energies_in_rows(lanes.state, model, each)


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
    tally, log, jumps = lanes.tally, lanes.tally.log, row_jumps(lanes.tally)
    gain: Any = tally.integrals
    z = model.blades.shroud(lanes.state.motion)
    assert log is not None  # only flows with tangents have none
    gained = energies_in_rows(lanes.state, model, each) - before
    works: dict[str, Any] = {}
    if gain.ledger is not None:
        ledger = row_ledger(tally)
        works = {"work": ledger.drive, "gross": ledger.gross, "viscous": ledger.viscous, "friction": ledger.friction}
        works |= {
            "switched": jumps.springs,
            "dropped": jumps.dropped,
            "residual": row_energy_residual(tally, gained, 0),
        }
    means = mean_position(tally, z, period, steps, blade_positions)
    logged = {name: getattr(log, name) for name in LOGGED_BY_PERIOD}
    sums = {"moments": gain.moments, "means": means}
    of_blades = {"motion": z, "largest": logged.pop("largest"), "extent": logged.pop("extent")} | sums
    told = filled(of_blades, gain.power) | filled({"loads": gain.loads} | logged, jumps.springs)
    sample = Sample(power=gain.power / period[None], **works, **told)
    totals = (jnp.sum(jnp.atleast_2d(a), axis=0) for a in jax.tree.leaves(sample._replace(own=None)))
    overflowed = ended & (lanes.status == Status.OK) & ~jnp.isfinite(sum(totals, gained))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), sample)


def balance_of_rows(tally: Tally, gained: np.ndarray) -> EnergyBalance | None:
    """The energy balance of rows that have `gained` energies [J]; None without a ledger."""
    if tally.integrals.ledger is None:
        return None
    works = row_ledger(tally)
    of_blades = {"blade_work_drive": np.asarray(works.drive), "blade_loss_viscous": np.asarray(works.viscous)}
    in_all = Ledger(*(np.asarray(a).sum(axis=-1) for a in works))._replace(friction=works.friction)
    residual = np.asarray(row_energy_residual(jax.tree.map(jnp.asarray, tally), jnp.asarray(gained), -1))
    return EnergyBalance(in_all, of_blades, residual, np.asarray(row_jumps(tally).dropped, float))


ROW_KERNELS = PeriodKernels(lanes_last, lanes_first, row_models, march_rows, _begin_row_period, _end_row_period)


def row_sample(row: Sample) -> Sample:
    """Samples of rows, in which the works on their blades are added up."""
    total = lambda a: None if a is None else a.sum(axis=-1)
    row = jax.tree.map(np.asarray, row)
    return row._replace(work=total(row.work), gross=total(row.gross), viscous=total(row.viscous))
