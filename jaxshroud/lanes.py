"""One function of one lane, run on many lanes.

XLA:CPU makes one kernel per number that a function returns, each recomputing or reloading what it needs. For a trial
step, with some fifty results of some two thousand operations, that is three to four times slower than one loop over
the lanes with everything in registers. A windowed reduction over several arrays is such a loop: its reducer may be any
function of scalars and returns all results at once. With windows of one lane there is nothing to reduce, and the
reducer is simply called once for each lane.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import jaxpr_as_fun

# (f, carried, fixed): `f(carried, fixed)`, alike in shape to `carried`, of every lane; all arrays have a lane axis
EachLane = Callable[[Callable, Any, Any], Any]


def plain(f: Callable, carried: Any, fixed: Any) -> Any:
    """By `jax.vmap`: runs, and differentiates, anywhere."""
    return jax.vmap(f)(carried, fixed)


def fused(f: Callable, carried: Any, fixed: Any) -> Any:
    """As one kernel; `f` may use elementwise operations on scalars only."""
    leaves, tree = jax.tree.flatten((carried, fixed))
    like, kept = jax.tree.structure(carried), len(jax.tree.leaves(carried))
    scalars = [jax.ShapeDtypeStruct((), a.dtype) for a in leaves]
    one = jaxpr_as_fun(jax.make_jaxpr(lambda *a: jax.tree.leaves(f(*tree.unflatten(a))))(*scalars))
    # as many results as operands are asked for: the fixed ones pass through
    reducer = lambda _, lane: (*one(*lane), *lane[kept:])  # noqa: E731
    zeros = tuple(jnp.zeros((), a.dtype) for a in leaves)
    return like.unflatten(lax.reduce_window(tuple(leaves), zeros, reducer, (1,), (1,), "VALID")[:kept])


@cache
def best() -> EachLane:
    """`fused` on a CPU where it does what it should, else `plain`."""
    if jax.default_backend() != "cpu":
        return plain
    lanes = jnp.arange(1.0, 9.0)
    double = jax.jit(lambda a, b: fused(lambda a, b: (a[0] * b, -a[0]), (a, a), b))
    try:
        got = double(lanes, 2 * lanes)
    except Exception:  # whatever a future XLA may object to, the plain way remains
        return plain
    return fused if bool(jnp.all(got[0] == 2 * lanes**2) & jnp.all(got[1] == -lanes)) else plain
