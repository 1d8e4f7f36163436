"""Guards that end a contact mode, and what changes when one is crossed.

| transition          | guard that rises through 0          | on crossing                                           |
|---------------------|-------------------------------------|-------------------------------------------------------|
| apart -> contact    | lift = v                            | u_s := u; slip if k_d abs(u') > mu k v', else stick   |
| contact -> apart    | lift = -v                           | forces vanish                                         |
| stick -> slip       | rub = abs(w) - mu k v / k_d         | sigma = sign(w); u_s follows u - sigma mu N / k_d     |
| slip -> stick       | rub = -sigma (u' - sigma mu k v'/k_d) | u_s frozen where it is                              |
| case 1 <-> 4, 2 <-> 3 | turn = theta_1 - theta_2 changes sign | tip, lever, face change; w carried                |
| case 1 <-> 2, 3 <-> 4 | height changes sign               | the same, and v jumps                                 |
"""

from collections.abc import Iterable
from enum import IntEnum
from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.friction import Springs, contact_energy, slider_speed, slip_sign, stretch
from jaxshroud.geometry import (
    Corners,
    Pose,
    Rates,
    Touch,
    is_upper,
    natural_case,
    pose,
    tip_is_left,
    touch,
    touch_rates,
)
from jaxshroud.rhs import Model
from jaxshroud.scene import Motion, Scalar
from jaxshroud.state import Mode, State


class Kind(IntEnum):
    """Which guard was crossed, in order of precedence where several are."""

    LIFT = 0
    TURN = 1
    HEIGHT = 2
    RUB = 3


Four = tuple[Scalar, Scalar, Scalar, Scalar]  # one number per Kind


class Guards(NamedTuple):
    """Guard values of the current mode: negative while the mode may go on."""

    value: Four
    rate: Four  # d(value)/dt; for RUB in slip it is not known and is 0
    slid: Scalar  # an integral of RUB's value in slip (the slider's way), 0 otherwise


class View(NamedTuple):
    """Where the corners are at the end of a trial step."""

    q: Pose
    at: Touch
    rate: Rates
    case: Int[Array, ""]  # the held case, or when apart the one the position would have
    guards: Guards


def look(z: Motion, held: State, model: Model) -> View:
    """Corner positions and guards of the motion `z` in the mode of `held`."""
    q = pose(z.x, z.y, z.theta)
    case = _case_in_view(q, held, model.block)
    at = touch(q, case, model.block, model.reading)
    rate = touch_rates(at, z, case, model.reading)
    return View(q, at, rate, case, guards(at, rate, held, case, model.spring))


def _case_in_view(q: Pose, held: State, block: Corners) -> Int[Array, ""]:
    return jnp.where(held.mode == Mode.APART, natural_case(q, block), held.case)


def guards(at: Touch, rate: Rates, held: State, case: Int[Array, ""], spring: Springs) -> Guards:
    """Values and rates of the four guards."""
    apart, stick = held.mode == Mode.APART, held.mode == Mode.STICK
    lift = jnp.where(apart, 1.0, -1.0)
    turn = jnp.where(is_upper(case), -1.0, 1.0)
    height = jnp.where(is_upper(case) == tip_is_left(case), 1.0, -1.0)

    w = at.u - held.u_s
    sigma = slip_sign(held.mode, at.v.dtype)
    rubs = spring.mu > 0
    # stick may begin at its limit, where a few roundings are no slip
    in_stick = jnp.abs(w) - spring.lag * at.v - 2 * at.rounding, jnp.sign(w) * rate.u - spring.lag * rate.v
    in_slip = -sigma * slider_speed(rate.v, rate.u, held.mode, spring)
    rub = jnp.where(stick, in_stick[0], jnp.where(rubs & ~apart, in_slip, -1.0))

    idle = lambda g: jnp.where(apart, -1.0, g)  # noqa: E731
    still = lambda g: jnp.where(apart, 0.0, g)  # noqa: E731
    return Guards(
        value=(lift * at.v, idle(turn * at.turn), idle(height * at.height), rub),
        rate=(
            lift * rate.v,
            still(turn * rate.turn),
            still(height * rate.height),
            jnp.where(stick, in_stick[1], 0.0),
        ),
        slid=jnp.where(stick | apart | ~rubs, 0.0, -sigma * (at.u - sigma * spring.lag * at.v)),
    )


def any_of(flags: Iterable[Bool[Array, ""]]) -> Bool[Array, ""]:
    """Whether any of the scalars is true."""
    return reduce(jnp.logical_or, flags)


