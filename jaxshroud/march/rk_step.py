"""One explicit Runge-Kutta step in a fixed mode."""

import math
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.march.carry import Lane, PerLane, TimeGrid
from jaxshroud.model.arithmetic import Pair, Scalar, plus, sincos_turns, sine_versine, times
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals


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
