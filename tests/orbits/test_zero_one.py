"""The 0-1 test for chaos, on series whose kind is known."""

import numpy as np
import pytest

from jaxshroud import zero_one
from jaxshroud.scene.checks import InputError

N = 512
TURN = 2 * np.pi * (np.sqrt(5) - 1) / 2 * np.arange(N)


def logistic(r, n=N):
    """From a start that is on no short cycle, after its transient."""
    x, out = 0.3, []
    for _ in range(n + 200):
        x = r * x * (1 - x)
        out.append(x)
    return np.array(out[200:])


def test_chaos_gives_one_and_regular_motion_nought():
    # With 512 numbers K is off by some 0.05: the correlation of 51 lags whose mean square is itself an average.
    series = [logistic(4.0), logistic(3.83), logistic(3.5), np.cos(TURN), np.cos(TURN) + 0.5 * np.sin(2 * TURN + 1)]
    K = zero_one(np.stack(series))
    assert K[0] > 0.95
    assert np.all(np.abs(K[1:]) < 0.1)
    np.testing.assert_array_equal(K, [zero_one(one) for one in series])  # many at once are each alone


def test_size_and_place_of_a_series_do_not_count():
    np.testing.assert_allclose(zero_one(1e-6 * logistic(4.0) + 3), zero_one(logistic(4.0)), atol=1e-6)


def test_a_series_within_what_counts_as_none_is_regular():
    noise = 1e-9 * np.random.default_rng(0).standard_normal(N)
    assert zero_one(1 + noise, 1e-8) == 0
    assert zero_one(1 + noise) > 0.9  # control: of noise alone, K is that of chaos


def test_smooth_curves_look_regular_however_chaotic():
    # Control for samples once a period: a curve through the same numbers with 40 samples from one to the next.
    fine = np.interp(np.arange(0, N, 1 / 40)[:N], np.arange(N), logistic(4.0))
    assert zero_one(fine) < 0.8 < zero_one(logistic(4.0))


def test_what_cannot_be_judged_is_refused_or_not_a_number():
    assert np.isnan(zero_one(np.append(logistic(4.0), np.nan)))
    with pytest.raises(InputError, match=r"needs 50 numbers, but has 49"):
        zero_one(np.ones(49))
