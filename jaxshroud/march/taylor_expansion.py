"""The motion of a lane, a pair or a row, as power series while its modes and cases are fixed.

Series are in the drive phase since the start of a trial [rad]. A row is expanded as a program of one element, see
`model.row_program`: every coefficient of every series is computed once, in kernels over all blades or interfaces.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxshroud.march.carry import Fixed, Lane, TimeGrid
from jaxshroud.march.event import switch_guards, turn_slack
from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import select
from jaxshroud.march.taylor_events import Coefficients
from jaxshroud.model.arithmetic import (
    ZERO,
    Scalar,
    any_along,
    both_sides,
    exchanged,
    is_unrolled,
    is_zero,
    sincos_turns,
    times,
    where,
)
from jaxshroud.model.blade import AnyBlade
from jaxshroud.model.contact_law import linear_laws
from jaxshroud.model.geometry import FaceKinematics, rotation
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.model.rhs import EndTorques, LoadedContact, Recorded, loaded_contact, torques_along_face
from jaxshroud.model.row import (
    Each,
    RowModel,
    alone,
    blade_forces,
    clusters_of,
    over,
    rates_of_blades,
)
from jaxshroud.model.row_program import of_row
from jaxshroud.model.series import Series, coefficients, polynomial, rate_of

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


class BladeSeries(NamedTuple):
    """The motion of one blade, or of all: polynomials."""

    own: tuple[Coefficients, ...]  # of the coordinates
    sine: Coefficients  # of the shroud's theta
    versine: Coefficients


class TaylorExpansion(NamedTuple):
    """The motion of a lane as polynomials in the drive phase since the start of a trial [rad]."""

    blades: BladeSeries
    faces: FaceSeries


class Joined(NamedTuple):
    """What blocks that are flat on each other have in common, as functions of their own angular accelerations."""

    mean: Callable[[Any], Any]  # the angular accelerations of the blocks
    torques: Callable[[Any], Any]  # `Cluster.torques`


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
    own, rates = model.blades.coordinates(state.motion)
    motion = model.blades.motion(own, [v * unit for v in rates])
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
    torques = partial(cluster.torques, model=model)
    if is_unrolled(state.case):
        return expanded(Joined(cluster.mean, torques))
    apart = expanded(None)
    flat = any_along(state.case == FLAT)

    def with_flat_faces():
        return select(flat, expanded(Joined(cluster.mean, partial(exchanged, "interface", torques))), apart)

    return lax.cond(jnp.any(flat), with_flat_faces, lambda: apart)


def blades_of(model: RowModel) -> RowModel:
    """What of a row belongs to its blades."""
    return replace(model, interfaces=None, coupling=None, kappa=())


def faces_of(model: RowModel) -> dict[str, Any]:
    """What of a row belongs to its interfaces."""
    return {"interfaces": model.interfaces, "coupling": model.coupling, "kappa": model.kappa}


def whole_row(blades: RowModel, faces: dict[str, Any]) -> RowModel:
    """The inverse of `blades_of` and `faces_of`."""
    return replace(blades, **faces)


def per_radian(model: RowModel, unit: Scalar) -> RowModel:
    """The model with time in units of `unit` seconds: masses stay, and forces are in kg m / unit^2."""

    def between(m: RowModel, kind: str) -> tuple[Any, ...]:
        return () if m.coupling is None else getattr(m.coupling, kind)

    def flows(m: RowModel, kind: str) -> list[Any]:
        return [] if m.aero is None else [getattr(one, kind) for one in m.aero if one is not None]

    def forces(m: RowModel) -> list[Any]:
        contact = [k for law in linear_laws(m.interfaces.law) for k in law.stiffnesses]
        return [*m.blades.springs, *between(m, "k"), m.kappa, *m.drive.loads, *flows(m, "k"), *contact]

    def dampers(m: RowModel) -> list[Any]:
        return [*m.blades.dampers, *between(m, "c"), *flows(m, "c")]

    for places, factor in ((forces, unit * unit), (dampers, unit)):
        scaled = jax.tree.map(lambda a, factor=factor: a * factor, places(model))
        model = eqx.tree_at(places, model, scaled, is_leaf=is_zero)
    return model


def _expansion(
    start: State, wave: tuple[Any, Any], model: RowModel, joined: Joined | None, order: int
) -> TaylorExpansion:
    """`taylor_expansion` of an element, with the blocks that are flat on each other, if there can be any."""
    own = [over(alone, _begun, *begin) for begin in zip(*model.blades.coordinates(start.motion), strict=True)]
    motion = motion_of_series(own, model.blades)
    shroud = model.blades.shroud(motion)
    pairs = State(both_sides(shroud, model.closed), start.u_s, start.mode, start.case)
    now, places = over(alone, _placed, pairs, model.interfaces)
    R = blade_forces(places, shroud, model)
    a = rates_of_blades(motion, series_of_wave(wave), R, model, Recorded(), alone).acceleration
    torques = None
    if joined is not None:
        alone_turning = model.blades.turning(a)
        a = model.blades.turned(a, joined.mean(alone_turning), model.inverse)
        torques = joined.torques(alone_turning)
    for series, rate in zip(own, a, strict=True):
        over(alone, _go_on, series, rate)
    faces = over(alone, partial(_face_series, order=order), now, places, torques, model.interfaces)
    sine, versine = over(alone, rotation, shroud.theta)
    up_to_order = partial(over, alone, partial(coefficients, n=order))
    blades = BladeSeries(own=tuple(map(up_to_order, own)), sine=up_to_order(sine), versine=up_to_order(versine))
    return TaylorExpansion(blades=blades, faces=faces)


def motion_of_series(own: Sequence[Any], blades: AnyBlade) -> Any:
    """The motion of blades whose coordinates are these series."""
    return blades.motion(own, [over(alone, rate_of, a) for a in own])


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


def _placed(now: State, model: Model) -> tuple[State, LoadedContact]:
    """The state of an interface in its current case, and its contact."""
    at_start = jax.tree.map(lambda a: a[0] if isinstance(a, Series) else a, now.motion)
    now = State(now.motion, now.u_s, now.mode, place_contact(at_start, now, model)[1])
    return now, loaded_contact(now, model)


def _face_series(now: State, place: LoadedContact, torque: Any, model: Model, order: int) -> FaceSeries:
    """The polynomials of one interface; `torque` is the relative torque of its corner, if faces can be flat."""
    at = place.point.at
    turn, height = _switch_series(now, place, torque, model, order)
    points = at.points if isinstance(at, FaceKinematics) else (at,)
    return FaceSeries(
        points=tuple(PointSeries(v=coefficients(own.v, order - 1), rounding=own.rounding) for own in points),
        u=coefficients(at.u, order - 1),
        turn=coefficients(turn, order),
        height=coefficients(height, order - 1),
        case=now.case,
    )


def _switch_series(now: State, place: LoadedContact, torque: Any, model: Model, order: int) -> tuple[Any, Any]:
    """The guards of the case, beyond their rounding. When apart they only end a trial: the position sets the case."""
    if not touches_at_corners(model):
        return ZERO, ZERO
    at = place.point.at
    leans = EndTorques(ZERO, ZERO)
    if torque is not None:
        leans = torques_along_face(torque, place.forces, at, now, model)
        leans = EndTorques._make(polynomial(coefficients(a, order - 2)) for a in leans)
    apart = now.mode == Mode.APART  # where the sign of the angle sets the case
    unsure = where(apart, at.turn_rounding, turn_slack(at.turn[1], 2 * at.turn[2], at.turn_rounding))
    turn, height = switch_guards(at, unsure, leans, now.case)
    # where contact ends, LIFT is first
    flat = now.case == FLAT
    slack = model.law.normal_stiffness * model.block.l_ab * at.rounding
    return turn - where(flat, slack, 0.0), height - where(flat, slack, at.rounding)
