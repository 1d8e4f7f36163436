"""Run-time checks of the arguments of public functions against their annotations."""

import reprlib
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from jaxshroud.scene.checks import InputError, word_argument

T = TypeVar("T")
Tree = TypeVar("Tree")  # of arrays
Function = TypeVar("Function", bound=Callable)
FloatArray = NDArray[np.float64]
TYPE_EXAMPLES = {"SceneFile": ' such as js.load("table1")', "RungeKutta": ' such as js.RungeKutta("dopri8")'}
INTERNAL_TYPES = ("Choices", "Asked")  # types that users do not make, which messages leave out


class TypeCheck(NamedTuple):
    """The check of an argument: a description that follows "must be", and a test."""

    words: str
    holds: Callable[[Any], bool]


def typed(f: Function) -> Function:
    """A decorator of a public function that refuses arguments of other types than annotated, with one line.

    Booleans are not numbers, a string is not a list of strings, and any array of numbers is a list of numbers. Traced
    values are checked by their type. Of annotations that are strings only those in `TYPE_CHECKS` are checked.
    """
    signature_of = signature(f)

    @wraps(f)
    def checked_call(*args, **kwargs):
        try:
            arguments = signature_of.bind(*args, **kwargs).arguments
        except TypeError:
            arguments = {}  # the call itself raises with what is missing
        for name, value in arguments.items():
            check_argument(name, value, signature_of.parameters[name])
        return f(*args, **kwargs)

    return checked_call  # pyright: ignore[reportReturnType]


def check_argument(name: str, value: Any, parameter: Parameter) -> None:
    """Raise InputError unless an argument, or each of variadic arguments, has the type of its parameter."""
    values = {Parameter.VAR_POSITIONAL: value, Parameter.VAR_KEYWORD: ()}.get(parameter.kind, (value,))
    kind = type_check(parameter.annotation)
    for one in values:
        if kind.holds(one):
            continue
        if words := _literal_words(parameter.annotation):
            word_argument(name, one, words)
        raise InputError(f"Argument `{name}` must be {kind.words}, but is {short_repr(one)}.")


def short_repr(value: object) -> str:
    """A short representation of a value in one line."""
    return " ".join(reprlib.repr(value).split())


@cache
def type_check(annotation: Any) -> TypeCheck:
    """The check for an annotation."""
    if annotation in TYPE_CHECKS or isinstance(annotation, str):
        return TYPE_CHECKS.get(annotation, TYPE_CHECKS[Any])
    origin = get_origin(annotation) or annotation
    inner = get_args(annotation)
    if origin in (Union, UnionType):
        if complex in inner:  # array-like in JAX and NumPy
            kinds = [TypeCheck("numbers", are_numbers)]
        else:
            kinds = [type_check(one) for one in inner if one is not NoneType]
        phrases = [kind.words for kind in kinds if kind.words]
        either = " or ".join([", ".join(phrases[:-1]), phrases[-1]] if phrases[1:] else phrases)
        return TypeCheck(either, lambda a: (a is None and NoneType in inner) or any(kind.holds(a) for kind in kinds))
    if origin is Literal:
        return TypeCheck(" or ".join(map(repr, inner)), lambda a: isinstance(a, str) and a in inner)
    if origin is Callable:
        return TypeCheck("a function", callable)
    kinds = [type_check(one) for one in inner if one is not ...]
    if origin is tuple and ... not in inner:
        return TypeCheck(f"a pair of {_plural(kinds[0])}", lambda a: _is_list_of(a, kinds[0]) and len(a) == len(kinds))
    if issubclass(origin, tuple | Sequence) and kinds:
        return TypeCheck(f"a list of {_plural(kinds[0])}", lambda a: _is_list_of(a, kinds[0]))
    if issubclass(origin, Mapping) and kinds:
        return TypeCheck(f"a dict of {_plural(kinds[0])} to {_plural(kinds[1])}", lambda a: _is_dict_of(a, *kinds))
    name = "" if origin.__name__ in INTERNAL_TYPES else origin.__name__
    article = "an" if name.startswith(("A", "O")) else "a"
    return TypeCheck(name and f"{article} {name}{TYPE_EXAMPLES.get(name, '')}", lambda a: isinstance(a, origin))


def _plural(kind: TypeCheck) -> str:
    """The plural of a description."""
    one, of, rest = kind.words.partition(" of ")
    return f"{one.partition(' ')[2]}s{of}{rest}" if one.startswith(("a ", "an ")) else kind.words


def _literal_words(annotation: Any) -> tuple[str, ...]:
    """The words of an annotation that allows only words, or None besides."""
    inner = [one for one in get_args(annotation) if one is not NoneType] if annotation not in TYPE_CHECKS else []
    if get_origin(annotation) is Literal:
        return tuple(inner)
    return get_args(inner[0]) if len(inner) == 1 and get_origin(inner[0]) is Literal else ()


def _is_whole_number(a: object) -> bool:
    return isinstance(a, int | np.integer) and not isinstance(a, bool)


def are_numbers(a: object) -> bool:
    """Whether an array, nested lists or a single value consist of numbers, none of which is a boolean."""
    if isinstance(a, Sequence) and not isinstance(a, str | bytes):
        return all(map(are_numbers, a))
    kind = getattr(getattr(a, "dtype", None), "kind", None)  # of an array
    return kind in ("i", "u", "f") if kind else isinstance(a, Real) and not isinstance(a, bool)


def series_argument(name: str, values: object) -> NDArray[np.float64]:
    """The values as an array (..., n), with n at least 1; InputError if they are not numbers."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)  # lists of different lengths
    if not array.size or not array.ndim:
        raise InputError(
            f"Argument `{name}` must be numbers, at least one in each series, but is {short_repr(values)}."
        )
    return array


def is_number(a: Any) -> bool:
    """Whether it is one number and not a boolean."""
    return not isinstance(a, Sequence) and are_numbers(a) and np.ndim(a) == 0


def _is_list_of(a: Any, kind: TypeCheck) -> bool:
    """Whether it is a list or an array whose elements pass a check."""
    if not isinstance(a, Collection) or isinstance(a, str | bytes | Mapping) or not hasattr(a, "__getitem__"):
        return False
    return getattr(a, "ndim", 1) > 0 and all(map(kind.holds, a))


def _is_dict_of(a: Any, key: TypeCheck, value: TypeCheck) -> bool:
    return isinstance(a, Mapping) and all(map(key.holds, a)) and all(map(value.holds, a.values()))


TYPE_CHECKS: dict[Any, TypeCheck] = {
    Any: TypeCheck("anything", lambda a: True),
    object: TypeCheck("anything", lambda a: True),
    Parameter.empty: TypeCheck("anything", lambda a: True),
    bool: TypeCheck("True or False", lambda a: isinstance(a, bool | np.bool_)),
    int: TypeCheck("a whole number", _is_whole_number),
    float: TypeCheck("a number", is_number),
    str: TypeCheck("a string", lambda a: isinstance(a, str)),
    "Axes | None": TypeCheck("Axes of matplotlib", lambda a: a is None or hasattr(a, "get_figure")),
}
