"""The numbers of a scene as arrays: one of the scene, or one of each blade."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.scene.typed import are_numbers

PerBlade = Float[Array, "... blades"]  # left blade first; two in a scene without a row


def per_blade(value: Any) -> Any:
    """The `value` as one number per blade; a single number means equal blades."""
    if not are_numbers(value):
        return value  # refused later, with its name
    if isinstance(value, int | float):
        return _from_numpy(np.full(2, value, float))
    if isinstance(value, tuple | list):
        if all(isinstance(v, int | float) for v in value):
            return _from_numpy(np.array(value, float))
        return jnp.stack([jnp.asarray(v, dtype=float) for v in value], axis=-1)
    value = jnp.asarray(value, dtype=float)
    return jnp.broadcast_to(value, (2,)) if value.ndim == 0 else value


def scalar(value: Any) -> Any:
    """The `value` as a float array, so that changing it never recompiles."""
    if not are_numbers(value):
        return value
    return _from_numpy(np.array(value, float)) if isinstance(value, int | float) else jnp.asarray(value, dtype=float)


def _from_numpy(value: np.ndarray) -> Array:
    """The JAX array of plain numbers that come by NumPy, so that nothing is compiled."""
    return jnp.asarray(value, dtype=float)
