"""What an accepted trial leaves, of a pair or of a row: what its accumulator asks of it, and the lane afterwards."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.accumulator import EnergyJumps
from jaxshroud.march.carry import Lane, PerLane
from jaxshroud.march.locate import select
from jaxshroud.march.observable import Lift
from jaxshroud.model.arithmetic import where
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals


class AcceptedTrial(NamedTuple):
    """A trial that was accepted, as far as the accumulator asks."""

    start: State
    mode: Int[Array, "..."]  # of each interface during it; of smooth contact, whether the faces touch at its end
    h: PerLane  # its length [s]
    end: Any  # motion at its end, before what happens there
    after: Any  # motion with which a row goes on, once blocks with flat faces turn as one; of pairs the same as `end`
    v: PerLane | None  # penetration there [m]; by power series the largest within, None with derivatives
    lift: Lift | None  # of each interface; None where no log of a row asks for it
    gain: Integrals
    jumps: EnergyJumps | None
    step: Int[Array, "..."]  # in which it was made
    next_step: Int[Array, "..."]  # in which the next one is made
    events: Any = None  # of a pair the `Ending`, None without events; of a row the values that observables give to it
    by_series: tuple[Any, ...] | None = None  # see `Observable.of_series`, of each; None for Runge-Kutta methods


def mode_of_smooth_contact(v: PerLane) -> Int[Array, "..."]:
    """Whether faces touch, as a mode, at a penetration `v` [m]; smooth contact has no modes of its own."""
    return where(v < 0, jnp.int32(Mode.APART), jnp.int32(Mode.SLIP_PLUS))


def lane_after(
    before: Lane,
    after: Lane,
    accept: Bool[Array, "..."],
    moves_low: Bool[Array, "..."],
    active: Bool[Array, "..."],
    repeated: Any,
) -> Lane:
    """The lane, or the row, after a trial.

    Args:
        before: The one before it.
        after: The one after it if it is accepted; its status is that in any case, of those that are active.
        accept: Whether it is accepted.
        moves_low: Whether its end is the new lower end of the bracket, whose guards are kept.
        active: Whether the lane runs.
        repeated: The search if the trial is not accepted.
    """
    return Lane(
        select(accept, after.state, before.state),
        where(accept, after.step, before.step),
        select(accept, after.search, repeated),
        None if after.guards is None else select(accept | moves_low, after.guards, before.guards),
        select(accept, after.accumulator, before.accumulator),
        where(active, after.status, before.status),
    )
