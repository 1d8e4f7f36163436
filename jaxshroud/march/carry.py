"""The state that a lane, a pair or a row of blades, carries through the march, and its constants.

Within a step it carries the search for an event, from trial to trial. For the axes of rows see `model.row`.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.march.accumulator import Accumulator
from jaxshroud.march.event import Guards
from jaxshroud.march.events import FLAT_PART
from jaxshroud.march.method import FLAT_RETURN
from jaxshroud.march.method_names import Locate
from jaxshroud.model.arithmetic import Scalar, is_unrolled, where
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State

MAX_EVENTS_PER_STEP = 64  # more is Zeno behaviour: regular scenes have a few per *period*
NEGLIGIBLE_REST = {8: 1e-12, 4: 1e-6}  # of a step, by the bytes of a number: a shorter rest is dropped

LaneTree = Any  # a tree of arrays with a leading lane axis, or a `Dual` of two
EachLane = Callable[..., Any]  # (f, *trees) -> `f(*trees)` for every lane, of any number of `LaneTree`s
PerLane = Float[Array, "..."]  # one number for each lane, or one lane's


def no_time(state: State) -> PerLane:
    """A zero for each lane."""
    return jnp.zeros_like(jax.tree.leaves(state.motion, is_leaf=is_unrolled)[0][0])


class TimeGrid(NamedTuple):
    """Steps of equal length: step i starts at drive phase `start + i * turn` turns."""

    start: Scalar  # drive phase where step 0 starts [turns]
    turn: Scalar  # advance of the drive phase in a step [turns]
    h: Scalar  # length of a step [s]
    flat: Scalar  # part of a step: faces whose rocking returns sooner become flat, see `march.events`


def time_grid(start: PerLane, steps: PerLane, period: PerLane, flat_return: PerLane | float = FLAT_RETURN) -> TimeGrid:
    """A grid with `steps` steps in a drive period of `period` seconds; `steps` need not be a whole number.

    Faces whose rocking returns within `flat_return` of a period, or `FLAT_PART` of a step, become flat.
    """
    return TimeGrid(start, 1 / steps, period / steps, jnp.minimum(FLAT_PART, flat_return * steps))


def most_events(grid: TimeGrid, at_corners: bool) -> Int[Array, "..."] | int:
    """How many events a step may have: more where faces that touch `at_corners` may rock more often within it."""
    if not at_corners:
        return MAX_EVENTS_PER_STEP
    return jnp.round(MAX_EVENTS_PER_STEP * (FLAT_PART / grid.flat)).astype(jnp.int32)


def most_turns(grid: TimeGrid) -> Int[Array, "..."]:
    """After how many turns within a step an interface of a row becomes flat: those that return twice too soon.

    What an interface predicts of its own return fails where its neighbours rock as well: their torques change with
    each of their turns.
    """
    return jnp.round(2 / grid.flat).astype(jnp.int32)


class Target(NamedTuple):
    """The guard that a search closes in on, at the upper end of the bracket."""

    kind: Int[Array, "..."]
    value: PerLane
    rate: PerLane
    integral: PerLane
    tries: Int[Array, "..."]
    place: Int[Array, "..."] | None = None  # the interface; None of what one interface shows


class Search(NamedTuple):
    """The search inside the current step; lengths are fractions of a step. Of a row there is one for all interfaces."""

    done: PerLane  # the part that is accepted
    length: PerLane  # of the next trial
    low: PerLane  # the bracket of the event, measured from `done`
    high: PerLane
    bracketing: Bool[Array, "..."]
    probing: Bool[Array, "..."]  # the next trial ends where a guard seems to have a maximum
    inside: Bool[Array, "..."]  # the bracket was found by such a trial
    recheck: Bool[Array, "..."]  # guards may have jumped: a violated guard counts even in a trial of length zero
    events: Int[Array, "..."]  # in this step
    target: Target | None  # None unless events are located by cubics
    pending: Bool[Array, "interfaces lanes"] | None = None  # of a row with derivatives: events at this very instant
    turns: Int[Array, "interfaces lanes"] | None = None  # of a row whose blocks turn: changes of case within this step

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent."""
        return self.done, self.length


def new_search(
    done: PerLane, length: PerLane, recheck: Bool[Array, "..."], events: Int[Array, "..."], locate: Locate
) -> Search:
    """A search without a bracket."""
    zero, no, none = jnp.zeros_like(done), jnp.zeros_like(done, bool), jnp.zeros_like(done, jnp.int32)
    target = Target(none, zero, zero, zero, none, none) if locate == "cubic" else None
    return Search(done, length, zero, zero, no, no, no, recheck, events, target)


def following_search(
    search: Search, step: Int[Array, "..."], fire: Bool[Array, "..."], recheck: Bool[Array, "..."], locate: Locate
) -> tuple[Search, Int[Array, "..."]]:
    """The search of the next trial, and the clock, after an accepted trial."""
    done = search.done + search.length
    complete = done >= 1 - NEGLIGIBLE_REST[done.dtype.itemsize]
    done = where(complete, 0.0, done)
    events = where(complete, 0, search.events + fire.astype(jnp.int32))
    after = new_search(done, where(recheck, 0.0, 1 - done), recheck, events, locate)
    # a trial that ended at the maximum of a guard leaves it there, where the next trial need not look for it
    after = after._replace(probing=search.probing & ~fire & ~complete, pending=search.pending)
    turns = None if search.turns is None else where(complete, 0, search.turns)
    return after._replace(turns=turns), step + complete.astype(jnp.int32)


class Lane(eqx.Module):
    """The loop state of one lane, or of a row: numbers of blades are pairs, or (N, lanes), see `model.row`."""

    state: State
    step: Int[Array, "..."]  # the clock: integer index of the current step in the period
    search: Any  # a `Search`, or a `TaylorSearch` for power series
    guards: Guards | None  # at the start of the trial; None where there are no events
    accumulator: Accumulator
    status: Int[Array, "..."]

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent: those on which later motion, power, moments or means depend."""
        sums = self.accumulator.integrals
        optional = [one for one in (sums.moments, sums.means) if one is not None]
        return self.state, *self.search.differentiable, sums.power, *optional


AnyModel = TypeVar("AnyModel")  # a `Model`, or a `RowModel`


class Fixed(eqx.Module, Generic[AnyModel]):
    """The constants of a lane, or of a row, during a march."""

    model: AnyModel
    grid: TimeGrid
    stop: Int[Array, "..."]  # the march ends at the start of this step


def running(lane: Lane, stop: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Whether a lane, or a row, has not arrived at the start of step `stop` and has not failed."""
    return (lane.step < stop) & (lane.status == Status.OK)
