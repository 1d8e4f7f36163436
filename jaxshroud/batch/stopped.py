"""Numbers of lanes that have stopped: NaN, and so are their derivatives, except for a loss that leaves them out.

A loss leaves numbers out by `jnp.where`, and reverse mode then asks for 0 times their derivatives, which is NaN where
these are. Up to here numbers and derivatives of stopped lanes are therefore finite; here they become NaN, and the
transpose of that knows what was left out. Inputs that are known only while a compiled function runs are checked here
too: they set a status instead of raising.
"""

import math
from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool, Int

from jaxshroud.cache.programs import kept
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import judge_step
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.ranges import ranges_hold
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def replaced_where(stopped: Bool[Array, "..."], tree: Tree, number: float) -> Tree:
    """The tree with a number for its real ones where `stopped`, whose axes are their first ones.

    Derivatives are NaN there, whatever the number.
    """

    def own(a):
        return np.asarray(number, a.dtype)  # of NumPy: outside of compiled functions, JAX may trap NaN

    return jax.tree.map(lambda a: _replaced(a, own(a), _along(stopped, a)) if _is_real(a) else a, tree)


def nan_where(stopped: Bool[Array, "..."], tree: Tree) -> Tree:
    """`replaced_where` by NaN."""
    return replaced_where(stopped, tree, jnp.nan)


def distinct_where(stopped: Bool[Array, "..."], tree: Tree) -> Tree:
    """`replaced_where` by finite numbers, no two of a lane equal: few functions are singular there."""
    leaves, structure = jax.tree.flatten(tree)
    for i, a in enumerate(leaves):
        if _is_real(a):
            shape = a.shape[stopped.ndim :]
            numbers = jnp.asarray(np.linspace(i + 1.0, i + 1.5, math.prod(shape)).reshape(shape), a.dtype)
            leaves[i] = _replaced(a, jnp.broadcast_to(numbers, a.shape), _along(stopped, a))
    return structure.unflatten(leaves)


def where_going(stopped: Bool[Array, "..."], going: Tree, otherwise: Tree) -> Tree:
    """The numbers of `going` lanes, and `otherwise` those of stopped ones; derivatives are NaN where the latter are."""

    def one(a: Any, b: Any) -> Any:
        if not _is_real(a):
            return b
        lost = _along(stopped, a)
        left_out = ~jnp.isnan(b)
        b = lax.stop_gradient(b)
        return jnp.where(lost & left_out, b, _replaced(a, b, lost & ~left_out))

    return jax.tree.map(one, going, otherwise)


def lost_tangents(stopped: Bool[Array, "..."], tangents: Tree) -> Tree:
    """Tangents that are NaN where `stopped`, whose axes are their first ones."""
    return jax.tree.map(lambda t: _lost.bind(t, _along(stopped, t), transposed=False), tangents)


def _is_real(a: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(a), jnp.inexact)


def _along(stopped: Bool[Array, "..."], a: Any) -> Bool[Array, "..."]:
    """Which of the numbers have stopped."""
    return jnp.broadcast_to(stopped.reshape(stopped.shape + (1,) * (jnp.ndim(a) - stopped.ndim)), jnp.shape(a))


@jax.custom_jvp
def _replaced(a: Array, b: Any, stopped: Bool[Array, "..."]) -> Array:
    """The numbers `a`, and `b` where `stopped`."""
    return jnp.where(stopped, b, a)


@_replaced.defjvp
def _(primals: tuple[Array, Any, Any], tangents: tuple[Array, Any, Any]) -> tuple[Array, Array]:
    return _replaced(*primals), _lost.bind(tangents[0], primals[2], transposed=False)


def _lost_numbers(t: Array, stopped: Bool[Array, "..."], *, transposed: bool) -> Array:
    """NaN where `stopped`; transposed: 0 where the cotangent is 0, else NaN."""
    nan = jnp.full_like(t, jnp.nan)
    return jnp.where(stopped, jnp.where(t == 0, jnp.zeros_like(t), nan) if transposed else nan, t)


