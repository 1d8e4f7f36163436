"""Coexisting motions: found, told apart, their shares; basins; sweeps in both directions."""

import numpy as np
import pytest
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import binomtest

import jaxshroud as js
from jaxshroud.orbits.starts import _overlaps, random_starts, start_range
from jaxshroud.plotting.style import PALE
from jaxshroud.results.attractors import share_interval

pytestmark = pytest.mark.full

STEPS = {"method": js.RungeKutta(steps=100)}
# Between the folds of test_branch: two orbits of period 1.
SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=5", "contact.gamma=2.2"]).scene


@pytest.fixture(scope="module")
def found():
    return js.attractors(SCENE, 64, **STEPS)


def test_two_motions_of_equal_period_number_are_told_apart(found):
    assert found.period_number.tolist() == [1, 1]
    assert found.names == ["A: period 1", "B: period 1"]
    assert found.undecided == 0
    assert found.distance.min() > 0.05  # they are far apart ...
    assert found.residual.max() < 1e-9  # ... and each is known exactly
    assert found.worst == int(np.argmin(found.P_d))
    assert (np.diff(found.P_d) < 0).all()  # letters follow P_d from the largest, whatever the shares


def test_each_start_ends_where_it_is_said_to(found):
    # Against runs of four times the length: the slower multiplier leaves 1e-6 of the start by then.
    state = js.State(found.initial, np.zeros(64), np.zeros(64, np.int32), np.zeros(64, np.int32))
    many = js.scenes_from({"contact.gamma": np.full(64, 2.2)}, SCENE)
    run = js.sweep(many, state=state, transient=800, n_periods=1, **STEPS)
    expected = found.motion.x[found.label]
    assert_allclose(run.motion.x[:, -1], expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_intervals_are_those_of_clopper_and_pearson():
    for n, of in ((0, 20), (1, 20), (7, 20), (20, 20), (255, 256)):
        exact = binomtest(n, of).proportion_ci(method="exact")
        assert_allclose(np.array(share_interval(np.array(n), of)), exact, rtol=1e-9, atol=1e-12)


def test_starts_are_apart_seeded_and_within_reach():
    scene = js.load("table1", ["drive.M_0=1"]).scene
    states, again = random_starts(scene, 50, 3, 2.0), random_starts(scene, 50, 3, 2.0)
    assert_array_equal(states.motion.theta, again.motion.theta)
    for drawn, most in zip(states.motion, start_range(scene), strict=True):
        share = np.abs(np.asarray(drawn)) / most
        assert share.max() <= 2
        assert share.max() > 1.8  # they use it
    assert (np.asarray(_overlaps(scene, states.motion)) < 0).all()


def test_permanent_stick_is_one_family():
    # Pressed together by the gap, with a friction that nothing overcomes: the slider stays wherever it came to.
    scene = js.load(
        "table1", ['parts.motion=["x"]', "shroud.gap=-0.4mm", "friction.mu=1000", "blades.c_x=60", "drive.F_0=5"]
    ).scene
    found = js.attractors(scene, 24, **STEPS)
    assert found.names == ["A: family of period 1"]
    assert found.share.tolist() == [1.0]
    assert found.P_d_most[0] >= found.P_d_least[0]


@pytest.mark.release
def test_a_long_transient_is_no_motion_of_its_own(reopened):
    # A free blade whose amplitude falls by e in 680 periods: what it does in 576 looks aperiodic, but decays.
    slow = js.load("table1", ['parts.motion=["x"]', "blades.c_x=0.02", "shroud.gap=20mm"]).scene
    found = js.attractors(slow, 4, most_periods=64, method=js.RungeKutta(steps=60))
    assert found.names == []
    assert found.undecided == 1
    assert (found.label == -1).all()
    assert repr(reopened(found)) == repr(found)
    plane = js.basins(slow, ranges=[(-5e-3, 5e-3), (-1.0, 1.0)], num=2, most_periods=64, method=js.RungeKutta(steps=60))
    assert (plane.label == -1).all()
    (panel, *_) = plane.plot().axes
    grey = panel.collections[0].to_rgba(panel.collections[0].get_array())
    assert {to_hex(cell) for cell in grey.reshape(-1, 4)} == {PALE}  # all of it
    assert not panel.lines  # no marker


@pytest.mark.parametrize("long", [128, 1])  # lanes whose sets are looked at, and the others
def test_a_transient_that_ends_while_it_is_run_on_joins_its_motion(long, monkeypatch):
    monkeypatch.setattr("jaxshroud.orbits.attractors.MAX_LONG_RUNS", long)
    # A free blade whose amplitude falls by e in 68 periods: 576 look aperiodic, thousands do not.
    short = js.load("table1", ['parts.motion=["x"]', "blades.c_x=0.2", "shroud.gap=20mm"]).scene
    found = js.attractors(short, 4, most_periods=64, **STEPS)
    assert found.names == ["A: period 1"]
    assert found.undecided == 0


def test_basins_are_what_their_starts_lead_to(found, reopened):
    plane = js.basins(SCENE, ("x[0]", "v_x[0]"), ranges=[(-4e-4, -1e-4), (-0.5, 0.5)], num=6, **STEPS)
    assert plane.label.shape == (6, 6)
    assert set(plane.label.ravel().tolist()) <= {0, 1}
    x, v = (plane.data[dim].to_numpy() for dim in plane.data["label"].dims)
    for i, j in ((0, 0), (3, 5), (5, 2)):
        at = js.vary(js.vary(SCENE, "initial.x[0]", x[i]), "initial.v_x[0]", v[j])
        end = js.simulate(at, n_periods=400, **STEPS).last.motion.x
        assert_allclose(end, plane.motion.x[plane.label[i, j]], rtol=0, atol=1e-3 * np.abs(end).max())
    assert reopened(plane).plot().axes


def test_letters_are_those_of_attractors_whatever_the_shares(found):
    # Starts near B, so that most end on it, as most random starts end on A.
    near, at = SCENE, found.motion
    for key, value in (("initial.x[1]", at.x[1, 1]), ("initial.v_x[1]", at.v_x[1, 1])):
        near = js.vary(near, key, float(value))
    x, v = at.x[1, 0], at.v_x[1, 0]
    plane = js.basins(near, ranges=[(x - 2e-4, x + 2e-4), (v - 0.2, v + 0.2)], num=6, **STEPS)
    assert found.share.argmax() != plane.share.argmax()
    assert plane.names == found.names
    assert_allclose(plane.P_d, found.P_d, rtol=1e-8)  # both orbits are closed to 1e-9
    assert_allclose(plane.motion.x, at.x, rtol=0, atol=1e-8 * np.abs(at.x).max())


def test_a_plane_is_of_two_numbers_of_the_start():
    with pytest.raises(js.InputError, match="two numbers"):
        js.basins(SCENE, ("x[0]", "x[0]"), **STEPS)
    with pytest.raises(js.InputError, match="no number"):
        js.basins(SCENE, ("x[0]", "gamma"), **STEPS)


VALUES = np.linspace(1.9, 2.6, 8)
OVER = {"contact.gamma": VALUES}


@pytest.fixture(scope="module")
def both():
    return js.sweep(SCENE, OVER, direction="both", n_periods=32, **STEPS)


def test_directions_are_the_sweeps_that_they_are_called_by(both):
    for i, way in enumerate(("independent", "forward", "backward")):
        alone = js.sweep(SCENE, OVER, direction=way, n_periods=32, **STEPS)
        assert_array_equal(both.motion.x[i], alone.motion.x)
        assert_array_equal(both.P_d[i], alone.P_d)


def test_motions_coexist_between_the_folds_and_jump_at_them(both):
    # The folds of this march are at 2.0205 and 2.4617.
    inside = (VALUES > 2.0205) & (VALUES < 2.4617)
    assert_array_equal(both.coexisting, inside)
    rows = dict(zip(both.data["direction"].to_numpy().tolist(), both.jump, strict=True))
    assert VALUES[rows["forward"]].tolist() == [VALUES[VALUES > 2.4617][0]]
    assert VALUES[rows["backward"]].tolist() == [VALUES[VALUES < 2.0205][-1]]
    assert not rows["independent"].any()


def test_several_directions_are_saved_and_drawn(both, reopened):
    again = reopened(both)
    assert_array_equal(again.jump, both.jump)
    assert again.axes.keys() == OVER.keys()
    assert len(again.plot().axes) == 2


def test_a_map_without_samples_has_the_same_numbers():
    over = {"contact.gamma": [1.0, 2.0, 3.0], "drive.F_0": [20.0, 40.0]}
    whole, numbers = (js.sweep(SCENE, over, n_periods=16, keep_samples=s, **STEPS) for s in (True, False))
    assert "x" not in numbers.data
    for name in ("P_d", "period_number", "status", "settling"):
        assert_array_equal(getattr(numbers, name), getattr(whole, name))
    assert numbers.plot().axes
