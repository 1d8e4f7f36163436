"""Access to the numbers of a scene by their keys."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.scene.checks import KeyNameError, SceneError
from jaxshroud.scene.derived_inputs import DERIVED_BY_KEY, DERIVED_INPUTS, check_independent, check_known
from jaxshroud.scene.keys import ALL_KEYS, KEYS, find_key, key_parts
from jaxshroud.scene.numbers import expressed_by, fields_of, given_of, numbers_of, replaced
from jaxshroud.scene.replacing import NO_WIDTH
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import check_number

NUMERIC_KEYS = tuple(KEYS)


def _named_number(scene: Scene, name: str) -> Any:
    """The number or numbers with the name of a key, for both blades.

    Raises:
        KeyNameError: The scene has no such number.
    """
    if name in DERIVED_BY_KEY:
        return _input_of(scene, name)
    if name == "contact.width" and scene.contact.width is None:
        raise KeyNameError(NO_WIDTH)
    if name == "contact.k":
        return scene.k
    if name == "contact.gamma":
        return scene.k / scene.blades.k_x[..., 0]
    return fields_of(scene).get(name, scene.blades.m)  # for a mass in y that is not there


def _input_of(scene: Scene, name: str) -> Any:
    """An input: the given one, else that by which the number would have been given.

    Raises:
        KeyNameError: The number does not determine it.
    """
    derived, given = DERIVED_BY_KEY[name], given_of(scene)
    if derived.counts(given):
        return given[name]
    check_known(name, given)
    return derived.given_value(numbers_of(scene))


@typed
def vary(scene: Scene, key: str, value: ArrayLike | Sequence[ArrayLike]) -> Scene:
    """The `scene` with one number replaced, and with it those that are worked out from it.

    Args:
        scene: The scene to start from.
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only: a number of the scene, or another way
            to give one, such as `drive.speed` for a scene with an engine order, or `blades.f_x`.
        value: The new value in SI units; a scalar or, for a per-blade key, one value per blade.

    Returns:
        A new scene, as if its file gave this value: `contact.k` drops `contact.gamma` and vice versa, `blades.f_x`
        drops `blades.k_x`; and a scene that is given by frequencies keeps these where its masses change.

    Raises:
        KeyNameError: There is no such number, or the scene has no engine order for a speed.
        SceneError: The value is out of its range; traced values are not checked.
    """
    row, blade = find_key(key)
    number: Any = jnp.asarray(value, dtype=float) if isinstance(value, tuple | list) else value
    check_number(row, number)
    lanes, own = np.shape(scene.drive.omega), np.shape(number)
    shape = (*lanes, 2) if row.pair and blade is None else lanes
    if np.broadcast_shapes(own, shape) != shape:
        raise SceneError(f"{key} has the shape {shape}, but its value has {own}; see js.scenes_from")
    return replaced(scene, {key: number})


def with_numbers(scene: Scene, keys: Sequence[str]) -> Scene:
    """The scene expressed such that each of the `keys` is one of its own numbers (`gamma` or `k`, `f_x` or `k_x`).

    Raises:
        KeyNameError: There is no such number, or two keys are one.
    """
    check_independent(keys)
    names = dict.fromkeys(find_key(key)[0].name for key in keys)
    return expressed_by(scene, {name: np.asarray(_named_number(scene, name)) for name in names})


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
    return [float(v) for v in np.atleast_1d(np.asarray(_named_number(scene, find_key(key)[0].name)))]


def numbers_that_count(scene: Scene) -> tuple[str, ...]:
    """The keys of all numbers on which the settled motion of a scene may depend.

    Left out are the initial motion, numbers without effect in the scene's parts, the phase of the left blade, which
    only sets the origin of time, and an engine order, which acts as the speed does. Inputs stand for the numbers that
    are worked out from them. Numbers that differ between the blades have one key each.
    """
    parts, keys = scene.parts, []
    derived = {one.number.name: one for one in DERIVED_INPUTS if one.counts(given_of(scene))}
    unused = _UNUSED["initial"] | {"contact.k" if scene.contact.k is None else "contact.gamma", "drive.phase"}
    unused |= set() if "y" in parts.motion else _UNUSED["y"]
    unused |= set() if "theta" in parts.motion else _UNUSED["theta"]
    unused |= set() if scene.blades.m_y is not None else {"blades.m_y"}
    unused |= set() if parts.contact == "smooth" else {"contact.width"}
    unused |= set() if parts.friction != "none" else _UNUSED["friction"]
    unused |= set() if parts.contact != "none" else _UNUSED["contact"] | _UNUSED["friction"]
    for number in (key for key in KEYS if key not in unused):
        if number in derived and not derived[number].keys:
            continue
        key = derived[number].keys[-1].name if number in derived else number
        pair = np.asarray(_named_number(scene, key))
        differ = ALL_KEYS[key].pair and bool(np.any(pair[..., :1] != pair))
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
