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

from jaxshroud.model.arithmetic import ABSENT, Pair, Scalar, is_absent, where
from jaxshroud.model.contact_law import ContactLaw, GuardCrossing
from jaxshroud.model.geometry import (
    Case,
    ContactKinematics,
    ContactRates,
    Pose,
    contact_kinematics,
    contact_rates,
    corner_case,
    is_upper,
    natural_case,
    pose,
    tip_is_left,
)
from jaxshroud.model.interface import EndTorques
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import end_torques, parallel_mean, stored_energy
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
    if not model.law.has_events:
        return []
    corners = [EventKind.TURN, EventKind.HEIGHT] if has_torsion(model) else []
    return [EventKind.LIFT, *corners, *([EventKind.RUB] if model.law.has_stick else [])]


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
def evaluate_guards(z: Motion, Q: Pair, state: State, model: Model) -> GuardEvaluation:
    """The contact kinematics and the guards of the motion `z` in the mode of `state`; `Q` is the drive's wave."""
    placed = place_contact(z, state, model)
    return guards_at(placed, z, end_torques(z, Q, placed[2], state, model), state, model)


def guards_at(
    placed: tuple[Pose, Any, ContactKinematics], z: Motion, torques: EndTorques, state: State, model: Model
) -> GuardEvaluation:
    """`evaluate_guards` of placed blocks under known torques."""
    q, case, at = placed
    rate = contact_rates(at, z, case, model.reading)
    return GuardEvaluation(q, at, rate, case, torques, guard_values(at, rate, torques, state, case, model.law))


def place_contact(z: Motion, state: State, model: Model) -> tuple[Pose, Any, ContactKinematics]:
    """The pose, the case and the contact kinematics of the motion `z` in the mode of `state`."""
    q = pose(z.x, z.y, z.theta)
    blend = model.law.case_blend(q, model.block) if has_torsion(model) else None
    case = _case_at_pose(q, state, model) if blend is None else blend
    return q, case, contact_kinematics(q, case, model.block, model.reading)


def _case_at_pose(q: Pose, state: State, model: Model) -> Int[Array, ""]:
    if not has_torsion(model):
        return jnp.int32(1)  # without rotation all corners move alike
    return where(state.mode == Mode.APART, natural_case(q, model.block), state.case)


def guard_values(
    at: ContactKinematics, rate: ContactRates, torques: EndTorques, state: State, case: Int[Array, ""], law: ContactLaw
) -> Guards:
    """The values and the rates of the four guards."""
    apart, flat = state.mode == Mode.APART, case == FLAT
    values, rates = ([a] for a in law.lift_guard(at, rate, apart))
    if is_absent(at.turn):
        values, rates = [*values, ABSENT, ABSENT], [*rates, ABSENT, ABSENT]
    else:
        idle = lambda g: where(apart, -1.0, g)
        still = lambda g: where(apart | flat, 0.0, g)
        values += map(idle, switch_guards(at, torques, case))
        turn, height = switch_signs(case)
        rates += [still(turn * rate.turn), still(height * rate.height)]
    rub, rub_rate, slip_path = law.friction_guard(at, rate, state.u_s, state.mode)
    return Guards((*values, rub), (*rates, rub_rate), slip_path)  # pyright: ignore[reportArgumentType]


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
    """Whether the forces jump at an event of `kind`: at a loaded case switch, or at any onset of some laws."""
    jumps = jnp.zeros_like(kind, bool)
    if has_torsion(model):
        jumps = ((kind == EventKind.TURN) | (kind == EventKind.HEIGHT)) & (state.case != FLAT)
    return jumps | (kind == EventKind.LIFT) if model.law.jumps_at_onset else jumps


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
    law, at, unprojected = model.law, view.at, z
    crossing = GuardCrossing(at, view.rate, state.u_s, state.mode, delay)
    case = _next_case(state, view, kind, h, model, rocks) if has_torsion(model) else view.case
    becomes_flat = (case == FLAT) & (state.case != FLAT)
    if has_torsion(model):
        z = jax.tree.map(lambda parallel, own: where(becomes_flat, parallel, own), _as_parallel(z, model), z)
    new = contact_kinematics(view.q, case, model.block, model.reading)

    mode = where(
        kind == EventKind.LIFT,
        where(state.mode == Mode.APART, law.onset_mode(crossing), jnp.int32(Mode.APART)),
        where(kind == EventKind.RUB, law.mode_after_rub(crossing), state.mode),
    )
    w = law.stretch(at.v, at.u, state.u_s, state.mode)
    u_s = law.slider_after(crossing, w, mode, new.u)
    after = State(z, u_s, mode, where(mode == Mode.APART, 0, case).astype(jnp.int32))
    guards = guard_values(new, contact_rates(new, z, case, model.reading), view.torques, after, case, law)
    energy = law.stored_energy(new.v, law.stretch(new.v, new.u, u_s, mode), mode)
    energy = energy - law.stored_energy(at.v, w, state.mode)
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
