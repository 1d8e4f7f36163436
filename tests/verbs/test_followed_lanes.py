"""Verbs that follow each lane on its own, for many scenes: lanes first, failures per lane, and the same numbers."""

import importlib

import jax
import numpy as np
import pytest
from matplotlib.text import Text
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud import LaneWarning, Status, load, vary
from jaxshroud.batch.threads import Interrupted
from jaxshroud.orbits import gradient as slopes
from jaxshroud.orbits.batched_algorithms import Derivatives
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.grids import scenes_at

pytestmark = pytest.mark.full

GAMMAS = (0.5, 2.5, 5.0)
STEPS = {"method": js.RungeKutta(steps=100)}
COARSE = {"method": js.RungeKutta(steps=100, precision="float32")}  # in which squares overflow
KEYS = ["shroud.gap", "contact.gamma"]


@pytest.fixture(scope="module")
def base():
    """Bending along x alone, damped so that it settles soon."""
    return load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene


@pytest.fixture(scope="module")
def scenes(base):
    return scenes_at(base, ["contact.gamma"], np.array(GAMMAS)[:, None])


@pytest.fixture(scope="module")
def each(base):
    return [vary(base, "contact.gamma", gamma) for gamma in GAMMAS]


@pytest.fixture(scope="module")
def found(scenes):
    return js.orbit(scenes, dims=["gamma"], **STEPS)


@pytest.fixture(scope="module")
def overflowing(scenes):
    """The middle lane begins so far out that its squares overflow."""
    far = [1e-6, 1e30, 1e-6]
    base = jax.tree.map(lambda a: a[0], scenes)
    return scenes_at(base, ["contact.gamma", "initial.x[0]"], np.stack([GAMMAS, far], axis=1))


def test_orbits_of_a_batch_are_those_of_a_loop(found, each):
    # Each lane runs through the same operations, whatever runs beside it: bit by bit the same.
    for lane, scene in enumerate(each):
        one = js.orbit(scene, **STEPS)
        assert isinstance(one.P_d, float)
        assert isinstance(one.flags, tuple)
        assert (found.q[lane], found.flags[lane], found.periods[lane]) == (one.q, one.flags, one.periods)
        for name in ("P_d", "P", "residual", "multipliers", "conditioning", "doubt"):
            assert_array_equal(getattr(found, name)[lane], getattr(one, name), name)
        assert_array_equal(found.start.motion.x[lane], one.start.motion.x)
        assert_array_equal(found.jacobian.by_state[lane], one.jacobian.by_state)
    assert len(set(found.P_d)) == len(GAMMAS)  # control: lanes that were swapped would differ


def test_leading_axes_come_first(scenes):
    grid = jax.tree.map(lambda a: np.stack([a[:2], a[1:]]), scenes)
    found = js.orbit(grid, dims=["a", "b"], **STEPS)
    assert found.P_d.shape == (2, 2)
    assert found.P.shape == (2, 2, 2)
    assert found.multipliers.shape == (2, 2, 13)
    assert found.P_d[0, 1] == found.P_d[1, 0]
    assert found.to_xarray().P_d.dims == ("a", "b")
    assert found.cycle(1, 1).P_d == found.P_d[1, 1]
    with pytest.raises(ValueError, match="chosen by 2 indices"):
        found.cycle(1)


def test_gradients_of_a_batch_are_those_of_a_loop(scenes, each, found):
    many = js.gradient(scenes, KEYS, orbit=found, **STEPS)
    for lane, scene in enumerate(each):
        one = js.gradient(scene, KEYS, **STEPS)
        for key in KEYS:
            assert isinstance(one.value[key], float)
            # The orbits of `gradient` are of scenes whose stiffness is written anew, rounded differently.
            assert_allclose(many.value[key][lane], one.value[key], rtol=1e-9)
        assert (many.kind[lane], many.flags[lane], many.ci[KEYS[0]][lane]) == ("periodic", (), 0.0)
    with pytest.raises(ValueError, match="`orbit` has lanes"):
        js.gradient(each[0], KEYS, orbit=found, **STEPS)


def test_kinds_of_gradients_are_told_by_lane():
    # Chaos beside an orbit: each has the derivative that it can have.
    base = load("table1", ["drive.F_0=60"]).scene
    pair = scenes_at(base, ["contact.gamma"], np.array([[5.5], [2.5]]))
    few = {"pairs": 4, "n_periods": 4, "transient": 4, "most_periods": 64, "method": js.RungeKutta(steps=200)}
    got = js.gradient(pair, ["shroud.gap"], **few)
    assert got.kind.tolist() == ["smoothed", "periodic"]
    assert "aperiodic" in got.flags[0]
    assert got.flags[1] == ()
    assert got.ci["shroud.gap"][0] > 0 == got.ci["shroud.gap"][1]
    assert np.isnan(got.orbit.P_d[0])
    assert np.isfinite(got.orbit.P_d[1])


def test_exponents_of_a_batch_are_those_of_a_loop(scenes, each):
    few = {"n_periods": 8, "transient": 4, **STEPS}
    many = js.lyapunov(scenes, **few)
    assert many.growth.shape == (3, 8, 5)  # x and its rate of both blades, and the slider
    for lane, scene in enumerate(each):
        one = js.lyapunov(scene, **few)
        assert_array_equal(many.exponents[lane], one.exponents)
        assert_array_equal(many.growth[lane], one.growth)
        assert many.status[lane] == one.status == Status.OK
    state = js.lyapunov(scenes, state=many.last, n_periods=8, transient=0, **STEPS)
    assert np.all(np.isfinite(state.exponents[:, 0]))


