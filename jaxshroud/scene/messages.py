"""What is told of a wrong scene file: one line that names file, table, key and cure."""

import json
import re
from collections.abc import Mapping
from typing import Any, NoReturn

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from jaxshroud.scene.checks import hint, meant
from jaxshroud.scene.errors import KeyNameError, SceneError
from jaxshroud.scene.keys import OTHERS
from jaxshroud.scene.schema import TABLES

UNKNOWN = "extra_forbidden"  # pydantic's word


def fail(where: str, what: str, kind: type[SceneError] = SceneError) -> NoReturn:
    """Raise an error of one line."""
    raise kind(" ".join(f"{where}: {what}".split()))


def shown(value: Any) -> str:
    """A value as a file has it, cut where it is long."""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except ValueError:  # Python does not write whole numbers of more than 4,300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def told(problem: Any) -> str:
    """Pydantic's account of a problem, in our words where a validator of ours found it."""
    context = problem.get("ctx", {})
    given, known = problem["input"], re.findall(r"'(\w+)'", context.get("expected", ""))
    cure = meant(given, known) if isinstance(given, str) else ""
    return str(context.get("error", re.sub(r"^\w+ should", "must", problem["msg"]))) + cure


def example(field: FieldInfo) -> str:
    """An example of a key's value, and what the key is."""
    return f"{shown((field.examples or [''])[0])} ({field.description})"


def problem(error: ValidationError, document: Mapping[str, Any]) -> tuple[str, str, str, type[SceneError]]:
    """Table, key, description and kind of the first problem; unknown keys first: they explain missing ones."""
    first = min(error.errors(), key=lambda e: e["type"] != UNKNOWN)
    kind = KeyNameError if first["type"] == UNKNOWN else SceneError
    if not first["loc"]:
        return "parts", "contact", told(first), kind
    table, name = (*map(str, first["loc"][:2]), "")[:2]
    return table, name, (_of_key if name else _of_table)(table, name, first, document), kind


def _of_key(table: str, name: str, first: Any, document: Mapping[str, Any]) -> str:
    fields = TABLES[table].model_fields
    if first["type"] == UNKNOWN:
        known = [*fields, *(row.parts[1] for row in OTHERS if row.parts[0] == table)]
        return f"[{table}] has no key `{name}`{hint(name, known)}"
    if first["type"] == "missing" and len(first["loc"]) == 2:
        return f"[{table}] lacks `{name}`; add it, e.g. {name} = {example(fields[name])}"
    return f"[{table}] {name} = {shown(document[table].get(name))} {told(first)}, e.g. {name} = {example(fields[name])}"


def _of_table(table: str, _: str, first: Any, __: Mapping[str, Any]) -> str:
    if first["type"] == UNKNOWN:
        return f"there is no table [{table}]{hint(table, ['title', *TABLES])}"
    if first["type"] == "missing":
        return f"[{table}] is missing; add this table with {', '.join(TABLES[table].model_fields)}"
    if table not in TABLES:
        return f'{table} must be one line of text, e.g. {table} = "Fig. 9"'
    return f"[{table}] {told(first) if first['type'] == 'value_error' else 'must be a table of keys'}"
