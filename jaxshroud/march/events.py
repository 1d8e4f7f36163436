"""The guards that end a contact mode, and the transition when one is crossed.

| transition          | guard that rises through 0          | on crossing                                           |
|---------------------|-------------------------------------|-------------------------------------------------------|
| apart -> contact    | lift = v                            | u_s := u; slip if k_d abs(u') > mu k v', else stick   |
| start with v > 0    | at once                             | u_s := u; stick (slip where mu or k_d is 0)           |
| contact -> apart    | lift = -v                           | forces vanish                                         |
| stick -> slip       | rub = abs(w) - mu k v / k_d         | sigma = sign(w); u_s follows u - sigma mu N / k_d     |
| slip -> stick       | rub = -sigma (u' - sigma mu k v'/k_d) | u_s frozen where it is                              |
| case 1 <-> 4, 2 <-> 3 | turn = theta_1 - theta_2 changes sign | tip, lever, face change; w carried                |
| case 1 <-> 2, 3 <-> 4 | height changes sign               | the same, and v jumps                                 |
| corner -> flat      | turn, and it would soon change back | both blocks turn as one; w carried                    |
| flat -> lower corner | turn = -torque of contact there    | case 3 or 4; force and moment continuous              |
| flat -> upper corner | height = torque of contact there   | case 1 or 2; the same                                 |

**Flat contact.** Contact at the upper corners turns the blocks one way against each other, contact at the lower corners
the other way. Under load, g = theta_1 - theta_2 is therefore a relay oscillator: its crossings accumulate as it is
damped, and follow each other at once where it starts at rest (Zeno behaviour). A crossing that predicts two returns,
2 abs(g') / abs(g'') on either side, within `FLAT_RETURN` of a step leads into flat contact, and the remaining rocking
motion is dropped. The error is at most `FLAT_RETURN` / 2 of a step times g'' in the rates of theta; the ledger records
the energy lost. With a finer step the rocking motion itself is resolved.

Flat contact ends where the torque at one end of the overlap no longer pushes back. There g, g' and g'' all vanish:
the faces part with the third power of time, and the sign of g means nothing until g exceeds its rounding error. A turn
of the blocks therefore counts only beyond that error.
"""

from collections.abc import Iterable
from enum import IntEnum
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.arithmetic import ABSENT, Scalar, is_absent, where
from jaxshroud.model.drive import Waves
from jaxshroud.model.friction import Springs, contact_energy, slider_speed, slip_sign, stretch
from jaxshroud.model.geometry import (
    Case,
    ContactKinematics,
    ContactRates,
    Pose,
    blended_case,
    contact_kinematics,
    contact_rates,
    corner_case,
    is_upper,
    natural_case,
    pose,
    tip_is_left,
)
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import EndTorques, end_torques, parallel_mean, stored_energy
from jaxshroud.scene.keys import Motion

FLAT_RETURN = 1 / 24  # of a step: a rocking motion that returns sooner than this counts as flat contact


class EventKind(IntEnum):
    """The guards, in order of precedence where several are crossed."""

    LIFT = 0
    TURN = 1
    HEIGHT = 2
    RUB = 3


PerKind = tuple[Scalar, Scalar, Scalar, Scalar]  # one number for each `EventKind`


def event_kinds(four: tuple[Any, Any, Any, Any]) -> list[EventKind]:
    """The kinds of events for which there is a number."""
    return [kind for kind in EventKind if not is_absent(four[kind])]


def model_events(model: Model) -> list[EventKind]:
    """The kinds of events that a model has."""
    if not model.spring.modal:
        return []
    corners = [EventKind.TURN, EventKind.HEIGHT] if has_torsion(model) else []
    return [EventKind.LIFT, *corners, *([] if is_absent(model.spring.lag) else [EventKind.RUB])]


class Guards(NamedTuple):
    """The guards of the current mode: negative while the mode lasts, and absent where the model lacks the event."""

    value: PerKind
    rate: PerKind  # d(value)/dt; unknown, and set to 0, for RUB in slip and for TURN and HEIGHT in flat contact
    slip_path: Scalar  # in slip the path of the slider, an integral of the guard RUB; else 0


