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

**Faces that touch at several points.** Contact begins and ends, sticks and slips, at each of them, by the first and the
last of these guards. Points that touch at an instant are crossed one after another, in trials of length zero, after
each of which all guards of the interface are evaluated again. Contact at a point ends only beyond the rounding of its
penetration, as slip begins only beyond that of its stretch: points that switch together would else switch forever.
"""

from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.event import (
    ContactNow,
    Event,
    Events,
    Guard,
    GuardEvaluation,
    Guards,
    always,
    any_of,
    next_mode,
)
from jaxshroud.model.arithmetic import ZERO, Scalar, where
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.geometry import (
    Kinematics,
    Pose,
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
from jaxshroud.model.rhs import EndTorques
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.point_numbers import MAX_POINTS

FLAT_PART = 1 / 24  # of a step: a rocking motion that returns sooner counts as flat contact in any case


def _guard_of_lift(m: int, now: ContactNow) -> Guard:
    law = now.model.law
    point = law.crossing_at(m, now.crossing)
    apart = point.mode == Mode.APART
    value, rate = law.of_points[m].lift_guard(point.at, point.rate, apart)
    return Guard(where(apart, value, value - point.at.rounding) if law.has_points else value, rate)


def _guard_of_turn(now: ContactNow) -> Guard:
    return now.of_corners[0]


def _guard_of_height(now: ContactNow) -> Guard:
    return now.of_corners[1]


def _guard_of_rub(m: int, now: ContactNow) -> Guard:
    point = now.model.law.crossing_at(m, now.crossing)
    return Guard._make(now.model.law.of_points[m].friction_guard(point.at, point.rate, point.u_s, point.mode))


def _mode_after_lift(m: int, instant: ContactNow) -> Any:
    law = instant.model.law
    point = law.crossing_at(m, instant.crossing)
    onset = law.of_points[m].onset_mode(point)
    return law.with_mode_at(m, instant.state.mode, where(point.mode == Mode.APART, onset, jnp.int32(Mode.APART)))


def _mode_after_friction(m: int, instant: ContactNow) -> Any:
    law = instant.model.law
    mode = law.of_points[m].mode_after_rub(law.crossing_at(m, instant.crossing))
    return law.with_mode_at(m, instant.state.mode, mode)


def _turn_rounding(at: Kinematics) -> Scalar:
    return at.turn_rounding / 4  # one rounding: what is taken for zero later than that drives the rocking of faces


def _jumps_at_onset(model: Model) -> bool:
    return model.law.jumps_at_onset


def _touches(m: int, of_points: bool, model: Model) -> bool:
    return model.law.has_points == of_points and m < len(model.law.of_points)


def _rubs(m: int, of_points: bool, model: Model) -> bool:
    return _touches(m, of_points, model) and model.law.of_points[m].has_stick


def _lift(m: int = 0, place: str = "") -> Event:
    """That contact begins or ends at a corner, or at one of several points."""
    return Event(
        name=f"lift{place}",
        label=f"contact{place}",
        guard=partial(_guard_of_lift, m),
        transition=partial(_mode_after_lift, m),
        exists=partial(_touches, m, bool(place)),
        forces_jump=_jumps_at_onset,
        counters=("onset_slip", "separation", "grazing"),
    )


def _rub(m: int = 0, place: str = "") -> Event:
    """That contact there sticks or slips."""
    return Event(
        name=f"rub{place}",
        label=f"friction{place}",
        guard=partial(_guard_of_rub, m),
        transition=partial(_mode_after_friction, m),
        exists=partial(_rubs, m, bool(place)),
        counters=("onset_stick", "stick_slip", "slip_stick"),
    )


LIFT = _lift()
RUB = _rub()
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
EVENTS = (LIFT, TURN, HEIGHT, RUB)  # of a corner, in order of precedence
LIFT_AT, RUB_AT = ([of(m, f" at point {m}") for m in range(MAX_POINTS)] for of in (_lift, _rub))
BUILT_IN_EVENTS = (*EVENTS, *LIFT_AT, *RUB_AT)


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
    torques: EndTorques,
    state: State,
    model: Model,
    events: Events = BUILT_IN_EVENTS,
) -> GuardEvaluation:
    """The contact kinematics and the guards of placed blocks under the torques at both ends of their overlap."""
    q, case, at = placed
    rate = contact_rates(at, state.motion, case, model.reading)
    now = ContactNow(at, rate, torques, state, case, model)
    guards = [event.guard(now) if event.exists(model) else NO_GUARD for event in events]
    return GuardEvaluation(q, at, rate, case, torques, Guards._make(zip(*guards, strict=True)))


NO_GUARD = Guard(ZERO, ZERO)


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


class Transition(NamedTuple):
    """A transition: the state after the event, and the energy that it adds."""

    after: State  # with the same motion: `as_flat` of a row lets blocks that become flat on each other turn as one
    energy: Scalar  # jump of the energy in the contact springs [J]
    kind: Int[Array, ""]
    before: State


def transition(
    state: State,
    view: GuardEvaluation,
    kind: Int[Array, ""],
    delay: Scalar,
    soon: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None = None,
    events: Events = BUILT_IN_EVENTS,
) -> Transition:
    """The transition of the event of number `kind` in a state.

    The guard was crossed at most `delay` [s] ago. Faces whose rocking returns within `soon` [s] become flat.
    `rocks`: the faces are known to turn to and fro within the step, so that their next turn leads into flat contact.
    """
    law = model.law
    case = _next_case(state, view, kind, soon, model, rocks) if touches_at_corners(model) else view.case
    new = contact_kinematics(view.q, case, model.block, model.reading)
    instant = ContactNow(view.at, view.rate, view.torques, state, view.case, model, delay)
    mode = next_mode(kind, instant, events)
    w = law.stretch_at(view.at, state.u_s, state.mode)
    u_s = law.slider_after(instant.crossing, w, mode, new.u)
    after = State(state.motion, u_s, mode, where(interface_mode(mode) == Mode.APART, 0, case).astype(jnp.int32))
    energy = law.energy_at(new, law.stretch_at(new, u_s, mode), mode) - law.energy_at(view.at, w, state.mode)
    return Transition(after, energy, kind, state)


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
