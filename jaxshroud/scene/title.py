"""The title of a scene with overrides."""

from collections.abc import Collection, Mapping
from typing import Any

from jaxshroud.scene.keys import ALL_KEYS

MOST_SHOWN = 4  # values of a list
CHANGE_SEPARATOR = ", but "  # between a title and the overrides

Tables = Mapping[str, Mapping[str, object]]
ByKey = dict[tuple[str, str], object]  # values by table and key


def retitled(title: str, now: Tables, before: Tables | None, set_: Collection[tuple[str, str]]) -> str:
    """The title of a changed scene: its subject and the changes, without the description in the file.

    Args:
        title: The title in the file, "SUBJECT" or "SUBJECT: DESCRIPTION".
        now: The physics, in SI units.
        before: The physics without the changes; None if the file is not a valid scene without them.
        set_: The tables and keys that were set.
    """
    rows = {(table, key): value for table, row in now.items() for key, value in row.items()}
    if before is None:
        new = {key: value for key, value in rows.items() if key in set_}
    else:

        def old(table, key):
            return before.get(table, {}).get(key, _default_of(table, key))

        new = {key: value for key, value in rows.items() if old(*key) != value}
    if not new:
        return title
    shown = _without_modes(new, rows, set_)
    changed = {display_name(*key): display_value(*key, value) for key, value in shown.items()}
    heading, _, earlier = title.partition(CHANGE_SEPARATOR)
    earlier_changes = [change for change in earlier.split(", ") if change and change.partition(" = ")[0] not in changed]
    return (
        subject_of(heading)
        + CHANGE_SEPARATOR
        + ", ".join([*earlier_changes, *(f"{name} = {value}" for name, value in changed.items())])
    )


def _without_modes(new: ByKey, rows: ByKey, set_: Collection[tuple[str, str]]) -> ByKey:
    """The changes; many numbers of modes that were not set one by one are one, the number of modes."""
    of_modes = {key for key in new if key[1].startswith("modes[")} - {*set_}
    if len(of_modes) <= MOST_SHOWN:
        return new
    count = len({key[1].partition("]")[0] for key in rows if key[1].startswith("modes[")})
    return {("blades", "blades"): f"{count} modes"} | {key: value for key, value in new.items() if key not in of_modes}


def _default_of(table: str, key: str) -> object:
    row = ALL_KEYS.get(f"{table}.{key}")
    return None if row is None else row.default


def subject_of(title: str) -> str:
    """The subject of a title, without its description."""
    subject, colon, _ = title.partition(": ")
    return f"Scene of {subject}" if colon and not subject.startswith("A ") else subject


def _word(value: object) -> str:
    """A choice as in a file."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def display_name(table: str, key: str) -> str:
    """The name of a number in titles."""
    return f"{table} {key}" if table in ("initial", "coupling") else key


def display_value(table: str, key: str, value: Any) -> str:
    """A value of a scene in the unit of pictures, as text; of a long list its length."""
    row = ALL_KEYS.get(f"{table}.{key}")
    if isinstance(value, list | tuple) and len(value) > MOST_SHOWN:
        return f"{len(value)} values"
    if row is None or isinstance(value, str):  # a choice, or a number given by a word as "block"
        return " and ".join(map(_word, value)) if isinstance(value, list | tuple) else _word(value)
    unit, factor = row.shown
    values = value if isinstance(value, list | tuple) else [value]
    return f"{' and '.join(f'{number * factor:.6g}' for number in values)} {unit}".strip()
