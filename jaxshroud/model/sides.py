"""The blades left and right of each interface of a row, and sums over the interfaces of each blade."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxshroud.model.arithmetic import is_zero


def left_of_interfaces(a: Array, closed: bool) -> Array:
    """The numbers of the blade left of each interface."""
    return a if closed else a[:-1]


def right_of_interfaces(a: Array, closed: bool) -> Array:
    """The numbers of the blade right of each interface."""
    return jnp.roll(a, -1, 0) if closed else a[1:]


def both_sides(tree: Any, closed: bool) -> Any:
    """A tree of numbers of blades as one of pairs at interfaces."""

    def sides(a):
        return (a, a) if is_zero(a) else (left_of_interfaces(a, closed), right_of_interfaces(a, closed))

    return jax.tree.map(sides, tree, is_leaf=is_zero)


def sum_at_blades(on_left: Array, on_right: Array, closed: bool) -> Array:
    """The sum of what its two interfaces add to each blade: on their left and on their right sides."""
    if closed:
        return on_left + jnp.roll(on_right, 1, 0)
    none = jnp.zeros_like(on_left[:1])
    return jnp.concatenate([on_left, none]) + jnp.concatenate([none, on_right])
