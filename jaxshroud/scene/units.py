"""Conversion of strings with units, such as "0.022 mm", to numbers in SI."""

import functools
import math
import re
from decimal import Decimal
from typing import Any

# The name of a unit in messages; of two with the same dimension the first is used for a given value.
QUANTITY_NAMES = {
    "": "a pure number",
    "rad": "an angle",
    "m": "a length",
    "kg": "a mass",
    "s": "a time",
    "N": "a force",
    "m/s": "a speed",
    "rad/s": "a circular frequency",
    "Hz": "a frequency",
    "kg m^2": "a moment of inertia",
    "N/m": "a stiffness",
    "N s/m": "a damping",
    "N m": "a moment",
    "N m/rad": "a torsion stiffness",
    "N m s/rad": "a torsion damping",
}
RPM = 30 / math.pi  # revolutions per minute, per rad/s
PI = Decimal("3.141592653589793238462643383279502884")
# SI unit and unit -> factor, as in pint, whose import takes half a second: what pages show, and what is typed most.
COMMON_FACTORS = {
    ("m", "mm"): Decimal("1e-3"),
    ("m", "um"): Decimal("1e-6"),
    ("rad", "deg"): PI / 180,
    ("rad", "°"): PI / 180,
    ("kg", "g"): Decimal("1e-3"),
    ("kg m^2", "g m²"): Decimal("1e-3"),
    ("N/m", "kN/m"): Decimal("1e3"),
    ("rad/s", "rpm"): PI / 30,
    ("", "%"): Decimal("1e-2"),
}
# Revolutions per minute as drawings and German name-plates write them: U/min, 1/min, min^-1.
PER_MINUTE = re.compile(r"(?:U|(?:1\s*)?)\s*/\s*min|min\s*(?:\^\s*-\s*1|\*\*\s*-\s*1|-1|⁻¹)")
REAL_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?"
QUANTITY = re.compile(rf"\s*({REAL_NUMBER})\s*((?:1\s*/|[^\d\s#])[^#]{{0,60}})?")


def in_rpm(speed: float) -> float:
    """A speed of rotation [rad/s] in revolutions per minute, with the digits that come back."""
    return float(f"{speed * RPM:.15g}")


@functools.cache
def _registry() -> Any:
    """Pint's units, imported for the first string; decimal, so that "0.022 mm" is exactly 2.2e-5."""
    import pint

    return pint.UnitRegistry(non_int_type=Decimal)  # pyright: ignore[reportArgumentType]


def _parsed_unit(text: str) -> Any:
    """The pint units named `text`; raises ValueError."""
    if PER_MINUTE.fullmatch(text.strip()):
        text = "rpm"
    registry = _registry()  # outside `try`: a failing import of pint is not an error of the text
    try:
        units = registry.parse_units(f"1{text}" if text.startswith("/") else text)
        registry.Quantity(Decimal(1), units).to_root_units()  # refuses decibels and the like
    except Exception:  # pint's parser raises a dozen types on malformed text
        raise ValueError(f"has an unknown unit `{text}`") from None
    return units


def is_speed_of_rotation(value: Any) -> bool:
    """Whether it is a string with revolutions in its unit, such as "1300 rpm"."""
    match = QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if match is None or not match[2]:
        return False
    try:
        unit = str(_parsed_unit(match[2]))
    except ValueError:
        return False  # an unknown unit, which is reported where it is converted
    return "revolution" in unit or "turn" in unit


def factor_of(unit: str, given: str) -> Decimal | None:
    """The SI `unit`s in a `given` unit, without pint; None for those that only pint knows."""
    return Decimal(1) if given == unit else COMMON_FACTORS.get((unit, given))


def to_si(unit: str, value: Any) -> Any:
    """The `value` with every string in it converted to the SI `unit`; numbers are unchanged."""
    if isinstance(value, list | tuple):
        return [to_si(unit, v) for v in value]
    if not isinstance(value, str):
        return value
    if "," in value and any(map(str.isdigit, value)) and "[" not in value:
        raise ValueError("has a comma: the decimal mark is a point, as in 3.57, and a list has brackets, as in [3, 57]")
    match = QUANTITY.fullmatch(value)
    if match is None:
        raise ValueError("is not a number with a unit")
    if factor := factor_of(unit, match[2] or ""):
        return float(Decimal(match[1]) * factor)
    given = _parsed_unit(match[2] or "")
    needed = _parsed_unit(unit)
    if given.dimensionality != needed.dimensionality:
        kind = next(
            (k for u, k in QUANTITY_NAMES.items() if _parsed_unit(u).dimensionality == given.dimensionality), None
        )
        raise ValueError(
            f"is {kind or f'of dimension {given.dimensionality}'}, but {QUANTITY_NAMES.get(unit, unit)} is needed"
        )
    if unit == "rad/s" and "hertz" in str(given):  # pint would take 1 Hz for 1 rad/s
        raise ValueError("is a frequency, but a circular frequency is needed")
    if unit == "Hz" and "hertz" not in str(given):  # and 1 rad/s for 1 Hz
        raise ValueError("is a circular frequency, but a frequency is needed")
    return float(_registry().Quantity(Decimal(match[1]), given).to(needed).magnitude)
