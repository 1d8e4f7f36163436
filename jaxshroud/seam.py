"""Fusion boundaries for XLA:CPU.

XLA:CPU fuses a producer into each of its consumers, so every output of a Runge-Kutta step would recompute all its
stages. A `lax.cond` on a traced predicate that is the same for all lanes cannot be fused through. In the batched march
the boundaries below halve the time per trial; a single lane does not need them.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int


class Seam(eqx.Module):
    """Calls a function as it is (`one` is None), or behind a fusion boundary (`one` is a traced 1)."""

    one: Int[Array, ""] | None = None

    def __call__(self, f: Callable, *args):
        """`f(*args)`; arguments that are not arrays are compile-time constants."""
        arrays, static = eqx.partition(args, eqx.is_array)
        if self.one is None:
            return f(*args)
        call = lambda arrays: f(*eqx.combine(arrays, static))  # noqa: E731
        shape = jax.eval_shape(call, arrays)
        never = lambda _: jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)  # noqa: E731
        return lax.cond(self.one > 0, call, never, arrays)
