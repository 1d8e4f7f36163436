"""What becomes of a trial step: accepted, cut short by an event, or repeated."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.events import (
    Counters,
    Crossing,
    Kind,
    View,
    any_of,
    count,
    crossing,
    first_kind,
    is_switch,
    kinds,
    look,
    seat,
)
from jaxshroud.march.implicit import at_the_root
from jaxshroud.march.lane import Fixed, Jumps, Lane, Log, Tally, displacements_of, running
from jaxshroud.march.locate import Search, fresh, judge, picked, select
from jaxshroud.march.method import Choices
from jaxshroud.march.peaks import Peaks, peaks
from jaxshroud.march.step import End, place_of
from jaxshroud.march.within import Within, extremes
from jaxshroud.model.absent import ABSENT, Pair, Scalar, is_absent, where
from jaxshroud.model.friction import Slider
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.state import State
from jaxshroud.model.trig import ANGLE_RANGE
from jaxshroud.scene.motion import Motion

# Where a derivative is wanted: the instant moves with the solution's slope, the step's being another by the method's
# error, whose power after so many meetings is left. After two it was up to 6e-6 between nearly parallel faces.
MEETINGS = 3
MAX_EVENTS_PER_STEP = 64  # more is chatter: regular scenes have a few per *period*


class Decision(NamedTuple):
    """What a trial step has come to."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept and change mode
    again: Bool[Array, ""]  # an event was found, but it must be met once more for its derivative
    kind: Int[Array, ""]  # of the event
    several: Bool[Array, ""]  # guards were violated at once
    forget: Bool[Array, ""]  # the trial's end is the new lower end of the bracket
    lost: Bool[Array, ""]
    late: Scalar  # the event is at most so long ago [s]
    search: Search  # if the trial is not accepted


def decide(lane: Lane, end: End, fixed: Fixed, method: Choices) -> Decision:
    """Judge a trial step that has come to `end`. Nothing here has a derivative."""
    lane, end, fixed = lax.stop_gradient((lane, end, fixed))
    (model, grid, stop), search = fixed, lane.search
    goes, lost, h = running(lane, stop), ~finite(end.state.motion), grid.h
    if not model.spring.modal:
        no = jnp.zeros_like(goes)
        return Decision(goes, no, no, jnp.int32(Kind.LIFT), no, no, lost, jnp.zeros_like(h), search)
    assert lane.guards is not None
    _, at, _, _, _, guards = look(end.state.motion, end.Q, _there(lane.state, end.state), model)
    counts = (search.length > 0) | search.recheck
    violated = {kind: (guards.value[kind] > 0) & counts for kind in kinds(guards.value)}
    kind = first_kind(violated)
    jumps = is_switch(kind, lane.state, model)
    rounding = where(kind == Kind.TURN, at.turn_rounding, at.rounding)
    several = _two_of(tuple(violated.values()))
    exact = jumps & ~several & (picked(guards.value, kind) <= rounding)
    verdict = judge(search, lane.guards, guards, violated, jumps, exact, h, method.locate, method.rk.order)
    again = jnp.zeros_like(goes)
    if search.met is not None:  # what is differentiated meets an event again to learn how its instant moves
        again = verdict.fire & goes & (search.met < MEETINGS - 1) & (search.length > 0)
    return Decision(
        accept=(verdict.accept | lost) & goes & ~again,
        fire=verdict.fire & goes & ~again,
        again=again,
        kind=kind,
        several=several,
        forget=goes & search.bracketing & ~any_of(violated.values()),
        lost=lost,
        late=verdict.late * h,
        search=select(goes & ~again, verdict.search, search),
    )


def _two_of(flags: tuple[Bool[Array, ""], ...]) -> Bool[Array, ""]:
    none = jnp.zeros_like(flags[0])
    return any_of([none, *(a & any_of(flags[i + 1 :]) for i, a in enumerate(flags[:-1]))])


