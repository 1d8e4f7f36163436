"""Compilation by XLA: the options, the fusion of functions over lanes into kernels, and the size of kernels.

XLA:CPU makes one kernel per number that a function returns, each recomputing or reloading what it needs. For a trial
step, with some sixty results of some two thousand operations, that is 19 times slower than one loop over the lanes with
everything in registers, and takes 13 times longer to compile (RK4, 64 lanes). A windowed reduction over several arrays
is such a loop: its reducer may be any function of scalars and returns all results at once. With windows of one lane
there is nothing to reduce, and the reducer is called once for each lane.

A kernel is kept whole up to some 3,500 operations; beyond, XLA:CPU cuts it into functions that recompute each other's
results. With more than some 120 arguments or results it no longer uses vector registers. Larger functions are
therefore split: see `march.row_step.whole`, and the options `FOR_SERIES` keep larger ones whole.
"""

import warnings
from collections.abc import Callable
from functools import cache, wraps
from inspect import signature
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.cache.garbage import no_garbage_collected
from jaxshroud.cache.programs import is_traced, kept
from jaxshroud.march.carry import EachLane
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.typed import Tree

HAS_TWO_EMITTERS = jax.__version_info__ < (0, 12)
WIDE_VECTORS = {"xla_cpu_prefer_vector_width": 512}  # the widest registers, where the CPU has them
FOR_SERIES = WIDE_VECTORS | ({"xla_cpu_use_fusion_emitters": False} if HAS_TWO_EMITTERS else {})
"""Options of XLA on a CPU, for `jax.jit(f, compiler_options=...)` of a program that marches by power series.

Its kernels have 3,000 to 8,000 operations: until JAX 0.12 the usual emitter takes minutes for them, the other one
seconds. Later there is one emitter, which takes seconds; its kernels are four times slower.
"""
DUAL_NUMBERS = 180  # of values and tangents in one kernel; with more, two kernels are faster


def compiled(*static: str) -> Callable[[Callable], Callable]:
    """A decorator: compile with `WIDE_VECTORS`, or without where XLA refuses it; `static` names arguments as in jit.

    If the stepper of the argument `method` has large kernels, `FOR_SERIES` is used, with one program for all
    tolerances. The function has the attributes `widest` and `large`: those with either set of options, see `kept`.
    """

    def decorate(f: Callable) -> Callable:
        plain = jax.jit(f, static_argnames=static)
        widest = kept(*static, compiler_options=WIDE_VECTORS)(f)

        @kept(*static, compiler_options=FOR_SERIES)
        @wraps(f)
        def large(*, tolerance: Scalar, method: Choices, **given: Any) -> Any:
            return f(**given, method=method.with_tolerance(tolerance))

        whole = kept(*static, compiler_options=FOR_SERIES)(f)

        @wraps(f)
        def call(*args: Any, **kwargs: Any) -> Any:
            given = signature(f).bind(*args, **kwargs).arguments
            method: Choices | None = given.get("method")
            if method is not None:
                given["method"] = method.as_static
            if is_traced((args, kwargs)) or not accepts_options():
                if method is not None:
                    given["method"] = method_without_options(method.as_static)
                return plain(**given)
            scenes = given.get("scenes")
            if method is None or not _has_large_kernels(method, getattr(scenes, "value", scenes)):
                return widest(**given)
            if not stepper_for(method).large_kernels:
                return whole(**given)
            return large(**given | {"method": method.as_static.with_tolerance()}, tolerance=method.tolerance)

        call.widest, call.large = widest, large  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


def _has_large_kernels(method: Choices, scenes: Any) -> bool:
    """Whether the kernels of a march have thousands of operations: those of pairs, whose axes are unrolled."""
    return stepper_for(method).large_kernels or scenes.layout == PAIR


def method_without_options(method: Choices) -> Choices:
    """The method as it is compiled where XLA's options cannot be set."""
    return method._replace(large_kernels=False) if HAS_TWO_EMITTERS else method


@cache
def accepts_options() -> bool:
    """Whether XLA accepts the options `FOR_SERIES`; warns if not."""
    try:
        with jax.ensure_compile_time_eval(), jax.transfer_guard("allow"):  # the probe has constants
            kept(compiler_options=FOR_SERIES)(lambda a: a + a)(np.zeros(()))
    except Exception as error:  # of whatever type a future XLA may raise
        warn_slower(f"XLA refuses {FOR_SERIES} ({error}): vectors may be narrower, kernels smaller")
        return False
    return True


def warn_slower(reason: str) -> None:
    """Warn that simulations will be slower."""
    warnings.warn(f"Simulations will be slower: {' '.join(reason.split())}.", RuntimeWarning, stacklevel=3)


def one_lane(tree: Tree) -> Tree:
    """A tree of arrays with a leading axis of one lane."""
    if is_traced(tree):
        return jax.tree.map(lambda a: jnp.asarray(a)[None], tree)
    return jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[None]), tree)


def repeat_lane(tree: Tree, lanes: int) -> Tree:
    """A tree of arrays with a leading axis of equal lanes, as read-only NumPy views."""
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), tree)


def vmapped(f: Callable, *args: Any) -> Any:
    """Apply `f` to every lane by `jax.vmap`, which runs, and differentiates, anywhere."""
    return lax.optimization_barrier(jax.vmap(f)(*args))


