"""The reference integrator: fixed-step Runge-Kutta that stops inside a step at every contact change.

It is written for one lane as one flat loop of trials: each pass makes one trial step of the lane's own length, either
marching to the end of its step or closing in on an event. Under `jax.vmap` every lane then pays for its own trials
only, where a bisection nested in the step would make all lanes wait for the one that is bisecting.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.events import Counters, Guards, Kind, View, count, crossing, first_kind, look
from jaxshroud.friction import contact_energy, stretch
from jaxshroud.rhs import Integrals, Model, rhs, stored_energy, wave
from jaxshroud.scene import Motion, Scalar
from jaxshroud.seam import Seam
from jaxshroud.state import Mode, State, Status
from jaxshroud.tableau import RK4, Tableau
from jaxshroud.trig import ANGLE_RANGE

MAX_EVENTS_PER_STEP = 64  # more is chatter: regular scenes have a few per *period*


class Method(NamedTuple):
    """Static choices of the march."""

    tableau: Tableau = RK4
    # "bisection": halve the bracket; "none": change mode at the end of the step (first order, for comparison only)
    locate: Literal["bisection", "none"] = "bisection"


REFERENCE = Method()


class Grid(NamedTuple):
    """Steps of equal length: step i starts at drive phase `start + i / steps` turns."""

    start: Scalar  # drive phase where step 0 starts [turns]
    steps: Scalar  # steps per period; not whole where a run is led to a phase between two steps
    period: Scalar  # [s]


class Tally(eqx.Module):
    """What a lane has summed up so far."""

    integrals: Integrals
    jumps: Scalar  # energy put into the contact springs by events [J]
    time_apart: Scalar  # [s]
    time_stick: Scalar  # [s]
    time_slip: Scalar  # [s]
    v_max: Scalar  # largest penetration at the end of a step or at an event [m]
    counters: Counters


class Search(NamedTuple):
    """Where a lane is inside its current step; lengths are fractions of a step."""

    done: Scalar  # accepted so far
    length: Scalar  # of the next trial
    low: Scalar  # bracket of the event, lengths from `done`
    high: Scalar
    bracketing: Bool[Array, ""]
    peeking: Bool[Array, ""]  # the next trial ends where a guard seems to peak
    inside: Bool[Array, ""]  # the bracket was found by peeking
    recheck: Bool[Array, ""]  # guards may have jumped: a violated one counts even in a trial of length zero
    events: Int[Array, ""]  # in this step


class Lane(eqx.Module):
    """All that one lane carries through the flat loop."""

    state: State
    step: Int[Array, ""]  # the clock: integer index of the current step in the period
    search: Search
    guards: Guards  # at the start of the trial
    tally: Tally
    status: Int[Array, ""]


NO_SEAM = Seam()


def begin(state: State, model: Model) -> Lane:
    """A lane at step 0 whose first act is to check every guard: a start in overlap is an onset at t = 0."""
    z = state.motion
    zero = jnp.zeros_like(z.x[0])
    count0 = jnp.zeros((), jnp.int32)
    no = jnp.zeros((), bool)
    tally = Tally(Integrals((zero, zero), zero, zero, zero), zero, zero, zero, zero, zero, Counters(*[count0] * 10))
    guards = Guards(
        (zero, zero, zero, zero), (zero, zero, zero, zero), zero
    )  # the first trial, of length zero, sets them
    return Lane(state, count0, _fresh(zero, zero, ~no, count0), guards, tally, count0)


def _fresh(done: Scalar, length: Scalar, recheck: Bool[Array, ""], events: Int[Array, ""]) -> Search:
    zero, no = jnp.zeros_like(done), jnp.zeros((), bool)
    return Search(done, length, zero, zero, no, no, no, recheck, events)


def rk_step(
    turns: Callable[[float], Scalar], h: Scalar, held: State, model: Model, method: Tableau, seam: Seam
) -> tuple[Motion, Integrals]:
    """One explicit Runge-Kutta step of length `h` [s] in a fixed mode: the new motion and what the integrals gain."""
    waves = {c: seam(wave, turns(c), model.drive) for c in set(method.c)}
    z, slopes, gains = held.motion, [], []
    for a, c in zip(method.a, method.c, strict=True):
        stage = seam(_combined, z, h, a, slopes) if a else z
        slope, gain = rhs(waves[c], stage, held, model, seam)
        slopes.append(slope)
        gains.append(gain)
    none = jax.tree.map(jnp.zeros_like, gains[0])
    return seam(_combined, z, h, method.b, slopes), seam(_combined, none, h, method.b, gains)


def _combined(z, h: Scalar, weights: tuple[float, ...], slopes: list):
    """Z + h sum(weights * slopes), leaf by leaf."""
    return jax.tree.map(lambda z, *k: z + h * sum(w * k for w, k in zip(weights, k, strict=True) if w), z, *slopes)


def peak(start: Guards, end: Guards, h: Scalar) -> Scalar:
    """Fraction of a trial at which a guard, negative at both ends, seems to have risen above zero; 1 if none.

    A guard's derivative over the step is taken as the parabola through its end values with the right mean; for the
    slip guard the guard itself is that parabola, its mean being the slider's way. No further evaluation is needed.
    """
    # the guard that seems to rise highest, by the straight line between its end rates
    best = (-jnp.ones_like(h),) * 5
    for g0, g1, r0, r1 in zip(start.value, end.value, start.rate, end.rate, strict=True):
        turns_back = (g0 <= 0) & (g1 <= 0) & (r0 > 0) & (r1 < 0)
        height = jnp.maximum(g0, g1) + jnp.minimum(r0, -r1) * h / 2
        higher = turns_back & (height > best[0])
        best = tuple(jnp.where(higher, new, old) for new, old in zip((height, g0, g1, r0, r1), best, strict=True))
    _, g0, g1, r0, r1 = best
    at, height = _peak_of_cubic(g0, g1, r0 * h, r1 * h)
    first = jnp.where(height > 0, at, 1.0)

    g0, g1 = start.value[Kind.RUB], end.value[Kind.RUB]
    bulge = 6 * ((end.slid - start.slid) / jnp.where(h > 0, h, 1.0) - (g0 + g1) / 2)
    at, height = _peak_of_parabola(g0, g1, bulge)
    slips_back = (start.slid != 0) & (h > 0) & (g0 <= 0) & (g1 <= 0) & (height > 0)
    return jnp.where(slips_back, jnp.minimum(first, at), first)


def _peak_of_parabola(g0: Scalar, g1: Scalar, bulge: Scalar) -> tuple[Scalar, Scalar]:
    """Interior maximum of `g0 + (g1 - g0) s + bulge s (1 - s)`: (s, value); value -1 if there is none."""
    curved = bulge > 0
    s = 0.5 + (g1 - g0) / (2 * jnp.where(curved, bulge, 1.0))
    inside = curved & (s > 0) & (s < 1)
    return s, jnp.where(inside, g0 + (g1 - g0) * s + bulge * s * (1 - s), -1.0)


def _peak_of_cubic(g0: Scalar, g1: Scalar, r0: Scalar, r1: Scalar) -> tuple[Scalar, Scalar]:
    """Interior maximum of the cubic with end values `g` and end slopes `r` on [0, 1]."""
    # g'(s) = r0 + (r1 - r0 + b) s - b s^2 with b = 6 (g1 - g0) - 3 (r0 + r1); it falls through zero at the maximum
    b = 6 * (g1 - g0) - 3 * (r0 + r1)
    p = r1 - r0 + b
    root = jnp.sqrt(jnp.maximum(p * p + 4 * b * r0, 0.0))
    s = 2 * r0 / jnp.where(root - p == 0, 1.0, root - p)
    inside = (r0 > 0) & (r1 < 0) & (s > 0) & (s < 1)
    return s, jnp.where(inside, g0 + s * (r0 + s * (p / 2 - b * s / 3)), -1.0)


def _tolerance(kind: Int[Array, ""], dtype) -> Scalar:
    """Width of the bracket, in steps, at which an event counts as located.

    Force-continuous events cost an error of the square of this width, loaded case switches its first power.
    """
    coarse, fine = (2.0**-20, 2.0**-36) if dtype == jnp.float64 else (2.0**-12, 2.0**-18)
    return jnp.where((kind == Kind.TURN) | (kind == Kind.HEIGHT), fine, coarse).astype(dtype)


class Verdict(NamedTuple):
    """What to do with a finished trial."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept and change mode
    width: Scalar  # of the bracket, in steps
    search: Search  # if the trial was not accepted


