"""A pair as an unrolled row of two blades: its Runge-Kutta trials are those of the row."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxshroud.march.accumulator import Accumulator, EnergyJumps, Log
from jaxshroud.march.carry import Fixed, Lane, Search, new_search
from jaxshroud.march.event import check_own_events, guards_to_begin_with
from jaxshroud.march.events import evaluate_guards
from jaxshroud.march.log import log_of, new_accumulator, value_in
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import row_trial, step_of_trial
from jaxshroud.model.arithmetic import ZERO, Unrolled, is_of_blades, is_zero, zeros_for
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.row import Each, RowModel


def along_blades(tree: Any) -> Any:
    """A tree of pairs along an unrolled axis of blades."""

    def along(a: Any) -> Any:
        if not is_of_blades(a):
            return a
        return ZERO if all(map(is_zero, a)) else Unrolled(*a)

    return jax.tree.map(along, tree, is_leaf=is_of_blades)


def at_interface(tree: Any) -> Any:
    """A tree of numbers of the only interface along an unrolled axis of interfaces."""
    return jax.tree.map(Unrolled, tree)


def row_of_pair(model: Model) -> RowModel:
    """The row of a pair."""
    return RowModel(
        blades=along_blades(model.blades),
        drive=along_blades(model.drive),
        inverse=along_blades(model.mobility.inverse),
        gyration=model.gyration,
        static=along_blades(model.static),
        interfaces=at_interface(model),
        coupling=at_interface(model.coupling),
        aero=None,
        closed=False,
        parts=model.parts,
        is_pair=True,
    )


def state_of_row(state: State) -> State:
    """The state of a pair as one of a row."""
    u_s, mode, case = at_interface((state.u_s, state.mode, state.case))
    return State(along_blades(state.motion), u_s, mode, case)


def begin_pair(state: State, model: Model, method: Choices) -> Lane:
    """A pair at step 0. The first trial has length zero: it sets the guards."""
    zero, step = jnp.zeros_like(state.motion.x[0]), jnp.zeros((), jnp.int32)
    accumulator = new_accumulator(state, model, method)
    guards = None
    check_own_events(method.events, model.law.has_events)
    if model.law.has_events:

        def waves():
            return drive_waves(zero, zero, model.drive)

        def evaluate():
            return evaluate_guards(state.motion, waves(), state, model, method.all_events)

        guards = guards_to_begin_with(zeros_for(evaluate).guards, method.all_events)
    search = new_search(zero, zero, jnp.ones((), bool), step, method.locate)
    return Lane(state, step, search, guards, accumulator, step)


def row_trial_of_pair(lane: Lane, fixed: Fixed[Model], method: Choices, each: Each) -> Lane:
    """One trial step of pairs."""
    constants = Fixed(row_of_pair(fixed.model), fixed.grid, fixed.stop)
    after = row_trial(_as_row(lane, method), constants, method, each)
    jumps = after.accumulator.jumps
    if jumps is not None and lane.accumulator.jumps is not None and is_zero(lane.accumulator.jumps.dropped):
        jumps = EnergyJumps(jumps.springs, ZERO)
    after = Lane(
        after.state,
        after.step,
        _with_place(after.search, None)._replace(pending=None),
        after.guards,
        after.accumulator._replace(jumps=jumps),
        after.status,
    )
    return jax.tree.unflatten(jax.tree.structure(lane), jax.tree.leaves(after))


def end_of_trial(lane: Lane, fixed: Fixed[Model], method: Choices, each: Each) -> State:
    """The states of pairs where their next trials end, in the modes of these."""
    constants = Fixed(row_of_pair(fixed.model), fixed.grid, fixed.stop)
    end = step_of_trial(_as_row(lane, method), constants, method, each)
    return jax.tree.unflatten(jax.tree.structure(lane.state), jax.tree.leaves(end.state))


def _with_place(search: Search, place: Any) -> Search:
    return search if search.target is None else search._replace(target=search.target._replace(place=place))


def _as_row(lane: Lane, method: Choices) -> Lane:
    """A pair as a row."""
    search = _with_place(lane.search, jnp.zeros_like(lane.step))
    if method.derivative:
        search = search._replace(pending=Unrolled(jnp.zeros_like(lane.search.recheck)))
    sums, jumps, log, margins = lane.accumulator
    integrals = sums._replace(
        power=along_blades(sums.power), moments=along_blades(sums.moments), loads=at_interface(sums.loads)
    )
    if jumps is not None:
        dropped = jnp.zeros_like(jumps.springs) if is_zero(jumps.dropped) else jumps.dropped
        springs: Any = Unrolled(jumps.springs)
        jumps = EnergyJumps(springs, dropped)
    accumulator = Accumulator(integrals, jumps, _log_of_row(log, method), at_interface(margins))
    return Lane(state_of_row(lane.state), lane.step, search, at_interface(lane.guards), accumulator, lane.status)


def _log_of_row(log: Log | None, method: Choices) -> Log | None:
    if log is None:
        return None
    along = {"interface": at_interface, "blade": along_blades, "left blade": lambda tree: tree}
    return log_of({one.name: along[one.per](value_in(log, one.name)) for one in observables_of(method)})