@no_garbage_collected()
def fused(f: Callable, *args: Any) -> Any:
    """Apply `f` to every lane in one kernel; by `jax.vmap` where `f` computes arrays, as user laws may."""
    leaves, tree = jax.tree.flatten(args)
    scalars = [jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in leaves]
    one = jax.jit(lambda *a: f(*tree.unflatten(a)), inline=True)  # traced here, once, and inlined in the kernel
    traced = one.trace(*scalars)
    jaxpr = traced.jaxpr
    out_tree = jax.tree.structure(traced.out_info)
    if not _is_scalar_program(jaxpr.jaxpr):
        return vmapped(f, *args)
    if not jaxpr.out_avals:
        return jax.tree.unflatten(out_tree, [])
    used = _used_arguments(jaxpr.jaxpr)
    if not used:
        return vmapped(f, *args)
    operands, results = _operands_for_results([leaves[i] for i in used], [a.dtype for a in jaxpr.out_avals])
    kernel = _reducer(one, scalars, used, results)
    zeros = tuple(jnp.zeros((), a.dtype) for a in operands)
    out = lax.reduce_window(operands, zeros, kernel, (1,), (1,), "VALID")
    return jax.tree.unflatten(out_tree, [out[i] for i in results])


def _is_scalar_program(jaxpr) -> bool:
    """Whether a program computes scalars only."""
    inner = [a for eqn in jaxpr.eqns for a in jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_program)]
    flat = all(not v.aval.shape for v in (*jaxpr.invars, *(v for eqn in jaxpr.eqns for v in eqn.outvars)))
    return flat and all(_is_scalar_program(getattr(a, "jaxpr", a)) for a in inner if _is_program(a))


def _is_program(a: Any) -> bool:
    return hasattr(a, "eqns")


def _used_arguments(jaxpr) -> list[int]:
    """The indices of the arguments on which the results depend."""
    needed = {id(v) for v in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if any(id(v) in needed for v in eqn.outvars):
            needed |= {id(v) for v in eqn.invars}
    return [i for i, v in enumerate(jaxpr.invars) if id(v) in needed]


def _operands_for_results(leaves: list, out_types: list) -> tuple[tuple, list[int]]:
    """The operands, and the operand whose place each result takes: a reduction returns results of the same types."""
    operands, free = list(leaves), list(range(len(leaves)))
    places = []
    for dtype in out_types:
        place = next((i for i in free if leaves[i].dtype == dtype), None)
        if place is None:
            place = len(operands)
            operands.append(jnp.zeros(leaves[0].shape, dtype))
        else:
            free.remove(place)
        places.append(place)
    return tuple(operands), places


def _reducer(one: Callable, scalars: list, used: list[int], places: list[int]) -> Callable:
    def reducer(_, lane):
        arguments = [jnp.zeros((), a.dtype) for a in scalars]
        for i, value in zip(used, lane, strict=False):
            arguments[i] = value
        results = list(lane)  # places without a result pass their operand through
        for place, value in zip(places, jax.tree.leaves(one(*arguments)), strict=True):
            results[place] = value
        return tuple(results)

    return reducer


@cache
def best_mapping() -> EachLane:
    """`fused` on a CPU where it computes the numbers of `vmapped`, else `vmapped` with a warning."""
    if jax.default_backend() != "cpu":
        return vmapped
    try:
        with jax.ensure_compile_time_eval(), jax.transfer_guard("allow"):  # the probe has constants
            lanes = np.linspace(-2.0, 2.0, 16), np.arange(16, dtype=np.int32), np.arange(16) % 3 == 0
            got, right = kept()(lambda lanes: (fused(_probe_function, lanes), vmapped(_probe_function, lanes)))(lanes)
            close = jax.tree.map(lambda a, b: np.allclose(a, b, rtol=1e-4, atol=1e-4), got, right)
    except Exception as error:  # of whatever type a future XLA may raise
        warn_slower(f"one kernel for all results of a trial step cannot be compiled ({error})")
        return vmapped
    if not all(jax.tree.leaves(close)):
        warn_slower("one kernel for all results of a trial step computes other numbers")
        return vmapped
    return fused


def _probe_function(lane: Any) -> dict[str, Any]:
    """A probe: dozens of operations on numbers of every type, with dependent choices, as in a trial step."""
    x, n, held = lane
    v = jnp.sqrt(jnp.abs(x))
    passed = []
    for i in range(2):
        force = jnp.where(held, x * (1 + x * x), x)
        v = v - 0.1 * force
        before = x
        x = x + 0.1 * v
        crossed = (x > 0) != (before > 0)
        n, held = jnp.where(crossed, n + i, n), jnp.where(crossed, n % 2 == 0, held | (n > 12))
        passed.append(jnp.where(crossed, before / jnp.where(crossed, before - x, 1.0), x))
    return {"state": (x, v), "count": n, "held": held, "passed": passed, "done": n > 6}


def has_several_kernels(method: Choices) -> bool:
    """Whether the trial of a pair is made of several kernels."""
    return stepper_for(method).large_kernels or method.derivative


def repeated_while(
    going: Callable[[Tree], Array],
    once: Callable[[Tree], Tree],
    lanes: Tree,
    several: bool,
    passes: Int[Array, ""] | None = None,
) -> Any:
    """Repeat `once` while `going`, in at most so many `passes` if there is a bound, whose rest is a second result then.

    A single kernel is called twice per pass: the first call writes to new memory and the second one back to the old, so
    that nothing is copied. With `several` kernels in `once`, the last one can do that.
    """
    twice = once if several else lambda lanes: once(once(lanes))
    if passes is None:
        return lax.while_loop(going, twice, lanes)

    def on(both):
        return going(both[0]) & (both[1] > 0)

    return lax.while_loop(on, lambda both: (twice(both[0]), both[1] - 1), (lanes, passes))
