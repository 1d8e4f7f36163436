"""The motion of one lane as power series while its mode and case are fixed, and integrals of squares over them."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.march.carry import Fixed, Lane
from jaxshroud.march.events import HEIGHT, LIFT, RUB, TURN, number_of, place_contact
from jaxshroud.march.guards import switch_guards
from jaxshroud.model.arithmetic import Pair, Scalar, is_absent, sincos_turns, where
from jaxshroud.model.contact_law import linear_law
from jaxshroud.model.drive import Waves, drive_wave_rates, drive_wave_series, drive_waves
from jaxshroud.model.geometry import Kinematics, Pose, contact_rates
from jaxshroud.model.interface import EndTorques, Placement, placement
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import Ledger, Recorded, end_torques_under, rhs, rhs_at
from jaxshroud.model.series import Series, of_each, rate_of, truncated
from jaxshroud.scene.keys import Motion

RADIANS_PER_TURN = 2 * math.pi
# The number of an event, and a `Series`, which stands for a Scalar in the model's equations.
GuardSeries = tuple[int, Any]


class TaylorExpansion(NamedTuple):
    """Power series in the drive phase since the start of a trial [rad]."""

    motion: Motion  # rates are per radian
    v: Any  # a `Series`, as is the next
    u: Any
    guards: list[GuardSeries]  # negative while the mode lasts
    pose: Pose
    works: Ledger | None  # their rates per radian, from the motion up to its order, in `unit ** 2` joules
    case: Int[Array, ""]  # the current case; when apart, that of the position at the start
    unit: Scalar  # seconds per radian


def taylor_expansion(lane: Lane, fixed: Fixed[Model], order: int, ledger: bool) -> TaylorExpansion:
    """The Taylor expansion of a lane's motion, guards and works.

    The motion is expanded up to an `order`, the accelerations to two orders less, and the guards to one order less.
    """
    grid, start = fixed.grid, lane.state
    unit = grid.h / (RADIANS_PER_TURN * grid.turn)
    model = per_radian(fixed.model, unit)
    s, c = sincos_turns(grid.start + (lane.step.astype(unit.dtype) + lane.search.done) * grid.turn)
    Q = drive_wave_series(drive_waves(s, c, model.drive), drive_wave_rates(c, -s, model.drive), model.drive)
    case = place_contact(start.motion, start, model)[1]

    accelerations: list = []  # filled once they are known as series
    places = [
        _displacement_series(getattr(start.motion, name), getattr(start.motion, f"v_{name}"), unit, k, accelerations)
        for k, name in enumerate(("x", "y", "theta"))
    ]
    rates = [tuple(map(rate_of, pair)) for pair in places]
    now = State(Motion(*places, *rates), start.u_s, start.mode, case)
    place = placement(now, model)
    accelerations.extend(rhs_at(place, Q, now, model, Recorded())[0].acceleration)
    # Products have twice the frequency: their integrals need more terms of the truncated motion.
    truncated_motion = jax.tree.map(lambda a: truncated(a, order), now.motion)
    works = rhs(Q, State(truncated_motion, start.u_s, start.mode, case), model, Recorded(ledger))[1].ledger

    at = place.at._replace(v=truncated(place.at.v, order - 1), u=truncated(place.at.u, order - 1))
    lift = number_of(LIFT), where(start.mode == Mode.APART, 1.0, -1.0) * at.v
    guards = [lift, *_switch_series(Q, place, now, model, order), *_friction_series(at, now, model)]
    return TaylorExpansion(now.motion, at.v, at.u, guards, place.pose, works, case, unit)


def without_derivatives(expansion: TaylorExpansion) -> TaylorExpansion:
    """The same numbers without derivatives."""
    return jax.tree.map(lambda a: a if isinstance(a, int) else of_each(a, lax.stop_gradient), expansion)


def per_radian(model: Model, unit: Scalar) -> Model:
    """The model with time in units of `unit` seconds: masses stay, and forces are in kg m / unit^2."""
    forces = lambda m: (m.blades.k_x, m.blades.k_y, m.blades.k_T, *m.drive.loads)
    dampers = lambda m: (m.blades.c_x, m.blades.c_y, m.blades.c_T)
    springs = lambda m: linear_law(m.law).stiffnesses
    for places, factor in ((forces, unit * unit), (dampers, unit), (springs, unit * unit)):
        scaled = jax.tree.map(lambda a, factor=factor: a * factor, places(model))
        model = eqx.tree_at(places, model, scaled, is_leaf=is_absent)
    return model


def _displacement_series(x: Pair, v: Pair, unit: Scalar, k: int, accelerations: list) -> Any:
    """The series of displacements from their values `x` and speeds `v` and the `k`-th of the accelerations."""

    def of(i: int) -> Series:
        initial = x[i], v[i] * unit
        return Series(lambda n: accelerations[k][i][n - 2] * (1 / (n * (n - 1))) if n > 1 else initial[n])

    left, right = (x[i] if is_absent(x[i]) else of(i) for i in (0, 1))
    return left, right


def _switch_series(Q: Waves, place: Placement, now: State, model: Model, order: int) -> list[GuardSeries]:
    """The guards of the case, beyond their rounding. When apart they only end a trial: the position sets the case."""
    if not has_torsion(model):
        return []
    at, torques = place.at, end_torques_under(place.loaded, now.motion, Q, place.at, now, model)
    leans = EndTorques(*(truncated(a, order - 2) for a in torques))
    turn, height = switch_guards(at._replace(height=truncated(at.height, order - 1)), leans, now.case)
    # where contact ends, LIFT is first
    flat, torque = now.case == FLAT, model.law.normal_stiffness * model.block.l_ab * at.rounding
    slack = where(flat, torque, 0.0), where(flat, torque, at.rounding)
    return [(number_of(TURN), turn - slack[0]), (number_of(HEIGHT), height - slack[1])]


def _friction_series(at: Kinematics, now: State, model: Model) -> list[GuardSeries]:
    """The guards of the friction element."""
    rate = contact_rates(at, now.motion, now.case, model.reading)
    guards = linear_law(model.law).friction_series(at, rate, now.u_s, now.mode)
    return [(number_of(RUB), guard) for guard in guards]
