"""The forms of a state (in compiled loops, for users, as rows of numbers), and the contact forces in stored states.

At the instant of a start contact begins where blocks that are apart overlap. A march crosses these events in its first
trials, of length zero; here they are crossed without a march.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import is_traced, kept
from jaxshroud.linear.equilibrium import ContactState
from jaxshroud.linear.load_path import start_equilibria
from jaxshroud.march.event import GuardEvaluation, any_of, first_kind, present
from jaxshroud.march.events import transition
from jaxshroud.march.forces_and_energy import ContactForces, contact_forces, stacked_point_forces
from jaxshroud.march.locate import select
from jaxshroud.model.arithmetic import ZERO, filled, is_of_blades, is_zero, sincos_turns
from jaxshroud.model.blade import ElasticMotion
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode, points_last
from jaxshroud.model.prepared import Model, State, as_pairs, prepared_model
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES, PAIR, Layout
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def initial_states(scenes: Scene) -> State:
    """The initial state of each scene (leading axis), which needs nothing compiled except for a static start."""
    if scenes.start != "motion":
        return static_states(scenes)
    return states_apart(scenes, scenes.initial)


def static_states(scenes: Scene) -> State:
    """The states of scenes (leading axis) in their static equilibria; see `Scene.start`.

    They are apart, so that faces which overlap touch at once without friction, unless loads from rest have led there.
    """
    if is_traced(scenes):
        raise InputError("A static start is not found inside JAX's transformations; give a `state` to start from.")
    single = not np.ndim(scenes.drive.omega)
    lanes = jax.tree.map(lambda a: np.asarray(a)[None], scenes) if single else scenes
    rest = start_equilibria(lanes)
    at_rest = rest.q.astype(lanes.drive.omega.dtype)
    x, y, theta = at_rest[0] if single else np.moveaxis(at_rest, 1, 0)
    still = np.zeros_like(x)
    state = states_apart(scenes, Motion(x, y, theta, still, still, still))
    is_led = scenes.start == "from rest" and scenes.parts.contact != "none"
    return _in_contact(state, rest.contact) if is_led else state


def _in_contact(state: State, contact: ContactState) -> State:
    """A state apart, with its faces in a state of contact."""
    apart = np.equal(contact.mode, Mode.APART).all(axis=-1)
    case = np.where(apart, 0, contact.case).astype(np.int32).reshape(np.shape(state.case))
    u_s = np.asarray(contact.u_s, state.u_s.dtype).reshape(np.shape(state.u_s))
    return State(state.motion, u_s, np.reshape(contact.mode, np.shape(state.mode)), case)


def states_apart(scenes: Scene, motion: Motion) -> State:
    """The states of scenes (leading axis) with a motion, apart: where blocks overlap, contact begins at once."""
    like = jnp if is_traced(scenes) else np
    one = scenes.friction.mu  # at each interface
    nothing, points = like.zeros_like(one, np.int32), scenes.contact.points
    if points is None:
        return State(motion, like.zeros_like(one, motion.x.dtype), nothing, nothing)
    shape = (*np.shape(one), points.number)
    return State(motion, like.zeros(shape, motion.x.dtype), like.zeros(shape, np.int32), nothing)


def carried_state(state: State, model: Model) -> State:
    """A user's state in the form that compiled loops carry."""
    names = [name.removeprefix("v_") for name in Motion._fields]

    def keep(name, pair):
        return tuple(pair[i] if model.parts.has(name, i) else ZERO for i in (0, 1))

    motion = Motion._make(keep(name, pair) for name, pair in zip(names, as_pairs(state.motion), strict=True))
    u_s = model.law.carried_slider(state.u_s, state.mode)
    return State(motion, u_s, model.law.carried_mode(state.mode), state.case)


def with_zeros(state: State) -> State:
    """A state of compiled loops with zeros for absent numbers."""
    motion, u_s = filled((state.motion, state.u_s), state.motion.x[0])
    return State(motion, _sliders_like(state.mode, u_s), state.mode, state.case)


def _sliders_like(mode: Any, u_s: Any) -> Any:
    """A slider for each mode: where several points have none, one zero stands for all of them."""
    return tuple(u_s for _ in mode) if isinstance(mode, tuple) and not isinstance(u_s, tuple) else u_s


def as_arrays(motion: Motion) -> Motion:
    """A motion of pairs as one with fields of shape (2,), inside compiled functions."""
    return Motion._make(map(jnp.stack, motion))


def by_blade(tree: Tree) -> Tree:
    """The tree as NumPy arrays: those of each blade (...,), which are a tuple, as one (..., blades)."""
    return jax.tree.map(
        lambda a: np.stack(a, axis=-1) if is_of_blades(a) else np.asarray(a), tree, is_leaf=is_of_blades
    )


def by_interface(tree: Tree) -> Tree:
    """The tree of numbers of one interface (...,) as NumPy arrays (..., 1)."""
    return jax.tree.map(lambda a: np.asarray(a)[..., None], tree)


def by_blade_or_interface(tree: Tree) -> Tree:
    """The tree as NumPy arrays: tuples of those of each blade (...,) as (..., blades), others as (..., 1)."""

    def stacked(a):
        return np.stack(a, axis=-1) if is_of_blades(a) else np.asarray(a)[..., None]

    return jax.tree.map(stacked, tree, is_leaf=is_of_blades)


def motion_rows(motion: Motion) -> np.ndarray:
    """Motions, fields (..., blades), as vectors (..., 6 blades)."""
    return np.concatenate(motion, axis=-1)


