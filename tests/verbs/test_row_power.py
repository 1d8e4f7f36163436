"""P_d of rows of blades: what a chain of two shares with the pair, and how it is told."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from row_runs import CHAIN_OF_TWO, PAIR

import jaxshroud as js

pytestmark = pytest.mark.full

IN_X = ['parts.motion=["x"]']
HOW = {"n_periods": 4, "transient": 2, "method": js.RungeKutta("rk4", steps=200), "amplitudes": True}
GAMMAS = {"contact.gamma": [2.0, 3.0, 4.0], "blades.m[1]": [0.08, 0.09, 0.08]}


@pytest.fixture(scope="module")
def powers():
    both = js.load("row_ring12", IN_X + CHAIN_OF_TWO), js.load("table1", IN_X + PAIR)
    return [js.power(js.scenes_from(GAMMAS, scene), **HOW) for scene in both]


def test_a_chain_of_two_has_the_powers_of_the_pair(powers):
    row, pair = powers
    for name in ("final_P", "final_P_0", "work_drive", "loss_viscous", "loss_friction", "x_peak", "x_rms"):
        got, want = getattr(row, name), getattr(pair, name)
        # Rounding alone: sums are taken in another order.
        assert_allclose(got, want, rtol=1e-9, atol=1e-9 * np.max(np.abs(want)), err_msg=name)
    assert_array_equal(row.final_period_number, pair.final_period_number)


def test_the_reduction_is_that_of_all_blades_beside_that_of_the_worst(powers):
    row, pair = powers
    P, P_0 = row.final_P, row.final_P_0
    assert_allclose(row.final_P_d, 100 * (1 - P.sum(axis=-1) / P_0.sum(axis=-1)), rtol=1e-12)
    assert_allclose(row.final_P_d_worst, (100 * (1 - P / P_0)).min(axis=-1), rtol=1e-12)
    # A blade of another mass gains differently: the left one, all and the worst are three numbers.
    assert len({pair.final_P_d[1], row.final_P_d[1], row.final_P_d_worst[1]}) == 3
    assert pair.final_P_d_worst is None
    assert "P_d_worst" not in pair.final


def test_a_row_tells_its_losses_and_no_equivalents(powers, reopened):
    row, pair = powers
    assert row.k_n is None
    one = row.lane(1)
    share = 100 * one.loss_friction / (one.loss_friction + one.loss_viscous)
    told = f"Of the drive's work {share:.3g} % is lost in friction, {100 - share:.3g} % in the dampers."
    assert one.mechanism == told
    assert pair.lane(1).mechanism.startswith("Of the drive's work")
    with pytest.raises(ValueError, match="The mechanism is that of one scene of many: choose it by `lane`"):
        _ = pair.mechanism
    assert one.summary()["final"]["P_d_worst"] == row.final_P_d_worst[1]
    assert one.summary()["equivalent"]["work_drive"] == row.work_drive[1]
    again = reopened(one)
    assert_array_equal(again.data["blade"], [0, 1])
    assert again.summary() == one.summary()
    again.plot()
