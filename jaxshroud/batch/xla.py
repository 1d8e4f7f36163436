"""All that knows XLA: how functions are compiled, how many lanes become one kernel, and how large a kernel may be.

XLA:CPU makes one kernel per number that a function returns, each recomputing or reloading what it needs. For a trial
step, with some sixty results of some two thousand operations, that is 19 times slower than one loop over the lanes with
everything in registers, and takes 13 times longer to compile (RK4, 64 lanes). A windowed reduction over several arrays
is such a loop: its reducer may be any function of scalars and returns all results at once. With windows of one lane
there is nothing to reduce, and the reducer is simply called once for each lane.

A kernel is kept whole up to some 3,500 operations; beyond, XLA:CPU cuts it into functions that recompute each other's
results. With more than some 120 arguments or results it no longer uses vector registers. Larger functions are given to
it in parts: see `groups`.
"""

import warnings
from collections.abc import Callable
from functools import cache, partial, wraps
from inspect import signature
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array

from jaxshroud.march.method import Choices
from jaxshroud.march.taylor import Taylor
from jaxshroud.model.absent import Scalar

COMPILER = {"xla_cpu_prefer_vector_width": 512}  # the widest registers, where the CPU has them
FOR_SERIES = COMPILER | {"xla_cpu_use_fusion_emitters": False}
"""Options of XLA on a CPU, for `jax.jit(f, compiler_options=...)` of a program that marches by power series.

Its kernels have 3,000 to 8,000 operations: the usual emitter takes minutes for them, this one seconds.
"""
STAGES_AT_ONCE = 7  # in one kernel
STAGES_WITH_EVENTS = 4  # in one kernel with everything else that a trial does
DUAL_STAGES = 4  # in one kernel where tangents come along
DUAL_NUMBERS = 160  # that values and tangents may take in one kernel; beyond, two are faster
SMOOTH = 0.75  # of these stages in smooth contact, whose laws are longer: beyond, RK8 is 60 times slower

Tree = TypeVar("Tree")  # of arrays
EachLane = Callable[..., Any]  # (f, *args): `f(*args)` of every lane; all arrays have a leading axis of lanes


def compiled(*static: str) -> Callable[[Callable], Callable]:
    """A decorator: compile with `COMPILER`, or without it where XLA refuses that; `static` names arguments as in jit.

    Where the argument `method` says so, a march by power series is compiled with `FOR_SERIES`, once for all tolerances.
    The function that is called has attributes `widest` and `large`: those that these compile.
    """

    def decorate(f: Callable) -> Callable:
        plain = jax.jit(f, static_argnames=static)
        widest = jax.jit(f, static_argnames=static, compiler_options=COMPILER)

        @partial(jax.jit, static_argnames=static, compiler_options=FOR_SERIES)
        @wraps(f)
        def large(*, tolerance: Scalar, method: Choices, **given: Any) -> Any:
            return f(**given, method=_of_tolerance(method, tolerance))

        @wraps(f)
        def call(*args: Any, **kwargs: Any) -> Any:
            given = signature(f).bind(*args, **kwargs).arguments
            method: Choices | None = given.get("method")
            taylor = method and method.taylor
            if inside_another((args, kwargs)) or not accepted(bool(taylor)):
                return plain(*args, **kwargs)
            if not method or not taylor:
                return widest(*args, **kwargs)
            named = given | {"method": method._replace(tableau=Taylor(taylor.order))}
            return large(**named, tolerance=taylor.tolerance)

        call.widest, call.large = widest, large  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


def inside_another(given: Any) -> bool:
    """Whether a call is part of another program, whose options count."""
    return any(isinstance(a, Tracer) for a in jax.tree.leaves(given))


def _of_tolerance(method: Choices, tolerance: Any) -> Choices:
    """The same power series with another tolerance."""
    assert method.taylor is not None
    return method._replace(tableau=method.taylor._replace(tolerance=tolerance))


@cache
def accepted(series: bool = False) -> bool:
    """Whether XLA compiles with `COMPILER`, or with `FOR_SERIES`; warns if not."""
    options = FOR_SERIES if series else COMPILER
    try:
        with jax.ensure_compile_time_eval():
            jax.jit(lambda a: a + a, compiler_options=options)(np.zeros(()))
    except Exception as error:  # of whatever type a future XLA may raise
        slower(f"XLA refuses {options} ({error}): vector registers may be narrower, and power series compile slowly")
        return False
    return True


def slower(reason: str) -> None:
    """Warn that everything works, but slower."""
    warnings.warn(f"Simulations will be slower: {' '.join(reason.split())}.", RuntimeWarning, stacklevel=3)


def alone(tree: Tree) -> Tree:
    """A tree of arrays with a leading axis of one lane."""
    return jax.tree.map(lambda a: jnp.asarray(a)[None], tree)


def repeated(tree: Tree, lanes: int) -> Tree:
    """A tree of arrays with a leading axis of equal lanes; numpy views that may not be written to."""
    return jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), tree)


def plain(f: Callable, *args: Any) -> Any:
    """By `jax.vmap`: runs, and differentiates, anywhere."""
    return lax.optimization_barrier(jax.vmap(f)(*args))


