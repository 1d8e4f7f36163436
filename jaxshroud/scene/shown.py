"""Numbers of a scene as texts in the unit that pages show: what is shown reads as the same number, to the last bit."""

from decimal import Context, Decimal
from typing import Any

from jaxshroud.scene.keys import Key
from jaxshroud.scene.overrides import literal
from jaxshroud.scene.typed import are_numbers
from jaxshroud.scene.units import factor_of, to_si

FEW_DIGITS = 12  # as one types them
ENOUGH_DIGITS, MOST_DIGITS = 17, 30  # what tells doubles apart; what the factor of a unit has, and more
PLAIN = range(-5, 16)  # powers of ten of numbers that are written without an exponent


def shown_text(key: Key, value: Any) -> str:
    """A number of a key in SI units, or a list of them, in the unit that is shown: the shortest text that reads so."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(shown_text(key, one) for one in value)}]"
    factor = factor_of(key.unit, key.shown[0])
    assert factor is not None, key
    exact = (Decimal(repr(float(value))) / factor).normalize()
    text = lambda digits: _written(Context(prec=digits).plus(exact))
    reads = lambda digits: to_si(key.unit, f"{text(digits)} {key.shown[0]}") == value
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
