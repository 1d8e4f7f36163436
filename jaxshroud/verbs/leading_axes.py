"""The leading axes of scenes, their shape and their names, and trees with one axis of lanes in their place."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import numbers_of
from jaxshroud.scene.typed import Tree
from jaxshroud.verbs.checks import refuse_traced


def leading_axes(scene: Scene) -> tuple[int, ...]:
    """The shape of the leading axes of scenes; () for a single scene.

    Raises:
        InputError: The numbers disagree in their leading axes, or one of these is empty.
    """
    refuse_traced(scene)
    ranks = {key: len(number_shape(ALL_KEYS[key], scene.layout)) for key in numbers_of(scene)}
    shapes = {key: a.shape[: a.ndim - ranks[key]] for key, a in numbers_of(scene).items()}
    first_keys: dict[tuple[int, ...], str] = {}
    for key, shape in shapes.items():
        first_keys.setdefault(shape, key)
    if len(first_keys) > 1:
        (a, one), (b, other) = list(first_keys.items())[:2]
        raise InputError(
            f"The scenes' numbers disagree in their leading axes: {one} has {a}, but {other} has {b}; "
            "make them with jax.vmap or js.scenes_from, which give all the same."
        )
    (shape,) = first_keys
    if 0 in shape:
        raise InputError(f"There are no scenes: their leading axes are {shape}.")
    return shape


def names_of(shape: tuple[int, ...], dims: Sequence[str] | None) -> tuple[str, ...]:
    """The names of leading axes: those given, else `lane`, or `lane_0`, `lane_1`, ... for several.

    Raises:
        InputError: The number of names is wrong, or two are equal.
    """
    if dims is None:
        return ("lane",) if len(shape) == 1 else tuple(f"lane_{i}" for i in range(len(shape)))
    if len(set(dims)) != len(shape) or len(dims) != len(shape):
        raise InputError(f"Argument `dims` must name {len(shape)} leading axes, each once, but is {tuple(dims)}.")
    return tuple(dims)


def flatten_lanes(tree: Tree, axes: int) -> Tree:
    """A tree of arrays with its leading axes joined into one, or with a new one where it has none."""
    reshaped = lambda a: np.reshape(np.asarray(a), (-1, *np.shape(a)[axes:]))  # by NumPy: nothing is compiled
    return jax.tree.map(lambda a: jnp.asarray(reshaped(a)), tree)


def in_shape(values: Any, shape: tuple[int, ...]) -> Any:
    """Trees of arrays whose leading axis of lanes is reshaped to `shape`; () drops it."""
    if isinstance(values, dict):
        return {name: in_shape(value, shape) for name, value in values.items()}  # jax.tree would sort them
    return jax.tree.map(lambda a: np.asarray(a).reshape((*shape, *np.shape(a)[1:])), values)
