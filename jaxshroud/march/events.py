"""Guards that end a contact mode, and what changes when one is crossed.

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

**Flat contact.** Contact at the upper corners turns the blocks one way against each other, at the lower ones the other
way: under load g = theta_1 - theta_2 is a relay oscillator, whose crossings come ever sooner as it is damped, and at
once where it starts at rest. A crossing that predicts two returns, 2 abs(g') / abs(g'') on either side, within
`FLAT_RETURN` of a step therefore leads into flat contact, and what is left of the rocking is dropped: an error of at
most `FLAT_RETURN` / 2 of a step times g'' in the rates of theta, and a loss of energy that the ledger names; with a
finer step the rocking itself is followed.

Flat contact ends where the torque at one end of the overlap no longer pushes back. There g, g' and g'' all vanish:
the faces part as the third power of the time, and until g has left its rounding its sign says nothing. A turn of the
blocks therefore counts only beyond that rounding.
"""

from collections.abc import Iterable
from enum import IntEnum
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.absent import ABSENT, Absent, Pair, Scalar, is_absent, where
from jaxshroud.model.friction import Springs, contact_energy, slider_speed, slip_sign, stretch
from jaxshroud.model.geometry import (
    Case,
    Pose,
    Rates,
    Touch,
    blend,
    corner_case,
    is_upper,
    natural_case,
    pose,
    tip_is_left,
    touch,
    touch_rates,
)
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.ready import Model, turns
from jaxshroud.model.rhs import Lean, as_one, lean, stored_energy
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion

FLAT_RETURN = 1 / 24  # of a step: a rocking that comes and goes quicker than this counts as flat contact


class Kind(IntEnum):
    """Which guard was crossed, in order of precedence where several are."""

    LIFT = 0
    TURN = 1
    HEIGHT = 2
    RUB = 3


Four = tuple[Scalar, Scalar, Scalar, Scalar]  # one number per Kind


def kinds(four: Four) -> list[Kind]:
    """The kinds of events that a model has."""
    return [kind for kind in Kind if not is_absent(four[kind])]


class Guards(NamedTuple):
    """Guard values of the current mode: negative while the mode may go on. Absent where the model lacks the event."""

    value: Four
    rate: Four  # d(value)/dt; not known and 0 for RUB in slip, TURN and HEIGHT in flat contact
    slid: Scalar  # an integral of RUB's value in slip (the slider's way), 0 otherwise


Violated = dict[Kind, Bool[Array, ""]]  # of the kinds that a model has


class View(NamedTuple):
    """Where the corners are at the end of a trial step."""

    q: Pose
    at: Touch
    rate: Rates
    case: Int[Array, ""]  # the held case, or when apart the one the position would have
    lean: Lean
    guards: Guards


@partial(jax.jit, inline=True)
def look(z: Motion, Q: Pair, held: State, model: Model) -> View:
    """Corner positions and guards of the motion `z` in the mode of `held`, with `Q` the drive's wave."""
    q, case, at = seat(z, held, model)
    rate = touch_rates(at, z, case, model.reading)
    leans = lean(z, Q, at, held, model)
    return View(q, at, rate, case, leans, guards(at, rate, leans, held, case, model.spring))


def seat(z: Motion, held: State, model: Model) -> tuple[Pose, Any, Touch]:
    """Pose, case and corner positions of the motion `z` in the mode of `held`."""
    q = pose(z.x, z.y, z.theta)
    smooth = model.spring.smooth and turns(model)
    case = blend(q, model.block, model.spring.width) if smooth else _case_in_view(q, held, model)
    return q, case, touch(q, case, model.block, model.reading)


def _case_in_view(q: Pose, held: State, model: Model) -> Int[Array, ""]:
    if not turns(model):
        return jnp.int32(1)  # without rotation all corners move alike
    return jnp.where(held.mode == Mode.APART, natural_case(q, model.block), held.case)