def test_a_lane_that_stops_is_flagged_and_the_others_go_on(overflowing, found):
    with pytest.warns(LaneWarning, match="Orbit of 3 lanes, 1 failed: 2 found"):
        some = js.orbit(overflowing, **COARSE)
    assert some.flags.tolist() == [(), ("stopped",), ()]
    assert some.status.tolist() == [Status.OK, Status.NOT_FINITE, Status.OK]
    assert np.isnan(some.P_d[1])
    assert np.isnan(some.jacobian.by_state[1]).all()
    assert_allclose(some.P_d[[0, 2]], found.P_d[[0, 2]], rtol=1e-5)  # float32
    assert some.failed == 1
    with pytest.raises(NumericalError, match="1 failed"):
        js.orbit(overflowing, throw=True, **COARSE)
    with pytest.warns(LaneWarning):
        slope = js.gradient(overflowing, ["shroud.gap"], orbit=some, **COARSE)
    assert slope.kind.tolist() == ["periodic", "none", "periodic"]
    assert slope.flags[1] == ("stopped", "failed")
    assert np.isnan(slope.value["shroud.gap"]).tolist() == [False, True, False]
    with pytest.raises(NumericalError, match="nothing to differentiate"):
        js.gradient(overflowing, ["shroud.gap"], orbit=some, throw=True, **COARSE)
    with pytest.warns(LaneWarning):
        grown = js.lyapunov(overflowing, n_periods=2, transient=1, **COARSE)
    assert np.isnan(grown.exponents[1]).all()
    assert np.isfinite(grown.exponents[[0, 2], 0]).all()


def test_an_interruption_leaves_the_lanes_that_had_ended(overflowing, monkeypatch):
    def stop(_):
        raise Interrupted([None])

    monkeypatch.setattr(Derivatives, "answers", staticmethod(stop))
    with pytest.raises(Interrupted) as stopped:
        js.orbit(overflowing, **COARSE)
    assert stopped.value.done.flags.tolist() == [("not run",), ("stopped",), ("not run",)]
    assert stopped.value.done.status.tolist() == [Status.NOT_RUN, Status.NOT_FINITE, Status.NOT_RUN]


def test_equations_that_cannot_be_solved_are_flagged(scenes, found, monkeypatch):
    held = slopes.moved_start

    def singular(M, by, free):
        if np.array_equal(M, found.jacobian.by_state[1]):
            raise np.linalg.LinAlgError("Singular matrix")
        return held(M, by, free)

    monkeypatch.setattr(slopes, "moved_start", singular)
    with pytest.warns(LaneWarning):
        got = js.gradient(scenes, ["shroud.gap"], orbit=found, **STEPS)
    assert got.flags.tolist() == [(), ("failed",), ()]
    one = js.orbit(vary(jax.tree.map(lambda a: a[0], scenes), "contact.gamma", GAMMAS[1]), **STEPS)
    with pytest.raises(np.linalg.LinAlgError):
        js.gradient(one.scene, ["shroud.gap"], orbit=one, **STEPS)


def test_results_come_back_from_files(found, scenes, tmp_path, reopened):
    back = reopened(found)
    assert isinstance(back, js.Orbit)
    assert repr(back) == repr(found)
    assert back.flags.tolist() == found.flags.tolist()
    assert back.method == found.method
    for a, b in zip(jax.tree.leaves(back.scene), jax.tree.leaves(scenes), strict=True):
        assert_array_equal(a, b)
    assert_array_equal(back.multipliers, found.multipliers)
    # It can be followed further: closed again at once, and differentiated.
    nearby = js.orbit(back.scene, state=back.start, q=1, **STEPS)
    assert np.all(nearby.updates <= 1)
    assert_allclose(nearby.P_d, found.P_d, rtol=1e-9)
    slope = js.gradient(back.scene, KEYS, orbit=back, **STEPS)
    again = reopened(slope)
    assert_array_equal(again.value[KEYS[0]], slope.value[KEYS[0]])
    assert_array_equal(again.orbit.P_d, found.P_d)
    assert (again.of, again.kind.tolist()) == ("P_d", ["periodic"] * 3)
    with pytest.raises(ValueError, match="holds a Gradient, not a Orbit"):
        js.Orbit.load(tmp_path / "result.nc")
    assert any("choose one of them" in text.get_text() for text in found.plot().findobj(Text))
    grown = js.lyapunov(scenes, n_periods=4, transient=1, **STEPS)
    assert_array_equal(reopened(grown).exponents, grown.exponents)


@pytest.mark.parametrize(
    "verb",
    [
        lambda s: js.tune(s, {"shroud.gap": (1e-5, 1e-4)}),
        js.explain,
        importlib.import_module("jaxshroud.verbs.trade").trade,
    ],
)
def test_verbs_of_one_scene_refuse_many(verb, scenes):
    with pytest.raises(ValueError, match="takes one scene, but was given 3"):
        verb(scenes)
