"""The arithmetic of compiled loops: symbolic zeros, sine and cosine as short polynomials, and sums along rows."""

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from functools import partial, reduce, wraps
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.extend.core import Primitive
from jaxtyping import Array, Float

from jaxshroud.cache.programs import is_traced


def traced_once(f: Callable[..., Any]) -> Callable[..., Any]:
    """A decorator: within a program `f` is traced once for all its calls of one kind; outside it runs as it stands."""
    inlined = jax.jit(f, inline=True)

    @wraps(f)
    def call(*args: Any) -> Any:
        return (inlined if is_traced(args) else f)(*args)

    return call


class Symbolic(ABC):
    """A stand-in for a number while a function is traced: a symbolic zero or a power series."""

    @staticmethod
    @abstractmethod
    def chosen(condition: Any, yes: Any, no: Any) -> Any:
        """`yes` where the `condition` holds, else `no`; at least one of them is of this class."""

    @abstractmethod
    def sine_versine(self) -> tuple[Any, Any]:
        """The sine and the versine of it as an angle."""

    @abstractmethod
    def moved(self, move: Callable[..., Any], *others: Any) -> Any:
        """What `move` makes of it, and of `others` that belong to the same instant, along a row."""


class Zero(Symbolic):
    """An exact zero that is known while tracing."""

    @staticmethod
    def chosen(condition: Any, yes: Any, no: Any) -> Any:
        """`yes` where the `condition` holds, else `no`; at least one of them is absent."""
        return where(condition, *(0.0 if is_zero(a) else a for a in (yes, no)))

    def sine_versine(self) -> tuple["Zero", "Zero"]:
        """Both absent."""
        return self, self

    def moved(self, move: Callable[..., Any], *others: Any) -> Any:
        """Still absent, or what is made of the others with a zero for it."""
        filler = next((jnp.zeros_like(a) for a in others if not is_zero(a)), None)
        return self if filler is None else move(filler, *(filler if is_zero(a) else a for a in others))

    def __add__(self, other: Any) -> Any:
        """The other number."""
        return other

    def __neg__(self) -> "Zero":
        """Still absent."""
        return self

    def __rsub__(self, other: Any) -> Any:
        """The other number."""
        return other

    def __sub__(self, other: Any) -> Any:
        """The negative of the other number."""
        return -other

    def __mul__(self, other: Any) -> "Zero":
        """Still absent."""
        return self

    def __repr__(self) -> str:
        """The name of the constant."""
        return "ZERO"

    __radd__, __rmul__, __truediv__, __pow__, __abs__ = __add__, __mul__, __mul__, __mul__, __neg__


if TYPE_CHECKING:
    Scalar = Float[Array, ""]
else:
    Scalar = Float[Array, ""] | Symbolic  # behaves like a number
Pair = tuple[Scalar, Scalar]  # one per blade: two flat arrays of lanes are faster than one strided
ZERO: Any = Zero()
jax.tree_util.register_pytree_node(Zero, lambda _: ((), None), lambda *_: ZERO)


class Unrolled:
    """The numbers along an axis of blades or of interfaces, each by itself: what is computed of them is unrolled.

    Arithmetic with it is that of each number, which may be absent. Other operands count for all of them.
    """

    def __init__(self, *numbers: Any):
        self.numbers = numbers

    @staticmethod
    def of(f: Callable[..., Any], *operands: Any) -> "Unrolled":
        """`f` of each of the numbers."""
        length = len(next(a for a in operands if isinstance(a, Unrolled)))
        by_place = [a if isinstance(a, Unrolled) else [a] * length for a in operands]
        return Unrolled(*map(f, *by_place))

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.numbers)

    def __getitem__(self, i: int) -> Any:
        return self.numbers[i]

    def __repr__(self) -> str:
        return f"Unrolled{self.numbers}"

    def astype(self, kind: Any) -> "Unrolled":
        """The numbers as others of that type."""
        return Unrolled.of(lambda a: a.astype(kind), self)


def _elementwise(name: str) -> Callable[..., Unrolled]:
    f = getattr(operator, name)
    return lambda *operands: Unrolled.of(f, *operands)


