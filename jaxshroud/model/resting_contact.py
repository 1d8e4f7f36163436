"""Contact of blocks at rest: the forces at each interface, their derivatives, and what decides in which state it is."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.cache.programs import kept
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.blocks import Pose
from jaxshroud.model.face_points import FaceKinematics
from jaxshroud.model.geometry import Kinematics, contact_kinematics, natural_case, pose
from jaxshroud.model.interface import loaded_contact, torques_along_face
from jaxshroud.model.prepared import Model, State, has_torsion, prepared_model, touches_at_corners
from jaxshroud.model.row import pair_at
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


class RestingContact(NamedTuple):
    """Contact at the interfaces of lanes, arrays (lanes, interfaces, ...) in SI units.

    Coordinates of an interface are x, y and theta of its two blocks: (x_l, x_r, y_l, y_r, theta_l, theta_r).
    """

    load: Any  # (..., 6) force of contact on each coordinate
    load_q: Any  # (..., 6, 6) its derivatives by the coordinates
    N: Any  # (..., points) normal force, as the next of each point, or of the corner
    v: Any  # (..., points) penetration in the state's case
    u: Any  # (..., points) slide
    v_q: Any  # (..., points, 6)
    u_q: Any  # (..., points, 6)
    natural_v: Any  # (...,) penetration in the natural case
    natural: Any  # (...,) the case that the position has by itself
    turn: Any  # (...,) theta_l - theta_r
    end_torques: Any  # (..., 2) at the lower and the upper end of flat faces, where none is passed on
    energy: Any  # (...,) of the springs of contact


@kept()
def resting_contact(scenes: Scene, q: Any, mode: Any, case: Any, u_s: Any) -> RestingContact:
    """The contact of scenes (leading axis) at rest.

    Args:
        scenes: The scenes.
        q: The displacements (lanes, 3, blades): x, y and theta.
        mode: The mode of each point, (lanes, interfaces, points); one point where a corner touches.
        case: The case of each interface, (lanes, interfaces).
        u_s: The slider of each point, as the modes.
    """

    def one(scene: Scene, q: Any, mode: Any, case: Any, u_s: Any) -> RestingContact:
        count, own = q.shape[-1], jnp.arange(case.shape[0])

        def at_interface(j: Any, mode: Any, case: Any, u_s: Any) -> RestingContact:
            model = prepared_model(pair_at(scene, j))
            sides = jnp.stack([j, (j + 1) % count])
            return _at_interface(q[:, sides].ravel(), State(None, u_s, mode, case), model)

        return jax.vmap(at_interface)(own, mode, case, u_s)

    return jax.vmap(one)(scenes, q, mode, case, u_s)


def _at_interface(q: Any, state: State, model: Model) -> RestingContact:
    """`RestingContact` of one interface."""
    (load, at), (load_q, at_q) = _contact_of(q, state, model), jax.jacfwd(_contact_of)(q, state, model)
    place, now = _placed(q, state, model), _state_at(q, state, model)
    natural = natural_case(place, model.block)
    by_itself = contact_kinematics(place, natural, model.block, model.reading)
    loaded = loaded_contact(_kinematics(place, state, model), now.motion, now, state.case, model)
    ends = jnp.zeros(2, q.dtype)
    if touches_at_corners(model):
        at_case = _kinematics(place, state, model)
        ends = jnp.stack([*torques_along_face(jnp.zeros((), q.dtype), loaded.forces, at_case, now, model)])
    kinematics = _kinematics(place, state, model)
    w = model.law.stretch_at(kinematics, now.u_s, now.mode)
    return RestingContact(
        load,
        load_q,
        at.N,
        at.v,
        at.u,
        at_q.v,
        at_q.u,
        by_itself.v,
        natural,
        q[4] - q[5] if has_torsion(model) else jnp.zeros((), q.dtype),
        ends,
        model.law.energy_at(kinematics, w, now.mode),
    )


class _AtPoints(NamedTuple):
    """Numbers of each point of contact, (points,)."""

    N: Any
    v: Any
    u: Any


def _contact_of(q: Any, state: State, model: Model) -> tuple[Any, _AtPoints]:
    """The force on each coordinate, and what there is at each point."""
    now, at = _state_at(q, state, model), _kinematics(_placed(q, state, model), state, model)
    loaded = loaded_contact(at, now.motion, now, state.case, model)
    load = filled((loaded.load.R_x, loaded.load.R_y, loaded.load.M), at.v)
    R_x, R_y, M = load
    if isinstance(at, FaceKinematics):
        N = [own.N for own in loaded.forces.points]
        v, u = ([getattr(own, name) for own in at.points] for name in ("v", "u"))
    else:
        N, v, u = [loaded.forces.N], [at.v], [at.u]
    moved = _moving(jnp.stack([R_x, -R_x, R_y, -R_y, *M]), model)
    return moved, _AtPoints(*(jnp.stack(filled(tuple(a), at.v)) for a in (N, v, u)))


def _moving(load: Any, model: Model) -> Any:
    """The load on the coordinates that the model has."""
    has = [model.parts.has(name, i) for name in ("x", "y", "theta") for i in (0, 1)]
    return jnp.where(jnp.array(has), load, 0.0)


def _state_at(q: Any, state: State, model: Model) -> State:
    """The state at rest with these displacements (6,)."""
    has = model.parts.has
    x, y, theta = (
        tuple(q[2 * row + i] if has(name, i) else jnp.zeros((), q.dtype) for i in (0, 1))
        for row, name in enumerate(("x", "y", "theta"))
    )
    still = (jnp.zeros((), q.dtype),) * 2
    motion = Motion(x, y, theta, still, still, still)
    if model.law.has_points:
        mode, slider = tuple(state.mode), tuple(state.u_s)
    else:
        mode, slider = state.mode[0], state.u_s[0]
    return State(motion, model.law.carried_slider(slider, mode), mode, state.case)


def _placed(q: Any, state: State, model: Model) -> Pose:
    z = _state_at(q, state, model).motion
    return pose(z.x, z.y, z.theta)


def _kinematics(place: Pose, state: State, model: Model) -> Kinematics:
    return contact_kinematics(place, state.case, model.block, model.reading)
