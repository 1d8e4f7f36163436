"""Checks of the numbers of a scene made in Python: their ranges, as in files, and their precision."""

from collections.abc import Collection, Sequence
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from numpy.typing import NDArray

from jaxshroud.scene.checks import InputError, Precision, SceneError
from jaxshroud.scene.keys import KEYS, Key, list_words, number_shape
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.typed import are_numbers, short_repr
from jaxshroud.scene.units import to_si

OPTIONAL_KEYS = tuple(key.name for key in KEYS.values() if key.default is None)
KEYS_BY_TABLE: dict[str, list[tuple[str, Key]]] = {}
for _row in KEYS.values():
    KEYS_BY_TABLE.setdefault(_row.parts[0], []).append((_row.parts[1], _row))


def check_numbers(table: str, holder: object, without: Collection[str] = ()) -> None:
    """Raise SceneError unless those attributes of `holder` that are numbers of a table are in their ranges.

    Numbers per blade must be of equally many blades; how many there are, only the scene knows. Keys in `without` are
    not requested.
    """
    numbers = [(key, getattr(holder, name)) for name, key in KEYS_BY_TABLE[table] if key.name not in without]
    check_given([(key, value) for key, value in numbers if value is not None or key.name not in OPTIONAL_KEYS])


def check_given(given: Sequence[tuple[Key, Any]]) -> None:
    """Raise SceneError unless the numbers of keys are in their ranges, those per blade of equally many blades."""
    for key, value in given:
        _check_is_number(key, value)
    per_blade = [(key, value) for key, value in given if key.pair]
    if len({np.shape(value)[-1:] for _, value in per_blade}) > 1:
        for key, value in per_blade:
            check_shape(key, value, PAIR)
    for key, value in given:
        _check_range(key, value)


def check_number(key: Key, value: Any, layout: Layout = PAIR) -> None:
    """Raise SceneError unless all of `value` is in the range of a key; traced values pass.

    Args:
        key: The key.
        value: A number, or an array with any leading axes; (..., 2) for a number per blade.
        layout: The layout of the scene.
    """
    _check_is_number(key, value)
    if np.shape(value):
        check_shape(key, value, layout)
    _check_range(key, value)


def _check_is_number(key: Key, value: Any) -> None:
    if not are_numbers(value) or np.size(value) == 0:
        _fail_range(key, f"{key.name} = {short_repr(value)} must be a valid number")


def check_shape(key: Key, value: Any, layout: Layout) -> None:
    """Raise SceneError unless the last axis of a number per blade or interface is that of the layout."""
    shape = np.shape(value)
    own = number_shape(key, layout)
    if not own or shape[-1:] == own:
        return
    _fail_range(key, f"{key.name} must be one number or {list_words(key, layout)}, but its shape is {shape}")


def _check_range(key: Key, value: Any) -> None:
    if isinstance(value, Tracer) or key.range.holds(numbers := np.asarray(value)).all():
        return
    is_alike = key.pair and numbers.ndim == 1 and np.array_equal(numbers[:-1], numbers[1:], equal_nan=True)
    check_values(key, numbers, key.name if is_alike or not numbers.ndim else key.name + "[{}]")


def check_values(row: Key, values: NDArray[Any], name: str) -> None:
    """Raise SceneError unless all `values` are in the range of a key; the message has `name` with the index for {}."""
    good = row.range.holds(values)
    if not good.all():
        at = tuple(np.argwhere(~good)[0])
        value = float(values[at])
        place = name.format(", ".join(map(str, at)))
        _fail_range(row, f"{place} = {str(value).removesuffix('.0')} {row.range.fault(value)}")


def _fail_range(row: Key, what: str) -> NoReturn:
    example = ", ".join(f"{v:g}" for v in np.atleast_1d(to_si(row.unit, row.example)))
    raise SceneError(f"{what}, e.g. {example} ({row.about}{f' [{row.unit}]' if row.unit else ''})")


def in_precision(tree: Any, precision: Precision) -> Any:
    """The `tree` with its floating-point arrays in that precision; ValueError if float64 is requested of float32."""
    leaves = jax.tree.leaves(tree)
    if wrong := [a for a in leaves if not hasattr(a, "dtype")]:
        raise InputError(f"The numbers of a scene or a state must be arrays of JAX or NumPy, but one is {wrong[0]!r}.")
    floats = [a for a in leaves if jnp.issubdtype(a.dtype, jnp.floating)]
    if precision == "float64" and any(a.dtype != jnp.float64 for a in floats):
        raise InputError(
            "Float64 is requested, but these numbers are float32: call jax.config.update('jax_enable_x64', True) "
            "before the scene is made, or ask for a method with that precision, js.RungeKutta(precision='float32')."
        )
    return jax.tree.map(lambda a: a.astype(precision) if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)
