"""The reference integrator: fixed-step Runge-Kutta that stops inside a step at every contact change.

It is written for one lane as one flat loop of trials: each pass makes one trial step of the lane's own length, either
marching to the end of its step or closing in on an event. Under `jax.vmap` every lane then pays for its own trials
only, where a bisection nested in the step would make all lanes wait for the one that is bisecting.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.absent import ABSENT, Pair, Scalar, where
from jaxshroud.checks import Precision, checked, type_argument, word_argument
from jaxshroud.events import (
    Counters,
    Guards,
    Kind,
    any_of,
    count,
    crossing,
    first_kind,
    is_switch,
    kinds,
    look,
    no_events,
    seat,
)
from jaxshroud.friction import contact_energy, stretch
from jaxshroud.geometry import Touch
from jaxshroud.implicit import at_the_root
from jaxshroud.lanes import EachLane
from jaxshroud.locate import Locate, Search, fresh, judge, picked, select
from jaxshroud.rhs import Integrals, Ledger, Model, Slope, reduced, rhs, stored_energy, turns, wave
from jaxshroud.scene import Motion
from jaxshroud.state import Mode, State, Status
from jaxshroud.tableau import RK4, Tableau
from jaxshroud.trig import ANGLE_RANGE, sincos_turns, sine_versine
from jaxshroud.within import Within, extremes, nothing_yet

STAGES_AT_ONCE = 7  # in one kernel: `lanes.fused` says why there is a limit
STAGES_WITH_EVENTS = 4  # in one kernel with everything else that a trial does
DUAL_STAGES = 4  # in one kernel where tangents come along
SMOOTH = 0.75  # of all these numbers in smooth contact, whose laws are longer: beyond, RK8 is 60 times slower
MAX_EVENTS_PER_STEP = 64  # more is chatter: regular scenes have a few per *period*


@checked
class Method(NamedTuple):
    """Static choices of the march; ValueError for a word that is not known."""

    tableau: Tableau = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs
    precision: Precision = "float64"
    derivative: bool = False  # instants of events are differentiable, at the price of one more trial for each
    within: bool = False  # log what happens between the ends of steps too

    def __check_init__(self):
        type_argument("tableau", self.tableau, Tableau, 'tableau("dopri8")')
        word_argument("locate", self.locate, Locate)
        word_argument("precision", self.precision, Precision)
        type_argument("ledger", self.ledger, bool, "True")
        type_argument("derivative", self.derivative, bool, "True")

    def __str__(self) -> str:
        return f"{self.tableau.name}, events by {self.locate}, {self.precision}"


REFERENCE = Method()
FAST_WITH_LEDGER = Method(locate="cubic")  # the same errors in less time
FAST = FAST_WITH_LEDGER._replace(ledger=False)  # no energy residual either


Lanes = Float[Array, "..."]  # one number for each lane, or one lane's


class Grid(NamedTuple):
    """Steps of equal length: step i starts at drive phase `start + i * turn` turns."""

    start: Scalar  # drive phase where step 0 starts [turns]
    turn: Scalar  # what the drive's phase gains in a step [turns]
    h: Scalar  # length of a step [s]


def grid(start: Lanes, steps: Lanes, period: Lanes) -> Grid:
    """Steps of which `steps` make a drive period of `period` seconds; not whole on the way to a phase in between."""
    return Grid(start, 1 / steps, period / steps)


class Log(eqx.Module):
    """What has happened to a lane so far."""

    time_apart: Scalar  # [s]
    time_stick: Scalar  # [s]
    time_slip: Scalar  # [s]
    v_max: Scalar  # largest penetration at the end of a step or at an event [m]
    largest: tuple[Pair, Pair, Pair]  # magnitudes of x, y [m] and theta [rad] at ends of steps and at events
    counters: Counters
    within: Within | None  # None where nobody asked for it


class Jumps(NamedTuple):
    """Energies that change at events."""

    springs: Scalar  # put into the contact springs [J]
    dropped: Scalar  # of the rocking that flat contact ended [J]; absent where blocks do not turn


class Tally(eqx.Module):
    """What a lane has summed up so far."""

    integrals: Integrals
    jumps: Jumps | None  # None where they are not kept
    log: Log | None  # None where derivatives are computed


class Lane(eqx.Module):
    """All that one lane carries through the flat loop."""

    state: State
    step: Int[Array, ""]  # the clock: integer index of the current step in the period
    search: Search
    guards: Guards | None  # at the start of the trial; None where there are no events
    tally: Tally
    status: Int[Array, ""]


def begin(state: State, model: Model, method: Method) -> Lane:
    """A lane at step 0 whose first act is to check every guard: a start in overlap is an onset at t = 0."""
    zero = jnp.zeros_like(state.motion.x[0])
    count0 = jnp.zeros((), jnp.int32)
    yes = jnp.ones((), bool)
    state = reduced(state, model)
    none = jax.tree.map(jnp.zeros_like, rhs((zero, zero), state, model, method.ledger)[1])
    jumps = Jumps(zero, zero if turns(model) else ABSENT) if method.ledger else None
    within = nothing_yet(zero) if method.within else None
    largest = jax.tree.map(jnp.zeros_like, _displacements(state.motion))
    log = None if method.derivative else Log(zero, zero, zero, zero, largest, no_events(model), within)
    tally = Tally(none, jumps, log)
    guards = look(state.motion, (zero, zero), state, model).guards if model.spring.modal else None
    guards = jax.tree.map(jnp.zeros_like, guards)  # the first trial, of length zero, sets them
    search = fresh(zero, zero, yes, count0, method.locate, method.derivative)
    return Lane(state, count0, search, guards, tally, count0)


class Place(NamedTuple):
    """A trial step of one lane in time."""

    turns: Scalar  # phase of the drive at its start [turns]
    dturns: Scalar  # and what it gains [turns]
    h: Scalar  # its length [s]


def _place(lane: Lane, grid: Grid) -> Place:
    done = lane.step.astype(lane.search.done.dtype) + lane.search.done
    length = lane.search.length
    return Place(grid.start + done * grid.turn, length * grid.turn, length * grid.h)


class Stages(NamedTuple):
    """What the stages of a Runge-Kutta step so far have found."""

    slopes: tuple[Slope, ...]
    gain: Integrals | None  # sum of the integrals' rates times the weights b


NO_STAGES = Stages((), None)


def rk_stages(known: Stages, upto: int, place: Place, held: State, model: Model, method: Method):
    """The stages before number `upto`, and the slopes dz/dt in all of them; the mode stays fixed."""
    tableau, (found, gain) = method.tableau, known
    slopes: list[State] = []
    waves = _waves(place, set(tableau.c[len(found) : upto]), model)
    for i in range(upto):
        now = _combined(held, place.h, tableau.a[i][: len(slopes)], slopes, model)
        if i == len(found):
            slope, rates = rhs(waves[tableau.c[i]], now, model, method.ledger)
            found = (*found, slope)
            gain = _added(gain, tableau.b[i], rates)
        slopes.append(_rates(now, found[i]))
    return Stages(found, gain), slopes


def _rates(now: State, slope: Slope) -> State:
    """d/dt of a state's numbers."""
    z = now.motion
    return State(Motion(z.v_x, z.v_y, z.v_theta, *slope.acceleration), slope.u_s, None, None)


