"""One explicit Runge-Kutta step of a row of blades in fixed modes, and the derivative of the instants of events.

With derivatives the events of one instant are crossed one after the other, the later ones in trials of length zero:
each has an instant of its own, which a direction may move apart from the others. Forces of interfaces add up, so that
their order does not matter.
"""

import math
from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.march.carry import Fixed, Lane, PerLane, TimeGrid
from jaxshroud.march.locate import at_event, select_guard
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import row_guards
from jaxshroud.model.arithmetic import (
    ZERO,
    Pair,
    Scalar,
    any_along,
    has_unrolled,
    is_unrolled,
    plus,
    sincos_turns,
    sine_versine,
    times,
    total,
    where,
    zeros_for,
)
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import Cluster, Each, FlatPair, RowModel, alone, clusters_of, row_rhs


class TrialInterval(NamedTuple):
    """The time interval of a trial step."""

    turns: PerLane  # drive phase at its start [turns]
    dturns: PerLane  # advance of the drive phase [turns]
    h: PerLane  # its length [s]


def interval_in_step(step: Int[Array, "..."], done: PerLane, length: PerLane, grid: TimeGrid) -> TrialInterval:
    """The time interval of so much of a `step` after the part that is `done`."""
    at = step.astype(done.dtype) + done
    return TrialInterval(grid.start + at * grid.turn, length * grid.turn, length * grid.h)


def trial_interval(lane: Lane, grid: TimeGrid) -> TrialInterval:
    """The time interval of the next trial step of a lane, or of a row."""
    return interval_in_step(lane.step, lane.search.done, lane.search.length, grid)


def weighted_sum(total: Integrals | None, weight: float, rates: Integrals) -> Integrals | None:
    """The sum of the integrals' rates times weights so far, with one more; None without any."""
    weighted = jax.tree.map(lambda a: weight * a, rates) if weight else None
    return weighted if total is None else total if weighted is None else jax.tree.map(jnp.add, total, weighted)


def waves_at_nodes(interval: TrialInterval, nodes: set[float]) -> dict[float, Pair]:
    """(sin, cos) of the drive's phase at some nodes of the tableau, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(interval.turns)

    def advanced(s, v):
        return (s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s)

    return {c: advanced(*by) if c else (s_0, c_0) for c, by in _node_angles(interval.dturns, nodes).items()}


def _node_angles(dturns: Scalar, nodes: set[float]) -> dict[float, Pair]:
    """The sine and versine of the drive's phase advance up to the nodes, by double angles where possible."""
    angles: dict[float, Pair] = {}
    for c in sorted(nodes):
        if c / 2 in angles and c:
            s, v = angles[c / 2]
            angles[c] = 2 * (s - s * v), 2 * s * s
        else:
            angles[c] = sine_versine(2 * math.pi * c * dturns)
    return angles


