"""A scene written down: its numbers by table and key, and as the TOML that gives it again."""

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np
import tomli_w

from jaxshroud.scene.parts import reading_text
from jaxshroud.scene.scene import Scene

TABLES = ("blades", "shroud", "contact", "friction", "drive", "initial")


def numbers_of(scene: Scene) -> dict[str, np.ndarray]:
    """Every number that a scene, or many (leading axes), has, by its key; in SI units."""
    tables = {table: getattr(scene, table) for table in TABLES}
    fields = {table: part._asdict() if table == "initial" else vars(part) for table, part in tables.items()}
    known = {f"{table}.{name}": value for table, part in fields.items() for name, value in part.items()}
    return {key: np.asarray(value) for key, value in known.items() if hasattr(value, "shape")}


def tables_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """One scene as plain numbers by table and key; alike blades have one."""
    tables: dict[str, dict[str, Any]] = {table: {} for table in TABLES}
    for key, value in numbers_of(scene).items():
        table, name = key.split(".")
        alike = value.ndim == 0 or value[0] == value[1]
        tables[table][name] = float(value.ravel()[0]) if alike else value.tolist()
    tables["contact"]["reading"] = reading_text(scene.contact.reading)
    return {**tables, "parts": {**scene.parts._asdict(), "motion": list(scene.parts.motion)}}


def words_of(text: str) -> dict[str, str]:
    """What a scene's text says, as `table.key` and words, but for its title and what is swept."""
    tables = tomllib.loads(text)
    physics = {table: keys for table, keys in tables.items() if isinstance(keys, dict) and table != "sweep"}
    return {f"{table}.{key}": str(value) for table, keys in physics.items() for key, value in keys.items()}


def text_of(scene: Scene, run: Mapping[str, Any], title: str = "") -> str:
    """One scene as a file, with how it was run: loading it gives the same scene."""
    return tomli_w.dumps({"title": title, **tables_of(scene), "run": dict(run)})
