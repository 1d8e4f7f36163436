"""Derived inputs: frequencies, damping ratios and speeds, and the formulas from them to the numbers of a scene.

| a scene is given by     | instead of     | by                                              |
|-------------------------|----------------|-------------------------------------------------|
| `blades.f_x`, `f_y`     | `k_x`, `k_y`   | k = m (2 pi f)^2                                |
| `blades.f_T`            | `k_T`          | k_T = I (2 pi f_T)^2                            |
| `blades.zeta_x`, `_y`   | `c_x`, `c_y`   | c = 2 zeta sqrt(k m)                            |
| `blades.zeta_T`         | `c_T`          | c_T = 2 zeta_T sqrt(k_T I)                      |
| `blades.I = "block"`    | a number       | I = m (l_oa^2 + l_ab^2) / 12, that of the block |
| `drive.f`               | `omega`        | omega = 2 pi f                                  |
| `drive.engine_order` and `drive.speed` | `omega` | omega = order times speed               |
| `drive.engine_order` of a row | `phase`  | phase of blade i = 2 pi order i / blades        |

In a row the engine order alone gives the phases, and with a speed the frequency too; `omega` or `f` may be beside it.
So they may in a pair whose stiffness or gap depends on its speed, which is omega over the engine order.

Two keys for one quantity are an error, as with `gamma` and `k`. A model only sees the numbers that result; a scene
remembers what it was given by, so that a number that changes takes with it those that are worked out from it.
"""

import math
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import KeyNameError, SceneError
from jaxshroud.scene.keys import ALL_KEYS, KEYS, Key, find_key, parse_key
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.speed import needed_order

BLOCK = "block"  # what a file gives as moment of inertia to have that of the block
Numbers = Mapping[str, Any]  # key -> array, or None for what a word gives


class DerivedInput(NamedTuple):
    """An alternative way to give a number of a scene."""

    keys: tuple[Key, ...]  # all of which are needed; none: a word in place of the number
    number: Key
    needs: tuple[Key, ...]  # further numbers of the scene
    formula: Callable[..., Any]  # a function of the keys and then of the further numbers
    inverse: Callable[..., Any] | None = None  # the key from the number and the further ones, if they determine it

    @property
    def marks(self) -> tuple[str, ...]:
        """The keys that are given where this input counts."""
        return tuple(row.name for row in self.keys) or (self.number.name,)

    def counts(self, given: Container[str]) -> bool:
        """Whether the number is given in this way."""
        return all(name in given for name in self.marks)

    def needed(self, numbers: Container[str]) -> list[str]:
        """The keys of the further numbers, of which `blades.m` stands for a `blades.m_y` that is not there."""
        names = [row.name for row in self.needs]
        return ["blades.m" if name == "blades.m_y" and name not in numbers else name for name in names]

    def value(self, numbers: Numbers, given: Numbers) -> Any:
        """The number: arrays as the numbers are, with a last axis for a number per blade."""
        inputs = [given[row.name] for row in self.keys]
        return self.formula(*self._beside_blades(self.keys, inputs), *self._further(numbers))

    def given_value(self, numbers: Numbers) -> Any:
        """The only key, from the number; None if that does not determine it."""
        return self.inverse and self.inverse(numbers[self.number.name], *self._further(numbers))

    def _further(self, numbers: Numbers) -> list[Any]:
        return self._beside_blades(self.needs, [numbers[name] for name in self.needed(numbers)])

    def _beside_blades(self, rows: tuple[Key, ...], values: list[Any]) -> list[Any]:
        """Values that broadcast against numbers per blade, if this is one."""
        return [v[..., None] if self.number.pair and not row.pair else v for row, v in zip(rows, values, strict=True)]


def _stiffness_from_frequency(f: Any, mass: Any) -> Any:
    omega = math.tau * f
    return mass * (omega * omega)


def _frequency_from_stiffness(k: Any, mass: Any) -> Any:
    return _square_root(k / mass) / math.tau


def _damping_from_ratio(zeta: Any, k: Any, mass: Any) -> Any:
    return 2.0 * zeta * _square_root(k * mass)


def _ratio_from_damping(c: Any, k: Any, mass: Any) -> Any:
    return c / (2.0 * _square_root(k * mass))


def _inertia_of_block(m: Any, l_oa: Any, l_ab: Any) -> Any:
    return m * (l_oa * l_oa + l_ab * l_ab) / 12.0