def first_kind(violated: tuple[Bool[Array, ""], ...]) -> Int[Array, ""]:
    """The kind that takes precedence among the violated guards."""
    kind = jnp.asarray(Kind.RUB, jnp.int32)
    for k in (Kind.HEIGHT, Kind.TURN, Kind.LIFT):
        kind = jnp.where(violated[k], jnp.int32(k), kind)
    return kind


class Counters(eqx.Module):
    """How often each event happened."""

    onset_slip: Int[Array, ""]
    onset_stick: Int[Array, ""]
    separation: Int[Array, ""]
    stick_slip: Int[Array, ""]
    slip_stick: Int[Array, ""]
    switch_14: Int[Array, ""]
    switch_23: Int[Array, ""]
    switch_12: Int[Array, ""]
    switch_34: Int[Array, ""]
    grazing: Int[Array, ""]  # onsets that began and ended within one step, found by looking inside it


class Crossing(NamedTuple):
    """What an event does: the state after it, the contact energy it adds, and which one it was."""

    after: State
    guards: Guards  # of the mode after it
    energy: Scalar  # jump of the energy in the contact springs [J]
    kind: Int[Array, ""]
    before: Int[Array, ""]  # mode before


def crossing(z: Motion, held: State, view: View, kind: Int[Array, ""], late: Scalar, model: Model) -> Crossing:
    """The transition of `kind` at motion `z`, where the guard was crossed at most `late` seconds ago."""
    spring, at = model.spring, view.at
    switch = (kind == Kind.TURN) | (kind == Kind.HEIGHT)
    neighbour = jnp.where(kind == Kind.TURN, 5 - view.case, view.case + jnp.where(tip_is_left(view.case), 1, -1))
    case = jnp.where(switch, neighbour, view.case)
    new = touch(view.q, case, model.block, model.reading)

    mode = jnp.where(
        kind == Kind.LIFT,
        jnp.where(held.mode == Mode.APART, _onset_mode(view, spring), jnp.int32(Mode.APART)),
        jnp.where(kind == Kind.RUB, _rub_mode(at, held), held.mode),
    )
    w = stretch(at.v, at.u, held.u_s, held.mode, spring)
    u_s = jnp.where(held.mode == Mode.APART, _touch_down(view, late), new.u - w)
    after = State(z, u_s, mode, jnp.where(mode == Mode.APART, 0, case).astype(jnp.int32))
    ahead = guards(new, touch_rates(new, z, case, model.reading), after, case, spring)
    energy = contact_energy(new.v, stretch(new.v, new.u, u_s, mode, spring), mode, spring)
    return Crossing(after, ahead, energy - contact_energy(at.v, w, held.mode, spring), kind, held.mode)


def _onset_mode(view: View, spring: Springs) -> Int[Array, ""]:
    rate = view.rate
    slips = (jnp.abs(rate.u) > spring.lag * rate.v) | (spring.mu == 0)
    sliding = jnp.where(rate.u < 0, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return jnp.where(slips, sliding, jnp.int32(Mode.STICK))


def _rub_mode(at: Touch, held: State) -> Int[Array, ""]:
    sliding = jnp.where(at.u < held.u_s, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))
    return jnp.where(held.mode == Mode.STICK, sliding, jnp.int32(Mode.STICK))


def _touch_down(view: View, late: Scalar) -> Scalar:
    """U at the instant v = 0, extrapolated back from the located time by the remaining penetration."""
    v, rate = view.at.v, view.rate
    closing = rate.v > 0
    return view.at.u - rate.u * jnp.where(closing, jnp.minimum(v / jnp.where(closing, rate.v, 1.0), late), 0.0)


def count(counters: Counters, crossing: Crossing, fired: Bool[Array, ""], inside: Bool[Array, ""]) -> Counters:
    """`counters` with this crossing added where it `fired`; `inside`: found between two free step ends."""
    kind, mode, before = crossing.kind, crossing.after.mode, crossing.before
    onset = (kind == Kind.LIFT) & (before == Mode.APART)
    rub = kind == Kind.RUB
    turn, height = kind == Kind.TURN, kind == Kind.HEIGHT
    case = crossing.after.case
    outer = (case == 1) | (case == 4)
    happened = dict(
        onset_slip=onset & (mode != Mode.STICK),
        onset_stick=onset & (mode == Mode.STICK),
        separation=(kind == Kind.LIFT) & (before != Mode.APART),
        stick_slip=rub & (before == Mode.STICK),
        slip_stick=rub & (before != Mode.STICK),
        switch_14=turn & outer,
        switch_23=turn & ~outer,
        switch_12=height & is_upper(case),
        switch_34=height & ~is_upper(case),
        grazing=onset & inside,
    )
    return Counters(**{n: getattr(counters, n) + (h & fired).astype(jnp.int32) for n, h in happened.items()})
