"""Amplitudes of steady numbers, each a mean and harmonics: of their sum, and not of each harmonic by itself."""

import jax
import numpy as np
import pytest

from jaxshroud.model.steady_numbers import steady_peak, steady_rms


@pytest.mark.parametrize("orders", [(1,), (1, 2), (1, 3), (2, 3, 5)])
def test_a_peak_is_that_of_the_sum_of_harmonics(orders):
    # A dense reference: 2^16 phases, the best of which are polished by a parabola through three. They are h = 1e-4
    # apart, so that parabolas miss (n h)^3 / 16, 1e-11 at n = 5.
    random, tau = np.random.default_rng(5), np.linspace(0, 2 * np.pi, 1 << 16, endpoint=False)
    waves = {n: random.normal(size=20) + 1j * random.normal(size=20) for n in orders}
    course = sum((a[:, None] * np.exp(1j * n * tau)).imag for n, a in waves.items())
    before, here, after = (np.abs(np.roll(course, k, axis=1)) for k in (1, 0, -1))
    bend = before - 2 * here + after
    polished = here - (after - before) ** 2 / (8 * np.where(bend < 0, bend, np.inf))
    want = np.where((here >= before) & (here >= after), polished, 0.0).max(axis=1)
    np.testing.assert_allclose(jax.jit(steady_peak)(waves), want, rtol=1e-10)
    np.testing.assert_allclose(jax.jit(steady_rms)(waves), np.sqrt(np.mean(course**2, axis=1)), rtol=1e-12)
    if len(orders) > 1:  # the control: harmonics do not peak together
        assert np.median(sum(abs(a) for a in waves.values()) / want) > 1.01


def test_an_infinite_harmonic_makes_an_infinite_peak():
    waves = {1: np.array([1.0 + 0j, np.inf, np.nan]), 2: np.array([0.5j, 1.0, 1.0])}
    assert np.isfinite(jax.jit(steady_peak)(waves)).tolist() == [True, False, False]
