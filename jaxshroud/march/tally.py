"""The tally of a lane: the integrals of its motion, its counts of events and the extremes of its motion so far."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.march.events import EventKind, Transition, model_events, place_contact
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import ABSENT, Absent, Scalar, is_absent, where, zeros_for
from jaxshroud.model.geometry import is_upper
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, has_torsion
from jaxshroud.model.rhs import Displacements, Integrals, Means, position_at, rhs
from jaxshroud.scene.keys import Motion

EventCount = Int[Array, ""] | Absent


class Counters(eqx.Module):
    """The number of events of each sort; absent where the model lacks it."""

    onset_slip: EventCount
    onset_stick: EventCount
    separation: EventCount
    stick_slip: EventCount
    slip_stick: EventCount
    switch_14: EventCount
    switch_23: EventCount
    switch_12: EventCount
    switch_34: EventCount
    flat: EventCount  # onsets of face-to-face contact
    flat_corner: EventCount  # transitions from face-to-face contact to a corner
    grazing: EventCount  # onsets that were found inside a step


def count_event(
    counters: Counters, transition: Transition, fired: Bool[Array, ""], inside: Bool[Array, ""]
) -> Counters:
    """The `counters` with a transition added where it `fired`; `inside`: at a maximum of the guard within a step."""
    kind, mode, before = transition.kind, transition.after.mode, transition.before.mode
    onset = (kind == EventKind.LIFT) & (before == Mode.APART)
    rub = kind == EventKind.RUB
    turn, height = kind == EventKind.TURN, kind == EventKind.HEIGHT
    case, previous = transition.after.case, transition.before.case
    onset_flat, end_flat = (case == FLAT) & (previous != FLAT), (previous == FLAT) & (turn | height)
    outer, corners = (case == 1) | (case == 4), ~onset_flat & ~end_flat
    occurred = dict(
        onset_slip=onset & (mode != Mode.STICK),
        onset_stick=onset & (mode == Mode.STICK),
        separation=(kind == EventKind.LIFT) & (before != Mode.APART),
        stick_slip=rub & (before == Mode.STICK),
        slip_stick=rub & (before != Mode.STICK),
        switch_14=turn & corners & outer,
        switch_23=turn & corners & ~outer,
        switch_12=height & corners & is_upper(case),
        switch_34=height & corners & ~is_upper(case),
        flat=onset_flat,
        flat_corner=end_flat,
        grazing=onset & inside,
    )
    counts = ((name, getattr(counters, name), now) for name, now in occurred.items())
    return Counters(**{name: n + (now & fired).astype(jnp.int32) if not is_absent(n) else n for name, n, now in counts})


COUNTED_BY_KIND = {
    EventKind.TURN: ("switch_14", "switch_23", "switch_12", "switch_34", "flat", "flat_corner"),
    EventKind.RUB: ("onset_stick", "stick_slip", "slip_stick"),
}  # counters that a model without events of that kind lacks


def no_events(model: Model) -> Counters:
    """The counters of the events that a model has, at zero."""
    names, present, zero = Counters.__annotations__, model_events(model), jnp.zeros((), jnp.int32)
    lacking = {name for kind, counted in COUNTED_BY_KIND.items() if kind not in present for name in counted}
    lacking = lacking if present else set(names)
    return Counters(**{name: ABSENT if name in lacking else zero for name in names})


class ContactTimes(NamedTuple):
    """The time in each contact state [s]."""

    apart: Any
    stick: Any
    slip: Any


class StepExtrema(NamedTuple):
    """The extremes of a lane so far, by the cubic through the penetration and its rate at the ends of each trial."""

    v_max: Scalar  # largest penetration [m]
    fastest: Scalar  # largest closing or opening speed [m/s]
    slowest_onset: Scalar  # closing speed at the gentlest onset [m/s]; infinite if there is none
    nearest_miss: (
        Scalar  # least distance at which the corners turned back without touching [m]; infinite if there is none
    )


def initial_extrema(v: Scalar) -> StepExtrema:
    """The extremes before the first step, which begins with the penetration `v`."""
    zero = jnp.zeros_like(v)
    return StepExtrema(v, zero, zero + jnp.inf, zero + jnp.inf)


class ContactPeaks(NamedTuple):
    """The largest contact forces so far [N], on both sides of every event and by cubics inside each trial step.

    The cubic interpolates the values and the rates of the penetration, and of the friction force, at both ends of a
    trial; its error falls with the fourth power of the step. The friction of smooth contact and the forces of user
    laws are evaluated at the ends only.
    """

    N: Scalar
    F: Scalar


class DisplacementRange(NamedTuple):
    """The largest and the smallest values of the displacements x, y [m] and theta [rad] so far, between steps too.

    A Runge-Kutta step is searched by the cubic through the displacement and its rate at both ends.
    """

    highest: Displacements
    lowest: Displacements


class Impacts(NamedTuple):
    """The impacts so far: contacts that begin from a gap, each of which ends where the faces separate."""

    number: Scalar
    approach: Scalar  # largest closing speed at an onset [m/s]
    approach_sum: Scalar  # of these speeds [m/s]
    ended: Scalar  # contacts that have ended
    impulse_sum: Scalar  # of their impulses of the normal force [N s]
    impulse: Scalar  # largest of these impulses [N s]
    now: Scalar  # impulse of the current contact [N s]


class Log(eqx.Module):
    """What has happened to a lane so far."""

    time_apart: Scalar  # [s]
    time_stick: Scalar  # [s]
    time_slip: Scalar  # [s]
    v_max: Scalar  # largest penetration at the start, at the end of a step or at an event [m]
    largest: Displacements  # magnitudes of x, y [m] and theta [rad] at ends of steps and at events
    counters: Counters
    within: StepExtrema | None  # None unless it was requested
    forces: ContactPeaks | None  # None unless it was requested, as are the next two
    impacts: Impacts | None
    extent: DisplacementRange | None
    positions: Means | None  # summed over the ends of steps; None unless the method `sums_positions`


class EnergyJumps(NamedTuple):
    """The energy that jumps at events."""

    springs: Scalar  # gained by the contact springs [J]
    dropped: Scalar  # lost where flat contact ended a rocking motion [J]; absent where the blocks do not turn


class EventMargins(NamedTuple):
    """How many events have happened, and how clearly: derivatives grow without bound as a speed goes to zero."""

    events: Int[Array, "..."]
    slowest_onset: Scalar  # least closing speed at an onset from a gap [m/s]; infinite without one
    slowest_switch: Scalar  # least speed at which corners pass each other at a change of case; infinite without one


def no_margins(like: Float[Array, "..."]) -> EventMargins:
    """The margins before the first event."""
    return EventMargins(jnp.zeros(like.shape, jnp.int32), *[jnp.full_like(like, jnp.inf)] * 2)


class Tally(eqx.Module):
    """The integrals and the log of a lane so far."""

    integrals: Integrals
    jumps: EnergyJumps | None  # None where they are not kept
    log: Log | None  # None where derivatives are computed
    margins: EventMargins | None = None  # None unless they were requested


def new_tally(state: State, model: Model, method: Choices) -> Tally:
    """The tally of a lane that starts from `state`."""
    zero = jnp.zeros_like(state.motion.x[0])
    _, none = zeros_for(partial(rhs, recorded=method.recorded), (zero, zero), state, model)
    jumps = EnergyJumps(zero, zero if has_torsion(model) else ABSENT) if method.ledger else None
    margins = no_margins(zero) if method.margins else None
    if method.derivative:
        return Tally(none, jumps, None, margins)
    deepest = jnp.maximum(place_contact(state.motion, state, model)[2].v, 0.0)
    within = initial_extrema(deepest) if method.within else None
    largest = jax.tree.map(jnp.zeros_like, displacements_of(state.motion))
    forces = ContactPeaks(zero, zero) if method.forces else None
    impacts = Impacts(*[zero] * 7) if method.forces else None
    at_start = displacements_of(state.motion)
    extent = DisplacementRange(at_start, at_start) if method.amplitudes else None
    positions = half_position(left_position_at(state.motion)) if method.sums_positions else None
    log = Log(zero, zero, zero, deepest, largest, no_events(model), within, forces, impacts, extent, positions)
    return Tally(none, jumps, log, margins)


class LogUpdates(NamedTuple):
    """How a trial updates the parts of a log."""

    counts: Callable[[Counters], Counters]
    within: Callable[[StepExtrema], StepExtrema]
    forces: Callable[[ContactPeaks], ContactPeaks]
    impacts: Callable[[Impacts], Impacts]
    extent: Callable[[DisplacementRange], DisplacementRange]
    positions: Callable[[Means], Means]
    margins: Callable[[EventMargins], EventMargins]


def updated_tally(
    tally: Tally,
    gain: Integrals,
    jumps: EnergyJumps | None,
    h: Scalar,
    mode,
    v: Scalar,
    sizes: Displacements,
    log_updates: LogUpdates,
) -> Tally:
    """The tally after `h` seconds in a `mode`, with the penetration `v` and displacements of these `sizes`."""
    return Tally(
        jax.tree.map(jnp.add, tally.integrals, gain),
        None if tally.jumps is None else jax.tree.map(jnp.add, tally.jumps, jumps),
        None if tally.log is None else _updated_log(tally.log, h, mode, v, sizes, log_updates),
        None if tally.margins is None else log_updates.margins(tally.margins),
    )


def _updated_log(log: Log, h: Scalar, mode, v: Scalar, sizes: Displacements, log_updates: LogUpdates) -> Log:
    apart, stick = mode == Mode.APART, mode == Mode.STICK
    return Log(
        log.time_apart + where(apart, h, 0.0),
        log.time_stick + where(stick, h, 0.0),
        log.time_slip + where(apart | stick, 0.0, h),
        jnp.maximum(log.v_max, where(apart, 0.0, v)),
        jax.tree.map(lambda most, now: jnp.maximum(most, jnp.abs(now)), log.largest, sizes),
        log_updates.counts(log.counters),
        None if log.within is None else log_updates.within(log.within),
        None if log.forces is None else log_updates.forces(log.forces),
        None if log.impacts is None else log_updates.impacts(log.impacts),
        None if log.extent is None else log_updates.extent(log.extent),
        None if log.positions is None else log_updates.positions(log.positions),
    )


def log_of_new_period(log: Log, z: Motion) -> Log:
    """The log with what is told of each period reset, at the motion `z`; the impulse of the current contact goes on."""
    largest, forces, impacts, times = jax.tree.map(
        jnp.zeros_like, (log.largest, log.forces, log.impacts, times_of(log))
    )
    if log.impacts is not None:
        impacts = impacts._replace(now=log.impacts.now)
    extent = None if log.extent is None else DisplacementRange(displacements_of(z), displacements_of(z))
    positions = None if log.positions is None else half_position(left_position_at(z))
    places = lambda log: (log.largest, log.forces, log.impacts, log.extent, log.positions, *times_of(log))
    reset = largest, forces, impacts, extent, positions, *times
    return eqx.tree_at(places, log, reset, is_leaf=lambda a: a is None)


def times_of(log: Any) -> ContactTimes:
    """The times of a `Log`, or those at each interface of a `RowLog`."""
    return ContactTimes(log.time_apart, log.time_stick, log.time_slip)


def left_position_at(z: Motion) -> Means:
    """The position of the left block."""
    return position_at(z.x[0], z.y[0], z.theta[0])


def half_position(at: Means) -> Means:
    """The share of a position that begins or ends a period in the sum of the trapezoidal rule."""
    return jax.tree.map(lambda a: a / 2, at)


def mean_position(tally: Any, end: Motion, period: Any, steps: Any, at: Callable[[Motion], Means]) -> Any:
    """The mean of the position over a drive period, from the tally of that period alone; None where it is not kept.

    Args:
        tally: A `Tally` or a `RowTally`.
        end: The motion at the end of the period.
        period: Its length [s].
        steps: The number of steps in it, of equal length.
        at: The position of a motion.

    Source:
        The trapezoidal rule, which on a whole orbit is as accurate as the motion is smooth: what is left stems from the
        instants at which the third derivative jumps, by at most 1/720 of the jump times the fourth power of the step.
    """
    sums = None if tally.log is None else tally.log.positions
    if sums is None:
        return jax.tree.map(lambda a: a / jax.lax.broadcast_to_rank(period, a.ndim), tally.integrals.means)
    return jax.tree.map(lambda total, half: (total - half) / steps, sums, half_position(at(end)))


def updated_positions(before: Means, complete: Bool[Array, "..."], now: Means) -> Means:
    """The sums over the ends of steps, with the position `now` where one is `complete`."""
    return jax.tree.map(lambda total, a: total + where(complete, a, 0.0), before, now)


def displacements_of(z: Motion) -> tuple[Any, Any, Any]:
    """The displacements x, y and theta, of pairs or of rows."""
    return z.x, z.y, z.theta
