"""Contact of blocks at rest: the forces at each interface, their derivatives, and what decides in which state it is."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.cache.programs import kept
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.contact_law import SummedForces
from jaxshroud.model.geometry import FaceKinematics, contact_kinematics, natural_case, pose
from jaxshroud.model.linear_system import coordinates_at, over_blades
from jaxshroud.model.prepared import Model, State, has_torsion, prepared_model, touches_at_corners
from jaxshroud.model.rhs import loaded_contact, torques_along_face
from jaxshroud.model.row import pair_at
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene

CASES_OF_CORNERS: tuple[Any, ...] = 2, 4  # cases in which the upper and the lower corners meet


class RestingContact(NamedTuple):
    """Contact at the interfaces of lanes, arrays (lanes, interfaces, ...) in SI units.

    Coordinates are those of all blades, x, then y, then theta.
    """

    load: Any  # (lanes, 3 blades) force of contact on each coordinate
    load_q: Any  # (lanes, 3 blades, 3 blades) its derivatives by the coordinates
    N: Any  # (..., points) normal force, as the next three of each point, or of the corner
    F: Any  # (..., points) friction force
    v: Any  # (..., points) penetration in the state's case
    u: Any  # (..., points) slide
    N_q: Any  # (..., points, 3 blades) derivatives by the coordinates, as the next
    F_q: Any  # (..., points, 3 blades)
    v_q: Any  # (..., points, 3 blades)
    u_q: Any  # (..., points, 3 blades)
    open_v: Any  # (..., corners) penetration of the upper and the lower corners, or of each point
    open_v_q: Any  # (..., corners, 3 blades)
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
        u_s: The slider of each point, as the modes; None: where the faces are.
    """
    return jax.vmap(resting_contact_of)(scenes, q, mode, case, u_s)


def resting_contact_of(scene: Scene, q: Any, mode: Any, case: Any, u_s: Any) -> RestingContact:
    """`resting_contact` of one scene, without the axis of lanes."""
    places = coordinates_at(scene.layout)

    def at_interface(j: Any, own: Any, mode: Any, case: Any, u_s: Any) -> RestingContact:
        return _contact_between(q.ravel()[own], State(None, u_s, mode, case), prepared_model(pair_at(scene, j)))

    in_axes = (0, 0, 0, 0, None if u_s is None else 0)
    found = jax.vmap(at_interface, in_axes)(jnp.arange(len(places)), places, mode, case, u_s)
    numbers = {
        name: over_blades(getattr(found, name), scene.layout) for name in ("N_q", "F_q", "v_q", "u_q", "open_v_q")
    }
    return found._replace(
        load=jnp.zeros(q.size, q.dtype).at[places].add(found.load),
        load_q=jnp.zeros((q.size, q.size), q.dtype).at[places[:, :, None], places[:, None]].add(found.load_q),
        **numbers,
    )


def _contact_between(q: Any, state: State, model: Model) -> RestingContact:
    """`RestingContact` of one interface, by the coordinates (x_l, x_r, y_l, y_r, theta_l, theta_r) of its blocks."""
    if state.u_s is None:
        at_zero = State(state.motion, jnp.zeros(state.mode.shape, q.dtype), state.mode, state.case)
        state = State(state.motion, _loads(q, at_zero, model)[1].u, state.mode, state.case)
    load, of_points = _loads(q, state, model)
    load_q, of_points_q = jax.jacfwd(_loads)(q, state, model)
    now = resting_state(q, state, model)
    place = pose(now.motion.x, now.motion.y, now.motion.theta)
    at = contact_kinematics(place, now.case, model.block, model.reading)
    natural = natural_case(place, model.block)
    zero, ends = jnp.zeros((), q.dtype), jnp.zeros(2, q.dtype)
    if touches_at_corners(model):
        ends = jnp.stack([*torques_along_face(zero, loaded_contact(now, model).forces, at, now, model)])
    return RestingContact(
        load,
        load_q,
        of_points.N,
        of_points.F,
        of_points.v,
        of_points.u,
        of_points_q.N,
        of_points_q.F,
        of_points_q.v,
        of_points_q.u,
        _open_corners(q, state, model),
        jax.jacfwd(_open_corners)(q, state, model),
        contact_kinematics(place, natural, model.block, model.reading).v,
        natural,
        q[4] - q[5] if has_torsion(model) else zero,
        ends,
        model.law.energy_at(at, model.law.stretch_at(at, now.u_s, now.mode), now.mode),
    )


class _OfPoints(NamedTuple):
    """Numbers of each point of contact, (points,)."""

    N: Any
    F: Any
    v: Any
    u: Any


def _loads(q: Any, state: State, model: Model) -> tuple[Any, _OfPoints]:
    """The force on each coordinate, and what there is at each point."""
    now = resting_state(q, state, model)
    point, forces, load = loaded_contact(now, model)
    at = point.at
    R_x, R_y, M = filled((load.R_x, load.R_y, load.M), at.v)
    if isinstance(at, FaceKinematics) and isinstance(forces, SummedForces):
        of_each = [own.N for own in forces.points], [own.F for own in forces.points]
        numbers = *of_each, [own.v for own in at.points], [own.u for own in at.points]
    else:
        numbers = [forces.N], [forces.F], [at.v], [at.u]
    moves = jnp.array([model.parts.has(name, i) for name in COORDINATES for i in (0, 1)])
    on_each = jnp.where(moves, jnp.stack([R_x, -R_x, R_y, -R_y, *M]), 0.0)
    return on_each, _OfPoints._make(jnp.stack(filled(tuple(a), at.v)) for a in numbers)


def _open_corners(q: Any, state: State, model: Model) -> Any:
    """The penetration of the upper and the lower corners where the faces are apart, or of each point."""
    z = resting_state(q, state, model).motion
    place = pose(z.x, z.y, z.theta)
    if model.law.has_points:
        at = contact_kinematics(place, state.case, model.block, model.reading)
        assert isinstance(at, FaceKinematics)
        return jnp.stack([own.v for own in at.points])

    def corners_v(case):
        return contact_kinematics(place, jnp.asarray(case), model.block, model.reading).v

    return jnp.stack([corners_v(case) for case in CASES_OF_CORNERS])


def resting_state(q: Any, state: State, model: Model, rate: Any = None) -> State:
    """The state with these displacements (6,) as compiled loops carry it: at rest, or with a `rate` of them."""
    v = jnp.zeros_like(q) if rate is None else rate
    motion = Motion((q[0], q[1]), (q[2], q[3]), (q[4], q[5]), (v[0], v[1]), (v[2], v[3]), (v[4], v[5]))
    sliders, modes = (state.u_s, state.mode) if model.law.has_points else (state.u_s[0], state.mode[0])
    return State(motion, model.law.carried_slider(sliders, modes), model.law.carried_mode(modes), state.case)
