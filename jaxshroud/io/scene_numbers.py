"""The numbers of scenes as dimensions and variables of results, and the scenes restored from these."""

import tomllib
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.scene.keys import Motion, find_key, key_parts

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.scene.checks import Precision
    from jaxshroud.scene.scene import Scene


def dimension(key: str) -> str:
    """The name of the dimension along `key`: its last word, or `initial_x` where a variable is called `x`."""
    table, name = key.split(".")
    stem, _, blade = name.partition("[")
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    return stem + {"": "", "0]": "_left", "1]": "_right"}[blade]


def key_attrs(key: str) -> dict[str, str]:
    """The attributes of the variable that holds a number of scenes."""
    return {"key": key, "units": find_key(key)[0].netcdf, "long_name": key_label(key)}


def key_label(key: str) -> str:
    """The description of a scene's number with its symbol, as axes show it."""
    row, blade = find_key(key)
    side = "" if blade is None else f", {('left', 'right')[blade]} blade"
    return f"{row.label}{side} ${row.symbol}$"


def scene_text_of_lane(data: "xr.Dataset") -> str:
    """The scene of a dataset that holds one lane of many, as TOML: the first lane's with the numbers of this one."""
    import tomli_w

    scene = tomllib.loads(data.attrs["scene"])
    for variable in data.variables.values():
        if "key" not in variable.attrs or set(variable.dims) - {"blade"}:
            continue
        table, name, blade = key_parts(variable.attrs["key"])
        value = variable.to_numpy().tolist()
        if blade is not None:
            pair = np.broadcast_to(scene[table][name], 2).tolist()
            value = [value if i == blade else pair[i] for i in (0, 1)]
        scene[table].pop({"k": "gamma", "gamma": "k"}.get(name, ""), None)
        scene[table][name] = value
    return tomli_w.dumps(scene)


def scene_differences(
    scenes: "Scene", shape: tuple[int, ...], lanes: tuple[str, ...]
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """The numbers that are not the same in all scenes (leading axes of `shape`), as xarray takes variables."""
    from jaxshroud.scene.text import numbers_of

    variables = {}
    for key, values in numbers_of(scenes).items() if shape else ():
        if np.any(values != values[(0,) * len(shape)]):
            dims = (*lanes, "blade") if values.ndim > len(shape) else lanes
            variables[dimension(key)] = (dims, values, key_attrs(key))
    return variables


def scenes_from_dataset(data: "xr.Dataset", shape: tuple[int, ...], precision: "Precision") -> "Scene":
    """The scenes (leading axes of `shape`) of a dataset, from its first scene and the numbers that differ."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from jaxshroud.scene.config import parse
    from jaxshroud.scene.valid import in_precision

    first = in_precision(parse(data.attrs["scene"], "the scene of this result").scene, precision)
    scenes = jax.tree.map(lambda a: jnp.broadcast_to(a, (*shape, *a.shape)), first)
    for variable in data.variables.values():
        if "key" in variable.attrs:
            table, name = variable.attrs["key"].split(".")
            number = lambda s, table=table, name=name: getattr(getattr(s, table), name)
            scenes = eqx.tree_at(number, scenes, jnp.asarray(variable.to_numpy(), precision))
    return scenes
