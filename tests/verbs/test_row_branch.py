"""Branches of rows: travelling waves, where their shift breaks, and what emanates there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.plotting.plot_branch import MARKERS

pytestmark = pytest.mark.full

METHOD = js.RungeKutta("dopri8", steps=60)
IN_X = ['parts.motion=["x"]']


def followed(low, high, *options, **how):
    scene = js.load("row_ring12", [*IN_X, *options]).scene
    return js.branch(scene, "drive.omega", low, high, method=METHOD, **how)


@pytest.fixture(scope="module")
def broken():
    """The ring of four in anti-phase, past where its shift breaks, and the branch that begins there."""
    options = ["row.blades=4", "drive.engine_order=2", "drive.omega=920"]
    return followed(920.5, 923.5, *options, at=920.5, most_points=9)


def test_localisation_is_where_the_reduced_map_breaks_the_shift(broken):
    (one,) = broken.special
    assert one.kind == "localisation"
    # i and -i: neighbours of the same phase part, and to the power of the two parts both are 1 at once, where
    # the determinant of the period's map does not change its sign. The equation is solved to 1e-8 of the multiplier.
    assert abs(one.multiplier - 1j) < 1e-6
    assert one.error < 1e-4 * one.value
    first = broken.branch == 0
    assert_array_equal(broken.stable[first & (broken.kind == 0)], broken.value[first & (broken.kind == 0)] < one.value)
    assert broken.is_wave[first].all()
    assert_allclose(broken.x_peak[first], broken.x_peak[first, :1] * np.ones(4), rtol=1e-6)


def test_every_blade_of_a_followed_wave_is_alike(broken, reopened):
    assert isinstance(broken, js.Branch)
    assert (broken.multipliers.shape[1], broken.u_s.shape[1]) == (28, 4)
    assert broken.residual.max() < 1e-9
    waves = np.flatnonzero((broken.branch == 0) & (broken.kind == 0))
    # Waves to the closing error, 1e-9 at most; amplitudes are sums in another order.
    assert broken.wave_residual[waves].max() < 1e-8
    assert_allclose(broken.P_d_worst[waves], broken.P_d[waves], rtol=1e-6)
    # The multipliers of the part, to the power of the parts, are those of the period; control: not without it.
    reduced = np.sort(np.abs(broken.wave_multipliers[waves]))
    period = np.sort(np.abs(broken.multipliers[waves]))
    assert_allclose(reduced**2, period, rtol=0, atol=1e-6)
    assert np.abs(reduced - period).max() > 0.05
    again = reopened(broken)
    assert isinstance(again, js.Branch)
    assert_array_equal(again.wave_multipliers, broken.wave_multipliers)
    assert again.special == broken.special


def test_a_broken_branch_begins_there_on_which_blades_differ(broken):
    on = broken.branch == 1
    assert broken.ends[1][0] == "localisation"
    assert abs(broken.value[on][0] - broken.special[0].value) < 0.01
    assert not broken.is_wave[on].any()
    assert broken.stable[on].all()
    spread = np.ptp(broken.x_peak[on], axis=1)
    assert np.all(np.diff(spread) > 0)
    assert spread[-1] > 0.1 * broken.x_peak[on][-1].mean()
    assert np.all(broken.P_d_worst[on] < broken.P_d[on])
    assert broken.summary()["localisation"] == 1
    marks = [
        line.get_xydata() for line in broken.plot().axes[0].lines if line.get_marker() == MARKERS["localisation"][0]
    ]
    assert sum(len(xy) for xy in marks) == 4  # one for each blade


def test_a_mistuned_ring_has_no_waves_to_break():
    # Control: the same place with one blade 1 % stiffer.
    options = ["row.blades=4", "drive.engine_order=2", "drive.omega=920", "row.mistuning=[0.01,0,0,0]"]
    found = followed(920.5, 921.5, *options, at=920.5, most_points=4)
    assert not found.wave_parts.any()
    assert np.isnan(found.wave_residual).all()
    assert "localisation" not in {one.kind for one in found.special}
    assert np.ptp(found.x_peak, axis=1).min() > 1e-3 * found.x_peak.mean()


@pytest.mark.release
def test_localisation_is_found_wherever_the_neighbouring_points_are():
    # The map of the period is nearly singular there: without looking beside, the longer range misses both.
    options = ["row.blades=4", "drive.engine_order=2"]
    ranges = {(880.0, 1100.0): 4, (1150.0, 1160.0): 2}
    found = [followed(low, 1450.0, *options, at=at, doublings=0, most_points=150) for low, at in ranges]
    assert [len(one.special) for one in found] == list(ranges.values())
    values = [[special.value for special in one.special if special.value > 1150.0] for one in found]
    assert_allclose(*values, rtol=1e-7)


@pytest.mark.release
def test_a_chain_of_two_grazes_where_the_pair_does():
    in_x, march = [*IN_X, "blades.c_x=5"], {"method": js.RungeKutta(steps=100)}
    pair = js.load("table1", [*in_x, 'blades.I="block"', "contact.k=3e5", "drive.F_0=60", "drive.M_0=0.3"]).scene
    chain = js.load(
        "row_ring12", [*in_x, "row.blades=2", "row.closed=false", "drive.engine_order=1", "contact.k=3e5"]
    ).scene
    exact, found = (js.branch(scene, "drive.omega", 480.0, 580.0, most_points=40, **march) for scene in (pair, chain))
    assert [one.kind for one in found.special] == [one.kind for one in exact.special] == ["fold", "fold", "grazing"]
    for one, other in zip(found.special, exact.special, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-10)
    assert_allclose(found.slowest_onset, exact.slowest_onset, rtol=1e-6)
