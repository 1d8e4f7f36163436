"""Scene files: TOML in, a checked scene with its run and sweep out."""

import os
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from jaxshroud.scene.axes import axes, axis
from jaxshroud.scene.checks import hint, meant
from jaxshroud.scene.errors import SceneError
from jaxshroud.scene.file import Axis, SceneFile, plain
from jaxshroud.scene.given import work_out
from jaxshroud.scene.messages import fail, problem
from jaxshroud.scene.overrides import RENAMED, has_old_name, override, renamed
from jaxshroud.scene.schema import FILE, PHYSICS, TABLES
from jaxshroud.scene.shipped import aliases, shipped, shipped_paths

__all__ = ["Axis", "SceneError", "SceneFile", "axis", "load", "parse", "shipped"]


def load(source: str | os.PathLike, overrides: Sequence[str] = ()) -> SceneFile:
    """Read a scene file.

    Args:
        source: A path, or the name of a shipped scene such as "fig09".
        overrides: `table.key=value` each, in order; `contact.gamma` replaces `contact.k` and vice versa.

    Raises:
        SceneError: The file or an override is wrong; the message is one line with the place and the cure.
    """
    path, name = Path(source), os.fspath(source)
    if not os.path.isfile(path):
        paths, others, stem = shipped_paths(), aliases(), name.removesuffix(".toml")
        if others.get(stem, stem) not in paths:
            asked = path.name.removesuffix(".toml")
            told = [name for name in paths if not name.endswith("_best")]  # all would be too many for a line
            cure = meant(asked, [*paths, *others]) or hint(asked, told)
            fail(name, f"no such file or shipped scene{cure}; `jaxshroud scenes` lists the shipped ones")
        path = paths[others.get(stem, stem)]
        name = path.name
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        fail(name, f"cannot be read as UTF-8 text: {error}")
    document = _document(text, name)
    if any(table in document for table in RENAMED):
        warnings.warn(f"{name}: [model] is called [parts] now; rename it", DeprecationWarning, stacklevel=2)
    return _loaded(document, name, overrides)


def parse(text: str, name: str, overrides: Sequence[str] = ()) -> SceneFile:
    """The scene in TOML `text`; messages call it `name`. See `load`."""
    return _loaded(_document(text, name), name, overrides)


def _document(text: str, name: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: a number of 5,000 digits
        fail(name, f"not valid TOML: {error}")


def _loaded(document: dict[str, Any], name: str, overrides: Sequence[str]) -> SceneFile:
    """The scene of a TOML document, which is changed in place."""
    old_name = renamed(document, name)
    blamed = {override(document, text) for text in overrides}
    work_out(document, name, blamed)
    try:
        file: Any = FILE.validate_python(document)
    except ValidationError as error:
        table, key, told, kind = problem(error, document)
        by_override = (table, key) in blamed or (table not in TABLES and table in dict(blamed))
        old_name = has_old_name(overrides) if by_override else old_name
        told = told.replace("[parts]", "[model]") if old_name else told
        fail("--set" if by_override else name, told, kind)
    tables = {table: plain(getattr(file, table)) for table in PHYSICS}
    loaded = SceneFile(name, file.title, tables, file.run)
    if file.sweep is None:
        return loaded
    where = f"{'--set' if 'sweep' in dict(blamed) else name}: [sweep]"
    return replace(loaded, axes=axes(loaded, file.sweep, where), direction=file.sweep.direction, keep=file.sweep.keep)
