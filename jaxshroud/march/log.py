"""What an accepted trial leaves: its accumulator, from what happened at its end.

What is logged, and how, stands in `logged`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.accumulator import Accumulator, EnergyJumps, EventMargins, Log, no_margins
from jaxshroud.march.carry import PerLane, no_time
from jaxshroud.march.events import place_contact
from jaxshroud.march.extremes import ContactSeries, MotionSeries
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Beginning, BladeTrial, InterfaceTrial, Lift, Observable, Per
from jaxshroud.model.arithmetic import Scalar, both_sides, is_unrolled
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import (
    Each,
    OfInterfaces,
    RowModel,
    alone,
    of_blades_that_count,
    over,
    pair_states,
)
from jaxshroud.scene.keys import Motion


class InterfaceChange(NamedTuple):
    """The change of one interface where a trial ended."""

    u_s: Any
    mode: Int[Array, ""]
    case: Int[Array, ""]
    becomes_flat: Bool[Array, ""]
    turns: Int[Array, ""] | None  # changes of case within this step; None where they are not counted
    jumped: Bool[Array, ""]  # guards may have jumped
    springs: Scalar  # energy gained by the contact springs [J]
    counted: dict[str, Any]  # values of the observables that take the event
    v: Scalar  # penetration before it [m]
    margins: EventMargins | None  # None where they are not logged
    lift: Lift | None  # None where no log asks for it


class RowChange(NamedTuple):
    """What happens where a trial ended."""

    state: State  # after it: blocks with new flat faces turn as one
    dropped: PerLane  # energy that these lose [J]
    at: InterfaceChange  # of each interface


class AcceptedTrial(NamedTuple):
    """A trial that was accepted, as far as the accumulator asks."""

    start: State
    mode: Int[Array, "..."]  # of each interface during it; of smooth contact, whether the faces touch at its end
    h: PerLane  # its length [s]
    end: Any  # motion at its end, before what happens there
    change: RowChange
    v: PerLane | None  # penetration there [m]; by power series the largest within, None with derivatives
    gain: Integrals
    step: Int[Array, "..."]  # in which it was made
    next_step: Int[Array, "..."]  # in which the next one is made
    by_series: dict[str, Any] | None = None  # see `Observable.of_series`, by names; None for Runge-Kutta methods


def log_of(values: Mapping[str, Any]) -> Log:
    """The log with the values of observables by their names."""
    built_in: dict[str, Any] = {name: values.get(name) for name in Log._fields if name != "own"}
    return Log(**built_in, own={name: value for name, value in values.items() if name not in built_in})


def value_in(log: Log, name: str) -> Any:
    """The value of an observable in a log."""
    return log.own[name] if name in log.own else getattr(log, name)


def found_by_series(inside: ContactSeries | MotionSeries, method: Choices) -> dict[str, Any]:
    """What each observable reads off the polynomials of a trial at one interface, or of one blade, by their names."""
    is_contact = isinstance(inside, ContactSeries)
    readers = {one.name: one.of_series for one in observables_of(method) if (one.per == "interface") == is_contact}
    return {name: read(inside) for name, read in readers.items() if read is not None}


def penetrations(state: State, model: RowModel, each: Each) -> OfInterfaces:
    """The penetration at each interface [m]."""
    return over(each, _penetration_at, pair_states(state, model), model.interfaces)


def _penetration_at(state: State, model: Model) -> Scalar:
    return place_contact(state.motion, state, model)[2].v


def _numbers_for(one: Observable, of_faces: Any, of_blades: Any, model: RowModel) -> Any:
    """The numbers that an observable takes, of interfaces, of all blades, or of those that count."""
    if one.per == "interface":
        return of_faces
    return of_blades if one.per == "blade" else of_blades_that_count(of_blades, model)


def new_log(state: State, at: OfInterfaces, model: RowModel, method: Choices, each: Each) -> Log:
    """The log of a row that starts from `state`; `at` are zeros."""
    motion = model.blades.watched(state.motion)
    v = penetrations(state, model, each)
    contact = Beginning(None, at, v, model.interfaces)
    zero = jax.tree.map(jnp.zeros_like, motion.x)
    blades = Beginning(motion, zero, zero, None)

    def start(one):
        return over(alone, one.start, _numbers_for(one, contact, blades, model))

    return log_of({one.name: start(one) for one in observables_of(method)})


def new_accumulator(nothing: Integrals, state: State, model: RowModel, method: Choices, each: Each) -> Accumulator:
    """The accumulator of a row that starts from `state`, with its integrals, which are `nothing` so far."""
    lanes = no_time(state)
    at = jax.tree.map(lambda case: jnp.zeros(case.shape, lanes.dtype), state.case)
    log = None if method.derivative else new_log(state, at, model, method, each)
    margins = over(each, no_margins, at) if method.margins else None
    return Accumulator(nothing, EnergyJumps(at, lanes) if method.ledger else None, log, margins)


def updated_accumulator(
    accumulator: Accumulator, trial: AcceptedTrial, model: RowModel, method: Choices, each: Each
) -> Accumulator:
    """The accumulator after a trial."""
    change, log = trial.change, accumulator.log
    accumulator = accumulator.plus(trial.gain, EnergyJumps(change.at.springs, change.dropped))
    log = None if log is None else _updated_log(log, trial, model, method, each)
    return accumulator._replace(log=log, margins=change.at.margins)


def _updated_log(log: Log, trial: AcceptedTrial, model: RowModel, method: Choices, each: Each) -> Log:
    shroud = model.blades.watched
    observables = observables_of(method)
    start, end, after = shroud(trial.start.motion), shroud(trial.end), shroud(trial.change.state.motion)
    contact = InterfaceTrial(trial.h, trial.mode, trial.v, trial.mode == Mode.APART)
    blades = BladeTrial(start, end, after, trial.h, trial.step, trial.next_step)
    together = [one for one in observables if one.takes == "all" and not is_unrolled(end.x)]
    values = {
        one.name: one.update(value_in(log, one.name), contact if one.per == "interface" else blades) for one in together
    }
    contact = contact._replace(
        start=pair_states(trial.start, model),
        end=both_sides(end, model.closed),
        lift=trial.change.at.lift,
        loads=trial.gain.loads,
        model=model.interfaces,
    )
    others = [one for one in observables if one.takes != "event" and one not in together]
    for per in get_args(Per):
        alike = [one for one in others if one.per == per]
        if alike:
            numbers = _numbers_for(alike[0], contact, blades, model)
            values |= _updated_each(log, numbers, alike, trial.by_series, each)
    return log_of(values | trial.change.at.counted)


def values_of_events(log: Log | None, method: Choices) -> dict[str, Any]:
    """The values of the observables that take the event; none where there is no log."""
    return {} if log is None else {one.name: value_in(log, one.name) for one in takers_of_events(method)}


def takers_of_events(method: Choices) -> list[Observable]:
    """The observables whose updates take the event that ends a trial."""
    return [one for one in observables_of(method) if one.takes == "event"]


def _updated_each(log: Log, trial: Any, observables: list[Observable], by_series: Any, each: Each) -> dict[str, Any]:
    """The values of observables after a trial of each interface, or of each blade, in one kernel."""
    names = [one.name for one in observables]
    read = {name: by_series[name] for name in names if name in (by_series or {})}

    def updated(values: dict[str, Any], read: dict[str, Any], trial: Any) -> dict[str, Any]:
        return {
            one.name: one.update(values[one.name], trial._replace(by_series=read.get(one.name))) for one in observables
        }

    return over(each, updated, {name: value_in(log, name) for name in names}, read, trial)


def accumulator_of_new_period(accumulator: Accumulator, z: Motion, model: RowModel, method: Choices) -> Accumulator:
    """The accumulator with the values of single periods reset, at the motion `z`."""
    integrals, jumps = jax.tree.map(jnp.zeros_like, (accumulator.integrals, accumulator.jumps))
    log = accumulator.log

    def reset(one: Observable, before: Any) -> Any:
        return over(alone, one.reset, before, _numbers_for(one, both_sides(z, model.closed), z, model))

    if log is not None:
        log = log_of({one.name: reset(one, value_in(log, one.name)) for one in observables_of(method)})
    return Accumulator(integrals, jumps, log, accumulator.margins)
