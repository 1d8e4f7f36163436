"""Lobatto's rule, and how long it must be."""

import numpy as np
import pytest

from jaxshroud.march.taylor_integrals import lobatto, lobatto_error, lobatto_rule_for


@pytest.mark.parametrize("n", [3, 5, 7, 9, 11])
def test_degrees_are_exact_up_to_that_of_the_rule_and_not_beyond(n):
    nodes, weights = map(np.array, lobatto(n))
    assert (nodes[0], nodes[n // 2], nodes[-1]) == (0.0, 0.5, 1.0)
    errors = [abs(weights @ nodes**k - 1 / (k + 1)) for k in range(2 * n - 1)]
    assert max(errors[:-1]) < 1e-15
    assert n > 9 or errors[-1] > 1e-14  # control: of degree 2 n - 2, for larger n below rounding


@pytest.mark.parametrize("n", [3, 5, 7])
@pytest.mark.parametrize("turn", [0.5, 1.0, 2.0, 3.0])
def test_the_error_of_waves_is_bounded_and_about_the_bound(n, turn):
    nodes, weights = map(np.array, lobatto(n))
    found = weights @ np.exp(1j * turn * nodes) - (np.exp(1j * turn) - 1) / (1j * turn)
    bound = lobatto_error(n, turn)
    assert abs(found) <= bound + 1e-15
    assert abs(found) > bound / 2 or bound < 1e-14


def test_rules_grow_with_the_order():
    lengths = [len(lobatto_rule_for(order).nodes) for order in range(4, 25)]
    assert lengths == sorted(lengths)
    assert all(n <= order for n, order in zip(lengths, range(4, 25), strict=True))  # else a product would be cheaper
