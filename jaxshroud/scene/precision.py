"""Numbers in the precision asked for."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxshroud.scene.checks import Precision
from jaxshroud.scene.errors import InputError


def in_precision(tree: Any, precision: Precision) -> Any:
    """`tree` with its floating-point arrays in that precision; ValueError if digits asked for are not there."""
    floats = [a for a in jax.tree.leaves(tree) if jnp.issubdtype(a.dtype, jnp.floating)]
    if precision == "float64" and any(a.dtype != jnp.float64 for a in floats):
        raise InputError(
            "Float64 is asked for, but these numbers are float32: call jax.config.update('jax_enable_x64', True) "
            "before the scene is made, or ask for Method(precision='float32')."
        )
    return jax.tree.map(lambda a: a.astype(precision) if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)
