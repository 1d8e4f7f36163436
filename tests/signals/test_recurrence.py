"""After how many periods samples return."""

import numpy as np
import pytest

from jaxshroud.signals.period import recurrence

RNG = np.random.default_rng(1)
NEAR = np.full((1, 2), 1e-3)


@pytest.mark.parametrize("q", [1, 2, 5, 21])
def test_a_pattern_returns_after_its_length(q):
    z = np.resize(RNG.standard_normal((q, 2)), (64, 2)) + 4e-4 * RNG.uniform(-1, 1, (64, 2))
    told = recurrence(z[None], NEAR)
    assert told.number[0] == told.nearest[0] == q
    assert told.error[0] <= 1  # twice the noise, in units of what counts
    assert not told.one_way[0]


def test_one_that_shows_less_than_three_times_is_not_found():
    z = np.resize(RNG.standard_normal((22, 2)), (64, 2))
    assert recurrence(z[None], NEAR).number[0] == 0


def test_drift_is_seen_however_slow():
    n = np.arange(64)[:, None]
    pattern = np.resize(RNG.standard_normal((2, 2)), (64, 2))
    for drift in (1e-4 * n, 0.1 * n, np.exp(-n / 30)):
        assert recurrence((pattern + drift)[None], NEAR).one_way[0]
    assert not recurrence((pattern + 0.01 * np.sin(n))[None], NEAR).one_way[0]


def test_a_lane_that_stopped_returns_never():
    z = np.zeros((1, 64, 2))
    z[0, 40:] = np.nan
    told = recurrence(z, NEAR)
    assert told.number[0] == 0
    assert np.isinf(told.error[0])
