"""Lanes of pairs and of rows: their states in all forms, their constants, their start, their energies.

Outside, arrays have the axis of lanes first, as everywhere; inside compiled functions the lanes are last, see
`model.row`. The numbers of a pair are those of a row of two, unrolled: each is an array of lanes by itself.

At the instant of a start contact begins where blocks that are apart overlap. A march crosses these events in its first
trials, of length zero; here they are crossed without a march.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.cache.programs import is_traced
from jaxshroud.linear.equilibrium import ContactState, with_float64
from jaxshroud.linear.load_path import start_equilibria
from jaxshroud.march.accumulator import Accumulator, EnergyJumps
from jaxshroud.march.carry import EachLane, Lane
from jaxshroud.march.event import GuardEvaluation, any_of, first_kind, present
from jaxshroud.march.events import transition
from jaxshroud.march.forces_and_energy import (
    ContactForces,
    contact_spring_energy,
    energy_residual,
    slider_position,
    stacked_point_forces,
)
from jaxshroud.march.locate import select
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import row_contact_forces
from jaxshroud.march.row_step import whole
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import ZERO, Unrolled, any_along, filled, is_unrolled, is_zero, sincos_turns, total
from jaxshroud.model.blade import ModalMotion
from jaxshroud.model.linear_system import moving_shapes, shroud_statics
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.points_contact import interface_mode, points_last
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
from jaxshroud.scene.checks import InputError, Precision
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.modes import ModalBlades
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree
from jaxshroud.scene.valid import in_precision


def initial_states(scenes: Scene) -> State:
    """The initial state of each scene (leading axis), which needs nothing compiled except for a static start."""
    if scenes.start != "motion":
        return static_states(scenes)
    motion = own_motion(scenes.initial, scenes)
    if isinstance(scenes.blades, ModalBlades):
        modes = scenes.blades.modes
        starts = [mode.q for mode in modes], [mode.v for mode in modes]
        motion = ModalMotion._make(tuple(map(_plus, *parts)) for parts in zip(motion, starts, strict=True))
    return states_apart(scenes, motion)


def _plus(a: Any, further: Any) -> Any:
    return a if further is None else a + further


def static_states(scenes: Scene) -> State:
    """The states of scenes (leading axis) in their static equilibria; see `Scene.start`.

    They are apart, so that faces which overlap touch at once without friction, unless loads from rest have led there.
    """
    if is_traced(scenes):
        raise InputError("A static start is not found inside JAX's transformations; give a `state` to start from.")
    single = not np.ndim(scenes.drive.omega)
    lanes = jax.tree.map(lambda a: np.asarray(a)[None], scenes) if single else scenes
    rest = start_equilibria(lanes)
    by_shroud = shroud_statics(jax.tree.map(with_float64, lanes))[1]
    places = rest.q
    if by_shroud is not None:
        places = (by_shroud @ rest.q.reshape(len(rest.q), -1, 1)).reshape(len(rest.q), -1, rest.q.shape[-1])
    at_rest = places.astype(lanes.drive.omega.dtype)
    q = tuple(at_rest[0] if single else np.moveaxis(at_rest, 1, 0))
    still = tuple(np.zeros_like(a) for a in q)
    state = states_apart(scenes, Motion._make([*q, *still]) if by_shroud is None else ModalMotion(q, still))
    is_led = scenes.start == "from rest" and scenes.parts.contact != "none"
    return _in_contact(state, rest.contact) if is_led else state


def _in_contact(state: State, contact: ContactState) -> State:
    """A state apart, with its faces in a state of contact."""
    apart = np.equal(contact.mode, Mode.APART).all(axis=-1)
    case = np.where(apart, 0, contact.case).astype(np.int32).reshape(np.shape(state.case))
    u_s = np.asarray(contact.u_s, state.u_s.dtype).reshape(np.shape(state.u_s))
    return State(state.motion, u_s, np.reshape(contact.mode, np.shape(state.mode)), case)


def states_apart(scenes: Scene, motion: Any) -> State:
    """The states of scenes (leading axis) with a motion, apart: where blocks overlap, contact begins at once."""
    like = jnp if is_traced(scenes) else np
    one = scenes.friction.mu  # at each interface
    real = scenes.drive.omega.dtype
    nothing = like.zeros_like(one, np.int32)
    points = scenes.contact.points
    motion = own_motion(motion, scenes)
    if points is None:
        return State(motion, like.zeros_like(one, real), nothing, nothing)
    shape = (*np.shape(one), points.number)
    return State(motion, like.zeros(shape, real), like.zeros(shape, np.int32), nothing)


def own_motion(motion: Any, scenes: Scene) -> Any:
    """The motion of the blades' own coordinates, of least norm, that moves the shrouds of scenes (leading axis) so."""
    if isinstance(motion, ModalMotion) or not isinstance(scenes.blades, ModalBlades):
        return motion
    if not is_traced((motion, scenes)):
        motion, scenes = jax.tree.map(np.asarray, (motion, scenes))  # by NumPy: nothing is compiled
    xp = motion.x.__array_namespace__()
    shapes = moving_shapes(scenes)
    gram = xp.sum(shapes[:, None] * shapes, axis=2)
    one = xp.eye(3).reshape(3, 3, *(1,) * (gram.ndim - 2))
    a, b, c = xp.where((gram == 0) & (one == 1), 1.0, gram)  # a shape of zeros moves nothing
    dual = xp.stack([xp.cross(b, c, axis=0), xp.cross(c, a, axis=0), xp.cross(a, b, axis=0)])

    def least(moved: Any) -> tuple[Any, ...]:
        q = xp.einsum("i...,ij...,jn...->n...", xp.stack(moved), dual / xp.sum(a * dual[0], axis=0), shapes)
        return tuple(q.astype(motion.x.dtype))

    return ModalMotion(q=least(motion[:3]), rate=least(motion[3:]))


