"""Many scenes from one, by the values of some of its numbers."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import vary


def grid_of_scenes(scene: Scene, axes: Mapping[str, np.ndarray]) -> Scene:
    """Scenes with one leading dimension per axis."""
    build = lambda *values: varied(scene, axes, values)  # noqa: E731
    for i in reversed(range(len(axes))):
        build = jax.vmap(build, in_axes=[0 if j == i else None for j in range(len(axes))])
    return jax.jit(build)(*(jnp.asarray(v) for v in axes.values()))


def varied(scene: Scene, keys: Iterable[str], values: Iterable[Any]) -> Scene:
    """`scene` with several numbers replaced, one after the other."""
    for key, value in zip(keys, values, strict=True):
        scene = vary(scene, key, value)
    return scene


def scenes_at(scene: Scene, keys: Sequence[str], values: np.ndarray) -> Scene:
    """Scenes (leading axis) with the numbers `keys` set to each row of `values` (n, keys)."""
    return _scenes_at(scene, tuple(keys), jnp.asarray(values, scene.drive.omega.dtype))


@partial(jax.jit, static_argnames="keys")
def _scenes_at(scene: Scene, keys: tuple[str, ...], rows) -> Scene:
    return jax.vmap(lambda row: varied(scene, keys, row))(rows)
