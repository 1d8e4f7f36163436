"""The numbers of scenes as dimensions and variables of results, and the scenes restored from these."""

import re
import tomllib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.scene.keys import ALL_KEYS, Key, Motion, parse_key
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.nested_tables import nested
from jaxshroud.scene.replacing import layout_of, replaced_tables

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.scene.checks import Precision
    from jaxshroud.scene.scene import Scene

NO_WORD = re.compile(r"\W+")  # of a key that is no name of a variable: harmonic[1].F is harmonic_1_F


def dimension(key: str, names: Sequence[str] = PAIR.names) -> str:
    """The name of the dimension along `key`: its last word, or `initial_x` where a variable is called `x`.

    One blade has its name, of those in `names`, at the end, and one interface its number: `k_x_left`, `k_x_17`.
    """
    number, index = parse_key(key)
    table, stem = number.parts
    stem = NO_WORD.sub("_", stem)
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    return stem if index is None else f"{stem}_{_name_of(number, index, names)}"


def _name_of(number: Key, index: int, names: Sequence[str]) -> str:
    """The name of a blade, or the number of an interface, and of a blade whose name is not known."""
    return dict(enumerate(() if number.per_interface else names)).get(index, str(index))


def key_attrs(key: str, names: Sequence[str] = PAIR.names) -> dict[str, str]:
    """The attributes of the variable that holds a number of scenes whose blades have these names."""
    return {"key": key, "units": parse_key(key)[0].netcdf, "long_name": key_label(key, names)}


def key_label(key: str, names: Sequence[str] = PAIR.names) -> str:
    """The description of a number of a scene with its symbol, as axes show it; `names` are those of the blades."""
    number, index = parse_key(key)
    place = "" if index is None else f", {_words_of(number, _name_of(number, index, names))}"
    return f"{number.label}{place} ${number.symbol}$"


def _words_of(number: Key, name: str) -> str:
    """A blade or an interface in words: "left blade", "blade 3"."""
    kind = "interface" if number.per_interface else "blade"
    return f"{kind} {name}" if name.isdigit() else f"{name} {kind}"


def layout_in(data: "xr.Dataset") -> Layout:
    """The layout of the scene that a dataset holds."""
    return layout_of(tomllib.loads(data.attrs.get("scene", "")))


def scene_text_of_lane(data: "xr.Dataset") -> str:
    """The scene of a dataset that holds one lane of many, as TOML: the first lane's with the numbers of this one."""
    import tomli_w

    from jaxshroud.scene.config import parse

    variables = [v for v in data.variables.values() if "key" in v.attrs and not set(v.dims) - {"blade", "interface"}]
    file = parse(data.attrs["scene"], "the scene of this result")
    tables = replaced_tables(file.tables, file.given, {v.attrs["key"]: v.to_numpy() for v in variables})
    return tomli_w.dumps(nested({**tomllib.loads(data.attrs["scene"]), **tables}))


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
    from jaxshroud.scene.valid import in_precision
    from jaxshroud.scene.vary import replaced

    first = in_precision(parse(data.attrs["scene"], "the scene of this result").scene, precision)
    scenes = jax.tree.map(lambda a: jnp.broadcast_to(a, (*shape, *a.shape)), first)
    return replaced(scenes, {v.attrs["key"]: v.to_numpy() for v in data.variables.values() if "key" in v.attrs})
