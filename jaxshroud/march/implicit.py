"""The derivative of an event's instant.

Searching for a root gives its value but no derivative: the instant enters through comparisons only, and differentiating
through them is silently wrong wherever the forces differ before and after. The implicit function theorem has it: where
a guard g(t, p) vanishes, dt/dp = -(dg/dp) / (dg/dt). That is the first derivative only; a second one is refused.
"""

from typing import TypeVar

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

Tree = TypeVar("Tree")  # of arrays


@jax.custom_jvp
def at_the_root(quantities, slopes, guard, rate):
    """`quantities` at the instant when `guard` vanishes.

    As numbers they are taken as given, at an instant that has been found; their derivatives are those of quantities
    that move with their `slopes` until the root that moves too.

    Args:
        quantities: Any tree of numbers at the given instant.
        slopes: Their time derivatives.
        guard: Value of the guard there.
        rate: Its time derivative; infinite where the instant is given and not a root.

    Raises:
        TypeError: It is differentiated twice: how the slopes themselves move with the root is not known.
    """
    del slopes, guard, rate
    return quantities


@at_the_root.defjvp
def _at_the_root(primals, tangents):
    quantities, slopes, _, rate = first_order_only(primals)
    shift = -tangents[2] / rate
    return quantities, jax.tree.map(lambda d, slope: d + slope * shift, tangents[0], slopes)


def first_order_only(tree: Tree) -> Tree:
    """Numbers with no further derivative: TypeError where it is asked for."""
    return jax.tree.map(_once.bind, tree)


def _refused(primals, tangents):
    raise TypeError(
        "Derivatives through contact events are of first order only: this motion is differentiated twice. "
        "Take differences of first derivatives instead, or period_map of contact that is smooth or absent."
    )


_once = Primitive("once")  # a custom rule would be lost in reverse mode
_once.def_impl(lambda a: a)
_once.def_abstract_eval(lambda a: a)
ad.primitive_jvps[_once] = _refused
batching.primitive_batchers[_once] = lambda args, axes: (_once.bind(*args), *axes)
mlir.register_lowering(_once, lambda _, a: [a])