def _added(total: Integrals | None, weight: float, rates: Integrals) -> Integrals | None:
    weighted = jax.tree.map(lambda a: weight * a, rates) if weight else None
    return weighted if total is None else total if weighted is None else jax.tree.map(jnp.add, total, weighted)


class End(NamedTuple):
    """Where a trial step ends."""

    state: State  # in the mode and case of the step
    Q: Pair  # the drive's wave
    gain: Integrals  # of the step
    slope: tuple[State, Pair, Integrals] | None  # d/dt of all three; None where nothing is differentiated


def rk_step(known: Stages, place: Place, held: State, model: Model, method: Method) -> End:
    """One explicit Runge-Kutta step in a fixed mode."""
    b = method.tableau.b
    (_, gain), slopes = rk_stages(known, len(b), place, held, model, method)
    now = _combined(held, place.h, b, slopes, model)
    Q, slope = _waves(place, {1.0}, model)[1.0], None
    if method.derivative:
        rates, of_integrals = rhs(Q, now, model, method.ledger)
        slope = _rates(now, rates), _wave_rates(place, model), of_integrals
    return End(now, Q, jax.tree.map(lambda a: place.h * a, gain), slope)


def _wave_rates(place: Place, model: Model) -> Pair:
    """d/dt of the drive's wave at the end of the step."""
    ahead = _waves(place._replace(turns=place.turns + 0.25), {1.0}, model)[1.0]
    omega = 2 * math.pi * place.dturns / jnp.where(place.h > 0, place.h, 1.0)
    return omega * ahead[0], omega * ahead[1]


