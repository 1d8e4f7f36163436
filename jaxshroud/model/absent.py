"""Numbers that a scene leaves out.

A model without torsion, without friction or with one blade is not the full one with zeros in it: what is absent must
not be in the compiled program at all. Here an absent number is `ABSENT`. Arithmetic with it is done when a function is
traced, as with an exact zero, and leaves no operation behind; as a pytree it has no leaves, so that a loop does not
carry it. The physics is written once, for the full model.
"""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Formal(ABC):
    """What stands for a number while a function is traced: an absent one, or a power series."""

    @staticmethod
    @abstractmethod
    def chosen(condition: Any, yes: Any, no: Any) -> Any:
        """`yes` where the `condition`, else `no`, one of which is of this class."""


class Absent(Formal):
    """An exact zero that is known when tracing."""

    @staticmethod
    def chosen(condition: Any, yes: Any, no: Any) -> Any:
        """One of two numbers, one of which is absent."""
        return jnp.where(condition, *(0.0 if is_absent(a) else a for a in (yes, no)))

    def __add__(self, other: Any) -> Any:
        """The other one."""
        return other

    def __neg__(self) -> "Absent":
        """Still absent."""
        return self

    def __rsub__(self, other: Any) -> Any:
        """The other one."""
        return other

    def __sub__(self, other: Any) -> Any:
        """The other one's negative."""
        return -other

    def __mul__(self, other: Any) -> "Absent":
        """Still absent."""
        return self

    def __repr__(self) -> str:
        """As it is called."""
        return "ABSENT"

    __radd__, __rmul__, __truediv__, __pow__, __abs__ = __add__, __mul__, __mul__, __mul__, __neg__


if TYPE_CHECKING:
    Scalar = Float[Array, ""]
else:
    Scalar = Float[Array, ""] | Formal  # behaves as a number would
Pair = tuple[Scalar, Scalar]  # one per blade: two flat arrays of lanes are faster than one strided
ABSENT: Any = Absent()
jax.tree_util.register_pytree_node(Absent, lambda _: ((), None), lambda *_: ABSENT)


def is_absent(value: Any) -> bool:
    """Whether a number is left out."""
    return isinstance(value, Absent)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """`jnp.where` of numbers that may be absent, or series."""
    if yes is no:
        return yes
    formal = [a for a in (yes, no) if isinstance(a, Formal)]
    kind = max(formal, key=lambda a: not is_absent(a), default=None)
    return jnp.where(condition, yes, no) if kind is None else kind.chosen(condition, yes, no)


def mixed(share: Any, yes: Any, no: Any) -> Any:
    """`yes` or `no` by a truth value, or their mixture by a share of `yes` in [0, 1]."""
    if yes is no:
        return yes
    if jnp.issubdtype(jnp.asarray(share).dtype, jnp.bool_):
        return where(share, yes, no)
    return no + share * (yes - no)


def filled(tree: Any, like: Any) -> Any:
    """`tree` with zeros for what is absent, of the shape and type of `like`."""
    return jax.tree.map(lambda a: jnp.zeros_like(like) if is_absent(a) else a, tree, is_leaf=is_absent)
