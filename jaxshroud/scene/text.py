"""A scene as text: its numbers by table and key, and its TOML file."""

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np
import tomli_w

from jaxshroud.scene.derived_inputs import in_given_form, in_tables
from jaxshroud.scene.drive import Drive
from jaxshroud.scene.harmonics import flattened, nested
from jaxshroud.scene.numbers import given_of, numbers_of
from jaxshroud.scene.parts import reading_text
from jaxshroud.scene.replacing import plain_numbers
from jaxshroud.scene.scene import Scene


def given_numbers_of(scene: Scene) -> dict[str, np.ndarray]:
    """What a scene, or many (leading axes), is given by: numbers by their keys, as NumPy arrays in SI units."""
    given = in_given_form(numbers_of(scene), given_of(scene), scene.layout)
    return {key: np.asarray(value) for key, value in given.items() if value is not None}


def tables_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """One scene as it is given, in plain numbers by table and key, with one number for equal blades."""
    tables = in_tables(plain_numbers(numbers_of(scene)), plain_numbers(given_of(scene)), scene.layout)
    tables["contact"]["reading"] = reading_text(scene.contact.reading)
    tables["drive"] |= {f"harmonic[{i}].order": one.order for i, one in enumerate(scene.drive.harmonic or ())}
    if scene.contact.points is not None:
        tables["contact"] |= scene.contact.points.as_given()
    if type(scene.drive) is not Drive:
        tables["drive"]["own"] = type(scene.drive).__name__  # which no file can name: it is refused there
    if row := scene.row:
        tables = {"row": {"blades": row.blades, "closed": row.closed, **tables.pop("row")}, **tables}
    return {**tables, "parts": {**scene.parts._asdict(), "motion": list(scene.parts.motion)}}


def words_of(text: str) -> dict[str, str]:
    """The entries of a scene's TOML text as `table.key` and words, without its title and sweep."""
    tables = flattened(tomllib.loads(text), "the scene of a result")
    physics = {table: keys for table, keys in tables.items() if isinstance(keys, dict) and table != "sweep"}
    return {f"{table}.{key}": str(value) for table, keys in physics.items() for key, value in keys.items()}


def text_of(scene: Scene, run: Mapping[str, Any], title: str = "") -> str:
    """The TOML file of one scene and its run: loading it gives the same scene."""
    return tomli_w.dumps(nested({"title": title, **tables_of(scene), "run": dict(run)}))
