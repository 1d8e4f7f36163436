"""Trees of numbers of many lanes with a tangent each, and functions of lanes applied to them."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero, zero_from_primal

from jaxshroud.batch.xla import DUAL_NUMBERS
from jaxshroud.march.carry import EachLane


class Dual(NamedTuple):
    """A tree and its tangent, a tree with None where nothing depends on the direction."""

    value: Any
    tangent: Any


def _has_tangent(tree: Any) -> Any:
    """Which leaves of a tree have a tangent: all real numbers; of lanes and trials, those that are differentiable."""
    return jax.tree.map(_part_has_tangent, tree, is_leaf=_selects_differentiable)


def _selects_differentiable(part: Any) -> bool:
    return hasattr(part, "differentiable")


def _part_has_tangent(part: Any) -> Any:
    if not _selects_differentiable(part):
        return _is_floating(part)
    fixed = jax.tree.map(lambda _: False, part)
    return eqx.tree_at(lambda part: part.differentiable, fixed, _is_floating(part.differentiable))


def _is_floating(tree: Any) -> Any:
    return jax.tree.map(lambda a: bool(jnp.issubdtype(a.dtype, jnp.floating)), tree)


def with_tangent(f: Any, *args: Any) -> Dual:
    """The value of `f` and its tangent; arguments that are not `Dual`s have none."""
    duals = [a if isinstance(a, Dual) else Dual(a, jax.tree.map(lambda _: None, a)) for a in args]
    values, tangents = zip(*duals, strict=True)
    moving = jax.tree.map(lambda _, d: d is not None, values, tangents, is_leaf=lambda x: x is None)
    moves, rest = eqx.partition(values, moving)

    def of_moving(moves):
        out = f(*eqx.combine(moves, rest))
        return eqx.partition(out, _has_tangent(out))

    out, out_tangent, out_rest = jax.jvp(of_moving, (moves,), (tangents,), has_aux=True)
    return Dual(eqx.combine(out, out_rest), out_tangent)


def differentiable(each: EachLane) -> EachLane:
    """How to apply a function to all lanes such that JAX can differentiate it once, forward.

    The tangents of a function are computed in its kernel, or in one of their own where they are many.
    """

    def run(f: Any, *args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)

        def of_leaves(leaves):
            return f(*tree.unflatten(leaves))

        call = jax.custom_jvp(lambda *leaves: each(of_leaves, leaves))
        call.defjvp(partial(_dual_rule, each, of_leaves), symbolic_zeros=True)
        return call(*leaves)

    return run


def _dual_rule(each: EachLane, f: Any, values: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    along = tuple(None if isinstance(t, SymbolicZero) or t.dtype == jax.dtypes.float0 else t for t in tangents)
    dual = Dual(values, along)
    if len(jax.tree.leaves(dual)) <= DUAL_NUMBERS:
        value, tangent = each(partial(with_tangent, f), dual)
    else:
        value = each(f, values)
        tangent = each(lambda dual: with_tangent(f, dual).tangent, dual)

    def none(v, t):
        return zero_from_primal(v, symbolic_zeros=True) if t is None else t

    return value, jax.tree.map(none, value, tangent)
