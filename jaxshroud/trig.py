"""Sine and cosine as short polynomials.

`jnp.sin` in float64 calls a scalar library routine on CPU, which costs four times a whole integration step. All
angles here are small or can be reduced exactly, so a Taylor polynomial on |x| <= pi/4 serves both the blades'
rotation and the drive's phase. Its error there is below one unit in the last place of float64.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxshroud.scene import Scalar

ANGLE_RANGE = math.pi / 4  # [rad]
_TERMS = {jnp.dtype("float64"): 9, jnp.dtype("float32"): 5}


@jax.custom_jvp
def sincos(x: Float[jax.Array, "..."]) -> tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]]:
    """(sin x, cos x) for |x| <= pi/4; beyond that range the error grows and callers must check it."""
    terms = _TERMS[x.dtype]
    x2 = x * x
    sine, cosine = jnp.zeros_like(x), jnp.zeros_like(x)
    for n in reversed(range(terms)):
        sine = sine * x2 + (-1) ** n / math.factorial(2 * n + 1)
        cosine = cosine * x2 + (-1) ** n / math.factorial(2 * n)
    return sine * x, cosine


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    s, c = sincos(x)
    return (s, c), (c * x_dot, -s * x_dot)


def sincos_turns(turns: Scalar) -> tuple[Scalar, Scalar]:
    """(sin, cos) of `2 pi turns`, exact at any multiple of a quarter turn."""
    quarter = jnp.round(4 * turns)
    s, c = sincos((turns - quarter / 4) * (2 * math.pi))
    quarter = quarter - 4 * jnp.floor(quarter / 4)
    swap = (quarter == 1) | (quarter == 3)
    sine, cosine = jnp.where(swap, c, s), jnp.where(swap, s, c)
    return jnp.where(quarter >= 2, -sine, sine), jnp.where((quarter == 1) | (quarter == 2), -cosine, cosine)
