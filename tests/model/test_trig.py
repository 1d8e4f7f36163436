"""The short sine and cosine polynomials against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

from jaxshroud.model.arithmetic import ANGLE_RANGE, sincos, sincos_turns


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_sine_and_cosine_are_right_to_two_units_in_the_last_place(dtype):
    x = np.linspace(-ANGLE_RANGE, ANGLE_RANGE, 20_001).astype(dtype)
    sine, cosine = map(np.asarray, sincos(jnp.asarray(x)))
    assert sine.dtype == cosine.dtype == np.dtype(dtype)
    exact = x.astype(np.longdouble)
    # Horner's rule rounds once per term, but only the last two roundings are not divided by a factorial.
    assert_array_less(np.abs(sine - np.sin(exact)), 2 * np.spacing(np.abs(x) + np.finfo(dtype).tiny))
    assert_array_less(np.abs(cosine - np.cos(exact)), 2 * np.finfo(dtype).eps)


def test_the_polynomial_is_no_good_far_beyond_its_range():
    # The control that makes the check of the angle range necessary: the error reaches 1e-4 before one turn.
    sine, _ = sincos(jnp.asarray(5.5))
    assert abs(float(sine) - np.sin(5.5)) > 1e-4


@pytest.mark.full
def test_derivatives_are_cosine_and_minus_sine():
    x, x_dot = jnp.linspace(-ANGLE_RANGE, ANGLE_RANGE, 1001), jnp.linspace(1.0, 2.0, 1001)
    _, (sine_dot, cosine_dot) = jax.jvp(sincos, (x,), (x_dot,))
    assert_allclose(sine_dot, np.cos(x) * x_dot, rtol=1e-15)
    assert_allclose(cosine_dot, -np.sin(x) * x_dot, rtol=1e-15, atol=1e-18)
    second = jax.vmap(jax.grad(jax.grad(lambda x: sincos(x)[0])))(x)  # the rule must itself be differentiable
    assert_allclose(second, -np.sin(x), rtol=1e-15, atol=1e-18)


def test_quarter_turns_are_exact():
    quarters = np.arange(-4000, 4001)
    sine, cosine = jax.vmap(sincos_turns)(jnp.asarray(quarters / 4))
    assert_array_equal(sine, np.array([0.0, 1.0, 0.0, -1.0])[quarters % 4])
    assert_array_equal(cosine, np.array([1.0, 0.0, -1.0, 0.0])[quarters % 4])


def test_random_turns_lose_nothing_to_the_number_of_whole_ones():
    turns = np.random.default_rng(2).uniform(-1000, 1000, 5000)
    sine, cosine = jax.vmap(sincos_turns)(jnp.asarray(turns))
    exact = 2 * np.pi * (turns - np.round(turns))  # exact subtraction; |exact| <= pi
    # Rounding of 2 pi and of the product, each half a unit in the last place of an angle up to pi.
    assert_allclose(sine, np.sin(exact), rtol=0, atol=1e-15)
    assert_allclose(cosine, np.cos(exact), rtol=0, atol=1e-15)


def test_the_drive_can_be_differentiated_by_its_phase():
    turns = jnp.asarray(np.random.default_rng(3).uniform(-2, 2, 200))
    rate = jax.vmap(jax.grad(lambda t: sincos_turns(t)[0]))(turns)
    assert_allclose(rate, 2 * np.pi * np.cos(2 * np.pi * turns), rtol=0, atol=2e-14)
