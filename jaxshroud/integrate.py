"""The reference integrator: fixed-step Runge-Kutta that stops inside a step at every contact change.

It is written for one lane as one flat loop of trials: each pass makes one trial step of the lane's own length, either
marching to the end of its step or closing in on an event. Under `jax.vmap` every lane then pays for its own trials
only, where a bisection nested in the step would make all lanes wait for the one that is bisecting.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.events import Counters, Crossing, Guards, Kind, View, any_of, count, crossing, first_kind, look
from jaxshroud.friction import contact_energy, stretch
from jaxshroud.lanes import EachLane
from jaxshroud.locate import Locate, Search, fresh, judge, select
from jaxshroud.rhs import Integrals, Model, rhs, stored_energy, wave
from jaxshroud.scene import Motion, Pair, Scalar
from jaxshroud.state import Mode, State, Status
from jaxshroud.tableau import RK4, Tableau
from jaxshroud.trig import ANGLE_RANGE, sincos_turns, sine_versine

MAX_EVENTS_PER_STEP = 64  # more is chatter: regular scenes have a few per *period*


class Method(NamedTuple):
    """Static choices of the march."""

    tableau: Tableau = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs


REFERENCE = Method()


class Grid(NamedTuple):
    """Steps of equal length: step i starts at drive phase `start + i / steps` turns."""

    start: Scalar  # drive phase where step 0 starts [turns]
    steps: Scalar  # steps per period; not whole where a run is led to a phase between two steps
    period: Scalar  # [s]


class Tally(eqx.Module):
    """What a lane has summed up so far."""

    integrals: Integrals
    jumps: Scalar | None  # energy put into the contact springs by events [J]; None where it is not kept
    time_apart: Scalar  # [s]
    time_stick: Scalar  # [s]
    time_slip: Scalar  # [s]
    v_max: Scalar  # largest penetration at the end of a step or at an event [m]
    counters: Counters


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
    tally = Tally(none, jumps, zero, zero, zero, zero, Counters(*[count0] * 10))
    four = (zero, zero, zero, zero)
    guards = Guards(four, four, zero)  # the first trial, of length zero, sets them
    return Lane(state, count0, fresh(zero, zero, yes, count0, method.locate), guards, tally, count0)


def rk_step(
    turns: Scalar, dturns: Scalar, h: Scalar, held: State, model: Model, method: Method
) -> tuple[Motion, Integrals]:
    """One explicit Runge-Kutta step in a fixed mode: the new motion and what the integrals gain.

    `h` is its length [s], `turns` the drive's phase at its start and `dturns` what it gains [turns].
    """
    tableau, z, slopes, gains = method.tableau, held.motion, [], []
    waves = _waves(turns, dturns, tableau, model)
    for a, c in zip(tableau.a, tableau.c, strict=True):
        stage = _combined(z, h, a, slopes) if a else z
        slope, gain = rhs(waves[c], stage, held, model, method.ledger)
        slopes.append(slope)
        gains.append(gain)
    none = jax.tree.map(jnp.zeros_like, gains[0])
    return _combined(z, h, tableau.b, slopes), _combined(none, h, tableau.b, gains)


def _waves(turns: Scalar, dturns: Scalar, tableau: Tableau, model: Model) -> dict[float, Pair]:
    """The drive at each of the tableau's nodes, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(turns)
    waves = {}
    for c in set(tableau.c):
        s, v = sine_versine(2 * math.pi * c * dturns)
        waves[c] = wave(s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s, model.drive)
    return waves


def _combined(z, h: Scalar, weights: tuple[float, ...], slopes: list):
    """Z + h sum(weights * slopes), leaf by leaf."""
    return jax.tree.map(lambda z, *k: z + h * sum(w * k for w, k in zip(weights, k, strict=True) if w), z, *slopes)


