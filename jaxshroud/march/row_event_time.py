"""The derivative of the instants of events in a row of blades.

With derivatives the events of one instant are crossed one after the other, the later ones in trials of length zero:
each has an instant of its own, which a direction may move apart from the others. Forces of interfaces add up, so that
their order does not matter.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import Fixed, Lane
from jaxshroud.march.locate import at_event, event_tolerance, select_guard
from jaxshroud.march.method import Choices
from jaxshroud.march.rk_step import interval_in_step
from jaxshroud.march.row_guards import row_guards
from jaxshroud.march.row_step import OfLanes, RowStepEnd, row_step
from jaxshroud.model.arithmetic import ABSENT
from jaxshroud.model.prepared import State
from jaxshroud.model.row import Each, RowModel, clusters_of


class RowCrossing(NamedTuple):
    """The events that a trial crosses."""

    fires: Bool[Array, "interfaces lanes"]
    kind: Int[Array, "interfaces lanes"]
    is_root: Bool[Array, " lanes"]  # it ends where the guard vanishes, rather than at a prescribed instant
    delay: OfLanes  # upper bound of the time since the event [s]
    pending: Bool[Array, "interfaces lanes"] | None  # events of this instant that are left; None: no derivatives


def one_after_the_other(crossing: RowCrossing, lane: Lane, place: Any, h: OfLanes, method: Choices) -> RowCrossing:
    """The crossing of the event at `place` alone, in a step of `h` seconds, with those that are left."""
    search, here = lane.search, jnp.arange(len(crossing.fires), dtype=jnp.int32)[:, None] == place[None]
    assert search.pending is not None
    moves = search.length > 0
    first, eligible = crossing.fires & here, crossing.fires & (search.pending | moves[None])
    fires = jnp.any(first, axis=0)
    waits = ~moves & jnp.any(first & search.pending, axis=0)
    finest = event_tolerance(jnp.zeros((), bool), method, h.dtype)
    return RowCrossing(
        first,
        crossing.kind,
        fires & (moves | waits),
        jnp.where(waits, finest * h, crossing.delay),
        jnp.where(fires[None], eligible & ~first, search.pending),
    )


def differentiable_event_end(
    end: RowStepEnd, lane: Lane, crossing: RowCrossing, fixed: Fixed[RowModel], method: Choices, each: Each
) -> tuple[RowStepEnd, OfLanes]:
    """The end of a trial and its length in steps, with derivatives where it ends at the root of a guard.

    The slopes are those of the step by its own length, so that what is computed is differentiated exactly.
    """
    ends, length = jnp.any(crossing.fires, axis=0) & crossing.is_root, lane.search.length
    still = lambda: (end, length)
    return lax.cond(jnp.any(ends), lambda: _at_root(end, lane, ends, crossing, fixed, method, each), still)


def _at_root(
    end: RowStepEnd,
    lane: Lane,
    ends: Bool[Array, " lanes"],
    crossing: RowCrossing,
    fixed: Fixed[RowModel],
    method: Choices,
    each: Each,
) -> tuple[RowStepEnd, OfLanes]:
    """`differentiable_event_end` where some of the lanes end at a root."""
    flows = fixed.model.interfaces.law.flows
    moving = lambda end: (end.state.motion, end.state.u_s if flows else ABSENT, end.gain)

    def guard(end: RowStepEnd, fixed: Fixed[RowModel]) -> OfLanes:
        values = select_guard(
            row_guards(end.state, end.wave, fixed.model, each, method.all_events).value, crossing.kind
        )
        return jnp.sum(jnp.where(crossing.fires, values, 0.0), axis=0)

    def after(length: OfLanes) -> tuple[Any, OfLanes]:
        row, constants = lax.stop_gradient((lane, fixed))
        interval = interval_in_step(row.step, row.search.done, length, constants.grid)
        cluster = clusters_of(row.state, constants.model)
        stepped = row_step(interval, row.state, cluster, constants.model, method, each)
        return moving(stepped), guard(stepped, constants)

    length = lane.search.length
    _, (slopes, rate) = jax.jvp(after, (lax.stop_gradient(length),), (jnp.ones_like(length),))
    rate = jnp.where(ends & (rate > 0), rate, jnp.inf)
    quantities, slopes = (*moving(end), length), (*slopes, jnp.ones_like(length))
    motion, u_s, gain, length = at_event(quantities, slopes, guard(end, fixed), rate)
    state = State(motion, u_s if flows else end.state.u_s, end.state.mode, end.state.case)
    return RowStepEnd(state, end.wave, gain), length
