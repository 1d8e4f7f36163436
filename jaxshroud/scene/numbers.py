"""The numbers of a scene by their keys, and the scene with some of them replaced."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxshroud.programs.kept import is_traced
from jaxshroud.scene.derived_inputs import check_order, consistent
from jaxshroud.scene.keys import ALL_KEYS, HARMONIC_ENTRY
from jaxshroud.scene.replacing import renamed_numbers, replace_numbers
from jaxshroud.scene.scene import Scene

TABLE_NAMES = ("blades", "shroud", "contact", "friction", "drive", "initial", "row")


def fields_of(scene: Scene) -> dict[str, Any]:
    """All numbers of a scene, or of many (leading axes), by their keys: arrays of NumPy or JAX, in SI units.

    Numbers of a drive of one's own that have no key are left out.
    """
    tables = {table: getattr(scene, table) for table in TABLE_NAMES if getattr(scene, table) is not None}
    fields = {table: part._asdict() if table == "initial" else vars(part) for table, part in tables.items()}
    fields["drive"] = {**fields["drive"], **scene.drive.of_harmonics()}
    named = {f"{table}.{name}": value for table, part in fields.items() for name, value in part.items()}
    return {key: value for key, value in named.items() if key in ALL_KEYS and hasattr(value, "shape")}


def field_of(scene: Scene, key: str) -> Any:
    """The number with a key, without the index of a blade: the leaf of the scene, None where it has none."""
    number = ALL_KEYS[key]
    table, name = number.parts
    match = HARMONIC_ENTRY.fullmatch(name)
    if match is not None:
        return getattr((scene.drive.harmonic or ())[int(match["index"])], match["name"])
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
    lanes, dtype = np.shape(scene.drive.omega), scene.drive.omega.dtype
    numbers, given = fields_of(scene), given_of(scene)
    if is_traced((scene, values)):
        values = {key: jnp.asarray(value, dtype) for key, value in values.items()}
    else:
        numbers, given, values = (_on_host(part) for part in (numbers, given, values))
    new, inputs = replace_numbers(numbers, given, values, lanes, scene.layout)
    if not is_traced(inputs):
        check_order(inputs)
    return _with_leaves(scene, numbers, new, inputs)


def expressed_by(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The same scene, given by these of its numbers or inputs (key -> value), from which nothing is worked out."""
    numbers, given = fields_of(scene), given_of(scene)
    renamed = renamed_numbers(numbers, given, values, np.shape(scene.drive.omega), scene.layout)
    return _with_leaves(scene, numbers, *renamed)


def _on_host(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if value is None else np.asarray(value, float) for key, value in numbers.items()}


def _with_leaves(scene: Scene, old: Mapping[str, Any], new: Mapping[str, Any], given: Mapping[str, Any]) -> Scene:
    """The scene with those numbers that are not the old ones, None where there is no longer one, and with inputs."""
    leaf = lambda value: None if value is None else jnp.asarray(value, scene.drive.omega.dtype)
    changed = [key for key in {**old, **new} if new.get(key) is not old.get(key)]
    places = lambda s: [*(field_of(s, key) for key in changed), s.given]
    leaves = [*(leaf(new.get(key)) for key in changed), {key: leaf(value) for key, value in given.items()}]
    return eqx.tree_at(places, scene, leaves, is_leaf=lambda part: part is None or part is scene.given)
