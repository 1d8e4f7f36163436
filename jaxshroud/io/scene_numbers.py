"""The numbers of scenes as dimensions and variables of results, and the scenes restored from these."""

import tomllib
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.scene.keys import ALL_KEYS, Key, Motion, parse_key
from jaxshroud.scene.measurements import BLADES
from jaxshroud.scene.replacing import replaced_tables

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.scene.checks import Precision
    from jaxshroud.scene.scene import Scene


def dimension(key: str, in_row: bool = False) -> str:
    """The name of the dimension along `key`: its last word, or `initial_x` where a variable is called `x`.

    One blade is `_left` or `_right`, and in a row, as one interface, its number: `k_x_17`.
    """
    number, index = parse_key(key)
    table, stem = number.parts
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    if index is None:
        return stem
    return f"{stem}_{index if _is_of_row(number, index, in_row) else BLADES[index]}"


def _is_of_row(number: Key, index: int, in_row: bool) -> bool:
    return in_row or number.per_interface or index >= len(BLADES)


def key_attrs(key: str, in_row: bool = False) -> dict[str, str]:
    """The attributes of the variable that holds a number of scenes."""
    return {"key": key, "units": parse_key(key)[0].netcdf, "long_name": key_label(key, in_row)}


def key_label(key: str, in_row: bool = False) -> str:
    """The description of a scene's number with its symbol, as axes show it."""
    number, index = parse_key(key)
    return f"{number.label}{_place_of(number, index, in_row)} ${number.symbol}$"


def _place_of(number: Key, index: int | None, in_row: bool) -> str:
    """The blade or interface that a key names, as the end of a description."""
    if index is None:
        return ""
    if _is_of_row(number, index, in_row):
        return f", {'interface' if number.per_interface else 'blade'} {index}"
    return f", {BLADES[index]} blade"


def has_row(scene_text: str) -> bool:
    """Whether a scene, as TOML, has a row of blades."""
    return "\n[row]" in f"\n{scene_text}"


def scene_text_of_lane(data: "xr.Dataset") -> str:
    """The scene of a dataset that holds one lane of many, as TOML: the first lane's with the numbers of this one."""
    import tomli_w

    from jaxshroud.scene.config import parse

    variables = [v for v in data.variables.values() if "key" in v.attrs and not set(v.dims) - {"blade", "interface"}]
    file = parse(data.attrs["scene"], "the scene of this result")
    tables = replaced_tables(file.tables, file.given, {v.attrs["key"]: v.to_numpy() for v in variables})
    return tomli_w.dumps({**tomllib.loads(data.attrs["scene"]), **tables})


def scene_differences(
    scenes: "Scene", shape: tuple[int, ...], lanes: tuple[str, ...]
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """The numbers that are not given alike in all scenes (leading axes of `shape`), as xarray takes variables."""
    from jaxshroud.scene.text import given_numbers_of

    variables = {}
    for key, values in given_numbers_of(scenes).items() if shape else ():
        if np.any(values != values[(0,) * len(shape)]):
            place = "interface" if ALL_KEYS[key].per_interface else "blade"
            dims = (*lanes, place) if values.ndim > len(shape) else lanes
            variables[dimension(key)] = (dims, values, key_attrs(key))
    return variables


def scenes_from_dataset(data: "xr.Dataset", shape: tuple[int, ...], precision: "Precision") -> "Scene":
    """The scenes (leading axes of `shape`) of a dataset, from its first scene and the numbers that differ."""
    import jax
    import jax.numpy as jnp

    from jaxshroud.scene.config import parse
    from jaxshroud.scene.numbers import replaced
    from jaxshroud.scene.valid import in_precision

    first = in_precision(parse(data.attrs["scene"], "the scene of this result").scene, precision)
    scenes = jax.tree.map(lambda a: jnp.broadcast_to(a, (*shape, *a.shape)), first)
    return replaced(scenes, {v.attrs["key"]: v.to_numpy() for v in data.variables.values() if "key" in v.attrs})
