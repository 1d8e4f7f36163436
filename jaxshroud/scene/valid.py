"""The numbers of a scene made in Python are in the ranges of those of files."""

from typing import Any, NoReturn

import jax
import numpy as np
from jax.core import Tracer
from numpy.typing import NDArray

from jaxshroud.scene.errors import SceneError
from jaxshroud.scene.keys import KEYS, Key
from jaxshroud.scene.units import to_si

NUMBERS = (jax.Array, np.ndarray, np.number, float, int)
TABLES: dict[str, list[tuple[str, Key]]] = {}
for _row in KEYS.values():
    TABLES.setdefault(_row.parts[0], []).append((_row.parts[1], _row))


def check_numbers(table: str, holder: Any) -> None:
    """Raise SceneError unless the attributes of `holder` that are numbers of a table are in their ranges."""
    for name, row in TABLES[table]:
        check_number(row, getattr(holder, name))


def check_number(row: Key, value: Any) -> None:
    """Raise SceneError unless all of `value` is in the range of a key; what is traced, or no number, passes.

    Args:
        row: The key.
        value: A number, or an array with any leading axes: (..., 2) of a number per blade.
    """
    if isinstance(value, str):
        _refuse(row, f"{row.name} = {value!r} must be a valid number")
    if not isinstance(value, NUMBERS):
        return
    shape = np.shape(value)
    if row.pair and shape and shape[-1] != 2:
        _refuse(row, f"{row.name} must be one number or a pair [left, right], but its shape is {shape}")
    if not isinstance(value, Tracer):
        numbers = np.asarray(value)
        alike = numbers.size == 1 or (numbers.shape == (2,) and numbers[0] == numbers[1])
        check_values(row, numbers, row.name if alike else row.name + "[{}]")


def check_values(row: Key, values: NDArray[Any], name: str) -> None:
    """Raise SceneError unless all `values` are in the range of a key; `name`, with the place for {}, is blamed."""
    good = row.range.holds(values)
    if not good.all():
        at = tuple(np.argwhere(~good)[0])
        value = float(values[at])
        _refuse(row, f"{name.format(', '.join(map(str, at)))} = {value:g} {row.range.fault(value)}")


def _refuse(row: Key, what: str) -> NoReturn:
    example = ", ".join(f"{v:g}" for v in np.atleast_1d(to_si(row.unit, row.example)))
    raise SceneError(f"{what}, e.g. {example} ({row.about}{f' [{row.unit}]' if row.unit else ''})")
