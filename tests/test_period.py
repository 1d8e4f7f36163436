"""Period numbers of orbits whose period is known."""

import numpy as np
import pytest

from jaxshroud.analysis.period import LARGEST_PERIOD, PERIOD_TOLERANCE, periodicity

RNG = np.random.default_rng(11)


def orbit(q: int, n: int = 96) -> np.ndarray:
    """A random orbit of q different points, repeated."""
    return np.resize(np.random.default_rng(q).uniform(-1, 1, q), n)


@pytest.mark.parametrize("q", range(1, LARGEST_PERIOD + 1))
def test_a_repeated_orbit_has_its_length_as_period(q):
    found = periodicity(orbit(q))
    assert (int(found.number), bool(found.settled)) == (q, True)
    assert int(periodicity(1e-9 * orbit(q)).number) == q  # metres or micrometres: the tolerance is relative


def test_seventeen_points_are_aperiodic():
    found = periodicity(orbit(LARGEST_PERIOD + 1))
    assert (int(found.number), bool(found.settled)) == (0, True)  # neither periodic nor on its way there


@pytest.mark.parametrize("q", [1, 2, 5, 16])
def test_noise_counts_from_the_tolerance_on(q):
    x = orbit(q)
    scale = np.abs(x).max()
    for factor, number in ((0.99, q), (1.01, 0)):
        noisy = x.copy()
        middle = np.flatnonzero(np.abs(x) < scale)[20] if q > 1 else 48  # not the point that sets the scale
        noisy[middle] -= np.sign(x[middle]) * factor * PERIOD_TOLERANCE * scale
        assert int(periodicity(noisy).number) == number
        assert int(periodicity(noisy, tolerance=2 * PERIOD_TOLERANCE).number) == q


def test_a_chaotic_orbit_is_aperiodic_and_settled():
    x = np.empty(400)
    x[0] = 0.3
    for i in range(399):
        x[i + 1] = 3.9 * x[i] * (1 - x[i])  # logistic map, no period window
    found = periodicity(x)
    assert (int(found.number), bool(found.settled)) == (0, True)


@pytest.mark.parametrize("q", [1, 2, 3])
def test_a_dying_transient_is_not_settled(q):
    decay = np.exp(-np.arange(200) / 60)  # return errors fall to a fifth from half to half
    found = periodicity(orbit(q, 200) + decay * RNG.uniform(0.9, 1.0, 200))
    assert (int(found.number), bool(found.settled)) == (0, False)
    later = orbit(q, 200) + np.exp(-10) * decay
    assert (int(periodicity(later).number), bool(periodicity(later).settled)) == (q, True)


def test_lanes_keep_their_shape_and_do_not_disturb_each_other():
    lanes = np.stack([orbit(q) for q in (3, 16, 1, 17, 2, 8)]).reshape(2, 3, 96)
    lanes[1, 0] = np.nan
    found = periodicity(lanes)
    assert found.number.dtype == np.int32
    np.testing.assert_array_equal(found.number, [[3, 16, 1], [0, 2, 8]])
    np.testing.assert_array_equal(found.settled, [[True, True, True], [False, True, True]])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_bad_sample_leaves_no_period(bad):
    x = orbit(2)
    x[50] = bad
    assert (int(periodicity(x).number), bool(periodicity(x).settled)) == (0, False)


def test_too_few_samples_show_no_period():
    assert int(periodicity(np.array([0.3])).number) == 0  # nothing to compare with
    assert periodicity(np.array([[0.3], [0.4]])).number.shape == (2,)
    assert int(periodicity(np.array([0.3, 0.3])).number) == 1


def test_a_blade_at_rest_has_period_1():
    found = periodicity(np.zeros(40))
    assert (int(found.number), bool(found.settled)) == (1, True)
