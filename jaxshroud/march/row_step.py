"""One explicit Runge-Kutta step of a row of blades in fixed modes."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshroud.march.method import Choices
from jaxshroud.march.rk_step import TrialInterval, waves_at_nodes
from jaxshroud.model.arithmetic import ABSENT, zeros_for
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import Cluster, Each, RowModel, row_rhs

OfLanes = Float[Array, " lanes"]


class RowStepEnd(NamedTuple):
    """The end of a trial step of a row."""

    state: State  # in the modes and cases of the step
    wave: Any  # (sin, cos) of omega t, (lanes,) each
    gain: Integrals  # of the step


def row_step(
    interval: TrialInterval, start: State, cluster: Cluster | None, model: RowModel, method: Choices, each: Each
) -> RowStepEnd:
    """One step from `start`, over the `interval` of each lane.

    The stages are a loop, so that the kernels of interfaces and blades are compiled once for all of them.
    """
    tableau, h = method.rk, interval.h
    stages = len(tableau.b)
    padded = [[*row, *[0.0] * (stages - len(row))] for row in tableau.a]
    weights, b = jnp.asarray(padded, h.dtype), jnp.asarray(tableau.b, h.dtype)
    waves = each(lambda interval: waves_at_nodes(interval, {*tableau.c, 1.0}), interval)
    at_stages = jax.tree.map(lambda *a: jnp.stack(a), *(waves[c] for c in tableau.c))

    def stage(i: Any, carry: Any) -> Any:
        slopes, gain = carry
        now = _advanced(start, h, weights[i], slopes, model)
        derivative, rates = row_rhs(jax.tree.map(lambda a: a[i], at_stages), now, cluster, model, method.recorded, each)
        z = now.motion
        slope = model.blades.rate(z, derivative.acceleration), derivative.u_s
        gain = jax.tree.map(lambda total, rate: total + b[i] * rate, gain, rates)
        return jax.tree.map(lambda all, one: all.at[i].set(one), slopes, slope), gain

    first = jax.tree.map(lambda a: a[0], at_stages)
    nothing = zeros_for(lambda: row_rhs(first, start, cluster, model, method.recorded, each)[1])
    u_s = start.u_s if model.interfaces.law.flows else ABSENT
    none = jax.tree.map(lambda a: jnp.zeros((stages, *a.shape), a.dtype), (start.motion, u_s))
    slopes, gain = jax.lax.fori_loop(0, stages, stage, (none, nothing))
    gain = jax.tree.map(lambda g: jax.lax.broadcast_to_rank(h, g.ndim) * g, gain)
    return RowStepEnd(_advanced(start, h, b, slopes, model), waves[1.0], gain)


def _advanced(start: State, h: OfLanes, weights: Array, slopes: tuple[Any, Any], model: RowModel) -> State:
    """The start + h sum(weights * slopes), the slopes of all stages along the first axis."""
    by_stage = weights[:, None, None]
    add = lambda z, k: z + h[None] * jnp.sum(by_stage * k, axis=0)
    motion = jax.tree.map(add, start.motion, slopes[0])
    u_s = add(start.u_s, slopes[1]) if model.interfaces.law.flows else start.u_s
    return State(motion, u_s, start.mode, start.case)
