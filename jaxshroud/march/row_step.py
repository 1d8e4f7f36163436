"""One explicit Runge-Kutta step of a row of blades in fixed modes."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshroud.march.carry import TimeGrid
from jaxshroud.march.method import Choices
from jaxshroud.march.rk_step import TrialInterval, waves_at_nodes
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import Cluster, Each, RowModel, row_rhs
from jaxshroud.scene.keys import Motion

OfLanes = Float[Array, " lanes"]


class RowStepEnd(NamedTuple):
    """The end of a trial step of a row."""

    state: State  # in the modes and cases of the step
    wave: Any  # (sin, cos) of omega t, (lanes,) each
    gain: Integrals  # of the step


def row_interval(step: Array, done: OfLanes, length: OfLanes, grid: TimeGrid) -> TrialInterval:
    """The time interval of the next trial step, each field (lanes,)."""
    at = step.astype(done.dtype) + done
    return TrialInterval(grid.start + at * grid.turn, length * grid.turn, length * grid.h)


def row_step(
    interval: TrialInterval, start: State, cluster: Cluster | None, model: RowModel, method: Choices, each: Each
) -> RowStepEnd:
    """One step from `start`, over the `interval` of each lane."""
    tableau, h = method.rk, interval.h
    nodes = tuple(sorted({*tableau.c, 1.0}))
    found = each(lambda interval: waves_at_nodes(interval, set(nodes)), interval)
    slopes: list[State] = []
    gain = None
    for a, b, c in zip(tableau.a, tableau.b, tableau.c, strict=True):
        stage = _advanced(start, h, a[: len(slopes)], slopes, model)
        derivative, rates = row_rhs(found[c], stage, cluster, model, method.recorded, each)
        z = stage.motion
        slopes.append(State(Motion(z.v_x, z.v_y, z.v_theta, *derivative.acceleration), derivative.u_s, None, None))
        if b:
            weighted = jax.tree.map(lambda r, b=b: b * r, rates)
            gain = weighted if gain is None else jax.tree.map(jnp.add, gain, weighted)
    end = _advanced(start, h, tableau.b, slopes, model)
    return RowStepEnd(end, found[1.0], jax.tree.map(lambda g: h * g, gain))


def _advanced(start: State, h: OfLanes, weights: Any, slopes: list[State], model: RowModel) -> State:
    """The start + h sum(weights * slopes), array by array."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return start
    add = lambda z, *k: z + h * sum(w * rate for (w, _), rate in zip(used, k, strict=True))
    motion = jax.tree.map(add, start.motion, *(k.motion for _, k in used))
    flows = model.interfaces.spring.flows
    u_s = jax.tree.map(add, start.u_s, *(k.u_s for _, k in used)) if flows else start.u_s
    return State(motion, u_s, start.mode, start.case)
