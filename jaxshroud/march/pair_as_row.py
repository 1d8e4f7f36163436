"""A pair as an unrolled row of two blades: its Runge-Kutta trial is that of the row."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxshroud.march.accumulator import Accumulator, EnergyJumps
from jaxshroud.march.carry import Fixed, Lane, Search
from jaxshroud.march.log import is_of_blades, log_of, value_in
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import row_trial
from jaxshroud.model.arithmetic import ZERO, Unrolled, is_unrolled, is_zero
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.row import RowModel


def alone(f: Callable[..., Any], *args: Any) -> Any:
    """`f` of one lane."""
    return f(*args)


def along_blades(tree: Any) -> Any:
    """A tree of pairs along an unrolled axis."""

    def along(a):
        if not is_of_blades(a):
            return a
        return ZERO if all(map(is_zero, a)) else Unrolled(*a)

    return jax.tree.map(along, tree, is_leaf=is_of_blades)


def as_interface(tree: Any) -> Any:
    """A tree of numbers of the only interface along an unrolled axis."""
    return jax.tree.map(Unrolled, tree)


def of_interface(tree: Any) -> Any:
    return jax.tree.map(lambda a: a[0] if is_unrolled(a) else a, tree, is_leaf=is_unrolled)


def as_pairs(tree: Any) -> Any:
    return jax.tree.map(lambda a: tuple(a) if is_unrolled(a) else a, tree, is_leaf=is_unrolled)


def row_of_pair(model: Model) -> RowModel:
    return RowModel(
        blades=along_blades(model.blades),
        drive=along_blades(model.drive),
        inverse=along_blades(model.mobility.inverse),
        gyration=model.gyration,
        static=along_blades(model.static),
        interfaces=as_interface(model),
        coupling=as_interface(model.coupling),
        aero=None,
        closed=False,
        parts=model.parts,
        is_pair=True,
    )


def row_state(state: State) -> State:
    contact = as_interface((state.u_s, state.mode, state.case))
    return State(along_blades(state.motion), *contact)


def pair_state(state: State) -> State:
    motion = type(state.motion)._make((ZERO, ZERO) if is_zero(a) else tuple(a) for a in state.motion)
    return State(motion, *of_interface((state.u_s, state.mode, state.case)))


def row_lane(lane: Lane, method: Choices) -> Lane:
    search: Search = lane.search
    if search.target is not None:
        search = search._replace(target=search.target._replace(place=jnp.zeros_like(search.target.kind)))
    old = lane.accumulator
    sums = old.integrals
    integrals = sums._replace(
        power=along_blades(sums.power), moments=along_blades_each(sums.moments), loads=as_interface(sums.loads)
    )
    zero = lane.search.done
    jumps = None
    if old.jumps is not None:
        jumps = EnergyJumps(Unrolled(old.jumps.springs), jnp.zeros_like(zero) if is_zero(old.jumps.dropped) else old.jumps.dropped)
    log = None
    if old.log is not None:
        log = log_of({one.name: _to_row(one.per, value_in(old.log, one.name)) for one in observables_of(method)})
    accumulator = Accumulator(integrals, jumps, log, as_interface(old.margins))
    return Lane(row_state(lane.state), lane.step, search, as_interface(lane.guards), accumulator, lane.status)


def along_blades_each(tree: Any) -> Any:
    return None if tree is None else type(tree)._make(tuple(map(along_blades, part)) for part in tree)


def _to_row(per: str, value: Any) -> Any:
    if per == "interface":
        return as_interface(value)
    if per == "blade":
        if type(value) is tuple:
            return tuple(map(along_blades, value))
        return jax.tree.map(lambda a: a, _deep(value))
    return value


def _deep(value: Any) -> Any:
    if is_of_blades(value):
        return along_blades(value)
    if isinstance(value, tuple):
        made = [_deep(a) for a in value]
        return type(value)._make(made) if hasattr(value, "_make") else tuple(made)
    return value


def _to_pair(per: str, value: Any, like: Any) -> Any:
    if per == "interface":
        return of_interface(value)
    if per == "blade":
        return jax.tree.unflatten(jax.tree.structure(like), jax.tree.leaves(value))
    return value


def pair_lane(lane: Lane, like: Lane, method: Choices) -> Lane:
    search: Search = lane.search
    if search.target is not None:
        search = search._replace(target=search.target._replace(place=None))
    search = search._replace(pending=None, turns=None)
    new, old = lane.accumulator, like.accumulator
    integrals = jax.tree.unflatten(jax.tree.structure(old.integrals), jax.tree.leaves(new.integrals))
    jumps = None
    if new.jumps is not None:
        jumps = EnergyJumps(new.jumps.springs[0], ZERO if is_zero(old.jumps.dropped) else new.jumps.dropped)
    log = None
    if new.log is not None:
        log = log_of(
            {
                one.name: _to_pair(one.per, value_in(new.log, one.name), value_in(old.log, one.name))
                for one in observables_of(method)
            }
        )
    accumulator = Accumulator(integrals, jumps, log, of_interface(new.margins))
    return Lane(pair_state(lane.state), lane.step, search, of_interface(lane.guards), accumulator, lane.status)


def pair_trial(lane: Lane, fixed: Fixed[Model], method: Choices) -> Lane:
    constants = Fixed(row_of_pair(fixed.model), fixed.grid, fixed.stop)
    return pair_lane(row_trial(row_lane(lane, method), constants, method, alone), lane, method)
