"""The errors of the package, with one-line messages, and the checks of arguments that raise them."""

import difflib
import json
from collections.abc import Sequence
from functools import wraps
from types import UnionType
from typing import Any, Literal, NoReturn, TypeVar, get_args


class Error(Exception):
    """The base class of all errors of the package."""


class InputError(Error, ValueError):
    """The input is invalid."""


class SceneError(InputError):
    """A scene file, an override or a number of a scene is invalid."""


class KeyNameError(SceneError, KeyError):
    """A key does not name exactly one number of a scene."""

    __str__ = ValueError.__str__  # that of KeyError puts the message into quotes


class StepTooLongError(InputError):
    """The step is too long: the march would be unstable."""


class NumericalError(Error, ValueError):
    """The request is valid, but its computation failed."""


class StoreError(InputError):
    """A result cannot be written or read; the message names the place and the cure."""


class WriteError(StoreError, OSError):
    """A file cannot be written."""


class MachineError(WriteError):
    """The request is valid, but the machine failed: a disk is full or broken, or a scheduler cannot be reached."""


MAX_VALUES = 10**7  # of one axis
MAX_AUTO_STEPS = 10**7  # in steps per period
DEFAULT_TRANSIENT = 64  # periods discarded by default, so that no average includes the start-up
Precision = Literal["float64", "float32"]
MAX_COUNT = 2**31 - 1  # compiled loops count in 32 bits
Tuple = TypeVar("Tuple", bound=type)


def digits_apart(value: float, limit: float) -> str:
    """A number in as many digits as distinguish it from a limit that it misses, six at least."""
    texts = (f"{value:.{digits}g}" for digits in range(6, 18))
    return next((text for text in texts if text != f"{limit:g}"), f"{value:g}")


def did_you_mean(word: str, known: Sequence[str], before: str = "") -> str:
    """A suggestion of the `known` word that may have been meant, as the end of a message; empty if none is close.

    What stands `before` each of the words is shown with it.
    """
    by_lower_case = {k.casefold(): k for k in known}
    close = difflib.get_close_matches(word.casefold(), by_lower_case, n=1)
    return f"; did you mean `{before}{by_lower_case[close[0]]}`?" if close else ""


def hint(word: str, known: Sequence[str], before: str = "") -> str:
    """The cure for an unknown word: a suggestion, or all `known` words; see `did_you_mean`."""
    return did_you_mean(word, known, before) or f"; known are {', '.join(before + one for one in known)}"


def word_argument(name: str, word: object, words: Any) -> None:
    """Raise ValueError unless `word` is one of the `words`, a Literal or a sequence."""
    allowed = get_args(words) or tuple(words)
    if not isinstance(word, str) or word not in allowed:
        raise InputError(f"Argument `{name}` cannot be {word!r}{hint(str(word), allowed)}")


def type_argument(name: str, value: object, kind: type | UnionType, example: str) -> None:
    """Raise ValueError unless `value` is an instance of `kind`."""
    if not isinstance(value, kind):
        words = kind.__name__ if isinstance(kind, type) else " or ".join(one.__name__ for one in kind.__args__)
        raise InputError(f"Argument `{name}` must be a {words}, e.g. {example}, but is {value!r}.")


def checked(cls: Tuple) -> Tuple:
    """A decorator of a NamedTuple: `__check_init__` is called for every new one, by `_replace` too, as in equinox."""
    create = cls.__new__

    @wraps(create)
    def create_checked(kind, *args, **kwargs):
        new = create(kind, *args, **kwargs)
        new.__check_init__()
        return new

    cls.__new__ = create_checked
    cls._make = classmethod(lambda kind, values: kind(*values))
    return cls


def count_argument(name: str, value: int, minimum: int) -> None:
    """Raise ValueError unless `value` is a whole number from `minimum` to `MAX_COUNT`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < minimum:
        kind = "positive" if minimum == 1 else f"a whole number of at least {minimum}"
        raise InputError(f"Argument `{name}` must be {kind}, but is {value!r}.")
    if value > MAX_COUNT:
        raise InputError(f"Argument `{name}` must be at most {MAX_COUNT}, but is larger.")


def seed_argument(value: int) -> None:
    """Raise ValueError unless `value` is a valid seed."""
    if value < 0:
        raise InputError(f"Argument `seed` must be a whole number of at least 0, but is {value}.")


def tolerance_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number of at least 0."""
    if not 0 <= value < float("inf"):
        raise InputError(f"Argument `{name}` must be a number of at least 0, but is {value}.")


def positive_argument(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a positive, finite number."""
    if not 0 < value < float("inf"):
        raise InputError(f"Argument `{name}` must be a positive number, but is {value}.")


def fail(where: str, what: str, kind: type[SceneError] = SceneError) -> NoReturn:
    """Raise an error with a one-line message."""
    raise kind(" ".join(f"{where}: {what}".split()))


def toml_text(value: object) -> str:
    """A value as in a file, truncated if it is long."""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except ValueError:  # Python does not print integers of more than 4,300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."
