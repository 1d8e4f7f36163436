"""The reference integrator: fixed-step Runge-Kutta that stops inside a step at every contact change.

It is written for one lane as one flat loop of trials: each pass makes one trial step of the lane's own length, either
marching to the end of its step or closing in on an event. Under `jax.vmap` every lane then pays for its own trials
only, where a bisection nested in the step would make all lanes wait for the one that is bisecting.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.checks import Precision
from jaxshroud.events import Counters, Crossing, Guards, Kind, View, any_of, count, crossing, first_kind, look, seat
from jaxshroud.friction import contact_energy, stretch
from jaxshroud.implicit import at_the_root
from jaxshroud.lanes import EachLane
from jaxshroud.locate import Locate, Search, fresh, judge, picked, select
from jaxshroud.rhs import Acceleration, Integrals, Model, rhs, stored_energy, wave
from jaxshroud.scene import Motion, Pair, Scalar
from jaxshroud.state import Mode, State, Status
from jaxshroud.tableau import RK4, Tableau
from jaxshroud.trig import ANGLE_RANGE, sincos_turns, sine_versine

STAGES_AT_ONCE = 7  # in one kernel: `lanes.fused` says why there is a limit
STAGES_WITH_EVENTS = 4  # in one kernel with everything else that a trial does
DUAL_STAGES = 4  # in one kernel where tangents come along
LEAST_STEPS = 8  # per period: what the drive's phase gains in a step must stay within ANGLE_RANGE
MAX_EVENTS_PER_STEP = 64  # more is chatter: regular scenes have a few per *period*


class Method(NamedTuple):
    """Static choices of the march."""

    tableau: Tableau = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs
    precision: Precision = "float64"
    derivative: bool = False  # instants of events are differentiable, at the price of one more trial for each

    def __str__(self) -> str:
        return f"{self.tableau.name}, events by {self.locate}, {self.precision}"


REFERENCE = Method()
FAST_WITH_LEDGER = Method(locate="cubic")  # the same errors in less time
FAST = FAST_WITH_LEDGER._replace(ledger=False)  # no energy residual either


class Grid(NamedTuple):
    """Steps of equal length: step i starts at drive phase `start + i / steps` turns."""

    start: Scalar  # drive phase where step 0 starts [turns]
    steps: Scalar  # steps per period; not whole where a run is led to a phase between two steps
    period: Scalar  # [s]


class Log(eqx.Module):
    """What has happened to a lane so far."""

    time_apart: Scalar  # [s]
    time_stick: Scalar  # [s]
    time_slip: Scalar  # [s]
    v_max: Scalar  # largest penetration at the end of a step or at an event [m]
    counters: Counters


class Tally(eqx.Module):
    """What a lane has summed up so far."""

    integrals: Integrals
    jumps: Scalar | None  # energy put into the contact springs by events [J]; None where it is not kept
    log: Log | None  # None where derivatives are computed


class Lane(eqx.Module):
    """All that one lane carries through the flat loop."""

    state: State
    step: Int[Array, ""]  # the clock: integer index of the current step in the period
    search: Search
    guards: Guards  # at the start of the trial
    tally: Tally
    status: Int[Array, ""]


def begin(state: State, model: Model, method: Method) -> Lane:
    """A lane at step 0 whose first act is to check every guard: a start in overlap is an onset at t = 0."""
    zero = jnp.zeros_like(state.motion.x[0])
    count0 = jnp.zeros((), jnp.int32)
    yes = jnp.ones((), bool)
    none = jax.tree.map(jnp.zeros_like, rhs((zero, zero), state.motion, state, model, method.ledger)[1])
    jumps = zero if method.ledger else None
    counters = Counters(*[count0] * len(Counters.__annotations__))
    log = None if method.derivative else Log(zero, zero, zero, zero, counters)
    tally = Tally(none, jumps, log)
    four = (zero, zero, zero, zero)
    guards = Guards(four, four, zero)  # the first trial, of length zero, sets them
    search = fresh(zero, zero, yes, count0, method.locate, method.derivative)
    return Lane(state, count0, search, guards, tally, count0)


class Place(NamedTuple):
    """A trial step of one lane in time."""

    turns: Scalar  # phase of the drive at its start [turns]
    dturns: Scalar  # and what it gains [turns]
    h: Scalar  # its length [s]


def _place(lane: Lane, grid: Grid) -> Place:
    done = lane.step.astype(lane.search.done.dtype) + lane.search.done
    dturns = lane.search.length / grid.steps
    return Place(grid.start + done / grid.steps, dturns, dturns * grid.period)


class Stages(NamedTuple):
    """What the stages of a Runge-Kutta step so far have found."""

    accelerations: tuple[Acceleration, ...]
    gain: Integrals | None  # sum of the integrals' rates times the weights b


NO_STAGES = Stages((), None)


def rk_stages(known: Stages, upto: int, place: Place, held: State, model: Model, method: Method):
    """The stages before number `upto`, and the slopes dz/dt in all of them; the mode stays fixed."""
    tableau, (found, gain) = method.tableau, known
    slopes: list[Motion] = []
    waves = _waves(place, set(tableau.c[len(found) : upto]), model)
    for i in range(upto):
        z = _combined(held.motion, place.h, tableau.a[i][: len(slopes)], slopes)
        if i == len(found):
            acceleration, rates = rhs(waves[tableau.c[i]], z, held, model, method.ledger)
            found = (*found, acceleration)
            gain = _added(gain, tableau.b[i], rates)
        slopes.append(Motion(z.v_x, z.v_y, z.v_theta, *found[i]))
    return Stages(found, gain), slopes


def _added(total: Integrals | None, weight: float, rates: Integrals) -> Integrals | None:
    weighted = jax.tree.map(lambda a: weight * a, rates) if weight else None
    return weighted if total is None else total if weighted is None else jax.tree.map(jnp.add, total, weighted)


class End(NamedTuple):
    """Where a trial step ends."""

    motion: Motion
    Q: Pair  # the drive's wave
    gain: Integrals  # of the step
    slope: tuple[Motion, Pair, Integrals] | None  # d/dt of all three; None where nothing is differentiated


def rk_step(known: Stages, place: Place, held: State, model: Model, method: Method) -> End:
    """One explicit Runge-Kutta step in a fixed mode."""
    b = method.tableau.b
    (_, gain), slopes = rk_stages(known, len(b), place, held, model, method)
    z = _combined(held.motion, place.h, b, slopes)
    Q, slope = _waves(place, {1.0}, model)[1.0], None
    if method.derivative:
        acceleration, rates = rhs(Q, z, held, model, method.ledger)
        slope = Motion(z.v_x, z.v_y, z.v_theta, *acceleration), _wave_rates(place, model), rates
    return End(z, Q, jax.tree.map(lambda a: place.h * a, gain), slope)


def _wave_rates(place: Place, model: Model) -> Pair:
    """d/dt of the drive's wave at the end of the step."""
    ahead = _waves(place._replace(turns=place.turns + 0.25), {1.0}, model)[1.0]
    omega = 2 * math.pi * place.dturns / jnp.where(place.h > 0, place.h, 1.0)
    return omega * ahead[0], omega * ahead[1]