def _square_root(a: Any) -> Any:
    """The square root of an array of NumPy or JAX."""
    return a.__array_namespace__().sqrt(a)


def _modal_inputs(name: str, mass: str) -> tuple[DerivedInput, DerivedInput]:
    k, c = f"blades.k_{name}", f"blades.c_{name}"
    return (
        _derived_input([f"blades.f_{name}"], k, [mass], _stiffness_from_frequency, _frequency_from_stiffness),
        _derived_input([f"blades.zeta_{name}"], c, [k, mass], _damping_from_ratio, _ratio_from_damping),
    )


def _derived_input(
    keys: list[str],
    number: str,
    needs: list[str],
    formula: Callable[..., Any],
    inverse: Callable[..., Any] | None = None,
) -> DerivedInput:
    of_keys, of_needs = (tuple(ALL_KEYS[name] for name in names) for names in (keys, needs))
    return DerivedInput(of_keys, KEYS[number], of_needs, formula, inverse)


DERIVED_INPUTS = (  # in the order of their evaluation
    _derived_input([], "blades.I", ["blades.m", "shroud.l_oa", "shroud.l_ab"], _inertia_of_block),
    *_modal_inputs("x", "blades.m"),
    *_modal_inputs("y", "blades.m_y"),
    *_modal_inputs("T", "blades.I"),
    _derived_input(["drive.f"], "drive.omega", [], lambda f: math.tau * f, lambda omega: omega / math.tau),
    _derived_input(["drive.engine_order", "drive.speed"], "drive.omega", [], lambda order, speed: order * speed),
)
DERIVED_BY_KEY = {key.name: derived for derived in DERIVED_INPUTS for key in derived.keys}


@lru_cache(maxsize=16)
def inputs_in(layout: Layout) -> tuple[DerivedInput, ...]:
    """All derived inputs of scenes with a row, or of the pair, in the order of their evaluation."""
    if layout == PAIR:
        return DERIVED_INPUTS

    def phases(order: Any) -> Any:
        return math.tau * order * order.__array_namespace__().arange(layout.blades, dtype=order.dtype) / layout.blades

    return _derived_input(["drive.engine_order"], "drive.phase", [], phases), *DERIVED_INPUTS


@lru_cache(maxsize=16)
def inputs_by_key(layout: Layout) -> Mapping[str, DerivedInput]:
    """The derived input that a key gives; that of the phases for the engine order of a row."""
    return {key.name: derived for derived in reversed(inputs_in(layout)) for key in derived.keys}


def inputs_that_count(given: Numbers, layout: Layout, numbers: Container[str]) -> dict[str, Any]:
    """The inputs without those that give nothing, such as a speed without an engine order."""
    by_key = inputs_by_key(layout)
    tells_speed = needed_order(numbers, given)

    def counts(key):
        return key not in by_key or by_key[key].counts(given) or key in tells_speed

    return {key: value for key, value in given.items() if counts(key)}


def alternative_keys(key: str, layout: Layout = PAIR) -> list[str]:
    """The keys that give the same quantity as `key`."""
    by_key = inputs_by_key(layout)
    number = by_key[key].number.name if key in by_key else key
    inputs = [derived for derived in inputs_in(layout) if derived.number.name == number]
    groups = [[number], *([one.name for one in derived.keys] for derived in inputs)]
    names = [name for names in groups if key not in names for name in names]
    return [name for name in names if name not in by_key or by_key[name].number.name == number]


def same_quantity(key: str, other: str, layout: Layout = PAIR) -> bool:
    """Whether two keys name, or give, one number of the scene or parts of it, and are not those of different blades."""
    (a, index_a), (b, index_b) = ((number.name, index) for number, index in (parse_key(key), parse_key(other)))
    if {a, b} <= {"contact.k", "contact.gamma"}:
        return True
    if a != b:
        return b in alternative_keys(a, layout)
    return index_a is None or index_b is None or index_a == index_b


def check_independent(keys: Sequence[str], layout: Layout = PAIR) -> None:
    """Raise a KeyNameError where two keys are different names of one number of a scene."""
    names = [parse_key(key)[0].name for key in keys]
    for i, name in enumerate(names):
        for other in names[:i]:
            if name != other and same_quantity(other, name, layout):
                raise KeyNameError(f"{other} and {name} are one number; name one of them")


