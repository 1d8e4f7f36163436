"""Lanes of pairs and of rows: their constants, their start, their energies, and their states as users have them.

Outside, arrays have the axis of lanes first, as everywhere; inside compiled functions the lanes are last, see
`model.row`. The numbers of a pair are those of a row of two, unrolled: each is an array of lanes by itself.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.states import carried_state, users_state
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.accumulator import Accumulator, EnergyJumps
from jaxshroud.march.carry import EachLane, Lane
from jaxshroud.march.forces_and_energy import (
    ContactForces,
    contact_spring_energy,
    energy_residual,
    slider_position,
    stacked_point_forces,
)
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import row_contact_forces
from jaxshroud.march.row_step import whole
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import any_along, filled, is_unrolled, is_zero, sincos_turns, total
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Ledger
from jaxshroud.model.row import (
    RowModel,
    at_interface,
    at_only_interface,
    blade_energies,
    clusters,
    coupling_energies,
    over,
    pair_states,
    prepared_row,
    turned_as_one,
)
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def lanes_last(tree: Tree) -> Tree:
    """A tree of arrays (lanes, ...) with the lanes last; those along unrolled axes have no other axis."""
    return _moved(tree, 0, -1)


def lanes_first(tree: Tree) -> Tree:
    """The inverse of `lanes_last`."""
    return _moved(tree, -1, 0)


def _moved(tree: Tree, source: int, to: int) -> Tree:
    return jax.tree.map(lambda a: a if is_unrolled(a) else jnp.moveaxis(a, source, to), tree, is_leaf=is_unrolled)


def lane_models(scenes: Scene) -> tuple[RowModel, Float[Array, " lanes"]]:
    """The constants of lanes, lanes last, and their drive periods."""
    return lanes_last(jax.vmap(prepared_row)(scenes)), scenes.drive.period


def begin_lanes(scenes: Scene, states: State, method: Choices) -> Lane:
    """The lanes at their start from `states`, as users have them."""
    return _begin_lanes(scenes, states, method, best_mapping())


@compiled("method", "each")
def _begin_lanes(scenes: Scene, states: State, method: Choices, each: EachLane) -> Lane:
    return lanes_first(lanes_at_start(states, lane_models(scenes)[0], method, each))


def lanes_at_start(states: State, model: RowModel, method: Choices, each: EachLane) -> Lane:
    """The lanes, lanes last, at their start from `states`, lanes first."""
    return stepper_for(method).begin(carried_states(states, model), model, method, each)


def carried_states(states: State, model: RowModel) -> State:
    """States as users have them, lanes first, in the form that compiled loops carry, lanes last."""
    return carried_state(lanes_last(states), model)


def stored_energies(state: State, model: RowModel, each: EachLane) -> Float[Array, " lanes"]:
    """The energy stored in blades, in the springs between them and in contact springs [J]."""
    springs = over(each, contact_spring_energy, pair_states(state, model), model.interfaces)
    own = total(blade_energies(state.motion, model, each)) + total(springs)
    between = coupling_energies(state.motion, model)
    return own if is_zero(between) else own + total(between)


@compiled("each")
def energies_of_lanes(scenes: Scene, lanes: Lane, each: EachLane) -> Float[Array, " lanes"]:
    """The energies stored in blades and springs of lanes (leading axis) [J]."""
    return stored_energies(lanes_last(lanes).state, lane_models(scenes)[0], each)


def ledger_of(accumulator: Accumulator) -> Ledger:
    """The works of lanes, with zeros where there is no friction: those of rows of each blade, friction of each face."""
    ledger, jumps = accumulator.integrals.ledger, accumulator.jumps
    assert ledger is not None  # where works are requested they are kept, and so are the jumps
    assert jumps is not None
    friction = at_interface(ledger.friction) if is_unrolled(jumps.springs) else ledger.friction
    return filled(ledger, ledger.drive)._replace(friction=filled(friction, jumps.springs))


def residual_of_energy(accumulator: Accumulator, gained: Any) -> Any:
    """The residual of the energy balance of lanes [J], lanes last, that have `gained` energy."""
    jumps = accumulator.jumps
    assert jumps is not None
    works = Ledger._make(in_all(a, gained) for a in ledger_of(accumulator))
    return energy_residual(works, EnergyJumps(in_all(jumps.springs, gained), jumps.dropped), gained)


def in_all(a: Any, like: Any) -> Any:
    """The sum of what there is of each blade or interface; what is of lanes, as `like` is, as it is."""
    return total(a) if is_unrolled(a) or jnp.ndim(a) > jnp.ndim(like) else a


class Sampled(NamedTuple):
    """States of lanes as users have them, and the forces of contact there."""

    state: State
    forces: ContactForces | None  # absent where the model lacks them; None where they are not requested


def sampled(
    state: State, status: Int[Array, " lanes"], turns: Any, model: RowModel, each: EachLane, forces: bool
) -> Sampled:
    """A sample of lanes, lanes last, at phases of the drive [turns]; NaN where the status is not OK."""
    u_s, of_contact = whole(each, partial(_contact_now, forces=forces), state, turns, model)
    found = as_users_have(State(model.blades.shroud(state.motion), u_s, state.mode, state.case))
    if forces:
        of_contact = as_arrays_of_users(of_contact)
    lost = status != Status.OK

    def kept(a: Any) -> Any:
        return jnp.where(lax.broadcast_in_dim(lost, a.shape, range(lost.ndim)), jnp.nan, a)

    motion, u_s, of_contact = jax.tree.map(kept, (found.motion, found.u_s, of_contact))
    return Sampled(State(motion, u_s, found.mode, found.case), of_contact)


def _contact_now(state: State, turns: Any, model: RowModel, each: EachLane, forces: bool) -> tuple[Any, Any]:
    """The sliders, and the forces of contact if they are requested, lanes last."""
    u_s = over(each, slider_position, pair_states(state, model), model.interfaces)
    return u_s, row_contact_forces(state, each(sincos_turns, turns), model, each) if forces else None


def as_arrays_of_users(forces: ContactForces) -> ContactForces:
    """The forces of contact, lanes last, as users have them, lanes first."""
    forces = at_only_interface(lanes_first(forces))
    points = stacked_point_forces(forces.points, jnp.zeros_like(forces.v))
    return forces._replace(N=filled(forces.N, forces.v), F=filled(forces.F, forces.v), points=points)


def as_users_have(state: State) -> State:
    """The states of shrouds, lanes last, as users have them, lanes first."""
    return users_state(lanes_first(state))


def canonical(state: State, model: RowModel, each: EachLane) -> State:
    """The states, lanes last, with the numbers that their modes determine: sliders but in stick, one angle if flat.

    Numbers on which no later motion depends are then unique, and have no tangent.
    """
    motion, u_s = state.motion, state.u_s
    if model.turns_by_events:
        motion = turned_as_one(motion, clusters(state.case, model), any_along(state.case == FLAT), model)
    state = State(motion, u_s, state.mode, state.case)
    if is_zero(u_s) or model.interfaces.law.flows:
        return state

    def slider(state: State, model: Model) -> Any:
        sliders = slider_position(state, model)
        return jax.tree.map(lambda u_s, mode: jnp.where(mode == Mode.APART, 0.0, u_s), sliders, state.mode)

    u_s = over(each, slider, pair_states(state, model), model.interfaces)
    return State(motion, u_s, state.mode, state.case)
