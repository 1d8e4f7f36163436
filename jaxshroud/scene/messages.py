"""The error messages for scene files: one line that names the file, the table, the key and the cure."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from jaxshroud.scene.checks import KeyNameError, SceneError, did_you_mean, hint, toml_text
from jaxshroud.scene.file_rules import NO_STIFFNESS
from jaxshroud.scene.keys import INPUT_KEYS, MODE_ENTRY, list_length
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.optional import harmonic_forms
from jaxshroud.scene.schema import TABLE_MODELS, Table, table_models

UNKNOWN_KEY = "extra_forbidden"  # the type of this error in pydantic
MISSING_TYPES = ("missing", NO_STIFFNESS)


def problem_text(problem: ErrorDetails) -> str:
    """The description of a pydantic problem, with the message of our own validator if that raised it."""
    context = problem.get("ctx", {})
    given = problem["input"]
    choices = re.findall(r"'(\w+)'", context.get("expected", ""))
    cure = did_you_mean(given, choices) if isinstance(given, str) else ""
    return str(context.get("error", re.sub(r"^\w+ should", "must", problem["msg"]))) + cure


def example(field: FieldInfo) -> str:
    """An example of a key's value, with the meaning of the key."""
    return f"{toml_text((field.examples or [''])[0])} ({field.description})"


def first_problem(error: ValidationError, document: Mapping[str, Any]) -> tuple[str, str, str, type[SceneError]]:
    """The table, key, description and kind of the first problem; unknown keys first, as they explain missing ones."""
    problems = error.errors()
    first = min(problems, key=lambda e: e["type"] != UNKNOWN_KEY)
    kind = KeyNameError if first["type"] == UNKNOWN_KEY else SceneError
    if not first["loc"]:
        return "parts", "contact", problem_text(first), kind
    table, name = (*map(str, first["loc"][:2]), "")[:2]
    missing = [e for e in problems if e["type"] in MISSING_TYPES]
    if len(missing) > 1 and first in missing:
        return table, name, _all_missing(missing, document), kind
    return table, name, (_of_key if name else _of_table)(table, name, first, document), kind


def _all_missing(missing: Sequence[ErrorDetails], document: Mapping[str, Any]) -> str:
    """The message for every missing table with its required keys, and every missing key of other tables."""
    missing_keys: dict[str, list[str]] = {}
    for e in missing:
        table, *names = map(str, e["loc"])
        missing_keys.setdefault(table, []).extend(["gamma"] if e["type"] == NO_STIFFNESS else names)
    missing_text = "; ".join(
        f"[{table}] lacks {', '.join(f'`{name}`' for name in names)}"
        if names
        else f"[{table}] is missing, with {', '.join(_required_keys(table))}"
        for table, names in missing_keys.items()
    )
    table, names = next(iter(missing_keys.items()))
    name = (names or _required_keys(table))[0]
    return (
        f"{missing_text}; add all of them, e.g. in [{table}] {name} = "
        f"{example(_model_of(table, document).model_fields[name])}"
    )


def _model_of(table: str, document: Mapping[str, Any]) -> type[Table]:
    """The model of a table, which knows the harmonics and the modes of the document."""
    drive, blades = document.get("drive"), document.get("blades")
    harmonics = harmonic_forms(drive) if isinstance(drive, Mapping) else ()
    return table_models(PAIR, harmonics, list_length(blades, MODE_ENTRY) if isinstance(blades, Mapping) else 0)[table]


def _required_keys(table: str) -> list[str]:
    """The required keys of a table."""
    needed = [name for name, field in TABLE_MODELS[table].model_fields.items() if field.is_required()]
    return [*needed, "gamma"] if table == "contact" else needed


def _of_key(table: str, name: str, first: ErrorDetails, document: Mapping[str, Any]) -> str:
    fields = _model_of(table, document).model_fields
    if first["type"] == UNKNOWN_KEY:
        keys = [*fields, *(row.parts[1] for row in INPUT_KEYS if row.parts[0] == table)]
        return f"[{table}] has no key `{name}`{hint(name, keys)}"
    if first["type"] == "missing" and len(first["loc"]) == 2:
        return f"[{table}] lacks `{name}`; add it, e.g. {name} = {example(fields[name])}"
    given = toml_text(document[table].get(name))
    description = problem_text(first)
    return f"[{table}] {name} = {given} {description}, e.g. {name} = {example(fields[name])}"


def _of_table(table: str, _: str, first: ErrorDetails, __: Mapping[str, Any]) -> str:
    if first["type"] == UNKNOWN_KEY:
        return f"there is no table [{table}]{hint(table, ['title', *TABLE_MODELS])}"
    if first["type"] == "missing":
        return f"[{table}] is missing; add this table with {', '.join(TABLE_MODELS[table].model_fields)}"
    if table not in TABLE_MODELS:
        return f'{table} must be one line of text without control characters, e.g. {table} = "Fig. 9"'
    is_own_message = first["type"] in ("value_error", NO_STIFFNESS)
    return f"[{table}] {problem_text(first) if is_own_message else 'must be a table of keys'}"
