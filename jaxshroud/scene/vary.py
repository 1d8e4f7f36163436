"""Numbers of a scene by their keys."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxshroud.scene.errors import KeyNameError
from jaxshroud.scene.keys import KEYS, key_parts
from jaxshroud.scene.scene import Contact, Scene
from jaxshroud.scene.valid import check_number

NUMERIC_KEYS = tuple(KEYS)


def _numbers(scene: Scene, key: str) -> Any:
    """The scene's number or numbers that a key names, before a blade is chosen."""
    table, name, _ = key_parts(key)
    old = scene.blades.inertia_y if name == "m_y" else getattr(getattr(scene, table), name)
    if name == "width" and old is None:
        raise KeyNameError("The scene's contact is not smooth: it has no width.")
    return old


def vary(scene: Scene, key: str, value: ArrayLike) -> Scene:
    """`scene` with one number replaced.

    Args:
        scene: The scene to start from.
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only.
        value: The new value in SI units; a scalar or, for a per-blade key, one value per blade.

    Returns:
        A new scene. Setting `contact.k` drops `contact.gamma`, and the other way round.

    Raises:
        KeyNameError: There is no such number.
        SceneError: The value is out of its range; one that JAX traces is not looked at.
    """
    (table, name, blade), old = key_parts(key), _numbers(scene, key)
    value = jnp.asarray(value, dtype=float) if isinstance(value, tuple | list) else value
    check_number(KEYS[f"{table}.{name}"], value)
    if blade is not None:
        value = old.at[blade].set(value)
    if name in ("k", "gamma"):
        other = {"k": "gamma", "gamma": "k"}[name]
        contact = Contact(**{name: value, other: None}, reading=scene.contact.reading, width=scene.contact.width)
        return eqx.tree_at(lambda s: s.contact, scene, contact)
    new = jnp.broadcast_to(jnp.asarray(value, dtype=old.dtype), old.shape)
    return eqx.tree_at(lambda s: getattr(getattr(s, table), name), scene, new, is_leaf=lambda x: x is None)


def value_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units.

    Raises:
        KeyNameError: There is no such number, or the blades differ and the key names neither `[0]` nor `[1]`.
    """
    blade, old = key_parts(key)[2], _numbers(scene, key)
    if key == "contact.k":
        old = scene.k
    if key == "contact.gamma":
        old = scene.k / scene.blades.k_x[0]
    values = [float(v) for v in jnp.atleast_1d(old)]
    if blade is None and len(set(values)) > 1:
        raise KeyNameError(f"{key} differs between the blades; name {key}[0] or {key}[1].")
    return values[blade or 0]