def _waves(place: Place, nodes: set[float], model: Model) -> dict[float, Pair]:
    """The drive at some of the tableau's nodes, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(place.turns)
    waves = {}
    for c, (s, v) in _angles(place.dturns, nodes).items():
        now = (s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s) if c else (s_0, c_0)
        waves[c] = wave(*now, model.drive)
    return waves


def _angles(dturns: Scalar, nodes: set[float]) -> dict[float, Pair]:
    """Sine and versine of what the drive's phase gains up to the nodes, by that of half the angle where it is known."""
    known: dict[float, Pair] = {}
    for c in sorted(nodes):
        if c / 2 in known and c:
            s, v = known[c / 2]
            known[c] = 2 * (s - s * v), 2 * s * s
        else:
            known[c] = sine_versine(2 * math.pi * c * dturns)
    return known


def _combined(held: State, h: Scalar, weights, slopes: Any, model: Model) -> State:
    """The held state + h sum(weights * slopes), number by number."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return held
    weights, slopes = zip(*used, strict=True)
    add = lambda z, *k: z + h * sum(w * k for w, k in zip(weights, k, strict=True))  # noqa: E731
    motion = jax.tree.map(add, held.motion, *(k.motion for k in slopes))
    u_s = jax.tree.map(add, held.u_s, *(k.u_s for k in slopes)) if model.spring.smooth else held.u_s
    return State(motion, u_s, held.mode, held.case)


class Fixed(NamedTuple):
    """What stays the same for a lane during a march."""

    model: Model
    grid: Grid
    stop: Int[Array, "..."]  # the step at whose start it ends


def running(lane: Lane, stop: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Whether a lane has not arrived at the start of step `stop` and has not failed."""
    return (lane.step < stop) & (lane.status == Status.OK)


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


def decide(lane: Lane, end: End, fixed: Fixed, method: Method) -> Decision:
    """Judge a trial step that has come to `end`. Nothing here has a derivative."""
    lane, end, fixed = lax.stop_gradient((lane, end, fixed))
    (model, grid, stop), search = fixed, lane.search
    goes, lost, h = running(lane, stop), ~_finite(end.state.motion), grid.h
    if not model.spring.modal:
        no = jnp.zeros_like(goes)
        return Decision(goes, no, no, jnp.int32(Kind.LIFT), no, no, lost, jnp.zeros_like(h), search)
    assert lane.guards is not None
    _, at, _, _, _, guards = look(end.state.motion, end.Q, lane.state, model)
    counts = (search.length > 0) | search.recheck
    violated = {kind: (guards.value[kind] > 0) & counts for kind in kinds(guards.value)}
    kind = first_kind(violated)
    jumps = is_switch(kind, lane.state, model)
    rounding = where(kind == Kind.TURN, at.turn_rounding, at.rounding)
    exact = jumps & (picked(guards.value, kind) <= rounding)
    verdict = judge(search, lane.guards, guards, violated, jumps, exact, h, method.locate, method.tableau.order)
    again = jnp.zeros_like(goes)
    if search.met is not None:  # what is differentiated meets an event twice: first to learn how its instant moves
        again = verdict.fire & goes & ~search.met & (search.length > 0)
    return Decision(
        accept=(verdict.accept | lost) & goes & ~again,
        fire=verdict.fire & goes & ~again,
        again=again,
        kind=kind,
        several=_two_of(tuple(violated.values())),
        forget=goes & search.bracketing & ~any_of(violated.values()),
        lost=lost,
        late=verdict.late * h,
        search=select(goes & ~again, verdict.search, search),
    )