def stage_state(start: State, h: Scalar, weights, slopes: Any, flows: bool) -> State:
    """The start + h sum(weights * slopes), number by number."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return start
    weights, slopes = zip(*used, strict=True)

    def add(z, *k):
        return plus(z, times(h, reduce(plus, map(times, weights, k), 0)))

    motion = jax.tree.map(add, start.motion, *(k.motion for k in slopes))
    u_s = jax.tree.map(add, start.u_s, *(k.u_s for k in slopes)) if flows else start.u_s
    return State(motion, u_s, start.mode, start.case)


OfLanes = Float[Array, "..."]


def whole(each: Each, f: Callable[..., Any], *trees: Any) -> Any:
    """`f(*trees, each=...)` of rows: of unrolled ones as one kernel, of others with its own kernels."""
    if each is alone or not has_unrolled(trees):
        return f(*trees, each=each)
    return each(partial(f, each=alone), *trees)


class RowStepEnd(NamedTuple):
    """The end of a trial step of a row."""

    state: State  # in the modes and cases of the step
    wave: Any  # (sin, cos) of omega t, (lanes,) each
    gain: Integrals  # of the step


def row_step(
    interval: TrialInterval,
    start: State,
    cluster: Cluster | FlatPair | None,
    model: RowModel,
    method: Choices,
    each: Each,
) -> RowStepEnd:
    """One step from `start`, over the `interval` of each lane.

    The stages are a loop, so that the kernels of interfaces and blades are compiled once for all of them.
    """
    if is_unrolled(start.case) and each is alone:
        return _unrolled_step(interval, start, cluster, model, method)
    tableau, h = method.rk, interval.h
    stages = len(tableau.b)
    padded = [[*row, *[0.0] * (stages - len(row))] for row in tableau.a]
    weights, b = jnp.asarray(padded, h.dtype), jnp.asarray(tableau.b, h.dtype)
    waves = each(lambda interval: waves_at_nodes(interval, {*tableau.c, 1.0}), interval)
    at_stages = jax.tree.map(lambda *a: jnp.stack(a), *(waves[c] for c in tableau.c))

    rates_of = partial(row_rhs, recorded=method.recorded)

    def stage(i: Any, carry: Any) -> Any:
        slopes, gain = carry
        now = _advanced(start, h, weights[i], slopes, model)
        at = jax.tree.map(lambda a: a[i], at_stages)
        derivative, rates = whole(each, rates_of, at, now, cluster, model)
        z = now.motion
        slope = model.blades.rate(z, derivative.acceleration), derivative.u_s
        gain = jax.tree.map(lambda total, rate: total + b[i] * rate, gain, rates)
        return jax.tree.map(lambda all, one: all.at[i].set(one), slopes, slope), gain

    first = jax.tree.map(lambda a: a[0], at_stages)
    nothing = zeros_for(lambda: whole(each, rates_of, first, start, cluster, model)[1])
    u_s = start.u_s if model.interfaces.law.flows else ZERO
    none = jax.tree.map(lambda a: jnp.zeros((stages, *a.shape), a.dtype), (start.motion, u_s))
    slopes, gain = jax.lax.fori_loop(0, stages, stage, (none, nothing))
    gain = jax.tree.map(lambda g: jax.lax.broadcast_to_rank(h, g.ndim) * g, gain)
    return RowStepEnd(_advanced(start, h, b, slopes, model), waves[1.0], gain)


def _unrolled_step(
    interval: TrialInterval, start: State, cluster: Cluster | FlatPair | None, model: RowModel, method: Choices
) -> RowStepEnd:
    """`row_step` of one lane, with its stages one after the other."""
    tableau, h = method.rk, interval.h
    flows = model.interfaces.law.flows
    waves = waves_at_nodes(interval, {*tableau.c, 1.0})
    slopes: list[State] = []
    gain = None
    for i, c in enumerate(tableau.c):
        now = stage_state(start, h, tableau.a[i][:i], slopes, flows)
        derivative, rates = row_rhs_once(waves[c], now, cluster, model, method.recorded, alone)
        rate = model.blades.rate(now.motion, derivative.acceleration)
        slopes.append(State(rate, derivative.u_s, None, None))
        gain = weighted_sum(gain, tableau.b[i], rates)
    gain = jax.tree.map(lambda a: h * a, gain)
    return RowStepEnd(stage_state(start, h, tableau.b, slopes, flows), waves[1.0], gain)


row_rhs_once = jax.jit(row_rhs, static_argnames=("recorded", "each"), inline=True)  # traced once for all stages


def _advanced(start: State, h: OfLanes, weights: Array, slopes: tuple[Any, Any], model: RowModel) -> State:
    """The start + h sum(weights * slopes), the slopes of all stages along the first axis."""

    def add(z, k):
        by_stage = weights.reshape(-1, *[1] * z.ndim)
        return z + h * jnp.sum(by_stage * k, axis=0)

    motion = jax.tree.map(add, start.motion, slopes[0])
    u_s = jax.tree.map(add, start.u_s, slopes[1]) if model.interfaces.law.flows else start.u_s
    return State(motion, u_s, start.mode, start.case)


class RowCrossing(NamedTuple):
    """The events that a trial crosses."""

    fires: Bool[Array, "interfaces lanes"]
    kind: Int[Array, "interfaces lanes"]
    is_root: Bool[Array, "..."]  # it ends where the guard vanishes, rather than at a prescribed instant
    delay: OfLanes  # upper bound of the time since the event [s]
    pending: Bool[Array, "interfaces lanes"] | None  # events of this instant that are left; None: no derivatives


def differentiable_event_end(
    end: RowStepEnd, lane: Lane, crossing: RowCrossing, fixed: Fixed[RowModel], method: Choices, each: Each
) -> tuple[RowStepEnd, OfLanes]:
    """The end of a trial and its length in steps, with derivatives where it ends at the root of a guard.

    The slopes are those of the step by its own length, so that what is computed is differentiated exactly.
    """
    ends = any_along(crossing.fires) & crossing.is_root
    length = lane.search.length

    def still():
        return (end, length)

    def at_root():
        found = partial(_at_root, method=method)
        trees = end, lane, ends, crossing, fixed
        return whole(each, found, *trees) if method.large_kernels else found(*trees, each=each)

    return lax.cond(jnp.any(ends), at_root, still)


def _at_root(
    end: RowStepEnd,
    lane: Lane,
    ends: Bool[Array, "..."],
    crossing: RowCrossing,
    fixed: Fixed[RowModel],
    method: Choices,
    each: Each,
) -> tuple[RowStepEnd, OfLanes]:
    """`differentiable_event_end` where some of the lanes end at a root."""
    flows = fixed.model.interfaces.law.flows

    def moving(end):
        return (end.state.motion, end.state.u_s if flows else ZERO, end.gain)

    def guard(end: RowStepEnd, fixed: Fixed[RowModel]) -> OfLanes:
        values = select_guard(
            row_guards(end.state, end.wave, fixed.model, each, method.all_events).value, crossing.kind
        )
        return total(where(crossing.fires, values, 0.0))

    def after(length: OfLanes) -> tuple[Any, OfLanes]:
        row, constants = lax.stop_gradient((lane, fixed))
        interval = interval_in_step(row.step, row.search.done, length, constants.grid)
        cluster = clusters_of(row.state, constants.model)
        stepped = row_step(interval, row.state, cluster, constants.model, method, each)
        return moving(stepped), guard(stepped, constants)

    length = lane.search.length
    _, (slopes, rate) = jax.jvp(after, (lax.stop_gradient(length),), (jnp.ones_like(length),))
    rate = where(ends & (rate > 0), rate, jnp.inf)
    quantities, slopes = (*moving(end), length), (*slopes, jnp.ones_like(length))
    motion, u_s, gain, length = at_event(quantities, slopes, guard(end, fixed), rate)
    state = State(motion, u_s if flows else end.state.u_s, end.state.mode, end.state.case)
    return RowStepEnd(state, end.wave, gain), length