def trial(lane: Lane, model: Model, grid: Grid, method: Method) -> Lane:
    """One trial step of a lane: the body of the flat loop."""
    search, held = lane.search, lane.state
    turns = grid.start + (lane.step.astype(search.done.dtype) + search.done) / grid.steps
    h_full = grid.period / grid.steps
    h = search.length * h_full
    z, gain = rk_step(turns, search.length / grid.steps, h, held, model, method)
    view = look(z, held, model)

    counts = (search.length > 0) | search.recheck
    violated = tuple((g > 0) & counts for g in view.guards.value)
    kind = first_kind(violated)
    verdict = judge(search, lane.guards, view.guards, violated, kind, h_full, method.locate)
    fire, lost = verdict.fire, ~_finite(z)
    accept = verdict.accept | lost

    cross = crossing(z, held, view, kind, verdict.late * h_full, model)
    state = select(fire, cross.after, State(z, held.u_s, held.mode, held.case))
    guards = select(fire, cross.guards, view.guards)
    # where guards may have jumped, or several were violated, one that still is fires in a trial of length zero
    several = sum(g.astype(jnp.int32) for g in violated) > 1
    jumped = several | (kind == Kind.TURN) | (kind == Kind.HEIGHT)
    again = fire & jumped & any_of(g > 0 for g in guards.value)
    ahead, step = _advanced(search, lane.step, fire, again, method.locate)
    tally = _tallied(lane.tally, gain, h, held, view, cross, fire, search.inside)
    status = jnp.where(accept, _status(z, lost, ahead.events), Status.OK).astype(jnp.int32)
    return Lane(
        select(accept, state, held),
        jnp.where(accept, step, lane.step),
        select(accept, ahead, verdict.search),
        select(accept | (search.bracketing & ~any_of(violated)), guards, lane.guards),
        select(accept, tally, lane.tally),
        jnp.where(lane.status == Status.OK, status, lane.status),
    )


def _tallied(tally: Tally, gain: Integrals, h: Scalar, held: State, view: View, cross: Crossing, fire, inside) -> Tally:
    apart, stick = held.mode == Mode.APART, held.mode == Mode.STICK
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        None if tally.jumps is None else tally.jumps + jnp.where(fire, cross.energy, 0.0),
        tally.time_apart + jnp.where(apart, h, 0.0),
        tally.time_stick + jnp.where(stick, h, 0.0),
        tally.time_slip + jnp.where(apart | stick, 0.0, h),
        jnp.maximum(tally.v_max, jnp.where(apart, 0.0, view.at.v)),
        count(tally.counters, cross, fire, inside),
    )


def _advanced(search: Search, step, fire, again, locate: Locate) -> tuple[Search, Int[Array, ""]]:
    """The search of the next trial and the clock, after an accepted trial."""
    done = search.done + search.length
    sliver = 1e-12 if done.dtype == jnp.float64 else 1e-6
    over = done >= 1 - sliver
    done = jnp.where(over, 0.0, done)
    events = jnp.where(over, 0, search.events + fire.astype(jnp.int32))
    ahead = fresh(done, jnp.where(again, 0.0, 1 - done), again, events, locate)
    # a trial that only peeked leaves the guard at its peak: march on without peeking again
    return ahead._replace(peeking=search.peeking & ~fire), step + over.astype(jnp.int32)


def _finite(z: Motion) -> Bool[Array, ""]:
    return jnp.isfinite(sum(jax.tree.leaves(jax.tree.map(jnp.abs, z))))


def _status(z: Motion, lost, events) -> Int[Array, ""]:
    turned = jnp.maximum(jnp.abs(z.theta[0]), jnp.abs(z.theta[1])) > ANGLE_RANGE
    status = jnp.where(events > MAX_EVENTS_PER_STEP, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return jnp.where(lost, Status.NOT_FINITE, status).astype(jnp.int32)


def advance(lane: Lane, fixed: tuple[Model, Grid, Int[Array, ""]], method: Method) -> Lane:
    """One trial step of a lane on its way to the start of step `stop`; nothing if it has arrived or failed."""
    model, grid, stop = fixed
    return select(running(lane, stop), trial(lane, model, grid, method), lane)


def running(lane: Lane, stop: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Whether a lane has not arrived at the start of step `stop` and has not failed."""
    return (lane.step < stop) & (lane.status == Status.OK)


def march(lanes: Lane, models: Model, grids: Grid, stops: Int[Array, " lanes"], method: Method, each: EachLane) -> Lane:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK."""
    fixed = (models, grids, stops)
    once = lambda lanes: each(lambda lane, fixed: advance(lane, fixed, method), lanes, fixed)  # noqa: E731
    return lax.while_loop(lambda lanes: jnp.any(running(lanes, stops)), lambda lanes: once(once(lanes)), lanes)


def energy(state: State, model: Model) -> Scalar:
    """Kinetic energy, blades' springs and contact springs [J]."""
    at = look(state.motion, state, model).at
    w = stretch(at.v, at.u, state.u_s, state.mode, model.spring)
    return stored_energy(state.motion, model) + contact_energy(at.v, w, state.mode, model.spring)
