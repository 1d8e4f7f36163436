"""The numbers of a scene by their keys: read, and replaced by others."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.checks import InputError, KeyNameError, SceneError
from jaxshroud.scene.derived_inputs import (
    DERIVED_BY_KEY,
    check_independent,
    check_known,
    check_order,
    consistent,
    inputs_by_key,
    inputs_in,
)
from jaxshroud.scene.drive_orders import drive_at_order
from jaxshroud.scene.keys import (
    ALL_KEYS,
    HARMONIC_ENTRY,
    KEYS,
    LIMIT_KEYS,
    MODAL_LOAD_KEYS,
    MODE_ENTRY,
    POINT_ENTRY,
    find_key,
    number_shape,
)
from jaxshroud.scene.modes import ModalBlades
from jaxshroud.scene.optional import require_number, standing_for
from jaxshroud.scene.replacing import renamed_numbers, replace_numbers
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import ORDER, check_speed
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import check_number

TABLE_NAMES = ("blades", "shroud", "contact", "friction", "coupling", "drive", "initial", "row", "aero")


def fields_of(scene: Scene) -> dict[str, Any]:
    """All numbers of a scene, or of many (leading axes), by their keys: arrays of NumPy or JAX, in SI units.

    Numbers of a drive of your own that have no key are left out.
    """
    tables = {table: getattr(scene, table) for table in TABLE_NAMES if getattr(scene, table) is not None}
    fields = {table: part._asdict() if table == "initial" else vars(part) for table, part in tables.items()}
    fields["drive"] = {**fields["drive"], **scene.drive.of_harmonics()}
    if isinstance(scene.blades, ModalBlades):
        fields["blades"] = scene.blades.by_entry()
    if scene.contact.points is not None:
        fields["contact"] = {**fields["contact"], **scene.contact.points.by_entry()}
    named = {f"{table}.{name}": value for table, part in fields.items() for name, value in part.items()}
    return {key: value for key, value in named.items() if key in ALL_KEYS and hasattr(value, "shape")}


def field_of(scene: Scene, key: str) -> Any:
    """The number with a key, without the index of a blade: the leaf of the scene, None where it has none."""
    number = ALL_KEYS[key]
    table, name = number.parts
    match = HARMONIC_ENTRY.fullmatch(name)
    if match is not None:
        one: Any = (scene.drive.harmonic or ())[int(match["index"])]
        return one.modal[match["name"]] if match["name"] in MODAL_LOAD_KEYS else getattr(one, match["name"])
    if isinstance(scene.blades, ModalBlades) and (mode := MODE_ENTRY.fullmatch(name)):
        return getattr(scene.blades.modes[int(mode["index"])], mode["name"])
    if point := POINT_ENTRY.fullmatch(name):
        assert scene.contact.points is not None  # else it has no such number
        return scene.contact.points.places[int(point["index"])]
    return getattr(getattr(scene, table), name)


def numbers_of(scene: Scene) -> dict[str, np.ndarray]:
    """All numbers of a scene by their keys, as NumPy arrays in SI units."""
    return {key: np.asarray(value) for key, value in fields_of(scene).items()}


def inputs_of(scene: Scene) -> dict[str, Any]:
    """The inputs of a scene, or of many, from which numbers of it were worked out, likewise."""
    return {key: value for key, value in scene.given.items() if value is not None}


def given_of(scene: Scene) -> dict[str, Any]:
    """The inputs that give numbers of the scene; None for a word. Those of numbers that were replaced do not count."""
    if not scene.given or is_traced((scene.given, fields_of(scene))):
        return scene.given
    given = {k: None if v is None else np.asarray(v) for k, v in scene.given.items()}
    return consistent(numbers_of(scene), given, scene.layout)


def replaced(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with numbers replaced, and with them those that are worked out from them.

    Where nothing is traced, this is done by NumPy in float64, as for a file: the numbers are those of an override.

    Args:
        scene: One scene, or many with leading axes.
        values: Key -> the value, which broadcasts with the scene's number, or, for one blade, with the blade's.

    Raises:
        KeyNameError: There is no such number, or the scene lacks what a key needs.
        SceneError: An engine order of at most 0 is to give the frequency with a speed.
    """
    if scene.start != "motion" and (of_motion := [key for key in values if key.startswith("initial.")]):
        raise KeyNameError(f"the scene has a static start and no {of_motion[0]}; drop initial.start to give one")
    lanes = np.shape(scene.drive.omega)
    dtype = scene.drive.omega.dtype
    numbers = fields_of(scene)
    given = given_of(scene)
    if is_traced((scene, values)):
        values = {key: jnp.asarray(value, dtype) for key, value in values.items()}
    else:
        numbers, given, values = (_on_host(part) for part in (numbers, given, values))
    new, inputs = replace_numbers(numbers, given, values, lanes, scene.layout)
    if not is_traced(inputs):
        check_order(inputs)
    if not is_traced((new, inputs)):
        check_speed(new, inputs, scene.layout.blades)
    changed = _with_leaves(scene, (numbers, given), (new, inputs))
    if changed.contact.points is not None:
        changed.contact.points.check_on(changed.shroud.l_ab)
    return changed