def _reflected(name: str) -> Callable[..., Unrolled]:
    f = getattr(operator, name)
    return lambda self, other: Unrolled.of(f, other, self)


for _name in ("add", "sub", "mul", "truediv", "pow", "and_", "or_", "mod"):
    setattr(Unrolled, f"__{_name.strip('_')}__", _elementwise(_name))
    setattr(Unrolled, f"__r{_name.strip('_')}__", _reflected(_name))
for _name in ("neg", "abs", "invert", "lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Unrolled, f"__{_name}__", _elementwise(_name))
jax.tree_util.register_pytree_node(Unrolled, lambda a: (a.numbers, None), lambda _, numbers: Unrolled(*numbers))


def is_unrolled(value: object) -> bool:
    """Whether it is the numbers along an unrolled axis."""
    return isinstance(value, Unrolled)


def has_unrolled(trees: Any) -> bool:
    """Whether trees have numbers along unrolled axes."""
    return any(map(is_unrolled, jax.tree.leaves(trees, is_leaf=is_unrolled)))


def is_zero(value: object) -> bool:
    """Whether a number is left out."""
    return isinstance(value, Zero)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """`jnp.where` for numbers that may be absent, series, or numbers along an unrolled axis."""
    if yes is no:
        return yes
    if any(isinstance(a, Unrolled) for a in (condition, yes, no)):
        return Unrolled.of(where, condition, yes, no)
    formal = [a for a in (yes, no) if isinstance(a, Symbolic)]
    kind = max(formal, key=lambda a: not is_zero(a), default=None)
    if kind is not None:
        return kind.chosen(condition, yes, no)
    alike = _scalars_of_one_type(yes, no)
    if alike is None or not _is_traced_scalar(condition) or condition.dtype != bool:
        return jnp.where(condition, yes, no)
    return lax.select(condition, *alike)


def _is_traced_scalar(a: Any) -> bool:
    if not isinstance(a, Tracer):
        return False
    kind: Any = a.aval
    return not kind.shape and not kind.weak_type


def _scalars_of_one_type(a: Any, b: Any) -> tuple[Any, Any] | None:
    """The operands as `lax` takes them, if they are traced scalars of one type, or one such and a Python number."""
    if _is_traced_scalar(a) and _is_traced_scalar(b):
        return (a, b) if a.dtype == b.dtype else None
    like, number = (a, b) if _is_traced_scalar(a) else (b, a)
    if type(number) not in (int, float) or not _is_traced_scalar(like) or like.dtype.kind != "f":
        return None
    number = like.dtype.type(number)
    return (like, number) if like is a else (number, like)


def _traced_fast(exact: Callable[[Any, Any], Any], general: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def apply(a: Any, b: Any) -> Any:
        alike = _scalars_of_one_type(a, b)
        return general(a, b) if alike is None else exact(*alike)

    return apply


# a + b, a - b and a * b for the thousands of operations of series: JAX traces the operators three times more slowly
plus = _traced_fast(lax.add, operator.add)
minus = _traced_fast(lax.sub, operator.sub)
times = _traced_fast(lax.mul, operator.mul)


def blended(share: Any, yes: Any, no: Any) -> Any:
    """`yes` or `no` by a truth value, or their mixture with a share of `yes` in [0, 1]."""
    if yes is no:
        return yes
    if jnp.issubdtype(jnp.asarray(share).dtype, jnp.bool_):
        return where(share, yes, no)
    return no + share * (yes - no)


def filled(tree: Any, like: Any) -> Any:
    """The `tree` with zeros in place of absent numbers, of the shape and type of `like`."""
    number = jax.tree.leaves(like)[0]
    zero = (np.zeros_like if isinstance(number, np.ndarray) else jnp.zeros_like)(number)
    whole = Unrolled(*[zero] * len(like)) if is_unrolled(like) else zero

    def fill(a: Any) -> Any:
        if is_unrolled(a):
            return Unrolled(*(zero if is_zero(one) else one for one in a))
        return whole if is_zero(a) else a

    return jax.tree.map(fill, tree, is_leaf=lambda a: is_zero(a) or is_unrolled(a))


def summed(terms: Iterable[Any]) -> Any:
    """The sum of at least one term; the only one as it is."""
    return reduce(operator.add, terms)


def zeros_for(f: Callable[..., Any], *args: Any) -> Any:
    """Zeros of the shapes and types of `f(*args)`, of which nothing is computed."""
    return jax.tree.map(jnp.zeros_like, jax.eval_shape(f, *args))


ANGLE_RANGE = math.pi / 4  # [rad]
# sin x = x + x^3 S(x^2), 1 - cos x = x^2 / 2 + x^4 V(x^2)
_SINE = {
    jnp.dtype("float64"): (
        -0.16666666666666666,
        0.00833333333333095,
        -0.0001984126983676098,
        2.755731610364807e-06,
        -2.5051132048565583e-08,
        1.5918142523743103e-10,
    ),
    jnp.dtype("float32"): (-0.16666664667931574, 0.008332748998589587, -0.0001958800886362705),
}
_VERSINE = {
    jnp.dtype("float64"): (
        -0.041666666666666664,
        0.0013888888888887398,
        -2.4801587298767024e-05,
        2.7557317272338524e-07,
        -2.0876146381542784e-09,
        1.1382639780204255e-11,
    ),
    jnp.dtype("float32"): (-0.04166666466418916, 0.001388830364336445, -2.454804054345909e-05),
}


def _polynomial(coefficients: tuple[float, ...], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The polynomial, with even and odd powers apart, which halves the depth of Horner's rule."""
    if len(coefficients) == 1:
        return jnp.full_like(x, coefficients[0])
    pairs = [c if i + 1 == len(coefficients) else c + coefficients[i + 1] * x for i, c in enumerate(coefficients)][::2]
    total = pairs[-1]
    square = x * x
    for pair in reversed(pairs[:-1]):
        total = pair + square * total
    return jnp.asarray(total)


@traced_once
def sine_versine(x: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """(sin x, 1 - cos x) for |x| <= pi/4; beyond that range the error grows and callers must check it.

    1 - cos x has no cancellation at small x.
    """
    return _sine_versine(x)


@jax.custom_jvp
def _sine_versine(x: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    square = x * x
    sine = x + x * square * _polynomial(_SINE[x.dtype], square)
    return sine, square * (0.5 + square * _polynomial(_VERSINE[x.dtype], square))


@_sine_versine.defjvp
def _sine_versine_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    s, v = sine_versine(x)
    return (s, v), ((1 - v) * x_dot, s * x_dot)


def sincos(x: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """(sin x, cos x) for |x| <= pi/4."""
    s, v = sine_versine(x)
    return s, 1 - v


def sincos_turns(turns: Scalar) -> tuple[Scalar, Scalar]:
    """(sin, cos) of `2 pi turns`, exact at any multiple of a quarter turn."""
    quarter = jnp.round(4 * turns)
    s, c = sincos((turns - quarter / 4) * (2 * math.pi))
    quarter = quarter - 4 * jnp.floor(quarter / 4)
    swap = (quarter == 1) | (quarter == 3)
    sine, cosine = where(swap, c, s), where(swap, s, c)
    return where(quarter >= 2, -sine, sine), where((quarter == 1) | (quarter == 2), -cosine, cosine)


Home = Literal["blade", "interface"]
# The result of a function of numbers along a row, in a program of one element; see `row_program`.
exchange = Primitive("exchange")
exchange.def_abstract_eval(lambda first, *_, **options: first)


def exchanged(to: Home, move: Callable[..., Any], *numbers: Any) -> Any:
    """`move(*numbers)`, which combines numbers of several blades or interfaces.

    Of series it is that of each coefficient. Of one element, while a program of all of them is traced, it is noted.

    Args:
        to: To what the results belong.
        move: A linear function of arrays (blades, lanes), or (interfaces, lanes).
        numbers: Its arguments.
    """
    first, *others = numbers
    if isinstance(first, Symbolic):
        return first.moved(partial(exchanged, to, move), *others)
    numbers = first, *(jnp.zeros_like(first) if is_zero(a) else a for a in others)
    return exchange.bind(*numbers, move=move, to=to) if jnp.ndim(first) == 0 else move(*numbers)


def total(a: Any) -> Any:
    """The sum along the axis of blades or of interfaces."""
    if is_zero(a):
        return a
    return summed(a) if isinstance(a, Unrolled) else jnp.sum(a, axis=0)


def any_along(flags: Any) -> Any:
    """Whether any flag is true along the axis of blades or of interfaces."""
    return reduce(jnp.logical_or, flags) if isinstance(flags, Unrolled) else jnp.any(flags, axis=0)


def least(a: Any) -> Any:
    """The least number along the axis of blades or of interfaces."""
    return reduce(jnp.minimum, a) if isinstance(a, Unrolled) else jnp.min(a, axis=0)


def greatest(a: Any) -> Any:
    """The greatest number along the axis of blades or of interfaces."""
    return -least(-a)


def place_of_largest(a: Any) -> Any:
    """The place of the largest number along the axis of blades or of interfaces, the first one of several."""
    if not isinstance(a, Unrolled):
        return jnp.argmax(a, axis=0).astype(jnp.int32)
    largest, *others = a
    place = jnp.zeros_like(largest, jnp.int32)
    for i, other in enumerate(others, start=1):
        place = where(other > largest, jnp.int32(i), place)
        largest = jnp.maximum(largest, other)
    return place


def is_place(place: Any, like: Any) -> Any:
    """Along an axis as that of `like`, whether it is this place."""
    if isinstance(like, Unrolled):
        return Unrolled(*(place == i for i in range(len(like))))
    return jnp.arange(len(like), dtype=jnp.int32)[:, None] == place[None]


def at_place(here: Any, a: Any) -> Any:
    """The number at the only place that is `here`."""
    if not isinstance(a, Unrolled):
        return jnp.sum(jnp.where(here, a, jnp.zeros_like(a)), axis=0, dtype=a.dtype)
    chosen = a[-1]
    for i in reversed(range(len(a) - 1)):
        chosen = where(here[i], a[i], chosen)
    return chosen


def times_along(matrix: Any, a: Any) -> Any:
    """A matrix times the numbers along the axis of blades."""
    return exchanged("blade", lambda a: jnp.sum(matrix * a[None], axis=1), a)


def left_of_interfaces(a: Any, closed: bool) -> Any:
    """The numbers of the blade left of each interface."""
    if isinstance(a, Unrolled):
        return Unrolled(*a.numbers[:-1])
    return exchanged("interface", lambda a: a if closed else a[:-1], a)


def right_of_interfaces(a: Any, closed: bool) -> Any:
    """The numbers of the blade right of each interface."""
    if isinstance(a, Unrolled):
        return Unrolled(*a.numbers[1:])
    return exchanged("interface", lambda a: jnp.roll(a, -1, 0) if closed else a[1:], a)


def neighbours(a: Any, shift: int, closed: bool) -> Any:
    """The numbers of the blade `shift` places before each; 0 where there is none."""

    def shifted(a):
        if closed:
            return jnp.roll(a, shift, 0)
        none = jnp.zeros_like(a[:1])
        return jnp.concatenate([none, a[:-1]] if shift > 0 else [a[1:], none])

    return exchanged("blade", shifted, a)


def both_sides(tree: Any, closed: bool) -> Any:
    """A tree of numbers of blades as one of pairs at interfaces."""

    def sides(a):
        return (a, a) if is_zero(a) else (left_of_interfaces(a, closed), right_of_interfaces(a, closed))

    return jax.tree.map(sides, tree, is_leaf=lambda a: is_zero(a) or isinstance(a, Unrolled))


def sum_at_blades(on_left: Any, on_right: Any, closed: bool) -> Any:
    """The sum of what its two interfaces add to each blade: on their left and on their right sides."""
    if isinstance(on_left, Unrolled):
        return Unrolled(*map(operator.add, [*on_left, ZERO], [ZERO, *on_right]))

    def added(on_left, on_right):
        if closed:
            return on_left + jnp.roll(on_right, 1, 0)
        none = jnp.zeros_like(on_left[:1])
        return jnp.concatenate([on_left, none]) + jnp.concatenate([none, on_right])

    return exchanged("blade", added, on_left, on_right)
