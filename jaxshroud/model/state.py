"""What moves: the state of one lane, its contact mode and how its run ended."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxshroud.scene.motion import Motion


class State(eqx.Module):
    """Motion and contact of one lane.

    Scalars in compiled code, arrays of lanes outside.
    """

    motion: Motion
    u_s: Any  # slider of Eq. (2), meaningful in contact only [m]
    mode: Any  # see `Mode`
    case: Any  # 1-4 (Sec. 2.3), 5 in flat contact, 0 when apart


def start(motion: Motion) -> State:
    """The state at t = 0: apart. A start with the blocks already overlapping becomes an onset at once."""
    zero = jnp.zeros((), jnp.int32)
    return State(motion, jnp.zeros((), motion.x.dtype), zero, zero)


def as_pairs(tree: Any) -> Any:
    """`tree` with every (2,) array as a tuple of two scalars: one flat array per number when lanes are batched."""
    return jax.tree.map(lambda a: (a[0], a[1]) if jnp.ndim(a) == 1 else a, tree)