Violated = dict[EventKind, Bool[Array, ""]]  # whether each guard of the model is above zero


class GuardEvaluation(NamedTuple):
    """The contact kinematics and the guards at the end of a trial step."""

    q: Pose
    at: ContactKinematics
    rate: ContactRates
    case: Int[Array, ""]  # the current case; when apart, the case of the position
    torques: EndTorques
    guards: Guards


@partial(jax.jit, inline=True)
def evaluate_guards(z: Motion, Q: Waves, state: State, model: Model) -> GuardEvaluation:
    """The contact kinematics and the guards of the motion `z` in the mode of `state`; `Q` is the drive's wave."""
    placed = place_contact(z, state, model)
    return guards_at(placed, z, end_torques(z, Q, placed[2], state, model), state, model)


def guards_at(
    placed: tuple[Pose, Any, ContactKinematics], z: Motion, torques: EndTorques, state: State, model: Model
) -> GuardEvaluation:
    """`evaluate_guards` of placed blocks under known torques."""
    q, case, at = placed
    rate = contact_rates(at, z, case, model.reading)
    return GuardEvaluation(q, at, rate, case, torques, guard_values(at, rate, torques, state, case, model.spring))


def place_contact(z: Motion, state: State, model: Model) -> tuple[Pose, Any, ContactKinematics]:
    """The pose, the case and the contact kinematics of the motion `z` in the mode of `state`."""
    q = pose(z.x, z.y, z.theta)
    smooth = model.spring.smooth and has_torsion(model)
    case = blended_case(q, model.block, model.spring.width) if smooth else _case_at_pose(q, state, model)
    return q, case, contact_kinematics(q, case, model.block, model.reading)


def _case_at_pose(q: Pose, state: State, model: Model) -> Int[Array, ""]:
    if not has_torsion(model):
        return jnp.int32(1)  # without rotation all corners move alike
    return where(state.mode == Mode.APART, natural_case(q, model.block), state.case)


def guard_values(
    at: ContactKinematics, rate: ContactRates, torques: EndTorques, state: State, case: Int[Array, ""], spring: Springs
) -> Guards:
    """The values and the rates of the four guards."""
    apart, flat = state.mode == Mode.APART, case == FLAT
    values, rates = ([a] for a in _lift_guard(at, rate, apart, spring))
    if is_absent(at.turn):
        values, rates = [*values, ABSENT, ABSENT], [*rates, ABSENT, ABSENT]
    else:
        idle = lambda g: where(apart, -1.0, g)
        still = lambda g: where(apart | flat, 0.0, g)
        values += map(idle, switch_guards(at, torques, case))
        turn, height = switch_signs(case)
        rates += [still(turn * rate.turn), still(height * rate.height)]
    rub, rub_rate, slip_path = _friction_guard(at, rate, state, spring)
    return Guards((*values, rub), (*rates, rub_rate), slip_path)  # pyright: ignore[reportArgumentType]


def _lift_guard(
    at: ContactKinematics, rate: ContactRates, apart: Bool[Array, ""], spring: Springs
) -> tuple[Scalar, Scalar]:
    """The value and the rate of the guard LIFT: v when apart, -v in contact. User laws must push as well."""
    lift = where(apart, 1.0, -1.0)
    if is_absent(spring.laws):
        return lift * at.v, lift * rate.v
    push = spring.laws.push(jnp.maximum(at.v, 0.0), rate.v) / spring.k  # a length, as v is
    sign = where((at.v > 0) & (push <= 0), -1.0, 1.0)  # apart although the corners overlap
    in_contact = -jnp.minimum(at.v, push), where(push < at.v, 0.0, -rate.v)
    return where(apart, sign * at.v, in_contact[0]), where(apart, sign * rate.v, in_contact[1])


def switch_signs(case: Case) -> tuple[Scalar, Scalar]:
    """The signs that theta_1 - theta_2 and the height take when they leave a case."""
    return where(is_upper(case), -1.0, 1.0), where(is_upper(case) == tip_is_left(case), 1.0, -1.0)


