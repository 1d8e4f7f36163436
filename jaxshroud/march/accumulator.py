"""The accumulator of a lane: the integrals of its motion, its counts of events and its extremes so far."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshroud.march.events import HEIGHT, TURN, happens, model_events
from jaxshroud.march.observable import Ending
from jaxshroud.model.arithmetic import ZERO, Scalar, Zero, is_zero
from jaxshroud.model.geometry import is_upper
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model
from jaxshroud.model.rhs import Integrals, Means

EventCount = Int[Array, "..."] | Zero


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


def count_event(counters: Counters, ending: Ending) -> Counters:
    """The `counters` with the transition added in which a trial ended, if it did: of all points, and of the case."""
    transition, fired, inside = ending
    kind, case, previous = transition.kind, transition.after.case, transition.before.case
    modes = [mode if isinstance(mode, tuple) else (mode,) for mode in (transition.before.mode, transition.after.mode)]
    turn, height = happens(kind, TURN), happens(kind, HEIGHT)
    onset_flat, end_flat = (case == FLAT) & (previous != FLAT), (previous == FLAT) & (turn | height)
    outer = (case == 1) | (case == 4)
    corners = ~onset_flat & ~end_flat
    occurred = [
        dict(
            switch_14=turn & corners & outer,
            switch_23=turn & corners & ~outer,
            switch_12=height & corners & is_upper(case),
            switch_34=height & corners & ~is_upper(case),
            flat=onset_flat,
            flat_corner=end_flat,
        )
    ]
    for before, after in zip(*modes, strict=True):
        touched, touches, stuck, sticks = (
            before != Mode.APART,
            after != Mode.APART,
            before == Mode.STICK,
            after == Mode.STICK,
        )
        onset = ~touched & touches
        occurred.append(
            dict(
                onset_slip=onset & ~sticks,
                onset_stick=onset & sticks,
                separation=touched & ~touches,
                stick_slip=stuck & touches & ~sticks,
                slip_stick=touched & ~stuck & sticks,
                grazing=onset & inside,
            )
        )
    counts = {name: getattr(counters, name) for name in Counters.__annotations__}
    for name, now in (pair for happened in occurred for pair in happened.items()):
        if not is_zero(counts[name]):
            counts[name] = counts[name] + (now & fired).astype(jnp.int32)
    return Counters(**counts)


def no_events(model: Model, zero: Int[Array, "..."]) -> Counters:
    """The counters of the events that a model has, at `zero`."""
    counted = {name for event in model_events(model) for name in event.counters}
    return Counters(**{name: zero if name in counted else ZERO for name in Counters.__annotations__})


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


class ContactPeaks(NamedTuple):
    """The largest contact forces so far [N], on both sides of every event and by cubics inside each trial step.

    The cubic interpolates the values and the rates of the penetration, and of the friction force, at both ends of a
    trial; its error falls with the fourth power of the step. The friction of smooth contact and the forces of user
    laws are evaluated at the ends only.
    """

    N: Scalar
    F: Scalar


class DisplacementRange(NamedTuple):
    """The largest and the smallest x, y [m], theta [rad], and stress [Pa] if there is one, so far, between steps too.

    A Runge-Kutta step is searched by the cubic through the displacement and its rate at both ends.
    """

    highest: tuple[Any, ...]
    lowest: tuple[Any, ...]


class Impacts(NamedTuple):
    """The impacts so far: contacts that begin from a gap, each of which ends where the faces separate."""

    number: Scalar
    approach: Scalar  # largest closing speed at an onset [m/s]
    approach_sum: Scalar  # of these speeds [m/s]
    ended: Scalar  # contacts that have ended
    impulse_sum: Scalar  # of their impulses of the normal force [N s]
    impulse: Scalar  # largest of these impulses [N s]
    now: Scalar  # impulse of the current contact [N s]


class Log(NamedTuple):
    """What has happened so far: the values of the observables of a march, by their names.

    Numbers of contact are those of the interface, or in rows (interfaces, lanes); those of blades are pairs, or
    (blades, lanes).
    """

    times: ContactTimes
    v_max: Any  # largest penetration at the start, at the end of a trial or at an event [m]
    largest: tuple[Any, Any, Any]  # magnitudes of x, y [m] and theta [rad] at ends of trials and at events
    counters: Counters
    within: StepExtrema | None  # None unless it was requested, as are the next three
    forces: ContactPeaks | None
    impacts: Impacts | None
    extent: DisplacementRange | None
    positions: Means | None  # summed over the ends of steps; None unless the method `sums_positions`
    own: dict[str, Any]  # of the method's own observables


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
    none = jnp.full_like(like, jnp.inf)
    return EventMargins(events=jnp.zeros(like.shape, jnp.int32), slowest_onset=none, slowest_switch=none)


class Accumulator(NamedTuple):
    """The integrals and the log of a lane, or of a row, so far."""

    integrals: Integrals
    jumps: EnergyJumps | None  # None where they are not kept
    log: Log | None  # None where derivatives are computed
    margins: EventMargins | None = None  # None unless they were requested

    def plus(self, gain: Integrals, jumps: EnergyJumps | None) -> "Accumulator":
        """The accumulator with the integrals and the jumps of a trial added."""
        return self._replace(
            integrals=jax.tree.map(jnp.add, self.integrals, gain),
            jumps=None if self.jumps is None else jax.tree.map(jnp.add, self.jumps, jumps),
        )


def half_position(at: Means) -> Means:
    """The share of a position that begins or ends a period in the sum of the trapezoidal rule."""
    return jax.tree.map(lambda a: a / 2, at)


def mean_position(accumulator: Accumulator, end: Means, period: Any, steps: Any) -> Any:
    """The mean of the position over a drive period, from the accumulator of that period; None where it is not kept.

    Args:
        accumulator: That of a lane or of a row.
        end: The position at the end of the period.
        period: Its length [s].
        steps: The number of steps in it, of equal length.

    Source:
        The trapezoidal rule, which on a whole orbit is as accurate as the motion is smooth: what is left stems from the
        instants at which the third derivative jumps, by at most 1/720 of the jump times the fourth power of the step.
    """
    sums = None if accumulator.log is None else accumulator.log.positions
    if sums is None:
        return jax.tree.map(lambda a: a / jax.lax.broadcast_to_rank(period, a.ndim), accumulator.integrals.means)
    return jax.tree.map(lambda total, half: (total - half) / steps, sums, half_position(end))


def watched_of(z: Any) -> tuple[Any, ...]:
    """The displacements, and the stress of a `StressedMotion`."""
    return *z[:3], *z[6:7]