def bisect(search: Search, kind, violated, peek: Scalar, locate: str) -> Verdict:
    """Judge a trial: march on, look inside it at the fraction `peek`, halve the bracket, or fire the event."""
    bracketing = search.bracketing | violated
    high = jnp.where(violated, search.length, search.high)
    low = jnp.where(search.bracketing & ~violated, search.length, search.low)
    width = high - low
    if locate == "none":
        no = jnp.zeros_like(violated)
        return Verdict(~no, violated, width, search)
    fire = violated & (width <= _tolerance(kind, high.dtype))
    peeks = ~bracketing & ~search.peeking & (peek < 1)
    narrow = width <= _tolerance(jnp.int32(Kind.TURN), high.dtype)
    halved = jnp.where(narrow, high, (low + high) / 2)
    after = search._replace(
        length=jnp.where(peeks, peek * search.length, halved),
        low=low,
        high=high,
        bracketing=bracketing,
        peeking=peeks,
        inside=search.inside | (search.peeking & violated),
    )
    return Verdict((~bracketing & ~peeks) | fire, fire, width, after)


def _select(condition: Bool[Array, ""], yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def trial(lane: Lane, model: Model, grid: Grid, method: Method, seam: Seam) -> Lane:
    """One trial step of a lane: the body of the flat loop."""
    search, held, tally = lane.search, lane.state, lane.tally
    step_start = grid.start + lane.step.astype(search.done.dtype) / grid.steps
    at = lambda c: step_start + (search.done + c * search.length) / grid.steps  # noqa: E731
    h_full = grid.period / grid.steps
    h = search.length * h_full
    z, gain = rk_step(at, h, held, model, method.tableau, seam)
    view = look(z, held, model, seam)

    counts = (search.length > 0) | search.recheck
    violated = tuple((g > 0) & counts for g in view.guards.value)
    kind = first_kind(violated)
    number = sum(g.astype(jnp.int32) for g in violated)
    peek = seam(peak, lane.guards, view.guards, h)
    verdict = seam(bisect, search, kind, number > 0, peek, method.locate)
    accept, fire = verdict.accept, verdict.fire

    cross = seam(crossing, z, held, view, kind, verdict.width * h_full, model)
    state = _select(fire, cross.after, State(z, held.u_s, held.mode, held.case))
    tally = _select(accept, seam(_tallied, tally, gain, h, held, view, cross, fire, search.inside), tally)
    recheck = fire & ((number > 1) | (kind == Kind.TURN) | (kind == Kind.HEIGHT))
    ahead, step = _advanced(search, lane.step, fire, recheck)
    status = _status(z, accept, ahead.events)
    return Lane(
        _select(accept, state, held),
        jnp.where(accept, step, lane.step),
        _select(accept, ahead, verdict.search),
        _select(accept, view.guards, lane.guards),
        tally,
        jnp.where(lane.status == Status.OK, status, lane.status),
    )


def _tallied(tally: Tally, gain: Integrals, h: Scalar, held: State, view: View, cross, fire, inside) -> Tally:
    apart, stick = held.mode == Mode.APART, held.mode == Mode.STICK
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        tally.jumps + jnp.where(fire, cross.energy, 0.0),
        tally.time_apart + jnp.where(apart, h, 0.0),
        tally.time_stick + jnp.where(stick, h, 0.0),
        tally.time_slip + jnp.where(apart | stick, 0.0, h),
        jnp.maximum(tally.v_max, jnp.where(apart, 0.0, view.at.v)),
        count(tally.counters, cross, fire, inside),
    )


