"""Checks of inputs that are known only while a compiled function runs: they set a status instead of raising."""

from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import ALL_KEYS, key_in
from jaxshroud.scene.numbers import fields_of, inputs_of
from jaxshroud.scene.scene import Scene


def require_single_scene(name: str, scene: Scene) -> None:
    """Raise InputError if the scene has leading axes, which the function `name` accepts under `jax.vmap` only."""
    shape = jnp.shape(scene.drive.omega)
    if shape:
        raise InputError(
            f"js.{name} takes one scene, but these have leading axes {shape}: "
            f"map it over them, jax.vmap(js.{name}), or use js.sweep_function."
        )


def admit_start(scene: Scene, state: State) -> tuple[State, Bool[Array, ""]]:
    """The initial state of a lane, and whether its numbers are valid.

    All numbers of the scene must be in the ranges of their keys, and those of the state finite; else the state is NaN,
    so that the lane stops at once and all results, derivatives included, are NaN.
    """
    numbers = {**fields_of(scene), **inputs_of(scene)}
    ranges = [jnp.all(key_in(ALL_KEYS[key], scene.row_size).range.holds(value)) for key, value in numbers.items()]
    starts = [jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves((state.motion, state.u_s))]
    good = reduce(jnp.logical_and, [*ranges, *starts])
    x = jnp.where(good, state.motion.x, jnp.nan)
    return eqx.tree_at(lambda state: state.motion.x, state, x), good


def status_if_admitted(status: Int[Array, "..."], good: Bool[Array, "..."]) -> Int[Array, "..."]:
    """The status of one or many lanes, with BAD_INPUT where the input is invalid."""
    return jnp.where(good, status, jnp.asarray(Status.BAD_INPUT, status.dtype))
