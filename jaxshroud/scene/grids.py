"""Many scenes in one, with leading axes: by values of some numbers of a scene, from a table, or from a list."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.scene.errors import InputError, KeyNameError, SceneError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import found
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.valid import check_values
from jaxshroud.scene.vary import vary


def grid_of_scenes(scene: Scene, axes: Mapping[str, np.ndarray]) -> Scene:
    """Scenes with one leading dimension per axis.

    Raises:
        KeyNameError: There is no such number.
        SceneError: A value is out of its range.
    """
    for key, values in axes.items():
        check_values(found(key)[0], np.asarray(values), key)
    return _grid(scene, tuple(axes), [jnp.asarray(v) for v in axes.values()])


@partial(jax.jit, static_argnames="keys")
def _grid(scene: Scene, keys: tuple[str, ...], values: list) -> Scene:
    build = lambda *values: varied(scene, keys, values)  # noqa: E731
    for i in reversed(range(len(keys))):
        build = jax.vmap(build, in_axes=[0 if j == i else None for j in range(len(keys))])
    return build(*values)


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


def scenes_from(table: Any, base: Scene | SceneFile) -> Scene:
    """Scenes (leading axis) from a table, one per row.

    Args:
        table: Its columns, in SI units, are called by the keys of a scene's numbers, `table.name` or, for one blade,
            `table.name[0]`, `table.name[1]`: a mapping of keys to values (n,), a pandas DataFrame, a structured array
            or an xarray Dataset.
        base: All other numbers, and the parts of the model.

    Returns:
        One scene, each number of which has the leading axis (n,).

    Raises:
        KeyNameError: A column is called as no number of the scene.
        SceneError: Columns differ in length or say the same thing twice, or a value is out of its range.

    Example:
        >>> import jaxshroud as js
        >>> scenes = js.scenes_from({"contact.gamma": [1.0, 2.5], "shroud.gap": [1e-5, 2e-5]}, js.load("table1"))
        >>> scenes.shroud.gap.shape, scenes.blades.m.shape
        ((2,), (2, 2))
    """
    keys = getattr(getattr(table, "dtype", None), "names", None) or [str(key) for key in table]
    columns = {key: _column(key, table[key]) for key in keys}
    sizes = {key: column.size for key, column in columns.items()}
    if not sizes or len(set(sizes.values())) > 1 or 0 in sizes.values():
        told = ", ".join(f"{key}: {n}" for key, n in sizes.items()) or "no column"
        raise SceneError(f"a table needs columns of one length and at least one row, but has {told}")
    if {"contact.k", "contact.gamma"} <= set(keys):
        raise KeyNameError("contact.k and contact.gamma are one number; name one of them")
    scene = base.scene if isinstance(base, SceneFile) else base
    return scenes_at(scene, keys, np.stack(list(columns.values()), axis=-1))


def _column(key: str, values: Any) -> np.ndarray:
    """The values of one number, checked."""
    row, _ = found(key)
    try:
        column = np.asarray(values, float)
    except (TypeError, ValueError):
        raise SceneError(f"column {key} must hold numbers in SI units ({row.unit or 'a pure number'})") from None
    if column.ndim != 1:
        raise SceneError(f"column {key} must be one value per row, but its shape is {column.shape}")
    check_values(row, column, f"row {{}}: {key}")
    return column


def stack_scenes(scenes: Sequence[Scene]) -> Scene:
    """Scenes with a new leading axis from a list of them, which differ in nothing but numbers.

    Raises:
        InputError: They differ in parts, in the misprints kept, or in which numbers they have, such as k or gamma.
    """
    if len({jax.tree.structure(scene) for scene in scenes}) != 1:
        raise InputError("scenes are stacked if they have the same parts, the same reading and the same numbers")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
