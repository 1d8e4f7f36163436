"""The tally of rows of blades through their trials: integrals, and the log of every interface and blade."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.events import place_contact
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import (
    closing_speed,
    updated_extrema,
    updated_impacts,
    updated_peaks,
    updated_range,
)
from jaxshroud.march.row_carry import InterfaceChange, Lift, RowLog, RowTally
from jaxshroud.march.row_step import OfLanes, RowStepEnd
from jaxshroud.march.tally import (
    ContactPeaks,
    DisplacementRange,
    Impacts,
    displacements_of,
    half_position,
    initial_extrema,
    no_events,
    updated_positions,
)
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import ContactLoads
from jaxshroud.model.row import Each, OfInterfaces, RowModel, blade_positions, both_sides, over, pair_states
from jaxshroud.scene.keys import Motion


class AcceptedTrial(NamedTuple):
    """A trial that was accepted, as far as the tally asks."""

    start: State
    mode: Any  # of each interface during it
    h: OfLanes  # its length [s]
    end: RowStepEnd  # before what happens there
    motion: Motion  # after it
    change: InterfaceChange
    dropped: OfLanes  # energy lost where flat contact ended a rocking motion [J]
    complete: Bool[Array, " lanes"]  # a step ends there


def penetrations(state: State, model: RowModel, each: Each) -> OfInterfaces:
    """The penetration at each interface [m]."""
    return over(each, _penetration_at, pair_states(state, model.closed), model.interfaces)


def _penetration_at(state: State, model: Model) -> Scalar:
    return place_contact(state.motion, state, model)[2].v


def new_row_log(state: State, at: OfInterfaces, model: RowModel, method: Choices, each: Each) -> RowLog:
    """The log of a row that starts from `state`; `at` are zeros."""
    displacements = displacements_of(state.motion)
    counters = jax.tree.map(lambda a: jnp.zeros(at.shape, a.dtype), no_events(model.interfaces))
    deepest = jnp.maximum(penetrations(state, model, each), 0.0)
    return RowLog(
        *(at, at, at, deepest),
        jax.tree.map(jnp.zeros_like, displacements),
        counters,
        over(each, initial_extrema, deepest) if method.within else None,
        ContactPeaks(at, at) if method.forces else None,
        Impacts(*[at] * 7) if method.forces else None,
        DisplacementRange(displacements, displacements) if method.amplitudes else None,
        half_position(blade_positions(state.motion)) if method.sums_positions else None,
    )


def updated_row_tally(tally: RowTally, trial: AcceptedTrial, model: RowModel, each: Each) -> RowTally:
    """The tally after a trial."""
    change, log = trial.change, None if tally.log is None else _updated_row_log(tally.log, trial, model, each)
    integrals = jax.tree.map(jnp.add, tally.integrals, trial.end.gain)
    return RowTally(integrals, tally.springs + change.springs, tally.dropped + trial.dropped, log, change.margins)


def _updated_row_log(log: RowLog, trial: AcceptedTrial, model: RowModel, each: Each) -> RowLog:
    start, end, h, extent, positions = trial.start, trial.end.state, trial.h, log.extent, log.positions
    if extent is not None:
        extent = over(each, updated_range, extent, start.motion, end.motion, h)
    if positions is not None:
        positions = updated_positions(positions, trial.complete, blade_positions(trial.motion))
    apart, stick = trial.mode == Mode.APART, trial.mode == Mode.STICK
    change = trial.change
    assert change.counters is not None
    spent = lambda before, during: before + jnp.where(during, h, 0.0)
    return RowLog(
        spent(log.time_apart, apart),
        spent(log.time_stick, stick),
        spent(log.time_slip, ~apart & ~stick),
        jnp.maximum(log.v_max, jnp.where(apart, 0.0, change.v)),
        jax.tree.map(lambda most, q: jnp.maximum(most, jnp.abs(q)), log.largest, displacements_of(trial.motion)),
        change.counters,
        *_updated_contact(log, trial, model, each),
        extent,
        positions,
    )


def _updated_contact(log: RowLog, trial: AcceptedTrial, model: RowModel, each: Each) -> tuple[Any, Any, Any]:
    """The extremes, the largest forces and the impacts of each interface, as far as they are kept."""
    if not log.searches_contact:
        return log.of_contact
    start, z = pair_states(trial.start, model.closed), both_sides(trial.end.state.motion, model.closed)
    return over(
        each,
        _updated_at_interface,
        log.of_contact,
        start,
        z,
        trial.h,
        trial.change.lift,
        trial.end.gain.loads,
        model.interfaces,
    )


def _updated_at_interface(
    log: tuple[Any, Any, Any],
    start: State,
    z: Motion,
    h: Scalar,
    lift: Lift,
    loads: ContactLoads | None,
    model: Model,
) -> tuple[Any, Any, Any]:
    """The same of one interface whose trial of `h` seconds from `start` ended at the motion `z`."""
    within, forces, impacts = log
    if within is not None:
        within = updated_extrema(within, start, z, h, start.mode == Mode.APART, lift.onset, model)
    if forces is not None:
        forces = updated_peaks(forces, start, z, h, model)
    if impacts is not None:
        impacts = updated_impacts(impacts, loads, closing_speed(z, start, model), lift.impact, lift.separation)
    return within, forces, impacts