def guards(at: Touch, rate: Rates, leans: Lean, held: State, case: Int[Array, ""], spring: Springs) -> Guards:
    """Values and rates of the four guards."""
    apart, flat = held.mode == Mode.APART, case == FLAT
    value, along = ([a] for a in _lift(at, rate, apart, spring))
    if is_absent(at.turn):
        value, along = [*value, ABSENT, ABSENT], [*along, ABSENT, ABSENT]
    else:
        idle = lambda g: jnp.where(apart, -1.0, g)  # noqa: E731
        still = lambda g: jnp.where(apart | flat, 0.0, g)  # noqa: E731
        value += map(idle, switches(at, leans, case))
        turn, height = senses(case)
        along += [still(turn * rate.turn), still(height * rate.height)]
    rub, rub_rate, slid = _rub(at, rate, held, spring)
    return Guards((*value, rub), (*along, rub_rate), slid)  # pyright: ignore[reportArgumentType]


def _lift(at: Touch, rate: Rates, apart: Bool[Array, ""], spring: Springs) -> tuple[Scalar, Scalar]:
    """Value and rate of the guard LIFT: v, or -v in contact; by own laws contact also wants them to push."""
    lift = jnp.where(apart, 1.0, -1.0)
    if is_absent(spring.laws):
        return lift * at.v, lift * rate.v
    pushed = spring.laws.push(jnp.maximum(at.v, 0.0), rate.v) / spring.k  # a length, as v is
    sense = jnp.where((at.v > 0) & (pushed <= 0), -1.0, 1.0)  # apart although the corners overlap
    in_contact = -jnp.minimum(at.v, pushed), jnp.where(pushed < at.v, 0.0, -rate.v)
    return jnp.where(apart, sense * at.v, in_contact[0]), jnp.where(apart, sense * rate.v, in_contact[1])


def senses(case: Case) -> tuple[Scalar, Scalar]:
    """The signs with which theta_1 - theta_2 and the height leave a case."""
    return jnp.where(is_upper(case), -1.0, 1.0), jnp.where(is_upper(case) == tip_is_left(case), 1.0, -1.0)


def switches(at: Touch, leans: Lean, case: Case) -> tuple[Scalar, Scalar]:
    """Values of the guards TURN and HEIGHT in contact."""
    (turn, height), flat = senses(case), case == FLAT
    return (
        where(flat, -leans.lower, turn * at.turn - at.turn_rounding),
        where(flat, leans.upper, height * at.height),
    )


def _rub(at: Touch, rate: Rates, held: State, spring: Springs) -> tuple[Scalar, Scalar, Scalar]:
    """Value, rate and integral of the guard of the friction element."""
    if is_absent(spring.lag):
        return ABSENT, ABSENT, ABSENT
    apart, stick = held.mode == Mode.APART, held.mode == Mode.STICK
    w = at.u - held.u_s
    sigma = slip_sign(held.mode, at.v.dtype)
    rubs = spring.mu > 0
    # stick may begin at its limit, where a few roundings are no slip
    in_stick = jnp.abs(w) - spring.lag * at.v - 2 * at.rounding, jnp.sign(w) * rate.u - spring.lag * rate.v
    in_slip = -sigma * slider_speed(rate.v, rate.u, held.mode, spring)
    return (
        jnp.where(stick, in_stick[0], jnp.where(rubs & ~apart, in_slip, -1.0)),
        jnp.where(stick, in_stick[1], 0.0),
        jnp.where(stick | apart | ~rubs, 0.0, -sigma * (at.u - sigma * spring.lag * at.v)),
    )


def any_of(flags: Iterable[Bool[Array, ""]]) -> Bool[Array, ""]:
    """Whether any of the scalars is true."""
    return reduce(jnp.logical_or, flags)


def first_kind(violated: Violated) -> Int[Array, ""]:
    """The kind that takes precedence among the violated guards."""
    *others, last = violated
    kind = jnp.asarray(last, jnp.int32)
    for k in reversed(others):
        kind = jnp.where(violated[k], jnp.int32(k), kind)
    return kind