def _waves(place: Place, nodes: set[float], model: Model) -> dict[float, Pair]:
    """The drive at some of the tableau's nodes, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(place.turns)
    waves = {}
    for c in nodes:
        s, v = sine_versine(2 * math.pi * c * place.dturns)
        waves[c] = wave(s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s, model.drive)
    return waves


def _combined(z, h: Scalar, weights, slopes):
    """Z + h sum(weights * slopes), leaf by leaf."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return z
    weights, slopes = zip(*used, strict=True)
    return jax.tree.map(lambda z, *k: z + h * sum(w * k for w, k in zip(weights, k, strict=True)), z, *slopes)


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
    h = grid.period / grid.steps
    guards = look(end.motion, end.Q, lane.state, model).guards
    counts = (search.length > 0) | search.recheck
    violated = tuple((g > 0) & counts for g in guards.value)
    kind = first_kind(violated)
    verdict = judge(search, lane.guards, guards, violated, kind, h, method.locate, method.tableau.order)
    goes, lost = running(lane, stop), ~_finite(end.motion)
    again = jnp.zeros_like(goes)
    if search.met is not None:  # what is differentiated meets an event twice: first to learn how its instant moves
        again = verdict.fire & goes & ~search.met & (search.length > 0)
    return Decision(
        accept=(verdict.accept | lost) & goes & ~again,
        fire=verdict.fire & goes & ~again,
        again=again,
        kind=kind,
        several=_two_of(violated),
        forget=goes & search.bracketing & ~any_of(violated),
        lost=lost,
        late=verdict.late * h,
        search=select(goes & ~again, verdict.search, search),
    )


def _two_of(flags: tuple[Bool[Array, ""], ...]) -> Bool[Array, ""]:
    return any_of(a & any_of(flags[i + 1 :]) for i, a in enumerate(flags[:-1]))