def _advanced(search: Search, step, fire, recheck) -> tuple[Search, Int[Array, ""]]:
    """The search of the next trial and the clock, after an accepted trial."""
    done = search.done + search.length
    sliver = 1e-12 if done.dtype == jnp.float64 else 1e-6
    over = done >= 1 - sliver
    done = jnp.where(over, 0.0, done)
    events = jnp.where(over, 0, search.events + fire.astype(jnp.int32))
    # after an event, a trial of length zero evaluates the guards of the new mode
    ahead = _fresh(done, jnp.where(fire, 0.0, 1 - done), recheck, events)
    # a trial that only peeked leaves the guard at its peak: march on without peeking again
    return ahead._replace(peeking=search.peeking & ~fire), step + over.astype(jnp.int32)


def _status(z: Motion, accept, events) -> Int[Array, ""]:
    finite = jnp.isfinite(sum(jax.tree.leaves(jax.tree.map(jnp.abs, z))))
    turned = jnp.maximum(jnp.abs(z.theta[0]), jnp.abs(z.theta[1])) > ANGLE_RANGE
    status = jnp.where(events > MAX_EVENTS_PER_STEP, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    status = jnp.where(finite, status, Status.NOT_FINITE)
    return jnp.where(accept, status, Status.OK).astype(jnp.int32)


def march(lane: Lane, stop: Int[Array, ""], model: Model, grid: Grid, method: Method, seam: Seam = NO_SEAM) -> Lane:
    """Run `lane` to the start of step `stop`, or until its status is no longer OK."""
    return lax.while_loop(
        lambda lane: (lane.step < stop) & (lane.status == Status.OK),
        lambda lane: trial(lane, model, grid, method, seam),
        lane,
    )


def energy(state: State, model: Model) -> Scalar:
    """Kinetic energy, blades' springs and contact springs [J]."""
    at = look(state.motion, state, model, NO_SEAM).at
    w = stretch(at.v, at.u, state.u_s, state.mode, model.spring)
    return stored_energy(state.motion, model) + contact_energy(at.v, w, state.mode, model.spring)