def is_switch(kind: Int[Array, ""], held: State, model: Model) -> Bool[Array, ""]:
    """Whether an event of `kind` is one at which forces jump: a loaded case switch, or any touch of own laws."""
    jumps = jnp.zeros_like(kind, bool)
    if turns(model):
        jumps = ((kind == Kind.TURN) | (kind == Kind.HEIGHT)) & (held.case != FLAT)
    return jumps if is_absent(model.spring.laws) else jumps | (kind == Kind.LIFT)


Count = Int[Array, ""] | Absent


class Counters(eqx.Module):
    """How often each event happened; absent where the model lacks it."""

    onset_slip: Count
    onset_stick: Count
    separation: Count
    stick_slip: Count
    slip_stick: Count
    switch_14: Count
    switch_23: Count
    switch_12: Count
    switch_34: Count
    flat: Count  # beginnings of face-to-face contact ...
    flat_corner: Count  # ... and its ends at a corner
    grazing: Count  # onsets that began and ended within one step, found by looking inside it


class Crossing(NamedTuple):
    """What an event does: the state after it, the energies it adds and drops, and which one it was."""

    after: State
    guards: Guards  # of the mode after it
    energy: Scalar  # jump of the energy in the contact springs [J]
    dropped: Scalar  # energy of the rocking that flat contact ends [J]; absent where blocks do not turn
    kind: Int[Array, ""]
    before: State


def crossing(
    z: Motion, held: State, view: View, kind: Int[Array, ""], late: Scalar, h: Scalar, model: Model
) -> Crossing:
    """The transition of `kind` at motion `z`, where the guard was crossed at most `late` seconds ago in a step `h`."""
    spring, at, came = model.spring, view.at, z
    case = _next_case(held, view, kind, h, model) if turns(model) else view.case
    begins = (case == FLAT) & (held.case != FLAT)
    if turns(model):
        z = jax.tree.map(lambda one, own: jnp.where(begins, one, own), _parallel(z, model), z)
    new = touch(view.q, case, model.block, model.reading)

    mode = jnp.where(
        kind == Kind.LIFT,
        jnp.where(held.mode == Mode.APART, _onset_mode(view, late, spring), jnp.int32(Mode.APART)),
        jnp.where(kind == Kind.RUB, _rub_mode(at, held, spring), held.mode),
    )
    w = stretch(at.v, at.u, held.u_s, held.mode, spring)
    u_s = ABSENT
    if not is_absent(spring.laws) and not is_absent(held.u_s):
        lasts = (held.mode != Mode.APART) & (mode != Mode.APART)
        u_s = jnp.where(lasts, held.u_s, spring.laws.z)
    elif not is_absent(held.u_s):
        u_s = jnp.where(held.mode == Mode.APART, _touch_down(view, late), new.u - w)
    after = State(z, u_s, mode, jnp.where(mode == Mode.APART, 0, case).astype(jnp.int32))
    ahead = guards(new, touch_rates(new, z, case, model.reading), view.lean, after, case, spring)
    energy = contact_energy(new.v, stretch(new.v, new.u, u_s, mode, spring), mode, spring)
    energy = energy - contact_energy(at.v, w, held.mode, spring)
    dropped = ABSENT
    if turns(model):
        dropped = jnp.where(begins, stored_energy(came, model) - stored_energy(z, model), 0.0)
    return Crossing(after, ahead, energy, dropped, kind, held)


def _parallel(z: Motion, model: Model) -> Motion:
    """The motion once both blocks turn as one; the sum of their angular momenta stays."""
    return z._replace(theta=as_one(z.theta, model), v_theta=as_one(z.v_theta, model))


def _next_case(held: State, view: View, kind: Int[Array, ""], h: Scalar, model: Model) -> Int[Array, ""]:
    """The case after an event of `kind`."""
    now, turn = view.case, kind == Kind.TURN
    neighbour = jnp.where(turn, 5 - now, now + jnp.where(tip_is_left(now), 1, -1))
    corner = jnp.where(now == FLAT, corner_case(~turn, view.at.height), neighbour)
    case = jnp.where(turn | (kind == Kind.HEIGHT), corner, now)
    touches = (kind == Kind.LIFT) & (held.mode == Mode.APART)
    level = touches & (view.at.turn == 0) & (view.rate.turn == 0)
    return jnp.where(level | (turn & (now != FLAT) & _soon_back(view, h, model)), FLAT, case)