def trial(lane: Lane, end: End, decision: Decision, fixed: Fixed, method: Choices) -> Lane:
    """What becomes of a lane whose trial step has come to `end`; nothing if it has arrived or failed."""
    (model, grid, stop), search, held = fixed, lane.search, lane.state
    accept, fire, again, kind = decision.accept, decision.fire, decision.again, decision.kind
    h = place_of(lane, grid).h
    if not model.spring.modal:
        return _glided(lane, end, decision, fixed, method)
    state, Q, gain, _ = end
    unaccepted = decision.search._replace(done=search.done)  # which may have a derivative
    if search.met is not None:
        there = _at_the_event(end, lane, kind, fixed)
        state, Q, gain, length = select(fire | again, there, (state, Q, gain, search.length))
        met = unaccepted._replace(length=length, met=search.met + 1)
        search, unaccepted = search._replace(length=length), select(again, met, unaccepted)
    z = state.motion
    view, cross, onset, jumps = change(z, Q, _there(held, state), fire, kind, decision.late, fixed)
    state = select(fire, cross.after, state)
    guards = select(fire, cross.guards, view.guards)
    # where guards may have jumped, or several were violated, one that still is fires in a trial of length zero
    jumped = decision.several | (kind == Kind.TURN) | (kind == Kind.HEIGHT) | (cross.after.case == FLAT)
    recheck = fire & jumped & any_of(guards.value[kind] > 0 for kind in kinds(guards.value))
    ahead, step = _advanced(search, lane.step, fire, recheck, method)
    noted = Noted(
        lambda counters: count(counters, cross, fire, search.inside),
        lambda before: extremes(before, held, z, h, held.mode == Mode.APART, onset, model),
        lambda before: peaks(before, held, z, h, model),
    )
    tally = tallied(lane.tally, gain, jumps, h, held.mode, view.at.v, displacements_of(z), noted)
    status = jnp.where(accept, status_of(z, decision.lost, ahead.events), Status.OK).astype(jnp.int32)
    return Lane(
        select(accept, state, held),
        jnp.where(accept, step, lane.step),
        select(accept, ahead, unaccepted),
        select(accept | decision.forget, guards, lane.guards),
        select(accept, tally, lane.tally),
        jnp.where(running(lane, stop), status, lane.status),
    )


def _there(held: State, end: State) -> State:
    """The held state with the slider, or what takes its place, as it is at the trial's end."""
    return State(held.motion, end.u_s, held.mode, held.case)


class Change(NamedTuple):
    """What an event does where it happens."""

    view: View
    cross: Crossing
    onset: Bool[Array, ""]
    jumps: Jumps  # 0 where there is none


def change(
    z: Motion, Q: Pair, held: State, fire: Bool[Array, ""], kind: Int[Array, ""], late: Scalar, fixed: Fixed
) -> Change:
    """What becomes of a lane that has come to the motion `z`, where an event of `kind` happens if there is a `fire`."""
    view = look(z, Q, held, fixed.model)
    cross = crossing(z, held, view, kind, late, fixed.grid.h, fixed.model)
    onset = fire & (kind == Kind.LIFT) & (held.mode == Mode.APART)
    jumps = jax.tree.map(lambda a: jnp.where(fire, a, 0.0), Jumps(cross.energy, cross.dropped))
    return Change(view, cross, onset, jumps)


def _glided(lane: Lane, end: End, decision: Decision, fixed: Fixed, method: Choices) -> Lane:
    """`trial` without events."""
    (model, grid, stop), accept = fixed, decision.accept
    at = seat(end.state.motion, lane.state, model)[2]
    ahead, step = _advanced(lane.search, lane.step, jnp.zeros_like(accept), jnp.zeros_like(accept), method)
    mode, h = jnp.where(at.v < 0, jnp.int32(Mode.APART), jnp.int32(Mode.SLIP_PLUS)), place_of(lane, grid).h
    no, still = jnp.zeros_like(accept), jax.tree.map(jnp.zeros_like, lane.tally.jumps)
    z = end.state.motion
    noted = Noted(
        lambda counters: counters,
        lambda before: extremes(before, lane.state, z, h, no, no, model),
        lambda before: peaks(before, lane.state, z, h, model),
    )
    tally = tallied(lane.tally, end.gain, still, h, mode, at.v, displacements_of(z), noted)
    status = jnp.where(accept, status_of(end.state.motion, decision.lost, ahead.events), Status.OK).astype(jnp.int32)
    before = (lane.state, lane.step, lane.search, lane.tally)
    state, step, search, tally = select(accept, (end.state, step, ahead, tally), before)
    return Lane(state, step, search, None, tally, jnp.where(running(lane, stop), status, lane.status))


