"""Numbers of a scene file set from outside: `table.key=value`."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from jaxshroud.scene.given import instead_of
from jaxshroud.scene.keys import KEYS
from jaxshroud.scene.messages import fail, shown
from jaxshroud.scene.schema import TABLES

OVERRIDE = re.compile(r"\s*([a-z]+)\.(\w+)(?:\[([01])\])?\s*=\s*(\S.*?)\s*")
PAIRS = {row.name for row in KEYS.values() if row.pair}
RENAMED = {"model": "parts"}  # tables that had another name
# Setting the left key drops the right ones: they say the same thing another way.
RIVALS = {
    ("contact", "k"): [("contact", "gamma")],
    ("contact", "gamma"): [("contact", "k")],
    ("run", "periods"): [("sweep", "keep")],
    ("sweep", "values"): [("sweep", "start"), ("sweep", "stop"), ("sweep", "num")],
    **{("sweep", key): [("sweep", "values")] for key in ("start", "stop", "num")},
}


def literal(text: str) -> Any:
    """A value from the command line: a number, TOML, a comma-separated list, or else a string."""
    for read in (int, float, lambda t: tomllib.loads(f"v = {t}")):
        try:
            value = read(text)
        except (ValueError, RecursionError):
            continue
        if not isinstance(value, dict):
            return value
        if list(value) == ["v"]:
            return value["v"]
    return [literal(t.strip()) for t in text.split(",")] if "," in text and text[0] != "[" else text


def override(document: dict[str, Any], text: str) -> tuple[str, str]:
    """Set one key of `document` in place and return its table and name."""
    match = OVERRIDE.fullmatch(text)
    if match is None:
        fail("--set", f"{shown(text)} is not table.key=value, e.g. --set contact.gamma=3")
    table, name, blade, value = RENAMED.get(match[1], match[1]), match[2], match[3], literal(match[4])
    rows = document.setdefault(table, {})
    if not isinstance(rows, dict):
        return "", ""  # the fault is the file's
    if blade is not None:
        if table in TABLES and name in TABLES[table].model_fields and f"{table}.{name}" not in PAIRS:
            one = "one number, " if f"{table}.{name}" in KEYS else ""
            fail("--set", f"[{match[1]}] {name} is {one}not one per blade; drop the [{blade}]")
        old = rows.get(name, rows.get("m") if name == "m_y" else 0.0 if table == "initial" else None)
        pair = old if isinstance(old, list) else [old, old]
        if old is None and instead_of(f"{table}.{name}"):
            fail("--set", f"[{table}] {name}[{blade}]: the file does not give `{name}`; set both blades, [left, right]")
        if old is None or len(pair) != 2:
            return "", ""  # the fault is the file's
        value = [value if i == int(blade) else v for i, v in enumerate(pair)]
    rows[name] = value
    ways = [tuple(key.split(".")) for key in instead_of(f"{table}.{name}")]
    for other, rival in [*RIVALS.get((table, name), []), *ways]:
        if isinstance(document.get(other), dict):
            document[other].pop(rival, None)
    return table, name


def renamed(document: dict[str, Any], where: str) -> bool:
    """Give the tables of `document` the names they have now; whether there was one of another name."""
    old = [table for table in RENAMED if table in document]
    for table in old:
        if RENAMED[table] in document:
            fail(where, f"[{table}] is the former name of [{RENAMED[table]}]; keep one of them")
        document[RENAMED[table]] = document.pop(table)
    return bool(old)


def has_old_name(overrides: Sequence[str]) -> bool:
    """Whether a table is called by another name than it has now."""
    return any(text.partition(".")[0].strip() in RENAMED for text in overrides)
