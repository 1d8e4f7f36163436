"""The tally of rows of blades through their trials; what is logged, and how, stands in `logged`."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxshroud.march.events import place_contact
from jaxshroud.march.log import log_of, value_in
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Beginning, BladeTrial, InterfaceTrial, Observable, Per
from jaxshroud.march.tally import Log, Tally
from jaxshroud.march.trial import AcceptedTrial
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.row import Each, OfInterfaces, RowModel, both_sides, over, pair_states
from jaxshroud.scene.keys import Motion


def penetrations(state: State, model: RowModel, each: Each) -> OfInterfaces:
    """The penetration at each interface [m]."""
    return over(each, _penetration_at, pair_states(state, model), model.interfaces)


def _penetration_at(state: State, model: Model) -> Scalar:
    return place_contact(state.motion, state, model)[2].v


def new_row_log(state: State, at: OfInterfaces, model: RowModel, method: Choices, each: Each) -> Log:
    """The log of a row that starts from `state`; `at` are zeros."""
    motion, v = model.blades.shroud(state.motion), penetrations(state, model, each)
    contact = Beginning(None, at, v, model.interfaces)
    zero = jnp.zeros_like(motion.x)
    blades = Beginning(motion, zero, zero, None)
    start = lambda one: one.start(contact if one.per == "interface" else blades)
    return log_of({one.name: start(one) for one in observables_of(method)})


def updated_row_tally(tally: Tally, trial: AcceptedTrial, model: RowModel, method: Choices, each: Each) -> Tally:
    """The tally after a trial; margins are kept."""
    tally = tally.plus(trial.gain, trial.jumps)
    return tally if tally.log is None else tally._replace(log=_updated_row_log(tally.log, trial, model, method, each))


def _updated_row_log(log: Log, trial: AcceptedTrial, model: RowModel, method: Choices, each: Each) -> Log:
    shroud = model.blades.shroud
    end = shroud(trial.end)
    contact = InterfaceTrial(trial.h, trial.mode, trial.v, trial.mode == Mode.APART)
    blades = BladeTrial(shroud(trial.start.motion), end, shroud(trial.after), trial.h, trial.step, trial.next_step)
    at_once = {
        one.name: one.update(value_in(log, one.name), contact if one.per == "interface" else blades)
        for one in observables_of(method)
        if one.takes == "all"
    }
    values = at_once | trial.events
    if takers_of_one("interface", method):
        start, end = pair_states(trial.start, model), both_sides(end, model.closed)
        loads = trial.gain.loads
        contact = contact._replace(start=start, end=end, lift=trial.lift, loads=loads, model=model.interfaces)
        values |= _updated_each(log, contact, takers_of_one("interface", method), each)
    if takers_of_one("blade", method):
        values |= _updated_each(log, blades, takers_of_one("blade", method), each)
    return log_of(values)


def takers_of_one(per: Per, method: Choices) -> list[Observable]:
    """The observables whose functions take one interface, or one blade."""
    return [one for one in observables_of(method) if one.per.endswith(per) and one.takes == "one"]


def takers_of_events(method: Choices) -> list[Observable]:
    """The observables whose updates take the event that ends a trial."""
    return [one for one in observables_of(method) if one.takes == "event"]


def _updated_each(log: Log, trial: Any, observables: list[Observable], each: Each) -> dict[str, Any]:
    """The values of observables after a trial of each interface, or of each blade, in one kernel."""

    def updated(values: dict[str, Any], trial: Any) -> dict[str, Any]:
        return {one.name: one.update(values[one.name], trial) for one in observables}

    return over(each, updated, {one.name: value_in(log, one.name) for one in observables}, trial)


def tally_of_new_period(tally: Tally, z: Motion, method: Choices) -> Tally:
    """The tally with what is told of each period reset, at the motion `z`."""
    integrals, jumps = jax.tree.map(jnp.zeros_like, (tally.integrals, tally.jumps))
    log = tally.log
    if log is not None:
        log = log_of({one.name: one.reset(value_in(log, one.name), z) for one in observables_of(method)})
    return Tally(integrals, jumps, log, tally.margins)
