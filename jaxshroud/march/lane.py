"""All that a lane carries through the march."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.march.events import Counters, Guards, look, no_events
from jaxshroud.march.locate import fresh
from jaxshroud.march.method import Choices
from jaxshroud.march.peaks import Peaks
from jaxshroud.march.rise import Stride
from jaxshroud.march.within import Within, nothing_yet
from jaxshroud.model.absent import ABSENT, Pair, Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import Model, turns
from jaxshroud.model.rhs import Integrals, rhs_once
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion

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
    forces: Peaks | None  # the same


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
    search: Any  # a Search; of power series a Stride
    guards: Guards | None  # at the start of the trial; None where there are no events
    tally: Tally
    status: Int[Array, ""]


def begin(state: State, model: Model, method: Choices) -> Lane:
    """A lane at step 0 whose first act is to check every guard: a start in overlap is an onset at t = 0.

    Args:
        state: Motion as pairs, without what the model leaves out.
        model: The lane's constants.
        method: Static choices of the march.
    """
    zero = jnp.zeros_like(state.motion.x[0])
    count0 = jnp.zeros((), jnp.int32)
    yes = jnp.ones((), bool)
    none = jax.tree.map(jnp.zeros_like, rhs_once((zero, zero), state, model, method.ledger)[1])
    jumps = Jumps(zero, zero if turns(model) else ABSENT) if method.ledger else None
    within = nothing_yet(zero) if method.within else None
    largest = jax.tree.map(jnp.zeros_like, displacements_of(state.motion))
    forces = Peaks(zero, zero) if method.forces else None
    log = None if method.derivative else Log(zero, zero, zero, zero, largest, no_events(model), within, forces)
    tally = Tally(none, jumps, log)
    guards = look(state.motion, (zero, zero), state, model).guards if model.spring.modal else None
    guards = jax.tree.map(jnp.zeros_like, guards)  # the first trial, of length zero, sets them
    if method.taylor:
        tolerance = zero + method.taylor.tolerance
        stride = Stride(zero, zero, yes, count0 - 1, ~yes, count0, count0, tolerance)
        return Lane(state, count0, stride, None, tally, count0)
    search = fresh(zero, zero, yes, count0, method.locate, method.derivative)
    return Lane(state, count0, search, guards, tally, count0)


class Fixed(NamedTuple):
    """What stays the same for a lane during a march."""

    model: Model
    grid: Grid
    stop: Int[Array, "..."]  # the step at whose start it ends


def running(lane: Lane, stop: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Whether a lane has not arrived at the start of step `stop` and has not failed."""
    return (lane.step < stop) & (lane.status == Status.OK)


def displacements_of(z: Motion) -> tuple[Pair, Pair, Pair]:
    """x, y and theta."""
    return z.x, z.y, z.theta
