"""The search for an event inside a step, by trial after trial, of a pair or of a row."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import NEGLIGIBLE_REST, PerLane
from jaxshroud.march.method_names import Locate
from jaxshroud.model.arithmetic import where


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
    refinements: Int[Array, "..."] | None = None  # times that the event of a pair was located, for its derivative
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
    refines: bool,
    of_row: bool = False,
) -> Search:
    """A search without a bracket; `refines`: an event is located several times, for its derivative."""
    zero, no, none = jnp.zeros_like(done), jnp.zeros_like(done, bool), jnp.zeros_like(done, jnp.int32)
    target = Target(none, zero, zero, zero, none, none if of_row else None) if locate == "cubic" else None
    refinements = none if refines and locate != "none" else None
    return Search(done, length, zero, zero, no, no, no, recheck, events, target, refinements)


def following_search(
    search: Search, step: Int[Array, "..."], fire: Bool[Array, "..."], recheck: Bool[Array, "..."], locate: Locate
) -> tuple[Search, Int[Array, "..."]]:
    """The search of the next trial, and the clock, after an accepted trial."""
    done = search.done + search.length
    complete = done >= 1 - NEGLIGIBLE_REST[done.dtype.itemsize]
    done = where(complete, 0.0, done)
    events = where(complete, 0, search.events + fire.astype(jnp.int32))
    of_row = search.target is not None and search.target.place is not None
    length, refines = where(recheck, 0.0, 1 - done), search.refinements is not None
    after = new_search(done, length, recheck, events, locate, refines, of_row)
    # a trial that ended at the maximum of a guard leaves it there, where the next trial need not look for it
    after = after._replace(probing=search.probing & ~fire & ~complete, pending=search.pending)
    turns = None if search.turns is None else where(complete, 0, search.turns)
    return after._replace(turns=turns), step + complete.astype(jnp.int32)