def _two_of(flags: tuple[Bool[Array, ""], ...]) -> Bool[Array, ""]:
    none = jnp.zeros_like(flags[0])
    return any_of([none, *(a & any_of(flags[i + 1 :]) for i, a in enumerate(flags[:-1]))])


def trial(lane: Lane, end: End, decision: Decision, fixed: Fixed, method: Method) -> Lane:
    """What becomes of a lane whose trial step has come to `end`; nothing if it has arrived or failed."""
    (model, grid, stop), search, held = fixed, lane.search, lane.state
    accept, fire, again, kind = decision.accept, decision.fire, decision.again, decision.kind
    h = _place(lane, grid).h
    if not model.spring.modal:
        return _glided(lane, end, decision, fixed, method)
    state, Q, gain, _ = end
    unaccepted = decision.search._replace(done=search.done)  # which may have a derivative
    if search.met is not None:
        there = _at_the_event(end, lane, kind, fixed)
        state, Q, gain, length = select(fire | again, there, (state, Q, gain, search.length))
        met = unaccepted._replace(length=length, met=jnp.ones_like(again))
        search, unaccepted = search._replace(length=length), select(again, met, unaccepted)
    z = state.motion
    view = look(z, Q, held, model)

    cross = crossing(z, held, view, kind, decision.late, grid.h, model)
    state = select(fire, cross.after, state)
    guards = select(fire, cross.guards, view.guards)
    # where guards may have jumped, or several were violated, one that still is fires in a trial of length zero
    jumped = decision.several | (kind == Kind.TURN) | (kind == Kind.HEIGHT)
    recheck = fire & jumped & any_of(guards.value[kind] > 0 for kind in kinds(guards.value))
    ahead, step = _advanced(search, lane.step, fire, recheck, method)
    onset = fire & (kind == Kind.LIFT) & (held.mode == Mode.APART)
    noted = Noted(
        lambda counters: count(counters, cross, fire, search.inside),
        lambda before: extremes(before, held, z, h, held.mode == Mode.APART, onset, model),
    )
    jumps = jax.tree.map(lambda a: jnp.where(fire, a, 0.0), Jumps(cross.energy, cross.dropped))
    tally = _tallied(lane.tally, gain, jumps, h, held.mode, z, view.at, noted)
    status = jnp.where(accept, _status(z, decision.lost, ahead.events), Status.OK).astype(jnp.int32)
    return Lane(
        select(accept, state, held),
        jnp.where(accept, step, lane.step),
        select(accept, ahead, unaccepted),
        select(accept | decision.forget, guards, lane.guards),
        select(accept, tally, lane.tally),
        jnp.where(running(lane, stop), status, lane.status),
    )


