"""Checks of arguments at the door."""

from typing import Any, Literal

import jax
import jax.numpy as jnp

Precision = Literal["float64", "float32"]


class NumericalError(ValueError):
    """What was asked for is in order, but the numbers do not bear it."""


def count_argument(name: str, value: int, least: int) -> None:
    """Raise ValueError unless `value` is a whole number of at least `least`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        kind = "positive" if least == 1 else f"a whole number of at least {least}"
        raise ValueError(f"Argument `{name}` must be {kind}, but is {value}.")


def tolerance_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a number of at least 0."""
    if not value >= 0:
        raise ValueError(f"Argument `{name}` must be a number of at least 0, but is {value}.")


def positive_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a positive, finite number."""
    if not 0 < value < float("inf"):
        raise ValueError(f"Argument `{name}` must be a positive number, but is {value}.")


def in_precision(tree: Any, precision: Precision) -> Any:
    """`tree` with its floating-point arrays in that precision; ValueError if digits asked for are not there."""
    floats = [a for a in jax.tree.leaves(tree) if jnp.issubdtype(a.dtype, jnp.floating)]
    if precision == "float64" and any(a.dtype != jnp.float64 for a in floats):
        raise ValueError(
            "Float64 is asked for, but these numbers are float32: call jax.config.update('jax_enable_x64', True) "
            "before the scene is made, or ask for Method(precision='float32')."
        )
    return jax.tree.map(lambda a: a.astype(precision) if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)
