"""A scene as text: its TOML file, and its numbers in the unit that pages show."""

import tomllib
from collections.abc import Mapping
from decimal import Context, Decimal
from typing import Any

import numpy as np
import tomli_w

from jaxshroud.scene.derived_inputs import in_given_form, in_tables
from jaxshroud.scene.drive import Drive
from jaxshroud.scene.drive_orders import entries_of_orders
from jaxshroud.scene.keys import Key
from jaxshroud.scene.layout import reading_text
from jaxshroud.scene.nested_tables import flattened, nested
from jaxshroud.scene.overrides import literal
from jaxshroud.scene.replacing import plain_numbers
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.tables import start_entries
from jaxshroud.scene.typed import are_numbers
from jaxshroud.scene.units import factor_of, to_si
from jaxshroud.scene.vary import given_of, numbers_of


def given_numbers_of(scene: Scene) -> dict[str, np.ndarray]:
    """What a scene, or many (leading axes), is given by: numbers by their keys, as NumPy arrays in SI units."""
    given = in_given_form(numbers_of(scene), given_of(scene), scene.layout)
    return {key: np.asarray(value) for key, value in given.items() if value is not None}


def tables_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """One scene as it is given, in plain numbers by table and key, with one number for equal blades."""
    given = given_of(scene)
    tables = in_tables(plain_numbers(numbers_of(scene)), plain_numbers(given), scene.layout)
    tables["contact"]["reading"] = reading_text(scene.contact.reading)
    tables["initial"] |= start_entries(scene.start)
    tables["drive"] |= entries_of_orders(scene.drive, given)
    if scene.contact.points is not None:
        tables["contact"] |= scene.contact.points.as_given()
    if type(scene.drive) is not Drive:
        tables["drive"]["own"] = type(scene.drive).__name__  # which no file can name: it is refused there
    if row := scene.row:
        sector = {} if row.sector == "whole" else {"sector": row.sector}
        tables = {"row": {"blades": row.blades, "closed": row.closed, **sector, **tables.pop("row")}, **tables}
    return {**tables, "parts": {**scene.parts._asdict(), "motion": list(scene.parts.motion)}}


def words_of(text: str) -> dict[str, str]:
    """The entries of a scene's TOML text as `table.key` and words, without its title and sweep."""
    tables = flattened(tomllib.loads(text), "the scene of a result")
    physics = {table: keys for table, keys in tables.items() if isinstance(keys, dict) and table != "sweep"}
    return {f"{table}.{key}": str(value) for table, keys in physics.items() for key, value in keys.items()}


def text_of(scene: Scene, run: Mapping[str, Any], title: str = "") -> str:
    """The TOML file of one scene and its run: loading it gives the same scene."""
    return tomli_w.dumps(nested({"title": title, **tables_of(scene), "run": dict(run)}))


FEW_DIGITS = 12  # as one types them
ENOUGH_DIGITS, MOST_DIGITS = 17, 30  # what distinguishes doubles; what the factor of a unit has, and more
PLAIN = range(-5, 16)  # powers of ten of numbers that are written without an exponent


def shown_text(key: Key, value: Any) -> str:
    """A number of a key in SI units, or a list of them, in the unit that is shown: the shortest text that reads so."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(shown_text(key, one) for one in value)}]"
    factor = factor_of(key.unit, key.shown[0])
    assert factor is not None, key
    exact = (Decimal(repr(float(value))) / factor).normalize()

    def text(digits):
        return _written(Context(prec=digits).plus(exact))

    def reads(digits):
        return to_si(key.unit, f"{text(digits)} {key.shown[0]}") == value

    if len(exact.as_tuple().digits) <= ENOUGH_DIGITS:  # as where the factor is a power of ten
        return text(ENOUGH_DIGITS)
    least = 1 if reads(FEW_DIGITS) else FEW_DIGITS + 1
    return text(next(filter(reads, range(least, MOST_DIGITS))))


def _written(number: Decimal) -> str:
    return format(number, "f") if number.adjusted() in PLAIN else f"{number:e}"


def read_shown(key: Key, text: str) -> Any:
    """What a text gives for a key, in SI units: bare numbers are in the unit that is shown, others name their own.

    Returns:
        A number, or a list of them.

    Raises:
        ValueError: It is neither, or of another unit.
    """
    value = to_si(key.unit, _in_shown_unit(literal(text.strip(), Decimal), key.shown[0]))
    if not are_numbers(value):
        raise ValueError("is not a number")
    return value


def _in_shown_unit(value: Any, unit: str) -> Any:
    if isinstance(value, list):
        return [_in_shown_unit(one, unit) for one in value]
    return f"{value} {unit}" if isinstance(value, int | Decimal) and not isinstance(value, bool) else value


def override_of(key: Key, text: str) -> str:
    """A text as the value of an override, as `read_shown` reads it; what is no number is left to the schema."""
    try:
        return repr(read_shown(key, text))
    except ValueError:
        return text.strip()
