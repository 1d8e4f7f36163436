"""Checks of inputs that are known only while a compiled function runs: they set a status instead of raising."""

from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxshroud.batch.stopped import replaced_where
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import judge_step
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.programs.kept import kept
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


class Admitted(NamedTuple):
    """A lane at its start; where its numbers are invalid, all of them are replaced by valid ones."""

    scene: Scene
    state: State
    start: State  # the same; where the numbers are invalid not finite, so that the lane stops at once
    good: Bool[Array, ""]  # whether its numbers are valid
    coarseness: Scalar  # see `StepVerdict`


def admit(scene: Scene, state: State, steps: int, method: Choices) -> Admitted:
    """A lane that is to be marched by so many steps in a period.

    All numbers of the scene must be in the ranges of their keys, those of the state finite, and the steps stable.
    Where they are not, numbers that are valid take their place: the derivatives of invalid ones are not finite, and
    would make NaN of 0 in reverse mode.
    """
    return _admitted(scene, state, np.int32(steps), method.tableau)


@kept("tableau")
def _admitted(scene: Scene, state: State, steps: Int[Array, ""], tableau: Tableau | TaylorOptions) -> Admitted:
    numbers = {**fields_of(scene), **inputs_of(scene)}
    ranges = [jnp.all(key_in(ALL_KEYS[key], scene.layout).range.holds(value)) for key, value in numbers.items()]
    starts = [jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves((state.motion, state.u_s))]
    step = judge_step(scene, steps, tableau)
    good = reduce(jnp.logical_and, [*ranges, *starts, step.stable])
    scene, state = replaced_where(~good, (scene, state), 1.0)
    start = eqx.tree_at(lambda state: state.motion.x, state, jnp.where(good, state.motion.x, jnp.nan))
    return Admitted(scene, state, start, good, step.coarseness)


def status_if_admitted(status: Int[Array, "..."], good: Bool[Array, "..."]) -> Int[Array, "..."]:
    """The status of one or many lanes, with BAD_INPUT where the input is invalid."""
    return jnp.where(good, status, jnp.asarray(Status.BAD_INPUT, status.dtype))
