"""A scene's numbers as dimensions and variables of results."""

from typing import Any

from jaxshroud.scene.keys import found
from jaxshroud.scene.motion import Motion


def dimension(key: str) -> str:
    """Name of the dimension along `key`: its last word, but `initial_x` where a variable has that name."""
    table, name = key.split(".")
    stem, _, blade = name.partition("[")
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    return stem + {"": "", "0]": "_left", "1]": "_right"}[blade]


def about(key: str) -> dict[str, Any]:
    """Attributes of the variable that holds a scene's number."""
    return {"key": key, "units": found(key)[0].netcdf, "long_name": key}
