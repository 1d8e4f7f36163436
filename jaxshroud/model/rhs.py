"""Equation (1): the motion of both blocks while the contact mode and case are held fixed."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.model.absent import ABSENT, Pair, Scalar, is_absent, where
from jaxshroud.model.contact import Load, contact_load, sprung_load
from jaxshroud.model.friction import Slider, Springs, following, friction_force, normal_force, slider_speed
from jaxshroud.model.geometry import Case, Pose, Rates, Touch, blend, is_upper, pose, tip_is_left, touch, touch_rates
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.ready import Excitation, Model, turns
from jaxshroud.model.series import Series
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion


class Acceleration(NamedTuple):
    """Second derivatives of the displacements."""

    x: Pair  # [m/s^2]
    y: Pair
    theta: Pair  # [rad/s^2]


class Ledger(NamedTuple):
    """Works that the energy balance needs."""

    drive: Scalar  # done by the drive [J]
    gross: Scalar  # the same, without its sign at each instant [J]
    viscous: Scalar  # lost in the dampers [J]
    friction: Scalar  # lost in the sliding contact [J]


class Integrals(NamedTuple):
    """Time integrals carried along with the motion, to the integrator's order."""

    power: Pair  # mean square displacement over the block, Eq. (23) divided by its area [m^2 s]
    ledger: Ledger | None  # None where it is not kept


def wave(s: Scalar, c: Scalar, drive: Excitation) -> Pair:
    """sin(omega t + phase) of each blade's drive from the sine and cosine of omega t."""
    left, right = (s * drive.cos_phase[i] + c * drive.sin_phase[i] for i in (0, 1))
    return left, right


def accelerated(z: Motion, Q: Pair, load: Load, model: Model) -> Acceleration:
    """Accelerations by Eq. (1), with `Q` the drive's wave of each blade and `load` at a corner."""
    b, d, inverse = model.blades, model.drive, model.mobility
    R_x, R_y = (load.R_x, -load.R_x), (load.R_y, -load.R_y)

    def rates(i: int) -> tuple[Scalar, Scalar, Scalar]:
        a_x = (d.F_x[i] * Q[i] + R_x[i] - b.c_x[i] * z.v_x[i] - b.k_x[i] * z.x[i]) * inverse.x[i]
        a_y = (d.F_y[i] * Q[i] + R_y[i] - b.c_y[i] * z.v_y[i] - b.k_y[i] * z.y[i]) * inverse.y[i]
        a_theta = (d.M_0[i] * Q[i] + load.M[i] - b.c_T[i] * z.v_theta[i] - b.k_T[i] * z.theta[i]) * inverse.theta[i]
        return a_x, a_y, a_theta

    left, right = rates(0), rates(1)
    return Acceleration(*zip(left, right, strict=True))


def as_one(pair: Pair, model: Model) -> Pair:
    """What two turning blocks have in common once they are held parallel: their mean, weighted by inertia."""
    mean = pair[1] + model.mobility.share * (pair[0] - pair[1])
    return mean, pair[1] if is_absent(pair[1]) else mean


class Lean(NamedTuple):
    """What contact at either end of the faces' overlap would do to parallel blocks: torques on theta_1 - theta_2.

    Each is the reduced inertia times the acceleration towards each other; absent where blocks do not turn. Where the
    lower is positive and the upper negative, the resultant finds a place between them that keeps the blocks parallel.
    """

    lower: Scalar  # of contact at corner b or d [N m]
    upper: Scalar  # of contact at corner a or c [N m]


def lean(z: Motion, Q: Pair, at: Touch, held: State, model: Model) -> Lean:
    """Torques at both ends of the overlap, from that at the corner of the held case.

    A resultant of -N n - F t that acts elsewhere by s t + r n changes the torque by F r - N s. Seen from d, b is
    u t + v n away, c is l_ab t, and a is both; the overlap ends at d and a, or at b and c.
    """
    if not turns(model):
        return Lean(ABSENT, ABSENT)
    N, F, _, load = _loaded(at, z, held, held.case, model)
    left, right = accelerated(z, Q, load, model).theta
    k = _stiffness(held, model)
    along, corner = N * model.block.l_ab, (F - k * at.u) * at.v if isinstance(at.v, Series) else F * at.v - N * at.u
    here = where(is_upper(held.case), along, ABSENT) - where(tip_is_left(held.case), corner, ABSENT)
    at_d, higher = model.mobility.joint * (left - right) + here, at.height > 0
    return Lean(at_d + where(higher, corner, ABSENT), at_d - along + where(higher, ABSENT, corner))


class Forces(NamedTuple):
    """What the laws of contact say."""

    N: Scalar  # [N]
    F: Scalar  # [N]
    u_s: Slider  # its rate, where it is integrated with the motion


def forces(at: Touch, z: Motion, held: State, case: Case, model: Model) -> Forces:
    """Normal and friction force of the motion `z` in the mode of `held`."""
    spring = model.spring
    if not is_absent(spring.laws):
        return _own_forces(at, touch_rates(at, z, case, model.reading), held, spring)
    N = normal_force(at.v, held.mode, spring)
    F = friction_force(at.v, at.u, held.u_s, held.mode, spring)
    return Forces(N, F, following(at.v, at.u, held.u_s, held.mode, spring))