def switch_guards(at: ContactKinematics, torques: EndTorques, case: Case) -> tuple[Scalar, Scalar]:
    """The values of the guards TURN and HEIGHT in contact."""
    (turn, height), flat = switch_signs(case), case == FLAT
    return (
        where(flat, -torques.lower, turn * at.turn - at.turn_rounding),
        where(flat, torques.upper, height * at.height),
    )


def _friction_guard(
    at: ContactKinematics, rate: ContactRates, state: State, spring: Springs
) -> tuple[Scalar, Scalar, Scalar]:
    """The value, the rate and the integral of the guard of the friction element."""
    if is_absent(spring.lag):
        return ABSENT, ABSENT, ABSENT
    apart, stick = state.mode == Mode.APART, state.mode == Mode.STICK
    w = at.u - state.u_s
    sigma = slip_sign(state.mode, at.v.dtype)
    rubs = spring.mu > 0
    # stick may begin at its limit, where a rounding error must not count as slip
    in_stick = jnp.abs(w) - spring.lag * at.v - 2 * at.rounding, jnp.sign(w) * rate.u - spring.lag * rate.v
    in_slip = -sigma * slider_speed(rate.v, rate.u, state.mode, spring)
    return (
        where(stick, in_stick[0], where(rubs & ~apart, in_slip, -1.0)),
        where(stick, in_stick[1], 0.0),
        where(stick | apart | ~rubs, 0.0, -sigma * (at.u - sigma * spring.lag * at.v)),
    )


def any_of(flags: Iterable[Bool[Array, "..."]]) -> Bool[Array, "..."]:
    """Whether any of the flags is true."""
    return reduce(jnp.logical_or, flags)


def first_kind(violated: Violated) -> Int[Array, ""]:
    """The kind of the violated guard that takes precedence."""
    *others, last = violated
    kind = jnp.asarray(last, jnp.int32)
    for k in reversed(others):
        kind = where(violated[k], jnp.int32(k), kind)
    return kind


def forces_jump(kind: Int[Array, ""], state: State, model: Model) -> Bool[Array, ""]:
    """Whether the forces jump at an event of `kind`: at a loaded case switch, or at any onset of user laws."""
    jumps = jnp.zeros_like(kind, bool)
    if has_torsion(model):
        jumps = ((kind == EventKind.TURN) | (kind == EventKind.HEIGHT)) & (state.case != FLAT)
    return jumps if is_absent(model.spring.laws) else jumps | (kind == EventKind.LIFT)


class Transition(NamedTuple):
    """A transition: the state after the event, and the energy that it adds and drops."""

    after: State
    guards: Guards  # of the mode after it
    energy: Scalar  # jump of the energy in the contact springs [J]
    dropped: Scalar  # energy of the rocking motion that flat contact ends [J]; absent where the blocks do not turn
    kind: Int[Array, ""]
    before: State


def transition(
    z: Motion,
    state: State,
    view: GuardEvaluation,
    kind: Int[Array, ""],
    delay: Scalar,
    h: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None = None,
) -> Transition:
    """The transition of `kind` at the motion `z`; the guard was crossed at most `delay` [s] ago, in a step of `h`.

    `rocks`: the faces are known to turn to and fro within the step, so that their next turn leads into flat contact.
    """
    spring, at, unprojected = model.spring, view.at, z
    case = _next_case(state, view, kind, h, model, rocks) if has_torsion(model) else view.case
    becomes_flat = (case == FLAT) & (state.case != FLAT)
    if has_torsion(model):
        z = jax.tree.map(lambda parallel, own: where(becomes_flat, parallel, own), _as_parallel(z, model), z)
    new = contact_kinematics(view.q, case, model.block, model.reading)

    mode = where(
        kind == EventKind.LIFT,
        where(state.mode == Mode.APART, _onset_mode(view, delay, spring), jnp.int32(Mode.APART)),
        where(kind == EventKind.RUB, _mode_after_rub(at, state, spring), state.mode),
    )
    w = stretch(at.v, at.u, state.u_s, state.mode, spring)
    u_s = ABSENT
    if not is_absent(spring.laws) and not is_absent(state.u_s):
        in_contact = (state.mode != Mode.APART) & (mode != Mode.APART)
        u_s = where(in_contact, state.u_s, spring.laws.z)
    elif not is_absent(state.u_s):
        u_s = where(state.mode == Mode.APART, _slider_at_onset(view, delay), new.u - w)
    after = State(z, u_s, mode, where(mode == Mode.APART, 0, case).astype(jnp.int32))
    guards = guard_values(new, contact_rates(new, z, case, model.reading), view.torques, after, case, spring)
    energy = contact_energy(new.v, stretch(new.v, new.u, u_s, mode, spring), mode, spring)
    energy = energy - contact_energy(at.v, w, state.mode, spring)
    dropped = ABSENT
    if has_torsion(model):
        dropped = where(becomes_flat, stored_energy(unprojected, model) - stored_energy(z, model), 0.0)
    return Transition(after, guards, energy, dropped, kind, state)


