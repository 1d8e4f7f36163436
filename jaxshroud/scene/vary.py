"""Access to the numbers of a scene by their keys."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.scene.checks import KeyNameError, SceneError
from jaxshroud.scene.keys import KEYS, key_parts
from jaxshroud.scene.scene import Contact, Scene
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import check_number

NUMERIC_KEYS = tuple(KEYS)


def _named_number(scene: Scene, key: str) -> Any:
    """The number or numbers with a key, for both blades."""
    table, name, _ = key_parts(key)
    number = scene.blades.inertia_y if name == "m_y" else getattr(getattr(scene, table), name)
    if name == "width" and number is None:
        raise KeyNameError("The scene's contact is not smooth: it has no width.")
    return number


@typed
def vary(scene: Scene, key: str, value: ArrayLike | Sequence[ArrayLike]) -> Scene:
    """The `scene` with one number replaced.

    Args:
        scene: The scene to start from.
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only.
        value: The new value in SI units; a scalar or, for a per-blade key, one value per blade.

    Returns:
        A new scene. Setting `contact.k` drops `contact.gamma`, and vice versa.

    Raises:
        KeyNameError: There is no such number.
        SceneError: The value is out of its range; traced values are not checked.
    """
    (table, name, blade), old = key_parts(key), _named_number(scene, key)
    value = jnp.asarray(value, dtype=float) if isinstance(value, tuple | list) else value
    check_number(KEYS[f"{table}.{name}"], value)
    if blade is not None:
        value = old.at[blade].set(value)
    if name in ("k", "gamma"):
        other = {"k": "gamma", "gamma": "k"}[name]
        contact = Contact(**{name: value, other: None}, reading=scene.contact.reading, width=scene.contact.width)
        precise = jax.tree.map(lambda a: a.astype(scene.blades.k_x.dtype), contact)
        return eqx.tree_at(lambda s: s.contact, scene, precise)
    new = jnp.asarray(value, dtype=old.dtype)
    if np.broadcast_shapes(new.shape, old.shape) != old.shape:
        raise SceneError(f"{key} has the shape {old.shape}, but its value has {new.shape}; see js.scenes_from")
    new = jnp.broadcast_to(new, old.shape)
    return eqx.tree_at(lambda s: getattr(getattr(s, table), name), scene, new, is_leaf=lambda x: x is None)


@typed
def value_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units.

    Raises:
        KeyNameError: There is no such number, or the blades differ and the key has neither `[0]` nor `[1]`.
    """
    blade, values = key_parts(key)[2], _blade_values(scene, key)
    if blade is None and len(set(values)) > 1:
        raise KeyNameError(f"{key} differs between the blades; name {key}[0] or {key}[1].")
    return values[blade or 0]


def level_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units; the mean of both blades where they differ and the key names neither."""
    return value_of(scene, key) if len(offsets(scene, key)) == 1 else float(np.mean(_blade_values(scene, key)))


def offsets(scene: Scene, key: str) -> dict[str, float]:
    """The numbers with a key, by keys of one value each, and their differences from `level_of`."""
    values = _blade_values(scene, key)
    if key_parts(key)[2] is not None or len(set(values)) == 1:
        return {key: 0.0}
    return {f"{key}[{blade}]": value - float(np.mean(values)) for blade, value in enumerate(values)}


def _blade_values(scene: Scene, key: str) -> list[float]:
    """The number with a key, or one for each blade."""
    number = _named_number(scene, key)
    if key == "contact.k":
        number = scene.k
    if key == "contact.gamma":
        number = scene.k / scene.blades.k_x[0]
    return [float(v) for v in jnp.atleast_1d(number)]


def numbers_that_count(scene: Scene) -> tuple[str, ...]:
    """The keys of all numbers on which the settled motion of a scene may depend.

    Left out are the initial motion, numbers without effect in the scene's parts, and the phase of the left blade, which
    only sets the origin of time. Numbers that differ between the blades have one key each.
    """
    parts, keys = scene.parts, []
    unused = _UNUSED["initial"] | {"contact.k" if scene.contact.k is None else "contact.gamma", "drive.phase"}
    unused |= set() if "y" in parts.motion else _UNUSED["y"]
    unused |= set() if "theta" in parts.motion else _UNUSED["theta"]
    unused |= set() if scene.blades.m_y is not None else {"blades.m_y"}
    unused |= set() if parts.contact == "smooth" else {"contact.width"}
    unused |= set() if parts.friction != "none" else _UNUSED["friction"]
    unused |= set() if parts.contact != "none" else _UNUSED["contact"] | _UNUSED["friction"]
    for key in (key for key in KEYS if key not in unused):
        pair = np.asarray(_named_number(scene, key))
        differ = KEYS[key].pair and bool(np.any(pair[..., :1] != pair))
        rigid = parts.neighbour == "rigid"
        keys += [f"{key}[0]", *([] if rigid else [f"{key}[1]"])] if differ else [key]
    return (*keys, *([] if parts.neighbour == "rigid" else ["drive.phase[1]"]))


_UNUSED = {
    "initial": {key for key in KEYS if key.startswith("initial.")},
    "y": {"blades.k_y", "blades.c_y", "blades.m_y"},
    "theta": {"blades.I", "blades.k_T", "blades.c_T", "drive.M_0", "shroud.l_oa", "shroud.l_ab"},
    "contact": {"contact.k", "contact.gamma", *(key for key in KEYS if key.startswith("shroud."))},
    "friction": {"friction.k_d", "friction.mu"},
}