def check_disjoint(keys: Sequence[str], layout: Layout = PAIR) -> None:
    """Raise a KeyNameError where two keys set one number, or that of one blade and of all."""
    for i, key in enumerate(keys):
        for other in keys[:i]:
            if same_quantity(other, key, layout):
                partly = "" if parse_key(other)[0].name != parse_key(key)[0].name else ", at least partly,"
                raise KeyNameError(f"{other} and {key} are{partly} one number; name one of them")


def check_known(key: str, given: Collection[str], where: str = "", layout: Layout = PAIR) -> None:
    """Raise a KeyNameError, which begins with `where`, unless a scene that is `given` so has what a key needs.

    These are the engine order for a speed, and the frequency of the other blade for that of one.
    """
    number, index = find_key(key, where, layout)
    derived = inputs_by_key(layout).get(number.name)
    if derived is None:
        return
    where = f"{where}: " if where else ""
    if missing := [name for name in derived.marks if name not in (*given, number.name)]:
        both = " and ".join(derived.marks)
        name = number.name
        raise KeyNameError(
            f"{where}the scene gives no {missing[0]}, which {name} needs; give {both} in its file or with --set, "
            f"or name {derived.number.name}"
        )
    if index is not None and number.name not in given:
        raise KeyNameError(
            f"{where}the scene does not give {number.name}; "
            f"name it for {layout.number_words}, or {derived.number.name}[{index}]"
        )


def check_order(given: Numbers, where: str = "") -> None:
    """Raise a SceneError, which begins with `where`, for an engine order of at most 0 that a speed multiplies."""
    if "drive.speed" in given and np.any(np.asarray(given["drive.engine_order"]) <= 0):
        where = f"{where}: " if where else ""
        raise SceneError(f"{where}drive.engine_order must be greater than 0 where drive.speed gives the frequency")


def in_given_form(numbers: Numbers, given: Numbers, layout: Layout = PAIR) -> dict[str, Any]:
    """What a scene is given by: its numbers without those that are worked out, and the inputs; None for a word."""
    derived = {one.number.name for one in inputs_in(layout) if one.counts(given)}
    return {key: value for key, value in numbers.items() if key not in derived} | dict(given)


def in_tables(numbers: Mapping[str, Any], given: Mapping[str, Any], layout: Layout = PAIR) -> dict[str, dict[str, Any]]:
    """Values by table and name, as a scene is given, from its numbers and its inputs."""
    tables: dict[str, dict[str, Any]] = {key.partition(".")[0]: {} for key in numbers}
    for key, value in in_given_form(numbers, given, layout).items():
        table, _, name = key.partition(".")
        tables[table][name] = BLOCK if value is None else value
    return tables


def worked_out(numbers: Numbers, given: Numbers, changed: set[str], layout: Layout = PAIR) -> dict[str, Any]:
    """The numbers that are worked out from others of which some have `changed`, in turn."""
    numbers = dict(numbers)
    results = {}
    for derived in inputs_in(layout):
        depends_on = {*derived.marks, *derived.needed(numbers)}
        if derived.counts(given) and depends_on & (changed | set(results)):
            results[derived.number.name] = numbers[derived.number.name] = derived.value(numbers, given)
    return results


def consistent(numbers: Numbers, given: Numbers, layout: Layout = PAIR) -> dict[str, Any]:
    """The inputs that give the numbers, to rounding: others were replaced in the scene without `vary`."""
    kept = dict(given)
    by_key = inputs_by_key(layout)
    for derived in inputs_in(layout):
        if not derived.counts(given):
            continue
        if not _gives(derived, numbers, given):
            for name in derived.marks:
                if by_key.get(name, derived) is derived:
                    kept.pop(name, None)
    return inputs_that_count(kept | needed_order(numbers, given), layout, numbers)


def _gives(derived: DerivedInput, numbers: Numbers, given: Numbers) -> bool:
    """Whether an input gives its number, to rounding; blades that were replaced by modes have none."""
    if derived.number.name not in numbers:
        return False
    number = np.asarray(numbers[derived.number.name])
    rounding = 64 * float(np.finfo(number.dtype).eps)
    return np.allclose(derived.value(numbers, given), number, rtol=rounding, atol=0.0, equal_nan=True)
