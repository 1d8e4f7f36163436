"""A scene as text: its numbers by table and key, and its TOML file."""

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np
import tomli_w

from jaxshroud.scene.parts import reading_text
from jaxshroud.scene.scene import Scene

TABLE_NAMES = ("blades", "shroud", "contact", "friction", "drive", "initial")


def fields_of(scene: Scene) -> dict[str, Any]:
    """All numbers of a scene, or of many (leading axes), by their keys: arrays of NumPy or JAX, in SI units."""
    tables = {table: getattr(scene, table) for table in TABLE_NAMES}
    fields = {table: part._asdict() if table == "initial" else vars(part) for table, part in tables.items()}
    named = {f"{table}.{name}": value for table, part in fields.items() for name, value in part.items()}
    return {key: value for key, value in named.items() if hasattr(value, "shape")}


def numbers_of(scene: Scene) -> dict[str, np.ndarray]:
    """All numbers of a scene by their keys, as NumPy arrays in SI units."""
    return {key: np.asarray(value) for key, value in fields_of(scene).items()}


def tables_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """One scene as plain numbers by table and key, with one number for equal blades."""
    tables: dict[str, dict[str, Any]] = {table: {} for table in TABLE_NAMES}
    for key, value in numbers_of(scene).items():
        table, name = key.split(".")
        is_equal = value.ndim == 0 or value[0] == value[1]
        tables[table][name] = float(value.ravel()[0]) if is_equal else value.tolist()
    tables["contact"]["reading"] = reading_text(scene.contact.reading)
    return {**tables, "parts": {**scene.parts._asdict(), "motion": list(scene.parts.motion)}}


def words_of(text: str) -> dict[str, str]:
    """The entries of a scene's TOML text as `table.key` and words, without its title and sweep."""
    tables = tomllib.loads(text)
    physics = {table: keys for table, keys in tables.items() if isinstance(keys, dict) and table != "sweep"}
    return {f"{table}.{key}": str(value) for table, keys in physics.items() for key, value in keys.items()}


def text_of(scene: Scene, run: Mapping[str, Any], title: str = "") -> str:
    """The TOML file of one scene and its run: loading it gives the same scene."""
    return tomli_w.dumps({"title": title, **tables_of(scene), "run": dict(run)})
