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
2 abs(g') / abs(g'') on either side, within the share `flat_return` of a drive period, or `FLAT_PART` of a step if that
is shorter, leads into flat contact, and the remaining rocking motion is dropped. The error is at most half of that time
times g'' in the rates of theta; the ledger records the energy lost. A smaller share resolves the rocking motion itself.

Flat contact ends where the torque at one end of the overlap no longer pushes back. There g, g' and g'' all vanish:
the faces part with the third power of time, and the sign of g means nothing until g exceeds its rounding error. A turn
as slow as that therefore counts only beyond that error; any other counts at once, see `turn_slack`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.event import (
    ContactNow,
    Event,
    EventInstant,
    Events,
    Guard,
    GuardEvaluation,
    Guards,
    always,
    any_of,
    next_mode,
)
from jaxshroud.march.point_events import LIFT_AT, POINT_EVENTS, RUB_AT
from jaxshroud.model.arithmetic import ZERO, Scalar, where
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.geometry import (
    Kinematics,
    Pose,
    Rates,
    contact_kinematics,
    contact_rates,
    corner_case,
    natural_case,
    pose,
    tip_is_left,
)
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State, has_torsion, touches_at_corners
from jaxshroud.model.rhs import EndTorques, parallel_mean
from jaxshroud.scene.keys import Motion

FLAT_PART = 1 / 24  # of a step: a rocking motion that returns sooner counts as flat contact in any case


def _guard_of_lift(now: ContactNow) -> Guard:
    value, rate = now.model.law.lift_guard(now.at, now.rate, now.apart)
    return Guard(value, rate)


def _guard_of_turn(now: ContactNow) -> Guard:
    return now.of_corners[0]


def _guard_of_height(now: ContactNow) -> Guard:
    return now.of_corners[1]


def _guard_of_rub(now: ContactNow) -> Guard:
    return Guard._make(now.model.law.friction_guard(now.at, now.rate, now.state.u_s, now.state.mode))


def _mode_after_lift(instant: EventInstant) -> Int[Array, ""]:
    is_apart = instant.state.mode == Mode.APART
    return where(is_apart, instant.model.law.onset_mode(instant.crossing), jnp.int32(Mode.APART))


def _mode_after_friction(instant: EventInstant) -> Int[Array, ""]:
    return instant.model.law.mode_after_rub(instant.crossing)


def _turn_rounding(at: Kinematics) -> Scalar:
    return at.turn_rounding / 4  # one rounding: what is taken for zero later than that drives the rocking of faces


def _jumps_at_onset(model: Model) -> bool:
    return model.law.jumps_at_onset


def _has_one_point(model: Model) -> bool:
    return not model.law.has_points


def _has_stick(model: Model) -> bool:
    return model.law.has_stick


LIFT = Event(
    name="lift",
    label="contact",
    guard=_guard_of_lift,
    transition=_mode_after_lift,
    exists=_has_one_point,
    forces_jump=_jumps_at_onset,
    counters=("onset_slip", "separation", "grazing"),
)
TURN = Event(
    name="turn",
    label="corner pair",
    guard=_guard_of_turn,
    switches_case=True,
    exists=touches_at_corners,
    forces_jump=always,
    rounding=_turn_rounding,
    counters=("switch_14", "switch_23", "flat", "flat_corner"),
)
HEIGHT = Event(
    name="height",
    label="tip",
    guard=_guard_of_height,
    switches_case=True,
    exists=touches_at_corners,
    forces_jump=always,
    counters=("switch_12", "switch_34"),
)
RUB = Event(
    name="rub",
    label="friction",
    guard=_guard_of_rub,
    transition=_mode_after_friction,
    exists=_has_stick,
    counters=("onset_stick", "stick_slip", "slip_stick"),
)
EVENTS = (LIFT, TURN, HEIGHT, RUB)  # of a corner, in order of precedence
BUILT_IN_EVENTS = (*EVENTS, *POINT_EVENTS)


def number_of(event: Event) -> int:
    """The number of a built-in event."""
    return BUILT_IN_EVENTS.index(event)


def events_at_points(law: ContactLaw) -> list[tuple[Event, Event]]:
    """For each point of contact of an interface: that contact begins or ends there, and that it sticks or slips."""
    return [*zip(LIFT_AT, RUB_AT, strict=True)][: len(law.of_points)] if law.has_points else [(LIFT, RUB)]


def happens(kind: Int[Array, ""], *events: Event) -> Bool[Array, ""]:
    """Whether the event of number `kind` is one of these built-in ones."""
    return any_of(kind == number_of(event) for event in events)


def model_events(model: Model) -> list[Event]:
    """The built-in events that a model has."""
    events = BUILT_IN_EVENTS if model.law.has_events else ()
    return [event for event in events if event.exists(model)]


def guards_at(
    placed: tuple[Pose, Any, Kinematics],
    z: Motion,
    torques: EndTorques,
    state: State,
    model: Model,
    events: Events = BUILT_IN_EVENTS,
) -> GuardEvaluation:
    """The contact kinematics and the guards of placed blocks under the torques at both ends of their overlap."""
    q, case, at = placed
    rate = contact_rates(at, z, case, model.reading)
    guards = guard_values(at, rate, torques, state, case, model, events)
    return GuardEvaluation(q, at, rate, case, torques, guards)


def place_contact(z: Motion, state: State, model: Model) -> tuple[Pose, Any, Kinematics]:
    """The pose, the case and the contact kinematics of the motion `z` in the mode of `state`."""
    q = pose(z.x, z.y, z.theta)
    blend = model.law.case_blend(q, model.block) if has_torsion(model) else None
    case = _case_at_pose(q, state, model) if blend is None else blend
    return q, case, contact_kinematics(q, case, model.block, model.reading)


def _case_at_pose(q: Pose, state: State, model: Model) -> Int[Array, ""]:
    if model.law.has_points:
        return jnp.int32(0)
    if not has_torsion(model):
        return jnp.int32(1)  # without rotation all corners move alike
    return where(state.mode == Mode.APART, natural_case(q, model.block), state.case)


def guard_values(
    at: Kinematics,
    rate: Rates,
    torques: EndTorques,
    state: State,
    case: Int[Array, ""],
    model: Model,
    events: Events,
) -> Guards:
    """The values, the rates and the integrals of the guards that a model has."""
    apart = interface_mode(state.mode) == Mode.APART
    now = ContactNow(at, rate, torques, state, case, apart, case == FLAT, model)
    guards = [event.guard(now) if event.exists(model) else NO_GUARD for event in events]
    return Guards._make(zip(*guards, strict=True))


NO_GUARD = Guard(ZERO, ZERO)


class Transition(NamedTuple):
    """A transition: the state after the event, and the energy that it adds."""

    after: State
    guards: Guards  # of the mode after it
    energy: Scalar  # jump of the energy in the contact springs [J]
    kind: Int[Array, ""]
    before: State


def transition(
    z: Motion,
    state: State,
    view: GuardEvaluation,
    kind: Int[Array, ""],
    delay: Scalar,
    soon: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None = None,
    events: Events = BUILT_IN_EVENTS,
) -> Transition:
    """The transition of the event of number `kind` at the motion `z`.

    The guard was crossed at most `delay` [s] ago. Faces whose rocking returns within `soon` [s] become flat.
    `rocks`: the faces are known to turn to and fro within the step, so that their next turn leads into flat contact.
    """
    law = model.law
    at = view.at
    case = _next_case(state, view, kind, soon, model, rocks) if touches_at_corners(model) else view.case
    becomes_flat = (case == FLAT) & (state.case != FLAT)
    if touches_at_corners(model):
        z = jax.tree.map(lambda parallel, own: where(becomes_flat, parallel, own), _as_parallel(z, model), z)
    new = contact_kinematics(view.q, case, model.block, model.reading)

    instant = EventInstant(view, state, delay, model)
    mode = next_mode(kind, instant, events)
    w = law.stretch_at(at, state.u_s, state.mode)
    u_s = law.slider_after(instant.crossing, w, mode, new.u)
    after = State(z, u_s, mode, where(interface_mode(mode) == Mode.APART, 0, case).astype(jnp.int32))
    guards = guard_values(new, contact_rates(new, z, case, model.reading), view.torques, after, case, model, events)
    energy = law.energy_at(new, law.stretch_at(new, u_s, mode), mode)
    energy = energy - law.energy_at(at, w, state.mode)
    return Transition(after, guards, energy, kind, state)


def _as_parallel(z: Motion, model: Model) -> Motion:
    """The motion once both blocks turn as one body; the sum of their angular momenta is kept."""
    return z._replace(theta=parallel_mean(z.theta, model), v_theta=parallel_mean(z.v_theta, model))


def _next_case(
    state: State,
    view: GuardEvaluation,
    kind: Int[Array, ""],
    soon: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None,
) -> Int[Array, ""]:
    """The case after the event of number `kind`."""
    now = view.case
    turn = happens(kind, TURN)
    neighbour = where(turn, 5 - now, now + where(tip_is_left(now), 1, -1))
    corner = where(now == FLAT, corner_case(~turn, view.at.height), neighbour)
    case = where(turn | happens(kind, HEIGHT), corner, now)
    touches = happens(kind, LIFT) & (state.mode == Mode.APART)
    level = touches & (view.at.turn == 0) & (view.rate.turn == 0)
    returns = _returns_within(soon, view, model)
    returns = returns if rocks is None else rocks | returns
    return where(level | (turn & (now != FLAT) & returns), FLAT, case)


def _returns_within(time: Scalar, view: GuardEvaluation, model: Model) -> Bool[Array, ""]:
    """Whether theta_1 - theta_2, having crossed zero, is pushed back from both sides and returns twice by then."""
    lower, upper = view.torques
    returns = 2 * jnp.abs(view.rate.turn) * model.mobility.joint * (lower - upper)  # times -lower * upper
    return (lower > 0) & (upper < 0) & (returns < time * -lower * upper)
