"""The motion of a lane, a pair or a row, as power series while its modes and cases are fixed.

Series are in the drive phase since the start of a trial [rad]. A row is expanded as a program of one element, see
`model.row_program`: every coefficient of every series is computed once, in kernels over all blades or interfaces.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxshroud.march.carry import Fixed, Lane, TimeGrid
from jaxshroud.march.event import switch_guards
from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import select
from jaxshroud.march.taylor_events import Coefficients
from jaxshroud.model.arithmetic import (
    ZERO,
    Scalar,
    any_along,
    exchanged,
    is_unrolled,
    is_zero,
    sincos_turns,
    times,
    where,
)
from jaxshroud.model.contact_law import linear_laws
from jaxshroud.model.geometry import FaceKinematics, rotation
from jaxshroud.model.modes import FLAT
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.model.rhs import EndTorques, Placement, Recorded, placement, torques_along_face
from jaxshroud.model.row import (
    Each,
    RowModel,
    alone,
    blade_forces,
    clusters_of,
    over,
    pair_states,
    rates_of_blades,
    relative_torques,
)
from jaxshroud.model.row_program import of_row
from jaxshroud.model.series import Series, coefficients, polynomial, rate_of
from jaxshroud.scene.keys import Motion

RADIANS_PER_TURN = 2 * math.pi


class PointSeries(NamedTuple):
    """A point of contact of one interface, or of all."""

    v: Coefficients  # penetration [m]
    rounding: Any  # bound of the rounding errors of v and u at the start of a trial [m]


class FaceSeries(NamedTuple):
    """The contact of one interface, or of all: polynomials, and numbers at the start of a trial."""

    points: tuple[PointSeries, ...]  # one where a corner touches
    u: Coefficients  # slide [m]
    turn: Coefficients  # guards of the case, negative while it lasts; absent where the blocks do not turn
    height: Coefficients
    case: Any  # the current case; when apart, that of the position at the start


class TaylorExpansion(NamedTuple):
    """The motion of a lane as polynomials in the drive phase since the start of a trial [rad]."""

    x: Coefficients  # of each blade [m]
    y: Coefficients
    theta: Coefficients
    sine: Coefficients  # of theta
    versine: Coefficients
    faces: FaceSeries


class Joined(NamedTuple):
    """What blocks that are flat on each other have in common, as functions of their own angular accelerations."""

    mean: Callable[[Any], Any]  # the angular accelerations of the blocks
    torques: Callable[[Any], Any]  # `relative_torques`


def seconds_per_radian(fixed: Fixed[RowModel]) -> Any:
    """The unit of time of series [s]."""
    return fixed.grid.h / (RADIANS_PER_TURN * fixed.grid.turn)


def wave_at(step: Any, done: Any, grid: TimeGrid, each: Each) -> tuple[Any, Any]:
    """(sin, cos) of omega t where so much of a step is done."""

    def wave(step: Any, done: Scalar, start: Scalar, turn: Scalar) -> tuple[Scalar, Scalar]:
        return sincos_turns(start + (step.astype(turn.dtype) + done) * turn)

    return each(wave, step, done, grid.start, grid.turn)


def taylor_expansion(lane: Lane, fixed: Fixed[RowModel], order: int, each: Each) -> TaylorExpansion:
    """The Taylor expansion of a lane's motion.

    The motion is expanded up to an `order`, the contact to one order less.
    """
    state = lane.state
    unit = seconds_per_radian(fixed)
    model = per_radian(fixed.model, unit)
    z = model.blades.shroud(state.motion)
    motion = z._replace(v_x=z.v_x * unit, v_y=z.v_y * unit, v_theta=z.v_theta * unit)
    at_faces = state.u_s, state.mode, state.case, faces_of(model)
    wave = wave_at(lane.step, lane.search.done, fixed.grid, each)
    trees = wave, (motion, blades_of(model)), at_faces

    def expanded(joined: Joined | None) -> TaylorExpansion:
        def of_element(wave, of_blades, of_faces):
            motion, blades = of_blades
            u_s, mode, case, faces = of_faces
            start = State(motion=motion, u_s=u_s, mode=mode, case=case)
            return _expansion(start, wave, whole_row(blades, faces), joined, order)

        return of_row(each, of_element, *trees)

    cluster = clusters_of(state, model)
    if cluster is None:
        return expanded(None)
    torques = partial(relative_torques, case=state.case, cluster=cluster, model=model)
    if is_unrolled(state.case):
        return expanded(Joined(cluster.mean, torques))
    apart = expanded(None)
    flat = any_along(state.case == FLAT)

    def with_flat_faces():
        return select(flat, expanded(Joined(cluster.mean, partial(exchanged, "interface", torques))), apart)

    return lax.cond(jnp.any(flat), with_flat_faces, lambda: apart)


def blades_of(model: RowModel) -> RowModel:
    """What of a row belongs to its blades."""
    return replace(model, interfaces=None, coupling=None)


def faces_of(model: RowModel) -> tuple[Any, Any]:
    """What of a row belongs to its interfaces."""
    return model.interfaces, model.coupling


def whole_row(blades: RowModel, faces: tuple[Any, Any]) -> RowModel:
    """The inverse of `blades_of` and `faces_of`."""
    return replace(blades, interfaces=faces[0], coupling=faces[1])


def per_radian(model: RowModel, unit: Scalar) -> RowModel:
    """The model with time in units of `unit` seconds: masses stay, and forces are in kg m / unit^2."""

    def of_kind(kind: str, *owners: Any) -> list[Any]:
        return [getattr(owner, f"{kind}_{name}") for name in ("x", "y", "T") for owner in owners if owner is not None]

    def flows(m: RowModel, kind: str) -> list[Any]:
        return [] if m.aero is None else [getattr(one, kind) for one in m.aero if one is not None]

    def forces(m: RowModel) -> list[Any]:
        springs = of_kind("k", m.blades, m.coupling)
        contact = [k for law in linear_laws(m.interfaces.law) for k in law.stiffnesses]
        return [*springs, *m.drive.loads, *flows(m, "k"), *contact]

    def dampers(m: RowModel) -> list[Any]:
        return [*of_kind("c", m.blades, m.coupling), *flows(m, "c")]

    for places, factor in ((forces, unit * unit), (dampers, unit)):
        scaled = jax.tree.map(lambda a, factor=factor: a * factor, places(model))
        model = eqx.tree_at(places, model, scaled, is_leaf=is_zero)
    return model


def _expansion(
    start: State, wave: tuple[Any, Any], model: RowModel, joined: Joined | None, order: int
) -> TaylorExpansion:
    """`taylor_expansion` of an element, with the blocks that are flat on each other, if there can be any."""
    z = start.motion
    x, y, theta = (over(alone, _begun, *own) for own in zip(z[:3], z[3:], strict=True))
    v_x, v_y, v_theta = (over(alone, rate_of, a) for a in (x, y, theta))
    motion = Motion(x, y, theta, v_x, v_y, v_theta)
    pairs = pair_states(State(motion, start.u_s, start.mode, start.case), model)
    now, places = over(alone, _placed, pairs, model.interfaces)
    R = blade_forces(over(alone, lambda place: place.loaded, places), motion, model)
    a = rates_of_blades(motion, series_of_wave(wave), R, model, Recorded(), alone).acceleration
    torques = None
    if joined is not None:
        own = model.blades.turning(a)
        a = model.blades.turned(a, joined.mean(own), model.inverse)
        torques = joined.torques(own)
    for series, rate in zip((x, y, theta), a, strict=True):
        over(alone, _go_on, series, rate)
    faces = over(alone, partial(_face_series, order=order), now, places, torques, model.interfaces)
    sine, versine = over(alone, rotation, theta)
    up_to_order = partial(coefficients, n=order)
    return TaylorExpansion(
        x=over(alone, up_to_order, x),
        y=over(alone, up_to_order, y),
        theta=over(alone, up_to_order, theta),
        sine=over(alone, up_to_order, sine),
        versine=over(alone, up_to_order, versine),
        faces=faces,
    )


def series_of_wave(wave: tuple[Any, Any]) -> tuple[Any, Any]:
    """(sin, cos) of omega t at the start of a trial as series, see `Excitation.wave`."""
    s, c = (Series(lambda n, a=a: a) for a in wave)
    return s, c


def _begun(x: Scalar, v: Scalar) -> Any:
    """The series of a displacement that begins with `x` and the speed `v`, and goes on once more is known."""
    begin = x, v
    return x if is_zero(x) else Series(lambda n: begin[n])


def _go_on(displacement: Any, acceleration: Any) -> None:
    """Let a displacement go on with an acceleration."""
    if not is_zero(displacement):
        displacement.go_on(lambda n: times(acceleration[n - 2], 1 / (n * (n - 1))))


def _placed(now: State, model: Model) -> tuple[State, Placement]:
    """The state of an interface in its current case, and the placement of its blocks."""
    at_start = jax.tree.map(lambda a: a[0] if isinstance(a, Series) else a, now.motion)
    now = State(now.motion, now.u_s, now.mode, place_contact(at_start, now, model)[1])
    return now, placement(now, model)


def _face_series(now: State, place: Placement, torque: Any, model: Model, order: int) -> FaceSeries:
    """The polynomials of one interface; `torque` is the relative torque of its corner, if faces can be flat."""
    at = place.at
    turn, height = _switch_series(now, place, torque, model, order)
    points = at.points if isinstance(at, FaceKinematics) else (at,)
    return FaceSeries(
        points=tuple(PointSeries(v=coefficients(own.v, order - 1), rounding=own.rounding) for own in points),
        u=coefficients(at.u, order - 1),
        turn=coefficients(turn, order),
        height=coefficients(height, order - 1),
        case=now.case,
    )


def _switch_series(now: State, place: Placement, torque: Any, model: Model, order: int) -> tuple[Any, Any]:
    """The guards of the case, beyond their rounding. When apart they only end a trial: the position sets the case."""
    if not touches_at_corners(model):
        return ZERO, ZERO
    at = place.at
    leans = EndTorques(ZERO, ZERO)
    if torque is not None:
        leans = torques_along_face(torque, place.loaded.forces, at, now, model)
        leans = EndTorques._make(polynomial(coefficients(a, order - 2)) for a in leans)
    turn, height = switch_guards(at, leans, now.case)
    # where contact ends, LIFT is first
    flat = now.case == FLAT
    slack = model.law.normal_stiffness * model.block.l_ab * at.rounding
    return turn - where(flat, slack, 0.0), height - where(flat, slack, at.rounding)
