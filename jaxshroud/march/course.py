"""The course of one lane as power series, as long as its mode and case are held: Eq. (1) applied to series.

Time is counted in radians of the drive's phase from the start of a trial, so that coefficients keep about one size.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.march.events import Kind, seat, switches
from jaxshroud.march.lane import Fixed, Lane
from jaxshroud.model.absent import Pair, Scalar, is_absent, where
from jaxshroud.model.friction import slider_speed, slip_sign
from jaxshroud.model.geometry import Pose, Touch, pose, touch, touch_rates
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.ready import Model, turns
from jaxshroud.model.rhs import Lean, Ledger, lean, rhs, wave
from jaxshroud.model.series import Series, cut, rate_of
from jaxshroud.model.state import State
from jaxshroud.model.trig import sincos_turns
from jaxshroud.scene.motion import Motion

RADIANS = 2 * math.pi  # in a turn
Guard = tuple[Kind, Any]  # with a Series


class Course(NamedTuple):
    """Series in the drive's phase since the start of a trial [rad]."""

    motion: Motion  # rates are per radian
    v: Any
    u: Any
    guards: list[Guard]  # negative while the mode may go on
    pose: Pose
    works: Ledger | None  # their rates per radian, by the motion up to its order, in `unit ** 2` joules
    case: Int[Array, ""]  # the held one; when apart, that of the position at the start
    unit: Scalar  # seconds per radian


def course(lane: Lane, fixed: Fixed, order: int, ledger: bool) -> Course:
    """What a lane does from where it is.

    Its motion is meant to be known up to an `order`, accelerations up to two less; guards go one further than these.
    """
    grid, held = fixed.grid, lane.state
    unit = grid.h / (RADIANS * grid.turn)
    model = per_radian(fixed.model, unit)
    s, c = sincos_turns(grid.start + (lane.step.astype(unit.dtype) + lane.search.done) * grid.turn)
    Q = _circling(wave(s, c, model.drive), wave(c, -s, model.drive))
    case = seat(held.motion, held, model)[1]

    found: list = []  # accelerations, once they are known as series
    places = [
        _from(getattr(held.motion, name), getattr(held.motion, f"v_{name}"), unit, k, found)
        for k, name in enumerate(("x", "y", "theta"))
    ]
    rates = [tuple(map(rate_of, pair)) for pair in places]
    now = State(Motion(*places, *rates), held.u_s, held.mode, case)
    found.extend(rhs(Q, now, model, False)[0].acceleration)
    # Products have twice the frequency: their integrals go on where those of what is known still matter.
    known = jax.tree.map(lambda a: cut(a, order), now.motion)
    works = rhs(Q, State(known, held.u_s, held.mode, case), model, ledger)[1].ledger

    q = pose(*places)
    at = touch(q, case, model.block, model.reading)
    at = at._replace(v=cut(at.v, order - 1), u=cut(at.u, order - 1))
    lift = Kind.LIFT, jnp.where(held.mode == Mode.APART, 1.0, -1.0) * at.v
    guards = [lift, *_switches(Q, at, now, model, order), *_rubs(at, now, model)]
    return Course(now.motion, at.v, at.u, guards, q, works, case, unit)


def frozen(way: Course) -> Course:
    """The same numbers without derivatives."""

    def plain(a: Any) -> Any:
        if isinstance(a, Series):
            return a.of_each(lax.stop_gradient)
        return a if isinstance(a, Kind) else lax.stop_gradient(a)

    return jax.tree.map(plain, way)


def per_radian(model: Model, unit: Scalar) -> Model:
    """The model where time is counted in units of `unit` seconds: masses stay, forces are in kg m / unit^2."""
    forces = lambda m: (m.blades.k_x, m.blades.k_y, m.blades.k_T, m.drive.F_x, m.drive.F_y, m.drive.M_0)  # noqa: E731
    dampers = lambda m: (m.blades.c_x, m.blades.c_y, m.blades.c_T)  # noqa: E731
    springs = lambda m: (m.spring.k, m.spring.k_d)  # noqa: E731
    for places, factor in ((forces, unit * unit), (dampers, unit), (springs, unit * unit)):
        scaled = jax.tree.map(lambda a, factor=factor: a * factor, places(model))
        model = eqx.tree_at(places, model, scaled, is_leaf=is_absent)
    return model


def _circling(wave: Pair, ahead: Pair) -> Any:
    """Series of waves whose derivatives are those `ahead`."""

    def of(i: int) -> Series:
        turns = (wave[i], ahead[i], -wave[i], -ahead[i])
        return Series(lambda n: turns[n % 4] * (1 / math.factorial(n)))

    return of(0), of(1)


def _from(x: Pair, v: Pair, unit: Scalar, k: int, accelerations: list) -> Any:
    """Displacements that begin at `x` with speeds `v` and go on with the `k`-th of the accelerations."""

    def of(i: int) -> Series:
        begun = x[i], v[i] * unit
        return Series(lambda n: accelerations[k][i][n - 2] * (1 / (n * (n - 1))) if n > 1 else begun[n])

    left, right = (x[i] if is_absent(x[i]) else of(i) for i in (0, 1))
    return left, right


def _switches(Q: Pair, at: Touch, now: State, model: Model, order: int) -> list[Guard]:
    """The guards of the case, met beyond their rounding. Apart they end a trial only: the case follows the position."""
    if not turns(model):
        return []
    leans = Lean(*(cut(a, order - 2) for a in lean(now.motion, Q, at, now, model)))
    turn, height = switches(at._replace(height=cut(at.height, order - 1)), leans, now.case)
    flat, torque = (
        now.case == FLAT,
        model.spring.k * model.block.l_ab * at.rounding,
    )  # where contact ends, LIFT is first
    slack = jnp.where(flat, torque, 0.0), jnp.where(flat, torque, at.rounding)
    return [(Kind.TURN, turn - slack[0]), (Kind.HEIGHT, height - slack[1])]


def _rubs(at: Touch, now: State, model: Model) -> list[Guard]:
    """The guard of the friction element: in stick one for each direction, of which slip needs the first only."""
    spring = model.spring
    if is_absent(spring.lag):
        return []
    apart, stick = now.mode == Mode.APART, now.mode == Mode.STICK
    w, limit = at.u - now.u_s, spring.lag * at.v + 2 * at.rounding  # stick may begin at its limit
    rate = touch_rates(at, now.motion, now.case, model.reading)
    slipping = -slip_sign(now.mode, at.v.dtype) * slider_speed(rate.v, rate.u, now.mode, spring)
    other = where(apart | (spring.mu <= 0), -1.0, slipping)
    return [(Kind.RUB, where(stick, w - limit, other)), (Kind.RUB, where(stick, -w - limit, -1.0))]