def _glided(lane: Lane, end: End, decision: Decision, fixed: Fixed, method: Method) -> Lane:
    """`trial` without events."""
    (model, grid, stop), accept = fixed, decision.accept
    at = seat(end.state.motion, lane.state, model)[2]
    ahead, step = _advanced(lane.search, lane.step, jnp.zeros_like(accept), jnp.zeros_like(accept), method)
    mode, h = jnp.where(at.v < 0, jnp.int32(Mode.APART), jnp.int32(Mode.SLIP_PLUS)), _place(lane, grid).h
    no, still = jnp.zeros_like(accept), jax.tree.map(jnp.zeros_like, lane.tally.jumps)
    z = end.state.motion
    noted = Noted(lambda counters: counters, lambda before: extremes(before, lane.state, z, h, no, no, model))
    tally = _tallied(lane.tally, end.gain, still, h, mode, z, at, noted)
    status = jnp.where(accept, _status(end.state.motion, decision.lost, ahead.events), Status.OK).astype(jnp.int32)
    before = (lane.state, lane.step, lane.search, lane.tally)
    state, step, search, tally = select(accept, (end.state, step, ahead, tally), before)
    return Lane(state, step, search, None, tally, jnp.where(running(lane, stop), status, lane.status))


def _at_the_event(end: End, lane: Lane, kind: Int[Array, ""], fixed: Fixed):
    """Motion, wave, integrals and length of a trial ending where the guard of `kind` vanishes, with derivatives."""
    assert end.slope is not None
    (model, grid, _), held, length = fixed, lane.state, lane.search.length
    guard = lambda z, Q: picked(look(z, Q, held, model).guards.value, kind)  # noqa: E731
    slope, Q_rate, _ = lax.stop_gradient(end.slope)
    value, rate = jax.jvp(guard, (end.state.motion, end.Q), (slope.motion, Q_rate))
    rate = jnp.where((length > 0) & (rate > 0), rate, jnp.inf)  # a trial of length zero has a given instant
    z, Q, gain, length = at_the_root(
        (end.state.motion, end.Q, end.gain, length),
        (end.slope[0].motion, *end.slope[1:], 1 / grid.h),
        value,
        rate,
    )
    return State(z, held.u_s, held.mode, held.case), Q, gain, length


class Noted(NamedTuple):
    """What a log notes of a trial beside its length."""

    counts: Callable[[Counters], Counters]
    within: Callable[[Within], Within]


def _displacements(z: Motion) -> tuple[Pair, Pair, Pair]:
    return z.x, z.y, z.theta


def _tallied(
    tally: Tally, gain: Integrals, jumps: Jumps | None, h: Scalar, mode, z: Motion, at: Touch, noted: Noted
) -> Tally:
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        None if tally.jumps is None else jax.tree.map(jnp.add, tally.jumps, jumps),
        None if tally.log is None else _logged(tally.log, h, mode, z, at, noted),
    )


def _logged(log: Log, h: Scalar, mode, z: Motion, at: Touch, noted: Noted) -> Log:
    apart, stick = mode == Mode.APART, mode == Mode.STICK
    return Log(
        log.time_apart + jnp.where(apart, h, 0.0),
        log.time_stick + jnp.where(stick, h, 0.0),
        log.time_slip + jnp.where(apart | stick, 0.0, h),
        jnp.maximum(log.v_max, jnp.where(apart, 0.0, at.v)),
        jax.tree.map(lambda most, now: jnp.maximum(most, jnp.abs(now)), log.largest, _displacements(z)),
        noted.counts(log.counters),
        None if log.within is None else noted.within(log.within),
    )


def _advanced(search: Search, step, fire, again, method: Method) -> tuple[Search, Int[Array, ""]]:
    """The search of the next trial and the clock, after an accepted trial."""
    done = search.done + search.length
    sliver = 1e-12 if done.dtype == jnp.float64 else 1e-6
    over = done >= 1 - sliver
    done = jnp.where(over, 0.0, done)
    events = jnp.where(over, 0, search.events + fire.astype(jnp.int32))
    ahead = fresh(done, jnp.where(again, 0.0, 1 - done), again, events, method.locate, method.derivative)
    # a trial that only peeked leaves the guard at its peak: march on without peeking again
    return ahead._replace(peeking=search.peeking & ~fire & ~over), step + over.astype(jnp.int32)


