"""Checks of arguments at the door."""

import difflib
from collections.abc import Sequence
from functools import wraps
from typing import Any, Literal, TypeVar, get_args

from jaxshroud.scene.errors import InputError
from jaxshroud.scene.errors import NumericalError as NumericalError

Precision = Literal["float64", "float32"]
MOST_COUNT = 2**31 - 1  # compiled loops count in 32 bits
Tuple = TypeVar("Tuple", bound=type)


def meant(word: str, known: Sequence[str]) -> str:
    """The `known` word that one may have meant, as the end of a message; nothing if none is close."""
    folded = {k.casefold(): k for k in known}
    close = difflib.get_close_matches(word.casefold(), folded, n=1)
    return f"; did you mean `{folded[close[0]]}`?" if close else ""


def hint(word: str, known: Sequence[str]) -> str:
    """The cure for a word that is not `known`."""
    return meant(word, known) or f"; known are {', '.join(known)}"


def word_argument(name: str, word: Any, words: Any) -> None:
    """Raise ValueError unless `word` is one of the `words`, a Literal or a sequence."""
    known = get_args(words) or tuple(words)
    if not isinstance(word, str) or word not in known:
        raise InputError(f"Argument `{name}` cannot be {word!r}{hint(str(word), known)}")


def type_argument(name: str, value: Any, kind: type, example: str) -> None:
    """Raise ValueError unless `value` is of a `kind`."""
    if not isinstance(value, kind):
        raise InputError(f"Argument `{name}` must be a {kind.__name__}, e.g. {example}, but is {value!r}.")


def checked(cls: Tuple) -> Tuple:
    """A NamedTuple whose `__check_init__` is called wherever one is made, by `_replace` too; as in equinox."""
    make = cls.__new__

    @wraps(make)
    def made(kind, *args, **kwargs):
        new = make(kind, *args, **kwargs)
        new.__check_init__()
        return new

    cls.__new__ = made
    cls._make = classmethod(lambda kind, values: kind(*values))
    return cls


def count_argument(name: str, value: int, least: int) -> None:
    """Raise ValueError unless `value` is a whole number from `least` to `MOST_COUNT`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        kind = "positive" if least == 1 else f"a whole number of at least {least}"
        raise InputError(f"Argument `{name}` must be {kind}, but is {value}.")
    if value > MOST_COUNT:
        raise InputError(f"Argument `{name}` must be at most {MOST_COUNT}, but is larger.")


def tolerance_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number of at least 0."""
    if not 0 <= value < float("inf"):
        raise InputError(f"Argument `{name}` must be a number of at least 0, but is {value}.")


def positive_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a positive, finite number."""
    if not 0 < value < float("inf"):
        raise InputError(f"Argument `{name}` must be a positive number, but is {value}.")