def _at_the_event(end: End, lane: Lane, kind: Int[Array, ""], fixed: Fixed):
    """Motion, wave, integrals and length of a trial ending where the guard of `kind` vanishes, with derivatives."""
    assert end.slope is not None
    (model, grid, _), held, length = fixed, lane.state, lane.search.length
    flowing = lambda state: state.u_s if model.spring.flows else ABSENT  # noqa: E731

    def guard(z: Motion, Q: Pair, u_s: Slider) -> Scalar:
        at = _there(held, end.state) if is_absent(u_s) else State(held.motion, u_s, held.mode, held.case)
        return picked(look(z, Q, at, model).guards.value, kind)

    slope, Q_rate, _ = lax.stop_gradient(end.slope)
    at_end, rates = (end.state.motion, end.Q, flowing(end.state)), (slope.motion, Q_rate, flowing(slope))
    value, rate = jax.jvp(guard, at_end, rates)
    rate = jnp.where((length > 0) & (rate > 0), rate, jnp.inf)  # a trial of length zero has a given instant
    z, Q, gain, length, u_s = at_the_root(
        (end.state.motion, end.Q, end.gain, length, flowing(end.state)),
        (end.slope[0].motion, *end.slope[1:], 1 / grid.h, flowing(end.slope[0])),
        value,
        rate,
    )
    return State(z, u_s if model.spring.flows else held.u_s, held.mode, held.case), Q, gain, length


class Noted(NamedTuple):
    """What a log notes of a trial beside its length."""

    counts: Callable[[Counters], Counters]
    within: Callable[[Within], Within]
    forces: Callable[[Peaks], Peaks]


Sizes = tuple[Pair, Pair, Pair]  # of x, y and theta


def tallied(
    tally: Tally, gain: Integrals, jumps: Jumps | None, h: Scalar, mode, v: Scalar, sizes: Sizes, noted: Noted
) -> Tally:
    """A tally after `h` seconds in a `mode`, with the penetration `v` and displacements of such `sizes` in them."""
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        None if tally.jumps is None else jax.tree.map(jnp.add, tally.jumps, jumps),
        None if tally.log is None else _logged(tally.log, h, mode, v, sizes, noted),
    )


def _logged(log: Log, h: Scalar, mode, v: Scalar, sizes: Sizes, noted: Noted) -> Log:
    apart, stick = mode == Mode.APART, mode == Mode.STICK
    return Log(
        log.time_apart + jnp.where(apart, h, 0.0),
        log.time_stick + jnp.where(stick, h, 0.0),
        log.time_slip + jnp.where(apart | stick, 0.0, h),
        jnp.maximum(log.v_max, jnp.where(apart, 0.0, v)),
        jax.tree.map(lambda most, now: jnp.maximum(most, jnp.abs(now)), log.largest, sizes),
        noted.counts(log.counters),
        None if log.within is None else noted.within(log.within),
        None if log.forces is None else noted.forces(log.forces),
    )


def _advanced(search: Search, step, fire, again, method: Choices) -> tuple[Search, Int[Array, ""]]:
    """The search of the next trial and the clock, after an accepted trial."""
    done = search.done + search.length
    sliver = 1e-12 if done.dtype == jnp.float64 else 1e-6
    over = done >= 1 - sliver
    done = jnp.where(over, 0.0, done)
    events = jnp.where(over, 0, search.events + fire.astype(jnp.int32))
    ahead = fresh(done, jnp.where(again, 0.0, 1 - done), again, events, method.locate, method.derivative)
    # a trial that only peeked leaves the guard at its peak: march on without peeking again
    return ahead._replace(peeking=search.peeking & ~fire & ~over), step + over.astype(jnp.int32)


def finite(z: Motion) -> Bool[Array, ""]:
    """Whether all numbers are."""
    return jnp.isfinite(sum(jax.tree.leaves(z)))  # no sum of numbers one of which is not finite is


def status_of(z: Motion, lost: Bool[Array, ""], events: Int[Array, ""]) -> Int[Array, ""]:
    """How a lane fares at the motion `z`, `lost` if that is not finite, after so many `events` in a step."""
    turned = any_of([lost, *(jnp.abs(theta) > ANGLE_RANGE for theta in jax.tree.leaves(z.theta))])
    status = jnp.where(events > MAX_EVENTS_PER_STEP, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return jnp.where(lost, Status.NOT_FINITE, status).astype(jnp.int32)
