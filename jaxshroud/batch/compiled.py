"""`jax.jit` with what makes XLA:CPU fast here, where it has that."""

import warnings
from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import jax
import jax.numpy as jnp

COMPILER = {"xla_cpu_prefer_vector_width": 512}  # the widest registers, where the CPU has them


def compiled(*static: str) -> Callable[[Callable], Callable]:
    """A decorator: compile with `COMPILER`, or without it where XLA refuses that; `static` names arguments as in jit.

    The function that is called has the attribute `widest`, which is the one compiled with `COMPILER`.
    """

    def decorate(f: Callable) -> Callable:
        widest = jax.jit(f, static_argnames=static, compiler_options=COMPILER)
        plain = jax.jit(f, static_argnames=static)

        @wraps(f)
        def call(*args: Any, **kwargs: Any) -> Any:
            return (widest if accepted() else plain)(*args, **kwargs)

        call.widest = widest  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


@cache
def accepted() -> bool:
    """Whether XLA compiles with `COMPILER`; warns if not."""
    try:
        with jax.ensure_compile_time_eval():
            jax.jit(lambda a: a + a, compiler_options=COMPILER)(jnp.zeros(()))
    except Exception as error:  # of whatever type a future XLA may raise
        slower(f"XLA refuses {COMPILER} ({error}): vector registers may be narrower")
        return False
    return True


def slower(reason: str) -> None:
    """Warn that everything works, but slower."""
    warnings.warn(f"Simulations will be slower: {' '.join(reason.split())}.", RuntimeWarning, stacklevel=3)
