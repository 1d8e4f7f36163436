"""The state that a lane, a pair or a row of blades, carries through the march, and its constants.

Within a step it carries the search for an event, from trial to trial. What an event changes in the state is here
too; for the axes of rows see `model.row`.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.march.accumulator import Accumulator, EventMargins
from jaxshroud.march.event import Events, GuardEvaluation, Guards, any_of, case_switches
from jaxshroud.march.events import (
    BUILT_IN_EVENTS,
    EVENTS,
    FLAT_PART,
    LIFT,
    TURN,
    Transition,
    happens,
    transition,
)
from jaxshroud.march.method import FLAT_RETURN, Choices
from jaxshroud.march.method_names import Locate
from jaxshroud.march.observable import Lift
from jaxshroud.model.arithmetic import Scalar, where
from jaxshroud.model.contact_law import starts_in_overlap
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.scene.keys import Motion

MAX_EVENTS_PER_STEP = 64  # more is Zeno behaviour: regular scenes have a few per *period*
NEGLIGIBLE_REST = {8: 1e-12, 4: 1e-6}  # of a step, by the bytes of a number: a shorter rest is dropped

LaneTree = Any  # a tree of arrays with a leading lane axis, or a `Dual` of two
EachLane = Callable[..., Any]  # (f, *trees) -> `f(*trees)` for every lane, of any number of `LaneTree`s
PerLane = Float[Array, "..."]  # one number for each lane, or one lane's


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
    place: Int[Array, "..."] | None = None  # the interface of a row; None of a pair


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
    done: PerLane,
    length: PerLane,
    recheck: Bool[Array, "..."],
    events: Int[Array, "..."],
    locate: Locate,
    of_row: bool = False,
) -> Search:
    """A search without a bracket."""
    zero, no, none = jnp.zeros_like(done), jnp.zeros_like(done, bool), jnp.zeros_like(done, jnp.int32)
    target = Target(none, zero, zero, zero, none, none if of_row else None) if locate == "cubic" else None
    return Search(done, length, zero, zero, no, no, no, recheck, events, target)


def following_search(
    search: Search, step: Int[Array, "..."], fire: Bool[Array, "..."], recheck: Bool[Array, "..."], locate: Locate
) -> tuple[Search, Int[Array, "..."]]:
    """The search of the next trial, and the clock, after an accepted trial."""
    done = search.done + search.length
    complete = done >= 1 - NEGLIGIBLE_REST[done.dtype.itemsize]
    done = where(complete, 0.0, done)
    events = where(complete, 0, search.events + fire.astype(jnp.int32))
    of_row = search.target is not None and search.target.place is not None
    length = where(recheck, 0.0, 1 - done)
    after = new_search(done, length, recheck, events, locate, of_row)
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


def updated_lanes(update: Callable[..., Lane], method: Choices, each: EachLane, *args: LaneTree) -> LaneTree:
    """`update(*args)` for every lane; the sums and extremes of a long accumulator in a kernel of their own.

    A kernel with all of them would have more arguments than vector registers serve.
    """
    if not method.has_long_accumulator:
        return each(update, *args)

    def sums(lane):
        return (lane.accumulator.integrals, lane.accumulator.log.impacts, lane.accumulator.log.extent)

    others = each(lambda *args: eqx.tree_at(sums, update(*args), (None,) * 3, is_leaf=lambda a: a is None), *args)
    return eqx.tree_at(sums, others, each(lambda *args: sums(update(*args)), *args), is_leaf=lambda a: a is None)


class EventChange(NamedTuple):
    """The change at an event."""

    view: GuardEvaluation
    transition: Transition
    lift: Lift
    springs: Scalar  # energy that the contact springs gain [J]; 0 without an event


def change_at(
    view: GuardEvaluation,
    z: Motion,
    start: State,
    fire: Bool[Array, ""],
    kind: Int[Array, ""],
    delay: Scalar,
    soon: Scalar,
    model: Model,
    rocks: Bool[Array, ""] | None = None,
    events: Events = BUILT_IN_EVENTS,
) -> EventChange:
    """The change at the motion `z`, where the event of number `kind` happens if `fire` is true.

    `soon` and `rocks` are as of `transition`.
    """
    change = transition(z, start, view, kind, delay, soon, model, rocks, events)
    lift = fire & _lifts(kind, start, change)
    apart = interface_mode(start.mode) == Mode.APART
    onset = lift & apart
    lifts = Lift(onset, onset & ~starts_in_overlap(view.at, delay), lift & ~apart)
    return EventChange(view, change, lifts, where(fire, change.energy, 0.0))


def _lifts(kind: Int[Array, ""], start: State, change: Transition) -> Bool[Array, ""]:
    """Whether contact begins or ends at an event; of several points at the first or the last one."""
    if not isinstance(start.mode, tuple):
        return happens(kind, LIFT)
    before, after = interface_mode(start.mode), interface_mode(change.after.mode)
    return (before == Mode.APART) != (after == Mode.APART)


def updated_margins(
    before: EventMargins | None, change: EventChange, fire: Bool[Array, ""], model: Model
) -> EventMargins | None:
    """The margins, if they are kept, after a trial that ends in a `change` if `fire` is true."""
    if before is None:
        return None
    turn, rate, slowest = change.transition, change.view.rate, before.slowest_switch
    if touches_at_corners(model):
        of_case = any_of(case_switches(turn.kind, EVENTS))
        switched = fire & of_case & (turn.before.case != FLAT) & (turn.after.case != FLAT)
        speed = jnp.abs(where(happens(turn.kind, TURN), rate.turn * model.block.a_x, rate.height))
        slowest = where(switched, jnp.minimum(slowest, speed), slowest)
    onset = where(change.lift.impact, jnp.minimum(before.slowest_onset, rate.v), before.slowest_onset)
    return EventMargins(before.events + fire.astype(jnp.int32), onset, slowest)


def status_of(turned: Bool[Array, "..."], lost: Bool[Array, "..."], too_many: Bool[Array, "..."]) -> Int[Array, "..."]:
    """The status where a block has `turned` too far, the motion is not finite, or a step has `too_many` events."""
    status = where(too_many, Status.TOO_MANY_EVENTS, Status.OK)
    status = where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return where(lost, Status.NOT_FINITE, status).astype(jnp.int32)


class InterfaceChange(NamedTuple):
    """The change of one interface at an event."""

    u_s: Any
    mode: Int[Array, ""]
    case: Int[Array, ""]
    becomes_flat: Bool[Array, ""]
    turns: Int[Array, ""] | None  # changes of case within this step; None where the blocks do not turn
    jumped: Bool[Array, ""]  # guards may have jumped
    springs: Scalar  # energy gained by the contact springs [J]
    counted: dict[str, Any]  # values of the observables that take the event
    v: Scalar  # penetration before it [m]
    margins: EventMargins | None  # None where they are not logged
    lift: Lift | None  # None where no log asks for it
