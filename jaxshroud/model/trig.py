"""Sine and cosine as short polynomials.

`jnp.sin` in float64 calls a scalar library routine on CPU, which costs four times a whole integration step. All
angles here are small or can be reduced exactly, so one polynomial on |x| <= pi/4 serves both the blades' rotation and
the drive's phase. The coefficients are the best in the largest error over that range (Remez exchange in 60 digits);
their error is below one unit in the last place.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshroud.model.absent import Scalar

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
    """Even and odd powers apart: half the depth of Horner's rule."""
    if len(coefficients) == 1:
        return jnp.full_like(x, coefficients[0])
    pairs = [c if i + 1 == len(coefficients) else c + coefficients[i + 1] * x for i, c in enumerate(coefficients)][::2]
    total, square = pairs[-1], x * x
    for pair in reversed(pairs[:-1]):
        total = pair + square * total
    return jnp.asarray(total)


@jax.custom_jvp
def sine_versine(x: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """(sin x, 1 - cos x) for |x| <= pi/4; beyond that range the error grows and callers must check it.

    1 - cos x has no cancellation at small x.
    """
    square = x * x
    sine = x + x * square * _polynomial(_SINE[x.dtype], square)
    return sine, square * (0.5 + square * _polynomial(_VERSINE[x.dtype], square))


@sine_versine.defjvp
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
    sine, cosine = jnp.where(swap, c, s), jnp.where(swap, s, c)
    return jnp.where(quarter >= 2, -sine, sine), jnp.where((quarter == 1) | (quarter == 2), -cosine, cosine)