def fused(f: Callable, *args: Any) -> Any:
    """As one kernel; by `jax.vmap` where `f` uses more than elementwise operations on scalars, as own laws may."""
    leaves, tree = jax.tree.flatten(args)
    scalars = [jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in leaves]
    jaxpr, shape = jax.make_jaxpr(lambda *a: f(*tree.unflatten(a)), return_shape=True)(*scalars)
    if not _of_scalars(jaxpr.jaxpr):
        return plain(f, *args)
    if not jaxpr.out_avals:
        return jax.tree.unflatten(jax.tree.structure(shape), [])
    used = _used(jaxpr.jaxpr)
    operands, results = _paired([leaves[i] for i in used], [a.dtype for a in jaxpr.out_avals])
    kernel = _reducer(jaxpr_as_fun(jaxpr), scalars, used, results)
    zeros = tuple(jnp.zeros((), a.dtype) for a in operands)
    out = lax.reduce_window(operands, zeros, kernel, (1,), (1,), "VALID")
    return jax.tree.unflatten(jax.tree.structure(shape), [out[i] for i in results])


def _of_scalars(jaxpr) -> bool:
    """Whether all that a program computes are scalars."""
    inner = [a for eqn in jaxpr.eqns for a in jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_program)]
    flat = all(not v.aval.shape for v in (*jaxpr.invars, *(v for eqn in jaxpr.eqns for v in eqn.outvars)))
    return flat and all(_of_scalars(getattr(a, "jaxpr", a)) for a in inner if _is_program(a))


def _is_program(a: Any) -> bool:
    return hasattr(a, "eqns")


def _used(jaxpr) -> list[int]:
    """Which arguments matter to the results."""
    needed = {id(v) for v in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if any(id(v) in needed for v in eqn.outvars):
            needed |= {id(v) for v in eqn.invars}
    return [i for i, v in enumerate(jaxpr.invars) if id(v) in needed]


def _paired(leaves: list, out_types: list) -> tuple[tuple, list[int]]:
    """Operands, and at which of them each result goes: a reduction returns as many results, of the same types."""
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
        results = list(lane)  # places that hold no result pass their operand through
        for place, value in zip(places, one(*arguments), strict=True):
            results[place] = value
        return tuple(results)

    return reducer


@cache
def best() -> EachLane:
    """`fused` on a CPU where it does what `plain` does; warns if it does not."""
    if jax.default_backend() != "cpu":
        return plain
    try:
        with jax.ensure_compile_time_eval():
            lanes = np.linspace(-2.0, 2.0, 16), np.arange(16, dtype=np.int32), np.arange(16) % 3 == 0
            got, right = jax.jit(lambda lanes: (fused(_alike, lanes), plain(_alike, lanes)))(lanes)
            close = jax.tree.map(lambda a, b: np.allclose(a, b, rtol=1e-4, atol=1e-4), got, right)
    except Exception as error:  # of whatever type a future XLA may raise
        slower(f"one kernel for all results of a trial step cannot be compiled ({error})")
        return plain
    if not all(jax.tree.leaves(close)):
        slower("one kernel for all results of a trial step computes other numbers")
        return plain
    return fused


def _alike(lane: Any) -> dict[str, Any]:
    """Dozens of operations on numbers of every type, with choices that depend on one another, as in a trial step."""
    x, n, held = lane
    v, passed = jnp.sqrt(jnp.abs(x)), []
    for i in range(2):
        force = jnp.where(held, x * (1 + x * x), x)
        v, before = v - 0.1 * force, x
        x = x + 0.1 * v
        crossed = (x > 0) != (before > 0)
        n, held = jnp.where(crossed, n + i, n), jnp.where(crossed, n % 2 == 0, held | (n > 12))
        passed.append(jnp.where(crossed, before / jnp.where(crossed, before - x, 1.0), x))
    return {"state": (x, v), "count": n, "held": held, "passed": passed, "done": n > 6}


def groups(method: Choices, smooth: bool) -> tuple[int, ...] | None:
    """Stages at which a trial step is divided into kernels; None where it is one kernel with all that follows."""
    size = len(method.rk.b)
    if size <= STAGES_WITH_EVENTS and not method.derivative:
        return None
    at_once = DUAL_STAGES if method.derivative else STAGES_AT_ONCE
    at_once = int(at_once * SMOOTH) if smooth else at_once
    return tuple(range(at_once, size, at_once))


def in_parts(method: Choices, smooth: bool) -> bool:
    """Whether a trial is several kernels."""
    return bool(method.taylor) or groups(method, smooth) is not None


def repeated_while(going: Callable[[Tree], Array], once: Callable[[Tree], Tree], lanes: Tree, parts: bool) -> Tree:
    """`once` again and again while `going`.

    Where `once` is a single kernel two by two: the first writes to memory of its own, the second back where the lanes
    came from, and none is copied. Where it is in `parts`, the last of these can do that.
    """
    twice = once if parts else lambda lanes: once(once(lanes))
    return lax.while_loop(going, twice, lanes)
