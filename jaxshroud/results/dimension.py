"""A scene's numbers as dimensions and variables of results."""

import tomllib
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.scene.keys import found, key_parts
from jaxshroud.scene.motion import Motion

if TYPE_CHECKING:
    import xarray as xr


def dimension(key: str) -> str:
    """Name of the dimension along `key`: its last word, but `initial_x` where a variable has that name."""
    table, name = key.split(".")
    stem, _, blade = name.partition("[")
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    return stem + {"": "", "0]": "_left", "1]": "_right"}[blade]


def about(key: str) -> dict[str, Any]:
    """Attributes of the variable that holds a scene's number."""
    return {"key": key, "units": found(key)[0].netcdf, "long_name": words(key)}


def words(key: str) -> str:
    """What a scene's number is, with its symbol, as xarray writes it on axes."""
    row, blade = found(key)
    side = "" if blade is None else f", {('left', 'right')[blade]} blade"
    return f"{row.label}{side} ${row.symbol}$"


def text_of_one(data: "xr.Dataset") -> str:
    """The scene, as a file, of a dataset that holds one lane of many: the first lane's with what differs here."""
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
