"""One scene or many: leading axes come first, names are as asked for, and a lane that fails stops no other."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.scene.checks import InputError, NumericalError
from jaxshroud.scene.config import parse

GAMMA = [1.0, 2.5, 4.0]
SHORT = {"method": js.RungeKutta(steps=200)}


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", ['parts.motion=["x"]']).scene


@pytest.fixture(scope="module")
def scenes(scene):
    return js.scenes_from({"contact.gamma": GAMMA, "drive.omega": [500.0, 536.0, 600.0]}, scene)


def test_swept_scenes_are_a_sweep(scene):
    alike = js.scenes_from({"contact.gamma": GAMMA}, scene)
    keeps = dict(n_periods=2, transient=1, **SHORT)
    got, exact = js.sweep(alike, **keeps), js.sweep(scene, {"contact.gamma": GAMMA}, **keeps)
    np.testing.assert_array_equal(got.P_d, exact.P_d)
    assert got.data["P_d"].dims == ("lane",)
    np.testing.assert_array_equal(got.data["gamma"], GAMMA)
    grid = js.sweep(alike, {"shroud.gap": [1e-5, 2.2e-5]}, direction="forward", dims=["point"], **keeps)
    assert grid.motion.x.shape == (3, 2, 2, 2)
    assert grid.data["P_d"].dims == ("point", "gap")


@pytest.mark.full
def test_power_of_scenes_ends_for_each_by_itself(scenes):
    keeps = dict(n_periods=128, transient=16, **SHORT)
    many, one = js.power(scenes, **keeps), js.power(jax.tree.map(lambda a: a[1], scenes), **keeps)
    assert many.final["P_d"][1] == pytest.approx(one.final["P_d"], rel=1e-9)
    assert many.P_d.shape == many.n.shape
    assert many.n.max(axis=1).tolist() == many.final["n"].tolist()


def test_a_lane_that_fails_is_told_and_stops_no_other(scene):
    wild = js.scenes_from({"drive.F_0": [60.0, 1e30]}, scene)
    coarse = {
        "n_periods": 2,
        "transient": 0,
        "method": js.RungeKutta(steps=200, precision="float32"),
    }  # which overflows
    with pytest.warns(js.LaneWarning, match="1 of 2 lanes ended with NOT_FINITE"):
        curve = js.sweep(wild, **coarse)
    assert (curve.failed, curve.status[0]) == (1, 0)
    assert np.isfinite(curve.P_d[0])
    assert "look at the drive" in curve.messages[0]
    with pytest.raises(NumericalError, match="1 of 2 lanes"):
        js.sweep(wild, throw=True, **coarse)


def test_leading_axes_that_disagree_are_refused(scene):
    wrong = eqx.tree_at(lambda s: s.shroud.gap, scene, jnp.ones(3))
    with pytest.raises(InputError, match="disagree in their leading axes"):
        js.simulate(wrong, n_periods=1, **SHORT)
    with pytest.raises(InputError, match="must name 1 leading axes"):
        js.sweep(js.scenes_from({"contact.gamma": GAMMA}, scene), dims=["a", "b"], n_periods=1, **SHORT)


@pytest.mark.release
@pytest.mark.full
def test_the_argument_counts_then_the_file_then_the_default():
    file = js.load("table1", ['parts.motion=["x"]', "run.periods=2", "run.transient=1", "run.steps_per_period=150"])
    run = js.simulate(file)
    assert (len(run.t), run.steps_per_period) == (301, 150)
    assert js.simulate(file, n_periods=1, method=js.RungeKutta(steps=200)).t.shape == (201,)
    quiet = js.sweep(file.scene, {"contact.gamma": GAMMA}, n_periods=1)
    assert quiet.period.tolist() == [65]  # nothing said: the start-up is no part of an average
    assert quiet.accuracy.startswith("accuracy 1e-06")
    with pytest.raises(js.SceneError, match="keep one of them"):
        parse(file.text().replace("[run]", '[run]\naccuracy = "fast"'), "both")


@pytest.mark.full
def test_an_accuracy_and_steps_of_a_file_replace_each_other():
    file = js.load("fig09_best", ['parts.motion=["x"]', "run.periods=1", "run.transient=1"])
    chosen, steps = js.simulate(file), js.simulate(file, method=js.RungeKutta(steps=150))
    assert chosen.accuracy.startswith("accuracy 1e-06")
    assert steps.accuracy is None
    assert parse(chosen.data.attrs["scene"], "stored").run.accuracy == 1e-6
    assert parse(steps.data.attrs["scene"], "stored").run.steps_per_period == 150
    for words, run in ((["run.steps_per_period=150"], (150, None)), (["run.accuracy=1e-4"], (None, 1e-4))):
        for name in ("fig09_best", "table1"):
            told = js.load(name, words).run
            assert (told.steps_per_period, told.accuracy) == run


@pytest.mark.full
def test_an_accuracy_of_a_file_is_of_located_contact():
    words = ["parts.contact=smooth", "contact.width=5um", 'parts.motion=["x"]', "run.periods=1"]
    run = js.simulate(js.load("fig09_best", words))
    assert run.accuracy is None
    assert run.method.startswith("rk4")
    with pytest.raises(InputError, match="not for smooth contact"):  # control: who asks for one is told
        js.simulate(js.load("fig09_best", words), method="balanced")


def test_the_sweep_of_a_file_needs_no_more_words():
    words = ['parts.motion=["x"]', "sweep.num=3", "run.transient=1", "sweep.keep=2"]
    curve = js.sweep(js.load("fig09", words))
    assert list(curve.axes) == ["contact.gamma"]
    assert curve.P_d.shape == (3,)
