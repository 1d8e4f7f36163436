"""Sobol indices of functions that have known ones."""

import numpy as np
import pytest
from scipy.stats import sobol_indices, uniform

from jaxshroud.signals.statistics import saltelli_rows, variance_indices

ENDS = np.array([[-np.pi, np.pi]] * 3)


def ishigami(z, a=7.0, b=0.1):
    """Of Ishigami and Homma, with its indices in closed form."""
    return np.sin(z[..., 0]) + a * np.sin(z[..., 1]) ** 2 + b * z[..., 2] ** 4 * np.sin(z[..., 0])


def known(a=7.0, b=0.1):
    """First and total indices: variances of the parts in closed form."""
    one, two = (1 + b * np.pi**4 / 5) ** 2 / 2, a**2 / 8
    both = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    whole = one + two + both
    return np.array([one, two, 0.0]) / whole, np.array([one + both, two, both]) / whole


@pytest.mark.parametrize("seed", range(4))
def test_intervals_hold_the_indices_of_a_known_function(seed):
    first, total = known()
    found = variance_indices(ishigami(saltelli_rows(1024, ENDS, seed)), seed)
    assert np.all((found.first_low <= first) & (first <= found.first_high))
    assert np.all((found.total_low <= total) & (total <= found.total_high))
    # Control: they are narrow enough to tell what acts alone from what does not.
    assert np.all(found.total_high - found.total_low < 0.25)
    assert found.first_high[2] < found.total_low[2]


def test_estimates_are_those_of_scipy():
    rows = saltelli_rows(256, ENDS, 0)
    values = ishigami(rows)
    told = {"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}
    theirs = sobol_indices(func=told, n=256, dists=[uniform()] * 3)
    ours = variance_indices(values, 0)
    np.testing.assert_allclose(ours.total, theirs.total_order, rtol=1e-12)
    np.testing.assert_allclose(ours.first, theirs.first_order, rtol=1e-12, atol=1e-14)


def test_what_varies_by_rounding_alone_has_no_shares():
    noise = 1e-13 * np.random.default_rng(0).standard_normal((3, 8))
    for still in (np.ones((3, 8)), np.zeros((3, 8)), noise):
        assert all(np.all(np.isnan(part)) for part in variance_indices(still, 0, rounding=1e-12))
    assert np.all(np.isfinite(variance_indices(noise, 0)))  # control