def _lost_jvp(primals: tuple[Any, Any], tangents: tuple[Any, Any], *, transposed: bool) -> tuple[Any, Any]:
    t, stopped = primals
    out = _lost.bind(t, stopped, transposed=transposed)
    along = tangents[0]
    return out, along if isinstance(along, ad.Zero) else _lost.bind(along, stopped, transposed=transposed)


def _lost_transpose(cotangent: Any, t: Any, stopped: Any, *, transposed: bool) -> tuple[Any, None]:
    zero = isinstance(cotangent, ad.Zero)
    return ad.Zero(t.aval) if zero else _lost.bind(cotangent, stopped, transposed=not transposed), None


def _lost_batched(args: tuple[Any, Any], axes: tuple[Any, Any], *, transposed: bool) -> tuple[Any, int]:
    size = next(a.shape[axis] for a, axis in zip(args, axes, strict=True) if axis is not None)
    t, stopped = (batching.bdim_at_front(a, axis, size) for a, axis in zip(args, axes, strict=True))
    return _lost.bind(t, stopped, transposed=transposed), 0


_lost = Primitive("lost")
_lost.def_impl(jax.jit(_lost_numbers, static_argnames="transposed"))
_lost.def_abstract_eval(lambda t, stopped, *, transposed: t)
ad.primitive_jvps[_lost] = _lost_jvp
ad.primitive_transposes[_lost] = _lost_transpose
batching.primitive_batchers[_lost] = _lost_batched
mlir.register_lowering(_lost, mlir.lower_fun(_lost_numbers, multiple_results=False))


def require_single_scene(name: str, scene: Scene) -> None:
    """Raise InputError if the scene has leading axes, which the function `name` accepts under `jax.vmap` only."""
    shape = jnp.shape(scene.drive.omega)
    if shape:
        raise InputError(
            f"js.{name} takes one scene, but these have leading axes {shape}: "
            f"map it over them, jax.vmap(js.{name}), or use js.sweep_function."
        )


class Admitted(NamedTuple):
    """A lane at its start; where its numbers are invalid, all of them are replaced by valid ones."""

    scene: Scene
    state: State
    start: State  # the same; where the numbers are invalid not finite, so that the lane stops at once
    good: Bool[Array, ""]  # whether its numbers are valid
    coarseness: Scalar  # see `StepVerdict`


def admit(scene: Scene, state: State, steps: int, method: Choices) -> Admitted:
    """A lane that is to be marched by so many steps in a period.

    All numbers of the scene must be in the ranges of their keys, those of the state finite, and the steps stable.
    Where they are not, numbers that are valid take their place: the derivatives of invalid ones are not finite, and
    would make NaN of 0 in reverse mode.
    """
    return _admitted(scene, state, np.int32(steps), method.tableau)


@kept("tableau")
def _admitted(scene: Scene, state: State, steps: Int[Array, ""], tableau: Tableau | TaylorOptions) -> Admitted:
    starts = [jnp.all(jnp.isfinite(a)) for a in jax.tree.leaves((state.motion, state.u_s))]
    step = judge_step(scene, steps, tableau)
    good = reduce(jnp.logical_and, [ranges_hold(scene), *starts, step.stable])
    scene, state = replaced_where(~good, (scene, state), 1.0)
    first = jax.tree.leaves(state.motion)[0]
    start = eqx.tree_at(lambda state: jax.tree.leaves(state.motion)[0], state, jnp.where(good, first, jnp.nan))
    return Admitted(scene, state, start, good, step.coarseness)


def status_if_admitted(status: Int[Array, "..."], good: Bool[Array, "..."]) -> Int[Array, "..."]:
    """The status of one or many lanes, with BAD_INPUT where the input is invalid."""
    return jnp.where(good, status, jnp.asarray(Status.BAD_INPUT, status.dtype))
