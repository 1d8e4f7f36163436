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

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.event import Event, EventInstant, Events, always, next_mode
from jaxshroud.march.guards import ContactNow, Guard, GuardEvaluation, Guards, any_of
from jaxshroud.model.arithmetic import ABSENT, Pair, Scalar, is_absent, where
from jaxshroud.model.friction import Springs, contact_energy, slider_speed, slip_sign, stretch
from jaxshroud.model.geometry import (
    ContactKinematics,
    ContactRates,
    Pose,
    blended_case,
    contact_kinematics,
    contact_rates,
    corner_case,
    natural_case,
    pose,
    tip_is_left,
)
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import EndTorques, end_torques, parallel_mean, stored_energy
from jaxshroud.scene.keys import Motion

FLAT_RETURN = 1 / 24  # of a step: a rocking motion that returns sooner than this counts as flat contact


def _guard_of_lift(now: ContactNow) -> Guard:
    return Guard(*_lift_guard(now.at, now.rate, now.apart, now.model.spring))


def _guard_of_turn(now: ContactNow) -> Guard:
    return now.of_corners[0]


def _guard_of_height(now: ContactNow) -> Guard:
    return now.of_corners[1]


def _guard_of_rub(now: ContactNow) -> Guard:
    return Guard(*_friction_guard(now.at, now.rate, now.state, now.model.spring))


def _mode_after_lift(instant: EventInstant) -> Int[Array, ""]:
    view, state, delay, model = instant
    return where(state.mode == Mode.APART, _onset_mode(view, delay, model.spring), jnp.int32(Mode.APART))


def _mode_after_friction(instant: EventInstant) -> Int[Array, ""]:
    return _mode_after_rub(instant.view.at, instant.state, instant.model.spring)


def _turn_rounding(at: ContactKinematics) -> Scalar:
    return at.turn_rounding


def _has_user_laws(model: Model) -> bool:
    return not is_absent(model.spring.laws)


def _has_friction_element(model: Model) -> bool:
    return not is_absent(model.spring.lag)


LIFT = Event(
    name="lift",
    label="contact",
    guard=_guard_of_lift,
    transition=_mode_after_lift,
    forces_jump=_has_user_laws,
    counters=("onset_slip", "separation", "grazing"),
)
TURN = Event(
    name="turn",
    label="corner pair",
    guard=_guard_of_turn,
    switches_case=True,
    exists=has_torsion,
    forces_jump=always,
    rounding=_turn_rounding,
    counters=("switch_14", "switch_23", "flat", "flat_corner"),
)
HEIGHT = Event(
    name="height",
    label="tip",
    guard=_guard_of_height,
    switches_case=True,
    exists=has_torsion,
    forces_jump=always,
    counters=("switch_12", "switch_34"),
)
RUB = Event(
    name="rub",
    label="friction",
    guard=_guard_of_rub,
    transition=_mode_after_friction,
    exists=_has_friction_element,
    counters=("onset_stick", "stick_slip", "slip_stick"),
)
EVENTS = (LIFT, TURN, HEIGHT, RUB)  # in order of precedence


def number_of(event: Event) -> int:
    """The number of a built-in event."""
    return EVENTS.index(event)


def happens(kind: Int[Array, ""], *events: Event) -> Bool[Array, ""]:
    """Whether the event of number `kind` is one of these built-in ones."""
    return any_of(kind == number_of(event) for event in events)


def model_events(model: Model) -> list[Event]:
    """The built-in events that a model has."""
    return [event for event in EVENTS if event.exists(model)] if model.spring.modal else []


@partial(jax.jit, inline=True, static_argnames=("events",))
def evaluate_guards(z: Motion, Q: Pair, state: State, model: Model, events: Events = EVENTS) -> GuardEvaluation:
    """The contact kinematics and the guards of the motion `z` in the mode of `state`; `Q` is the drive's wave."""
    placed = place_contact(z, state, model)
    return guards_at(placed, z, end_torques(z, Q, placed[2], state, model), state, model, events)


def guards_at(
    placed: tuple[Pose, Any, ContactKinematics],
    z: Motion,
    torques: EndTorques,
    state: State,
    model: Model,
    events: Events = EVENTS,
) -> GuardEvaluation:
    """`evaluate_guards` of placed blocks under known torques."""
    q, case, at = placed
    rate = contact_rates(at, z, case, model.reading)
    guards = guard_values(at, rate, torques, state, case, model, events)
    return GuardEvaluation(q, at, rate, case, torques, guards)


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
    at: ContactKinematics,
    rate: ContactRates,
    torques: EndTorques,
    state: State,
    case: Int[Array, ""],
    model: Model,
    events: Events,
) -> Guards:
    """The values, the rates and the integrals of the guards that a model has."""
    now = ContactNow(at, rate, torques, state, case, state.mode == Mode.APART, case == FLAT, model)
    guards = [event.guard(now) if event.exists(model) else NO_GUARD for event in events]
    return Guards(*zip(*guards, strict=True))


NO_GUARD = Guard(ABSENT, ABSENT)


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
    events: Events = EVENTS,
) -> Transition:
    """The transition of the event of number `kind` at the motion `z`, in a step of `h` [s].

    The guard was crossed at most `delay` [s] ago.
    `rocks`: the faces are known to turn to and fro within the step, so that their next turn leads into flat contact.
    """
    spring, at, unprojected = model.spring, view.at, z
    case = _next_case(state, view, kind, h, model, rocks) if has_torsion(model) else view.case
    becomes_flat = (case == FLAT) & (state.case != FLAT)
    if has_torsion(model):
        z = jax.tree.map(lambda parallel, own: where(becomes_flat, parallel, own), _as_parallel(z, model), z)
    new = contact_kinematics(view.q, case, model.block, model.reading)

    mode = next_mode(kind, EventInstant(view, state, delay, model), events)
    w = stretch(at.v, at.u, state.u_s, state.mode, spring)
    u_s = ABSENT
    if not is_absent(spring.laws) and not is_absent(state.u_s):
        in_contact = (state.mode != Mode.APART) & (mode != Mode.APART)
        u_s = where(in_contact, state.u_s, spring.laws.z)
    elif not is_absent(state.u_s):
        u_s = where(state.mode == Mode.APART, _slider_at_onset(view, delay), new.u - w)
    after = State(z, u_s, mode, where(mode == Mode.APART, 0, case).astype(jnp.int32))
    guards = guard_values(new, contact_rates(new, z, case, model.reading), view.torques, after, case, model, events)
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
    """The case after the event of number `kind`."""
    now, turn = view.case, happens(kind, TURN)
    neighbour = where(turn, 5 - now, now + where(tip_is_left(now), 1, -1))
    corner = where(now == FLAT, corner_case(~turn, view.at.height), neighbour)
    case = where(turn | happens(kind, HEIGHT), corner, now)
    touches = happens(kind, LIFT) & (state.mode == Mode.APART)
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