def _soon_back(view: View, h: Scalar, model: Model) -> Bool[Array, ""]:
    """Whether theta_1 - theta_2, having crossed zero, is pushed back from both sides and returns twice before long."""
    lower, upper = view.lean
    returns = 2 * jnp.abs(view.rate.turn) * model.mobility.joint * (lower - upper)  # times -lower * upper
    return (lower > 0) & (upper < 0) & (returns < FLAT_RETURN * h * -lower * upper)


def _onset_mode(view: View, late: Scalar, spring: Springs) -> Int[Array, ""]:
    """Stick or slip as contact begins: by the rates where v = 0, stick in a start in overlap.

    There the element is unstretched under a normal force: k_d abs(w) = 0 is less than mu N whatever the rates.
    """
    rate = view.rate
    if is_absent(spring.lag):
        return jnp.int32(Mode.SLIP_PLUS)
    in_overlap = (late == 0) & (view.at.v > view.at.rounding)
    slips = ((jnp.abs(rate.u) > spring.lag * rate.v) & ~in_overlap) | (spring.mu == 0)
    sliding = jnp.where(rate.u < 0, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return jnp.where(slips, sliding, jnp.int32(Mode.STICK))


def _rub_mode(at: Touch, held: State, spring: Springs) -> Int[Array, ""]:
    if is_absent(spring.lag):
        return held.mode
    sliding = jnp.where(at.u < held.u_s, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return jnp.where(held.mode == Mode.STICK, sliding, jnp.int32(Mode.STICK))


def _touch_down(view: View, late: Scalar) -> Scalar:
    """U at the instant v = 0, extrapolated back from the located time by the remaining penetration."""
    v, rate = view.at.v, view.rate
    closing = rate.v > 0
    return view.at.u - rate.u * jnp.where(closing, jnp.minimum(v / jnp.where(closing, rate.v, 1.0), late), 0.0)


def count(counters: Counters, crossing: Crossing, fired: Bool[Array, ""], inside: Bool[Array, ""]) -> Counters:
    """`counters` with this crossing added where it `fired`; `inside`: found between two free step ends."""
    kind, mode, before = crossing.kind, crossing.after.mode, crossing.before.mode
    onset = (kind == Kind.LIFT) & (before == Mode.APART)
    rub = kind == Kind.RUB
    turn, height = kind == Kind.TURN, kind == Kind.HEIGHT
    case, old = crossing.after.case, crossing.before.case
    begins, ends = (case == FLAT) & (old != FLAT), (old == FLAT) & (turn | height)
    outer, corners = (case == 1) | (case == 4), ~begins & ~ends
    happened = dict(
        onset_slip=onset & (mode != Mode.STICK),
        onset_stick=onset & (mode == Mode.STICK),
        separation=(kind == Kind.LIFT) & (before != Mode.APART),
        stick_slip=rub & (before == Mode.STICK),
        slip_stick=rub & (before != Mode.STICK),
        switch_14=turn & corners & outer,
        switch_23=turn & corners & ~outer,
        switch_12=height & corners & is_upper(case),
        switch_34=height & corners & ~is_upper(case),
        flat=begins,
        flat_corner=ends,
        grazing=onset & inside,
    )
    counts = ((name, getattr(counters, name), now) for name, now in happened.items())
    return Counters(**{name: n + (now & fired).astype(jnp.int32) if not is_absent(n) else n for name, n, now in counts})


def no_events(model: Model) -> Counters:
    """Counters at zero, of the events that a model has."""
    corners = ("switch_14", "switch_23", "switch_12", "switch_34", "flat", "flat_corner")
    if not model.spring.modal:
        return Counters(*[ABSENT] * len(Counters.__annotations__))
    lacks = set() if turns(model) else set(corners)
    lacks |= {"onset_stick", "stick_slip", "slip_stick"} if is_absent(model.spring.lag) else set()
    zero = jnp.zeros((), jnp.int32)
    return Counters(**{name: ABSENT if name in lacks else zero for name in Counters.__annotations__})
