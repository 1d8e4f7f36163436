"""Batches of scenes, with leading axes: on a grid of values, from a table, or from a list."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.checks import InputError, SceneError
from jaxshroud.scene.derived_inputs import check_disjoint
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import find_key, number_shape
from jaxshroud.scene.layout import Layout, reading_text
from jaxshroud.scene.scene import Scene, with_plain_orders
from jaxshroud.scene.typed import short_repr, typed
from jaxshroud.scene.valid import check_values
from jaxshroud.scene.vary import fields_of, replaced


def grid_of_scenes(scene: Scene, axes: Mapping[str, np.ndarray]) -> Scene:
    """Scenes with the leading axes of the given ones, and then one for each axis of a grid.

    Raises:
        KeyNameError: There is no such number.
        SceneError: A value is out of its range.
    """
    check_disjoint(list(axes), scene.layout)
    for key, values in axes.items():
        check_values(find_key(key, layout=scene.layout)[0], np.asarray(values), key)
    return _with_axes(scene, dict(zip(axes, np.ix_(*axes.values()), strict=True)), tuple(map(len, axes.values())))


def scenes_at(scene: Scene, keys: Sequence[str], values: np.ndarray) -> Scene:
    """Scenes (leading axis) with the numbers `keys` set to each row of `values` (n, keys)."""
    return _with_axes(scene, dict(zip(keys, np.asarray(values).T, strict=True)), (len(values),))


def _with_axes(scene: Scene, values: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> Scene:
    """Scenes with leading axes of `shape` after their own, and numbers replaced; values broadcast with `shape`."""
    like = jnp if is_traced(scene) else np  # by NumPy nothing is compiled
    own = np.shape(scene.drive.omega)
    lanes = (*own, *shape)
    beside = jax.tree.map(lambda a: like.reshape(a, (*own, *(1 for _ in shape), *np.shape(a)[len(own) :])), scene)
    columns = {key: _per_number(key, column, len(own), scene.layout) for key, column in values.items()}
    varied = replaced(beside, columns)
    return jax.tree.map(lambda a: jnp.asarray(like.broadcast_to(a, (*lanes, *np.shape(a)[len(lanes) :]))), varied)


def _per_number(key: str, values: np.ndarray, own_axes: int, layout: Layout) -> np.ndarray:
    """Values with an axis for each of the scenes' own, and one of the blades or interfaces for a number of all."""
    number, index = find_key(key, layout=layout)
    values = values.reshape(*(1 for _ in range(own_axes)), *values.shape)
    return values[..., None] if number_shape(number, layout) and index is None else values


@typed
def scenes_from(table: object, base: Scene | SceneFile) -> Scene:
    """Scenes (leading axis) from a table, one for each row.

    Args:
        table: A mapping of keys to values (n,), a pandas DataFrame, a structured array or an xarray Dataset. Its
            columns, in SI units, are named by the keys of numbers of a scene, `table.name` or, for one blade,
            `table.name[0]`, `table.name[1]`; in a row any blade or interface may be named.
        base: The scene of all other numbers and of the parts of the model.

    Returns:
        Scenes with the leading axis (n,) on each number.

    Raises:
        KeyNameError: The name of a column is not that of a number of the scene.
        SceneError: Columns differ in length or give one number twice, or a value is out of its range.

    Example:
        >>> import jaxshroud as js
        >>> scenes = js.scenes_from({"contact.gamma": [1.0, 2.5], "shroud.gap": [1e-5, 2e-5]}, js.load("table1"))
        >>> scenes.shroud.gap.shape, scenes.blades.m.shape
        ((2,), (2, 2))
    """
    scene = base.scene if isinstance(base, SceneFile) else base
    columns = {key: _column(key, column, scene.layout) for key, column in columns_of(table).items()}
    sizes = {key: column.size for key, column in columns.items()}
    if not sizes or len(set(sizes.values())) > 1 or 0 in sizes.values():
        lengths = ", ".join(f"{key}: {n}" for key, n in sizes.items()) or "no column"
        raise SceneError(f"a table needs columns of one length and at least one row, but has {lengths}")
    check_disjoint(list(columns), scene.layout)
    return scenes_at(scene, list(columns), np.stack(list(columns.values()), axis=-1))


def columns_of(table: object) -> dict[str, Any]:
    """The columns of a table by their heads: of a mapping, a pandas DataFrame, a structured array or an xarray Dataset.

    Raises:
        SceneError: It is none of these.
    """
    rows: Any = table
    try:
        keys = getattr(getattr(rows, "dtype", None), "names", None) or [str(key) for key in rows]
        return {key: rows[key] for key in keys}
    except (TypeError, IndexError, KeyError):
        raise SceneError(
            f"a table needs columns that are called by keys of a scene, but is {short_repr(table)}"
        ) from None


def _column(key: str, values: Any, layout: Layout) -> np.ndarray:
    """The values of one number, checked."""
    number, _ = find_key(key, layout=layout)
    try:
        column = np.asarray(values, float)
    except (TypeError, ValueError):
        raise SceneError(f"column {key} must hold numbers in SI units ({number.unit or 'a pure number'})") from None
    if column.ndim != 1:
        raise SceneError(f"column {key} must be one value per row, but its shape is {column.shape}")
    check_values(number, column, f"row {{}}: {key}")
    return column


@typed
def stack_scenes(scenes: Sequence[Scene]) -> Scene:
    """Stack scenes, which may differ in their numbers only, along a new leading axis.

    Raises:
        InputError: They differ in their parts, in the misprints kept, or in which numbers they have (k or gamma).
    """
    what = "scenes are stacked if they have the same parts, the same reading and the same numbers"
    if not len(scenes):
        raise InputError(f"{what}; there is none")
    if (
        len({jax.tree.structure(scene.drive) for scene in scenes}) > 1
    ):  # as where some give orders, others engine orders
        scenes = [with_plain_orders(scene) for scene in scenes]
    for i, other in enumerate(scenes[1:], 1):
        if jax.tree.structure(other) != jax.tree.structure(scenes[0]):
            raise InputError(f"{what}; scene {i} {_unlike_part(scenes[0], other)}")
    if len({tuple(leaf.shape for leaf in jax.tree.leaves(scene)) for scene in scenes}) > 1:
        raise InputError("scenes are stacked if all have the same leading axes")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)


def _unlike_part(first: Scene, other: Scene) -> str:
    """What a scene has where the first one, which is not alike, has something else."""
    here, there = _what_it_has(first), _what_it_has(other)
    pairs = [(there.get(name), here.get(name)) for name in {**here, **there} if here.get(name) != there.get(name)]
    has = [" and ".join(text for text in side if text) or "nothing" for side in zip(*pairs, strict=True)]
    return f"has {has[0]} where the first has {has[1]}" if pairs else "has other laws than the first"


def _what_it_has(scene: Scene) -> dict[str, str]:
    """What must be alike in scenes that are stacked, each in words."""
    parts = {name: f"parts.{name} = {value!r}" for name, value in scene.parts._asdict().items()}
    reading = f"the reading {reading_text(scene.contact.reading)!r}"
    return {
        **parts,
        "layout": scene.layout.text,
        "reading": reading,
        "start": f"start = {scene.start!r}",
        "points": "" if scene.contact.points is None else f"{scene.contact.points.number} contact points",
        **{key: key for key in (*fields_of(scene), *scene.given)},
    }