def _finite(z: Motion) -> Bool[Array, ""]:
    return jnp.isfinite(sum(jax.tree.leaves(z)))  # no sum of numbers one of which is not finite is


def _status(z: Motion, lost, events) -> Int[Array, ""]:
    turned = any_of([lost, *(jnp.abs(theta) > ANGLE_RANGE for theta in jax.tree.leaves(z.theta))])
    status = jnp.where(events > MAX_EVENTS_PER_STEP, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return jnp.where(lost, Status.NOT_FINITE, status).astype(jnp.int32)


def advance(lanes: Any, fixed: Any, method: Method, each: EachLane) -> Any:
    """One trial step of every lane on its way: of `Lane`s, or of whatever `each` makes of them.

    A short Runge-Kutta method and all that follows is one kernel. The stages of a long one come first, in groups.
    """
    size, known = len(method.tableau.b), NO_STAGES
    at_once = DUAL_STAGES if method.derivative else STAGES_AT_ONCE
    if getattr(fixed, "value", fixed).model.spring.smooth:
        at_once = int(at_once * SMOOTH)
    if size <= STAGES_WITH_EVENTS and not method.derivative:
        return each(lambda lane, fixed: _whole(lane, fixed, method), lanes, fixed)
    for upto in range(at_once, size, at_once):
        known = each(lambda lane, known, fixed, upto=upto: _some(lane, known, upto, fixed, method), lanes, known, fixed)
    end = each(lambda lane, known, fixed: _step(lane, known, fixed, method), lanes, known, fixed)
    if not method.derivative:
        return each(lambda lane, end, fixed: _judged(lane, end, fixed, method), lanes, end, fixed)
    decision = each(lambda lane, end, fixed: decide(lane, end, fixed, method), lanes, end, fixed)
    return each(lambda lane, end, what, fixed: trial(lane, end, what, fixed, method), lanes, end, decision, fixed)


def _whole(lane: Lane, fixed: Fixed, method: Method) -> Lane:
    return _judged(lane, _step(lane, NO_STAGES, fixed, method), fixed, method)


def _judged(lane: Lane, end: End, fixed: Fixed, method: Method) -> Lane:
    return trial(lane, end, decide(lane, end, fixed, method), fixed, method)


def _some(lane: Lane, known: Stages, upto: int, fixed: Fixed, method: Method) -> Stages:
    model, grid, _ = fixed
    return rk_stages(known, upto, _place(lane, grid), lane.state, model, method)[0]


def _step(lane: Lane, known: Stages, fixed: Fixed, method: Method) -> End:
    model, grid, _ = fixed
    return rk_step(known, _place(lane, grid), lane.state, model, method)


def march(
    lanes: Lane,
    models: Model,
    grids: Grid,
    stops: Int[Array, " lanes"],
    method: Method,
    each: EachLane,
    most_trials: int | None = None,
) -> Lane:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK.

    With `most_trials` it ends after so many trials anyway: a loop of known length can be differentiated in reverse.
    """
    fixed = Fixed(models, grids, stops)
    once = jax.jit(lambda lanes: advance(lanes, fixed, method, each))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    # two by two: the first writes to memory of its own, the second back where the lanes came from, and none is copied
    return lax.while_loop(lambda lanes: jnp.any(running(lanes, stops)), lambda lanes: once(once(lanes)), lanes)


def energy(state: State, model: Model) -> Scalar:
    """Kinetic energy, blades' springs and contact springs [J]."""
    at = seat(state.motion, state, model)[2]
    w = stretch(at.v, at.u, state.u_s, state.mode, model.spring)
    return stored_energy(state.motion, model) + contact_energy(at.v, w, state.mode, model.spring)


def balance(ledger: Ledger, jumps: Jumps, stored: Lanes) -> Lanes:
    """What the energy balance misses [J]: works and jumps less the change of the `stored` energy."""
    return ledger.drive + jumps.springs - jumps.dropped - ledger.viscous - ledger.friction - stored