def _as_parallel(z: Motion, model: Model) -> Motion:
    """The motion once both blocks turn as one body; the sum of their angular momenta is kept."""
    return z._replace(theta=parallel_mean(z.theta, model), v_theta=parallel_mean(z.v_theta, model))


def _next_case(
    state: State,
    view: GuardEvaluation,
    kind: Int[Array, ""],
    h: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None,
) -> Int[Array, ""]:
    """The case after an event of `kind`."""
    now, turn = view.case, kind == EventKind.TURN
    neighbour = where(turn, 5 - now, now + where(tip_is_left(now), 1, -1))
    corner = where(now == FLAT, corner_case(~turn, view.at.height), neighbour)
    case = where(turn | (kind == EventKind.HEIGHT), corner, now)
    touches = (kind == EventKind.LIFT) & (state.mode == Mode.APART)
    level = touches & (view.at.turn == 0) & (view.rate.turn == 0)
    soon = _returns_soon(view, h, model) if rocks is None else rocks | _returns_soon(view, h, model)
    return where(level | (turn & (now != FLAT) & soon), FLAT, case)


def _returns_soon(view: GuardEvaluation, h: Scalar, model: Model) -> Bool[Array, ""]:
    """Whether theta_1 - theta_2, having crossed zero, is pushed back from both sides and soon returns twice."""
    lower, upper = view.torques
    returns = 2 * jnp.abs(view.rate.turn) * model.mobility.joint * (lower - upper)  # times -lower * upper
    return (lower > 0) & (upper < 0) & (returns < FLAT_RETURN * h * -lower * upper)


def _onset_mode(view: GuardEvaluation, delay: Scalar, spring: Springs) -> Int[Array, ""]:
    """The mode as contact begins: by the rates where v = 0, and stick where the blocks start in overlap.

    In overlap the element is unstretched under a normal force: k_d abs(w) = 0 is less than mu N at any rates.
    """
    rate = view.rate
    if is_absent(spring.lag):
        return jnp.int32(Mode.SLIP_PLUS)
    slips = ((jnp.abs(rate.u) > spring.lag * rate.v) & ~starts_in_overlap(view, delay)) | (spring.mu == 0)
    sliding = where(rate.u < 0, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return where(slips, sliding, jnp.int32(Mode.STICK))


def starts_in_overlap(view: GuardEvaluation, delay: Scalar) -> Bool[Array, ""]:
    """Whether an onset is that of blocks which start pressed together, rather than one from a gap."""
    return (delay == 0) & (view.at.v > view.at.rounding)


def _mode_after_rub(at: ContactKinematics, state: State, spring: Springs) -> Int[Array, ""]:
    if is_absent(spring.lag):
        return state.mode
    sliding = where(at.u < state.u_s, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return where(state.mode == Mode.STICK, sliding, jnp.int32(Mode.STICK))


def _slider_at_onset(view: GuardEvaluation, delay: Scalar) -> Scalar:
    """The slide u where v = 0, extrapolated back from the located time by the remaining penetration."""
    v, rate = view.at.v, view.rate
    closing = rate.v > 0
    return view.at.u - rate.u * where(closing, jnp.minimum(v / where(closing, rate.v, 1.0), delay), 0.0)