def given_states(states: State, scenes: Scene, precision: Precision) -> State:
    """A user's states in a precision, with the motion of the own coordinates of the blades of scenes."""
    precise: State = in_precision(states, precision)
    return State(own_motion(precise.motion, scenes), precise.u_s, precise.mode, precise.case)


def carried_state(state: State, model: RowModel) -> State:
    """A user's state, or those of lanes along a last axis, in the form that compiled loops carry."""
    parts = model.parts
    law = at_only_interface(model.interfaces.law)
    u_s, mode = state.u_s, state.mode

    def along(name: str, numbers: Any) -> Any:
        if not parts.has(name, 0):
            return ZERO
        return Unrolled(numbers[0], numbers[1] if parts.has(name, 1) else ZERO) if model.is_pair else numbers

    motion = state.motion
    if isinstance(motion, Motion):
        motion = Motion(**{name: along(name.removeprefix("v_"), a) for name, a in motion._asdict().items()})
    else:
        motion = ModalMotion._make(tuple(along("x", a) for a in numbers) for numbers in motion)
    if law.has_points and not model.is_pair and not isinstance(mode, tuple):
        u_s, mode = (jnp.moveaxis(a, 1, 0) for a in (u_s, mode))  # the axis of points first
    contact = law.carried_slider(u_s, mode), law.carried_mode(mode), state.case
    u_s, mode, case = at_interface(contact) if model.is_pair else contact
    return State(motion, u_s, mode, case)


def on_last_axis(tree: Any) -> Any:
    """A tree with the numbers along unrolled axes as arrays, whose last axis they are."""

    def along(a: Any) -> Any:
        if not is_unrolled(a):
            return a
        like: Any = np if isinstance(a[0], np.ndarray) else jnp
        return like.stack(tuple(a), axis=-1)

    return jax.tree.map(along, tree, is_leaf=is_unrolled)


def users_state(state: State) -> State:
    """States of lanes (leading axis), as compiled loops carry them, in the form that users know."""
    z = state.motion
    real = jax.tree.leaves(z)[0].dtype
    u_s = filled(state.u_s, jax.tree.map(lambda case: case.astype(real), state.case))
    if isinstance(state.mode, tuple) and not isinstance(u_s, tuple):
        u_s = tuple(u_s for _ in state.mode)  # one zero stands for all points
    motion = on_last_axis(filled(z, z.q[0] if isinstance(z, ModalMotion) else z.x))
    u_s, mode, case = at_only_interface((u_s, state.mode, state.case))
    return State(motion, points_last(u_s), points_last(mode), case)


def motion_rows(motion: Motion) -> np.ndarray:
    """Motions, fields (..., blades), as vectors (..., 6 blades)."""
    return np.concatenate(motion, axis=-1)