def expressed_by(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The same scene, given by these of its numbers or inputs (key -> value), from which nothing is worked out."""
    numbers = fields_of(scene)
    given = given_of(scene)
    renamed = renamed_numbers(numbers, given, values, np.shape(scene.drive.omega), scene.layout)
    return _with_leaves(scene, (numbers, given), renamed)


def _on_host(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if value is None else np.asarray(value, float) for key, value in numbers.items()}


def _with_leaves(scene: Scene, before: tuple[Mapping[str, Any], ...], after: tuple[Mapping[str, Any], ...]) -> Scene:
    """The scene with those numbers that are not the old ones, None where there is no longer one, and with inputs.

    Args:
        scene: The scene.
        before: Its numbers and its inputs.
        after: Those that it is to have.
    """
    (old, inputs), (new, given) = before, after

    def leaf(value):
        return None if value is None else jnp.asarray(value, scene.drive.omega.dtype)

    changed = [key for key in {**old, **new} if new.get(key) is not old.get(key)]

    def places(s):
        return [*(field_of(s, key) for key in changed), s.given]

    leaves = [*(leaf(new.get(key)) for key in changed), {key: leaf(value) for key, value in given.items()}]
    changed_scene = eqx.tree_at(places, scene, leaves, is_leaf=lambda part: part is None or part is scene.given)
    drive = drive_at_order(changed_scene.drive, inputs.get(ORDER), given.get(ORDER))
    return eqx.tree_at(lambda s: s.drive, changed_scene, drive, is_leaf=lambda part: part is changed_scene.drive)


NUMERIC_KEYS = tuple(KEYS)


def named_number(scene: Scene, name: str) -> Any:
    """The number or numbers with the name of a key, for all blades or interfaces.

    Raises:
        KeyNameError: The scene has no such number.
    """
    numbers = fields_of(scene)
    require_number(name, numbers)
    if name in DERIVED_BY_KEY:
        return _input_of(scene, name)
    if name == "contact.k":
        return scene.k
    if name == "contact.gamma":
        return scene.k / scene.left_k_x
    return numbers[name] if name in numbers else standing_for(name, numbers)


def _input_of(scene: Scene, name: str) -> Any:
    """An input: the given one, else that by which the number would have been given.

    Raises:
        KeyNameError: The number does not determine it.
    """
    derived = inputs_by_key(scene.layout)[name]
    given = given_of(scene)
    if derived.counts(given):
        return given[name]
    check_known(name, given, layout=scene.layout)
    if derived.inverse is None:
        raise KeyNameError(f"the scene does not give {name}; name {derived.number.name}")
    return derived.given_value(numbers_of(scene))


def with_checked(scene: Scene, values: Mapping[str, ArrayLike | Sequence[ArrayLike]]) -> Scene:
    """The scene with numbers replaced that are in their ranges: see `Scene.replace`."""
    check_independent(list(values), scene.layout)
    arrays = {}
    for key, value in values.items():
        named, index = find_key(key, layout=scene.layout)
        number: Any = jnp.asarray(value, dtype=float) if isinstance(value, tuple | list) else value
        check_number(named if index is None else named._replace(pair=False, per_interface=False), number, scene.layout)
        lanes, own = np.shape(scene.drive.omega), np.shape(number)
        shape = (*lanes, *number_shape(named, scene.layout)) if index is None else lanes
        if np.broadcast_shapes(own, shape) != shape:
            raise SceneError(f"{key} has the shape {shape}, but its value has {own}; see js.scenes_from")
        arrays[key] = number
    return replaced(scene, arrays)


@typed
def vary(scene: Scene, key: str, value: ArrayLike | Sequence[ArrayLike]) -> Scene:
    """The `scene` with one number replaced: `scene.replace({key: value})`."""
    return scene.replace({key: value})


def with_numbers(scene: Scene, keys: Sequence[str]) -> Scene:
    """The scene expressed such that each of the `keys` is one of its own numbers (`gamma` or `k`, `f_x` or `k_x`).

    Raises:
        KeyNameError: There is no such number, or two keys are one.
    """
    check_independent(keys, scene.layout)
    names = dict.fromkeys(find_key(key, layout=scene.layout)[0].name for key in keys)
    return expressed_by(scene, {name: np.asarray(named_number(scene, name)) for name in names})


@typed
def value_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units.

    Raises:
        KeyNameError: There is no such number, or the blades differ and the key has neither `[0]` nor `[1]`.
        InputError: The scene is traced.
    """
    if is_traced(scene):
        raise InputError(f"`value_of` returns a plain number, of which JAX traces nothing: take scene.{key} itself.")
    named, index = find_key(key, layout=scene.layout)
    values = _all_values(scene, key)
    if index is None and len(set(values)) > 1:
        kind = "interfaces" if named.per_interface else "blades"
        last = len(values) - 1
        cure = f"{key}[0] or {key}[1]" if last == 1 else f"one of {key}[0] to {key}[{last}]"
        raise KeyNameError(f"{key} differs between the {kind}; name {cure}.")
    return values[index or 0]


def level_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units; the mean of all blades where they differ and the key names none."""
    return value_of(scene, key) if len(offsets(scene, key)) == 1 else float(np.mean(_all_values(scene, key)))


def offsets(scene: Scene, key: str) -> dict[str, float]:
    """The numbers with a key, by keys of one value each, and their differences from `level_of`."""
    values = _all_values(scene, key)
    if find_key(key, layout=scene.layout)[1] is not None or len(set(values)) == 1:
        return {key: 0.0}
    return {f"{key}[{i}]": value - float(np.mean(values)) for i, value in enumerate(values)}


def _all_values(scene: Scene, key: str) -> list[float]:
    """The number with a key, or one for each blade or interface."""
    name = find_key(key, layout=scene.layout)[0].name
    return [float(v) for v in np.atleast_1d(np.asarray(named_number(scene, name)))]


def numbers_that_count(scene: Scene) -> tuple[str, ...]:
    """The keys of all numbers on which the settled motion of a scene may depend.

    Left out are the initial motion, numbers without effect in the scene's parts, the phase of the left blade, which
    only sets the origin of time, and an engine order, which acts as the speed does. Inputs stand for the numbers that
    are worked out from them. Numbers that differ between the blades, or the interfaces of a row, have one key each.
    """
    parts = scene.parts
    layout = scene.layout
    keys = []
    derived = {one.number.name: one for one in inputs_in(layout) if one.counts(given_of(scene))}
    unused = _UNUSED["initial"] | {"contact.k" if scene.contact.k is None else "contact.gamma", "drive.phase"}
    unused |= set() if "y" in parts.motion else _UNUSED["y"]
    unused |= set() if "theta" in parts.motion else _UNUSED["theta"]
    still = {"y", "theta"} - {*parts.motion}
    of_lists = {"q", "v", "sigma", *(f"phi_{name}" for name in still), *("place" for _ in still & {"theta"})}
    unused |= {key for key in fields_of(scene) if key.rpartition(".")[2] in of_lists} | {*LIMIT_KEYS}
    unused |= set() if parts.contact == "smooth" else {"contact.width"}
    unused |= set() if parts.friction != "none" else _UNUSED["friction"]
    unused |= set() if parts.contact != "none" else _UNUSED["contact"] | _UNUSED["friction"]
    for number in (key for key in fields_of(scene) if key not in unused):
        if number in derived and not derived[number].keys:
            continue
        key = derived[number].keys[-1].name if number in derived else number
        values = np.asarray(named_number(scene, key))
        shape = number_shape(ALL_KEYS[key], layout)
        differ = bool(shape) and bool(np.any(values[..., :1] != values))
        moving = 1 if parts.neighbour == "rigid" else math.prod(shape)
        keys += [f"{key}[{i}]" for i in range(moving)] if differ else [key]
    by_order = scene.depends_on_speed or "drive.speed" in given_of(scene)  # which gives a row its phases
    fixed = parts.neighbour == "rigid" or (scene.row is not None and by_order)
    phases = () if fixed else range(1, layout.blades)
    return (*keys, *(f"drive.phase[{i}]" for i in phases))


_UNUSED = {
    "initial": {key for key in KEYS if key.startswith("initial.")},
    "y": {"blades.k_y", "blades.c_y", "blades.m_y", "blades.B_y", "coupling.k_y", "coupling.c_y"},
    "theta": {"blades.I", "blades.k_T", "blades.c_T", "blades.B_T", "drive.M_0", "shroud.l_oa", "shroud.l_ab"}
    | {"coupling.k_T", "coupling.c_T"},
    "contact": {"contact.k", "contact.gamma", *(key for key in KEYS if key.startswith("shroud."))},
    "friction": {"friction.k_d", "friction.mu"},
}