def trial(lane: Lane, end: End, decision: Decision, fixed: Fixed, method: Method) -> Lane:
    """What becomes of a lane whose trial step has come to `end`; nothing if it has arrived or failed."""
    (model, grid, stop), search, held = fixed, lane.search, lane.state
    accept, fire, again, kind = decision.accept, decision.fire, decision.again, decision.kind
    h = _place(lane, grid).h
    z, Q, gain, _ = end
    unaccepted = decision.search._replace(done=search.done)  # which may have a derivative
    if search.met is not None:
        there = _at_the_event(end, lane, kind, fixed)
        z, Q, gain, length = select(fire | again, there, (z, Q, gain, search.length))
        met = unaccepted._replace(length=length, met=jnp.ones_like(again))
        search, unaccepted = search._replace(length=length), select(again, met, unaccepted)
    view = look(z, Q, held, model)

    cross = crossing(z, held, view, kind, decision.late, grid.period / grid.steps, model)
    state = select(fire, cross.after, State(z, held.u_s, held.mode, held.case))
    guards = select(fire, cross.guards, view.guards)
    # where guards may have jumped, or several were violated, one that still is fires in a trial of length zero
    jumped = decision.several | (kind == Kind.TURN) | (kind == Kind.HEIGHT)
    recheck = fire & jumped & any_of(g > 0 for g in guards.value)
    ahead, step = _advanced(search, lane.step, fire, recheck, method)
    tally = _tallied(lane.tally, gain, h, held, view, cross, fire, search.inside)
    status = jnp.where(accept, _status(z, decision.lost, ahead.events), Status.OK).astype(jnp.int32)
    return Lane(
        select(accept, state, held),
        jnp.where(accept, step, lane.step),
        select(accept, ahead, unaccepted),
        select(accept | decision.forget, guards, lane.guards),
        select(accept, tally, lane.tally),
        jnp.where(running(lane, stop), status, lane.status),
    )


def _at_the_event(end: End, lane: Lane, kind: Int[Array, ""], fixed: Fixed):
    """Motion, wave, integrals and length of a trial ending where the guard of `kind` vanishes, with derivatives."""
    assert end.slope is not None
    (model, grid, _), held, length = fixed, lane.state, lane.search.length
    guard = lambda z, Q: picked(look(z, Q, held, model).guards.value, kind)  # noqa: E731
    value, rate = jax.jvp(guard, (end.motion, end.Q), lax.stop_gradient(end.slope[:2]))
    rate = jnp.where((length > 0) & (rate > 0), rate, jnp.inf)  # a trial of length zero has a given instant
    return at_the_root((end.motion, end.Q, end.gain, length), (*end.slope, grid.steps / grid.period), value, rate)


def _tallied(tally: Tally, gain: Integrals, h: Scalar, held: State, view: View, cross: Crossing, fire, inside) -> Tally:
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        None if tally.jumps is None else tally.jumps + jnp.where(fire, cross.energy, 0.0),
        None if tally.log is None else _logged(tally.log, h, held, view, cross, fire, inside),
    )


def _logged(log: Log, h: Scalar, held: State, view: View, cross: Crossing, fire, inside) -> Log:
    apart, stick = held.mode == Mode.APART, held.mode == Mode.STICK
    return Log(
        log.time_apart + jnp.where(apart, h, 0.0),
        log.time_stick + jnp.where(stick, h, 0.0),
        log.time_slip + jnp.where(apart | stick, 0.0, h),
        jnp.maximum(log.v_max, jnp.where(apart, 0.0, view.at.v)),
        count(log.counters, cross, fire, inside),
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
    return jnp.isfinite(sum(jax.tree.leaves(jax.tree.map(jnp.abs, z))))


def _status(z: Motion, lost, events) -> Int[Array, ""]:
    turned = jnp.maximum(jnp.abs(z.theta[0]), jnp.abs(z.theta[1])) > ANGLE_RANGE
    status = jnp.where(events > MAX_EVENTS_PER_STEP, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return jnp.where(lost, Status.NOT_FINITE, status).astype(jnp.int32)


def advance(lanes: Any, fixed: Any, method: Method, each: EachLane) -> Any:
    """One trial step of every lane on its way: of `Lane`s, or of whatever `each` makes of them.

    A short Runge-Kutta method and all that follows is one kernel. The stages of a long one come first, in groups.
    """
    size, known = len(method.tableau.b), NO_STAGES
    at_once = DUAL_STAGES if method.derivative else STAGES_AT_ONCE
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