def final_states(state: State) -> State:
    """The final state of a compiled loop as an initial state for users; of elastic blades with their coordinates."""
    if isinstance(state.motion, ElasticMotion):
        return state
    like = np.asarray(jax.tree.leaves(state.motion.x)[0])
    motion, u_s = filled(state.motion, like), filled(state.u_s, np.asarray(state.case, like.dtype))
    u_s, mode = points_last(_sliders_like(state.mode, u_s)), points_last(state.mode)
    return State(by_blade(motion), u_s, mode, state.case)


def shroud_motion(motion: Any, scenes: Scene) -> Motion:
    """The motion of the shrouds, fields (lanes, blades), of final states of scenes (leading axis)."""
    if not isinstance(motion, ElasticMotion):
        return motion
    matrices, has = scenes.blade_matrices, scenes.parts.has
    assert matrices is not None  # which have such motions
    moves = np.array([has(name, 0) for name in COORDINATES])

    def of(numbers):
        return np.einsum("lbij,jlb->ilb", np.asarray(matrices.shroud) * moves[:, None], np.stack(numbers))

    return Motion._make((*of(motion.q), *of(motion.rate)))


def in_scene_precision(state: State, scene: Scene) -> State:
    """The state as arrays, its real numbers in the precision of the scene."""
    real = scene.drive.omega.dtype
    motion = Motion(**{name: np.asarray(value, real) for name, value in state.motion._asdict().items()})
    return State(
        motion, np.asarray(state.u_s, real), np.asarray(state.mode, np.int32), np.asarray(state.case, np.int32)
    )


def to_vector(state: State) -> np.ndarray:
    """States, the motion with fields (..., blades), as vectors (..., `Layout.state_size`)."""
    sliders = np.reshape(state.u_s, (*np.shape(state.motion.x)[:-1], -1))
    return np.concatenate([*state.motion, sliders], axis=-1)


def from_vector(vector: np.ndarray, mode: Any, case: Any, layout: Layout = PAIR, points: int = 0) -> State:
    """The inverse of `to_vector`, with so many points of contact of a face, 0 where a corner touches."""
    blades = layout.blades
    motion = Motion._make(vector[..., i : i + blades] for i in range(0, 6 * blades, blades))
    sliders = vector[..., 6 * blades :]
    if points:
        return State(motion, sliders.reshape(*vector.shape[:-1], *layout.interface_shape, points), mode, case)
    return State(motion, layout.at_interfaces(sliders), mode, case)


def events_at_start(model: Model) -> int:
    """How many events happen at most: an onset, and the transition from flat contact to a corner; or one a point."""
    return max(2, len(model.block.points))


def next_at_start(state: State, start: State, view: GuardEvaluation, model: Model) -> State:
    """The state after the next event at the instant of a `start` apart, if its guards show one; its motion is kept."""
    violated = {kind: view.guards.value[kind] > 0 for kind in present(view.guards.value)}
    zero = jnp.zeros_like(view.at.v)
    after = transition(state.motion, state, view, first_kind(violated), zero, zero, model).after
    fires = any_of(violated.values()) & (interface_mode(start.mode) == Mode.APART)
    u_s, mode, case = select(fires, (after.u_s, after.mode, after.case), (state.u_s, state.mode, state.case))
    return State(state.motion, u_s, mode, case)


SAMPLES_PER_CALL = 1024  # one program for runs of any length


def sampled_contact_forces(scenes: Scene, states: State, turns: np.ndarray) -> ContactForces:
    """The contact forces, (lanes, samples) each; absent where the model lacks them, NaN after a lane has stopped.

    Args:
        scenes: Scenes with a leading lane axis, with contact.
        states: Their states as users have them, with axes (lanes, samples) first and the slider updated.
        turns: The drive phase at each sample [turns], (samples,).
    """
    count, blocks = len(turns), []
    for begin in range(0, max(count, 1), SAMPLES_PER_CALL):  # without samples too: the program knows what is absent
        block = jax.tree.map(lambda a, begin=begin: _block_from(a, begin, axis=1), states)
        phase = np.asarray(_block_from(turns, begin, axis=0) % 1, states.u_s.dtype)
        blocks.append(jax.tree.map(np.asarray, _forces_of_block(scenes, block, phase)))
    return jax.tree.map(lambda *a: np.concatenate(a, axis=1)[:, :count], *blocks)


def _block_from(a: np.ndarray, begin: int, axis: int) -> np.ndarray:
    """`SAMPLES_PER_CALL` samples along an axis, the first of them at `begin`; zeros where there are no more."""
    block = np.asarray(a).take(range(begin, min(begin + SAMPLES_PER_CALL, a.shape[axis])), axis)
    missing = [(0, 0)] * a.ndim
    missing[axis] = (0, SAMPLES_PER_CALL - block.shape[axis])
    return np.pad(block, missing)


@kept()
def _forces_of_block(scenes: Scene, states: State, turns) -> ContactForces:
    def one_lane(scene: Scene, states: State) -> ContactForces:
        model = prepared_model(scene)

        def one(state: State, turns) -> ContactForces:
            carried = carried_state(state, model)
            forces = contact_forces(drive_waves(*sincos_turns(turns), model.drive), carried, model)

            def force(a):
                return jnp.zeros_like(forces.v) if is_zero(a) else a

            lost = jnp.isnan(forces.v)
            of_points = stacked_point_forces(forces.points, jnp.zeros_like(forces.v))
            forces = forces._replace(N=force(forces.N), F=force(forces.F), points=of_points)
            return jax.tree.map(lambda a: jnp.where(lost, jnp.nan, a), forces)

        return jax.vmap(one)(states, turns)

    return jax.vmap(one_lane)(scenes, states)