def _own_forces(at: Touch, rate: Rates, held: State, spring: Springs) -> Forces:
    touches = held.mode != Mode.APART
    N = jnp.where(touches, jnp.maximum(spring.laws.push(jnp.maximum(at.v, 0.0), rate.v), 0.0), 0.0)
    if is_absent(held.u_s):
        return Forces(N, ABSENT, ABSENT)
    F, z_t = spring.laws.rub(held.u_s, rate.u, N)
    return Forces(N, jnp.where(touches, F, 0.0), jnp.where(touches, z_t, jnp.zeros_like(z_t)))


def _lost(at: Touch, z: Motion, found: Forces, held: State, case: Case, model: Model) -> Scalar:
    """What contact dissipates [W]: F times the slider's speed; by own laws what their energy does not take."""
    spring, rate = model.spring, touch_rates(at, z, case, model.reading)
    if is_absent(spring.laws):
        return found.F * (found.u_s if spring.smooth else slider_speed(rate.v, rate.u, held.mode, spring))
    v, v_t = jnp.maximum(at.v, 0.0), jnp.where(at.v > 0, rate.v, 0.0)
    stored = spring.laws.stored_power(v, held.u_s, v_t, found.u_s)
    return jnp.where(held.mode == Mode.APART, 0.0, found.N * rate.v + found.F * rate.u - stored)


def _loaded(at: Touch, z: Motion, held: State, case: Case, model: Model) -> tuple[Scalar, Scalar, Slider, Load]:
    N, F, u_s = forces(at, z, held, case, model)
    if isinstance(at.v, Series) and model.spring.modal and turns(model) and not model.reading:
        return N, F, u_s, sprung_load(at, _stiffness(held, model), N, F, case, model.block)
    return N, F, u_s, contact_load(at, N, F, case, model.block, model.reading)


def _stiffness(held: State, model: Model) -> Scalar:
    """Of the contact; absent where there is none."""
    return where(held.mode == Mode.APART, ABSENT, model.spring.k)


def mean_square(q: Pose, gyration: Scalar) -> Pair:
    """Square displacement averaged over each block: x^2 + y^2 + 4 (J_A/A) sin^2(theta/2) [m^2].

    Source:
        Eqs. (22), (23): over a centrally symmetric block the cross terms vanish, so no area quadrature is needed.
    """
    left, right = (q.x[i] ** 2 + q.y[i] ** 2 + gyration * 2 * q.versine[i] for i in (0, 1))
    return left, right


def works(z: Motion, Q: Pair, lost: Scalar, model: Model) -> Ledger:
    """Rates of the works; `lost` is what contact dissipates."""
    b, d = model.blades, model.drive
    drive = lambda i: (d.F_x[i] * z.v_x[i] + d.F_y[i] * z.v_y[i] + d.M_0[i] * z.v_theta[i]) * Q[i]  # noqa: E731
    viscous = lambda i: b.c_x[i] * z.v_x[i] ** 2 + b.c_y[i] * z.v_y[i] ** 2 + b.c_T[i] * z.v_theta[i] ** 2  # noqa: E731
    power = drive(0) + drive(1)
    return Ledger(power, abs(power), viscous(0) + viscous(1), lost)


class Slope(NamedTuple):
    """Second derivatives of the displacements, and d/dt of the slider where it moves without events."""

    acceleration: Acceleration
    u_s: Slider


def rhs(Q: Pair, now: State, model: Model, ledger: bool) -> tuple[Slope, Integrals]:
    """Accelerations by Eq. (1) and the rates of the running integrals while mode and case stay fixed.

    `Q` is the drive's `wave` at the time in question; the rates of the works are left out without `ledger`.
    """
    z, spring = now.motion, model.spring
    q = pose(z.x, z.y, z.theta)
    case = blend(q, model.block, spring.width) if spring.smooth and turns(model) else now.case
    at = touch(q, case, model.block, model.reading)
    N, F, u_s, load = _loaded(at, z, now, case, model)
    spent = works(z, Q, _lost(at, z, Forces(N, F, u_s), now, case, model), model) if ledger else None
    a = accelerated(z, Q, load, model)
    if turns(model) and spring.modal:
        theta = jax.tree.map(lambda one, own: where(case == FLAT, one, own), as_one(a.theta, model), a.theta)
        a = a._replace(theta=theta)
    return Slope(a, u_s), Integrals(mean_square(q, model.gyration), spent)


rhs_once = jax.jit(rhs, static_argnames="ledger", inline=True)  # the same, traced once for all stages


def stored_energy(z: Motion, model: Model) -> Scalar:
    """Kinetic energy and energy of the blades' own springs [J]."""
    b = model.blades

    def twice(i: int) -> Scalar:
        kinetic = b.m[i] * z.v_x[i] ** 2 + b.inertia_y[i] * z.v_y[i] ** 2 + b.I[i] * z.v_theta[i] ** 2
        return kinetic + b.k_x[i] * z.x[i] ** 2 + b.k_y[i] * z.y[i] ** 2 + b.k_T[i] * z.theta[i] ** 2

    return (twice(0) + twice(1)) / 2