def final_states(state: State) -> State:
    """The final states of a compiled loop as initial states for users; of blades by modes with their coordinates."""
    return jax.tree.map(np.asarray, users_state(state))


def shroud_motion(motion: Any, scenes: Scene) -> Motion:
    """The motion of the shrouds, fields (..., blades), of that of the own coordinates of the blades of scenes."""
    if not isinstance(scenes.blades, ModalBlades):
        return motion

    shapes = moving_shapes(jax.tree.map(np.asarray, scenes))
    return Motion._make(row for part in motion for row in np.einsum("in...,n...->i...", shapes, np.stack(part)))


def modal_motion(modal: np.ndarray) -> ModalMotion:
    """The motion of modes from their coordinates and rates, (..., 2, n, blades)."""
    return ModalMotion._make(tuple(np.moveaxis(part, -2, 0)) for part in np.moveaxis(modal, -3, 0))


def in_scene_precision(state: State, scene: Scene) -> State:
    """The state as arrays, its real numbers in the precision of the scene."""
    real = scene.drive.omega.dtype
    motion = jax.tree.map(lambda a: np.asarray(a, real), own_motion(state.motion, scene))
    return State(
        motion, np.asarray(state.u_s, real), np.asarray(state.mode, np.int32), np.asarray(state.case, np.int32)
    )


def to_vector(state: State) -> np.ndarray:
    """States, the motion of own coordinates with fields (..., blades), as vectors (..., `Scene.state_size`)."""
    motion = jax.tree.leaves(state.motion)
    sliders = np.reshape(state.u_s, (*np.shape(motion[0])[:-1], -1))
    return np.concatenate([*motion, sliders], axis=-1)


def from_vector(vector: np.ndarray, mode: Any, case: Any, scene: Scene) -> State:
    """The inverse of `to_vector` for states of a scene."""
    layout, n = scene.layout, scene.coordinates
    parts = np.split(vector, range(layout.blades, 2 * n * layout.blades + 1, layout.blades), axis=-1)
    motion = ModalMotion(tuple(parts[:n]), tuple(parts[n:-1]))
    if not isinstance(scene.blades, ModalBlades):
        motion = Motion._make(parts[:-1])
    if scene.points:
        sliders = parts[-1].reshape(*vector.shape[:-1], *layout.interface_shape, scene.points)
        return State(motion, sliders, mode, case)
    return State(motion, layout.at_interfaces(parts[-1]), mode, case)


def shroud_rows(vectors: np.ndarray, scene: Scene) -> np.ndarray:
    """The motions of the shrouds (..., 6 blades) of the state vectors of a scene."""
    return motion_rows(shroud_motion(from_vector(vectors, None, None, scene).motion, scene))


def coordinate_sizes(sizes: np.ndarray, scene: Scene) -> np.ndarray:
    """The sizes (coordinates,) of the blades' own coordinates that move shrouds by so much in all of x, y, theta.

    `sizes` are of x of all blades, then of y and theta (3 blades,). What does not move the shroud has the size 1.
    """
    if not isinstance(scene.blades, ModalBlades):
        return sizes
    shapes = moving_shapes(jax.tree.map(np.asarray, scene)).astype(float)
    with np.errstate(divide="ignore"):
        reach = np.sqrt(np.sum(np.divide(shapes, sizes.reshape(3, 1, -1), where=shapes != 0, out=0 * shapes) ** 2, 0))
        return np.where(reach > 0, 1 / reach, 1.0).ravel()


def events_at_start(model: Model) -> int:
    """How many events happen at most: an onset, and the transition from flat contact to a corner; or one a point."""
    return max(2, len(model.block.points))


def next_at_start(state: State, start: State, view: GuardEvaluation, model: Model) -> State:
    """The state after the next event at the instant of a `start` apart, if its guards show one; its motion is kept."""
    violated = {kind: view.guards.value[kind] > 0 for kind in present(view.guards.value)}
    zero = jnp.zeros_like(view.at.v)
    after = transition(state, view, first_kind(violated), zero, zero, model).after
    fires = any_of(violated.values()) & (interface_mode(start.mode) == Mode.APART)
    u_s, mode, case = select(fires, (after.u_s, after.mode, after.case), (state.u_s, state.mode, state.case))
    return State(state.motion, u_s, mode, case)


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
