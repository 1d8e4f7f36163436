"""Numbers that JAX must not differentiate, or not once more: primitives that raise where it tries."""

from typing import NoReturn

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxshroud.scene.typed import Tree


def _undifferentiated(name: str, told: str) -> Primitive:
    """The identity, whose derivative raises a TypeError; a custom rule would be lost in reverse mode."""

    def refuse(primals: object, tangents: object) -> NoReturn:
        raise TypeError(told)

    one = Primitive(name)
    one.def_impl(lambda a: a)
    one.def_abstract_eval(lambda a: a)
    ad.primitive_jvps[one] = refuse
    batching.primitive_batchers[one] = lambda args, axes: (one.bind(*args), *axes)
    mlir.register_lowering(one, lambda _, a: [a])
    return one


_first_order = _undifferentiated(
    "once",
    "Derivatives through contact events are of first order only: this motion is differentiated twice. "
    "Take differences of first derivatives instead, or period_map of contact that is smooth or absent.",
)
_value_only = _undifferentiated("values", "Rows of blades have no derivatives yet: take differences of values instead.")


def first_order_only(tree: Tree) -> Tree:
    """The numbers, for which a further derivative raises a TypeError."""
    return jax.tree.map(_first_order.bind, tree)


def values_only(tree: Tree) -> Tree:
    """The numbers of rows, for which any derivative raises a TypeError."""
    return jax.tree.map(_value_only.bind, tree)
