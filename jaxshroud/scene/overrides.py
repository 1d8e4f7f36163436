"""Overrides of a scene file: `table.key=value`."""

import re
import tomllib
from typing import Any

from jaxshroud.scene.derived_inputs import alternative_keys
from jaxshroud.scene.keys import KEYS
from jaxshroud.scene.messages import fail, toml_text
from jaxshroud.scene.schema import TABLE_MODELS
from jaxshroud.scene.units import is_speed_of_rotation

OVERRIDE = re.compile(r"\s*([a-z]+)\.(\w+)(?:\[([01])\])?\s*=\s*(\S.*?)\s*")
PER_BLADE_KEYS = {row.name for row in KEYS.values() if row.pair}
# Setting the left key drops the right ones, which say the same.
EXCLUSIVE_KEYS = {
    ("contact", "k"): [("contact", "gamma")],
    ("contact", "gamma"): [("contact", "k")],
    ("run", "periods"): [("sweep", "keep")],
    ("run", "steps_per_period"): [("run", "accuracy")],
    ("run", "accuracy"): [("run", "steps_per_period")],
    ("sweep", "values"): [("sweep", "start"), ("sweep", "stop"), ("sweep", "num")],
    **{("sweep", key): [("sweep", "values")] for key in ("start", "stop", "num")},
}


def literal(text: str) -> Any:
    """A value from the command line: a number, TOML, a comma-separated list, or else a string."""
    for parse in (int, float, lambda t: tomllib.loads(f"v = {t}")):
        try:
            value = parse(text)
        except (ValueError, RecursionError):
            continue
        if not isinstance(value, dict):
            return value
        if list(value) == ["v"]:
            return value["v"]
    return [literal(t.strip()) for t in text.split(",")] if "," in text and text[0] != "[" else text


def check_is_no_speed(where: str, key: str, value: Any, engine_order: Any) -> None:
    """Refuse a speed of rotation for the circular frequency of a drive whose scene has an engine order."""
    if key == "drive.omega" and engine_order is not None and is_speed_of_rotation(value):
        order = f"{engine_order:g}" if isinstance(engine_order, int | float) else engine_order
        fail(
            where,
            f"{toml_text(value)} is a speed of rotation, but omega is the frequency of a drive with engine order "
            f"{order}; name drive.speed, or give omega in rad/s",
        )


def override(document: dict[str, Any], text: str) -> tuple[str, str]:
    """Set one key of the `document` in place; its table and name are returned."""
    match = OVERRIDE.fullmatch(text)
    if match is None:
        fail("--set", f"{toml_text(text)} is not table.key=value, e.g. --set contact.gamma=3")
    table, name, blade, value = match[1], match[2], match[3], literal(match[4])
    rows = document.setdefault(table, {})
    if not isinstance(rows, dict):
        return "", ""  # an error of the file, which is reported later
    if blade is not None:
        if (
            table in TABLE_MODELS
            and name in TABLE_MODELS[table].model_fields
            and f"{table}.{name}" not in PER_BLADE_KEYS
        ):
            kind = "one number, " if f"{table}.{name}" in KEYS else ""
            fail("--set", f"[{match[1]}] {name} is {kind}not one per blade; drop the [{blade}]")
        old = rows.get(name, rows.get("m") if name == "m_y" else 0.0 if table == "initial" else None)
        pair = old if isinstance(old, list) else [old, old]
        if old is None and alternative_keys(f"{table}.{name}"):
            fail("--set", f"[{table}] {name}[{blade}]: the file does not give `{name}`; set both blades, [left, right]")
        if old is None or len(pair) != 2:
            return "", ""  # an error of the file, which is reported later
        value = [value if i == int(blade) else v for i, v in enumerate(pair)]
    check_is_no_speed("--set", f"{table}.{name}", value, rows.get("engine_order"))
    rows[name] = value
    alternatives = [tuple(key.split(".")) for key in alternative_keys(f"{table}.{name}")]
    for rival_table, rival_key in [*EXCLUSIVE_KEYS.get((table, name), []), *alternatives]:
        if isinstance(document.get(rival_table), dict):
            document[rival_table].pop(rival_key, None)
    return table, name
