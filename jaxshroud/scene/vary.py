"""Numbers of a scene by their keys."""

import re
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Blades, Contact, Drive, Friction, Scene, Shroud

KEY = re.compile(r"^(?P<table>[a-z]+)\.(?P<name>\w+)(\[(?P<blade>[01])\])?$")
NUMERIC_KEYS = tuple(
    f"{table}.{field}"
    for table, kind in dict(
        blades=Blades, shroud=Shroud, contact=Contact, friction=Friction, drive=Drive, initial=Motion
    ).items()
    for field in kind.__annotations__
    if field != "reading"
)


def key_parts(key: str) -> tuple[str, str, int | None]:
    """Table, name and blade (None: both, or neither) that a key names.

    Raises:
        KeyError: A scene has no such number.
    """
    match = KEY.match(key)
    if match is None or f"{match['table']}.{match['name']}" not in NUMERIC_KEYS:
        raise KeyError(f"The scene has no number called {key!r}.")
    return match["table"], match["name"], None if match["blade"] is None else int(match["blade"])


def _numbers(scene: Scene, key: str) -> Any:
    """The scene's number or numbers that a key names, before a blade is chosen."""
    table, name, blade = key_parts(key)
    old = scene.blades.inertia_y if name == "m_y" else getattr(getattr(scene, table), name)
    if name == "width" and old is None:
        raise KeyError("The scene's contact is not smooth: it has no width.")
    if blade is not None and (old is None or old.ndim == 0):
        raise KeyError(f"{table}.{name!s} is one number, not one per blade.")
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
        KeyError: There is no such number.
    """
    (table, name, blade), old = key_parts(key), _numbers(scene, key)
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
        KeyError: There is no such number, or the blades differ and the key names neither `[0]` nor `[1]`.
    """
    blade, old = key_parts(key)[2], _numbers(scene, key)
    if key == "contact.k":
        old = scene.k
    if key == "contact.gamma":
        old = scene.k / scene.blades.k_x[0]
    values = [float(v) for v in jnp.atleast_1d(old)]
    if blade is None and len(set(values)) > 1:
        raise KeyError(f"{key} differs between the blades; name {key}[0] or {key}[1].")
    return values[blade or 0]
