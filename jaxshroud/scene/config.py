"""Scene files: from TOML, with derived inputs replaced, to a checked scene with its run and sweep."""

import copy
import os
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from jaxshroud.scene.checks import SceneError, did_you_mean, fail, hint
from jaxshroud.scene.document import resolve_derived_inputs
from jaxshroud.scene.engine_orders import resolve_orders
from jaxshroud.scene.file import Axis, SceneFile, table_values
from jaxshroud.scene.keys import MODE_ENTRY, list_length
from jaxshroud.scene.layout import layout_with
from jaxshroud.scene.load_table import resolve_table
from jaxshroud.scene.messages import first_problem
from jaxshroud.scene.mode_table import resolve_modes
from jaxshroud.scene.nested_tables import flattened
from jaxshroud.scene.overrides import axes, axis, override
from jaxshroud.scene.point_numbers import with_place_entries
from jaxshroud.scene.schema import PHYSICS_TABLES, ROW_TYPE, TABLE_MODELS, scene_file_type
from jaxshroud.scene.shipped import aliases, shipped, shipped_paths
from jaxshroud.scene.speed import GROWTHS, SPEED_KEYS, UNTWIST, check_speed
from jaxshroud.scene.title import retitled
from jaxshroud.scene.typed import typed

__all__ = ["Axis", "SceneError", "SceneFile", "axis", "load", "parse", "shipped"]
MAX_NAME_LENGTH = 200  # characters of a missing file's name in messages


@typed
def load(source: str | os.PathLike, overrides: Sequence[str] = ()) -> SceneFile:
    """Read a scene file.

    Args:
        source: A path, or the name of a shipped scene such as "fig09".
        overrides: `table.key=value` each, in order; `contact.gamma` replaces `contact.k` and vice versa.

    Raises:
        SceneError: The file or an override is invalid; the message is one line with the place and the cure.
    """
    path = Path(source)
    name = os.fspath(source)
    if not os.path.isfile(path):
        paths = shipped_paths()
        alias_names = aliases()
        stem = name.removesuffix(".toml")
        if alias_names.get(stem, stem) not in paths:
            stem_given = path.name.removesuffix(".toml")
            cure = did_you_mean(stem_given, [*paths, *alias_names]) or hint(stem_given, [*paths])
            fail(
                name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}...",
                f"no such file or shipped scene{cure}; `jaxshroud scenes` lists the shipped ones",
            )
        path = paths[alias_names.get(stem, stem)]
        name = path.name
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        fail(name, f"cannot be read as UTF-8 text: {error}")
    return _scene_file(_document(text, name), name, overrides, path.parent)


def parse(text: str, name: str, overrides: Sequence[str] = ()) -> SceneFile:
    """The scene in TOML `text`; messages call it `name`. See `load`."""
    return _scene_file(_document(text, name), name, overrides)


def _document(text: str, name: str) -> dict[str, Any]:
    try:
        return flattened(tomllib.loads(text), name)
    except SceneError:
        raise
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: a number of 5,000 digits
        fail(name, f"not valid TOML: {error}")


def _scene_file(document: dict[str, Any], name: str, overrides: Sequence[str], folder: Path | None = None) -> SceneFile:
    """The scene file of a TOML document, which is changed in place; tables of loads are looked for in a folder."""
    if isinstance(document.get("initial"), str):
        document["initial"] = {"start": document["initial"]}
    original = copy.deepcopy(document) if len(overrides) else {}
    first = [text for text in overrides if _is_table_of_modes(text)]
    for text in first:
        override(document, text, name)
    resolve_modes(document, folder or Path(), "--set" if first else name, bool(first))
    others = sorted((text for text in overrides if text not in first), key=_precedence)
    overridden = {override(document, text, name) for text in others} | {("blades", "modes") for _ in first}
    row = _validated(ROW_TYPE, document, name, overridden).row
    layout = layout_with(row)
    table_note = resolve_table(document, folder or Path(), name, overridden)
    harmonics = resolve_orders(document, name, overridden)
    given = resolve_derived_inputs(document, name, overridden, layout)
    modes = list_length(document["blades"], MODE_ENTRY) if isinstance(document.get("blades"), dict) else 0
    file = _validated(scene_file_type(layout, harmonics, modes), document, name, overridden)
    physics = {table: getattr(file, table) for table in ("row", "aero", *PHYSICS_TABLES)}
    tables = {table: table_values(of_file) for table, of_file in physics.items() if of_file is not None}
    tables["contact"] = with_place_entries(tables["contact"])
    numbers = {f"{table}.{entry}": value for table, part in tables.items() for entry, value in part.items()}
    speed_is_set = any(f"{table}.{entry}" in (*GROWTHS, *UNTWIST) for table, entry in overridden)
    check_speed(numbers, given, layout.blades, "--set" if speed_is_set else name)
    loaded = SceneFile(
        name, file.title, tables, file.run, given=given, notes={"load table": table_note} if table_note else {}
    )
    if len(overrides):
        title = file.title or Path(name).name
        loaded = replace(
            loaded, title=retitled(title, loaded.given_tables, _physics_of(original, name, folder), overridden)
        )
    if file.sweep is None:
        return loaded
    place = f"{'--set' if 'sweep' in dict(overridden) else name}: [sweep]"
    return replace(loaded, axes=axes(loaded, file.sweep, place), direction=file.sweep.direction, keep=file.sweep.keep)


def _is_table_of_modes(text: str) -> bool:
    """Whether an override names another table of modes, which is read before numbers of it are set."""
    return text.partition("=")[0].strip() == "blades.modes"


def _precedence(text: str) -> int:
    """The place of an override: first those of the row, which size lists, then what makes an engine order needed."""
    text = text.lstrip()
    return 0 if text.startswith("row.") else 1 if text.startswith(SPEED_KEYS) else 2


def _validated(kind: Any, document: dict[str, Any], name: str, overridden: set[tuple[str, str]]) -> Any:
    """The document as a pydantic type has it.

    Raises:
        SceneError: It is invalid; the message names `--set` where an override is, else the file.
    """
    try:
        return kind.validate_python(document)
    except ValidationError as error:
        table, key, message, error_kind = first_problem(error, document)
        by_override = (table, key) in overridden or (table not in TABLE_MODELS and table in dict(overridden))
        fail("--set" if by_override else name, message, error_kind)


def _physics_of(document: dict[str, Any], name: str, folder: Path | None) -> dict[str, Any] | None:
    """The physics of a TOML document as it is given; None if it is not a valid scene."""
    try:
        return _scene_file(document, name, (), folder).given_tables
    except SceneError:
        return None
