"""Verbs of rows of blades: what a chain of two shares with the pair, results and pictures, and what is refused."""

import numpy as np
import pytest
from command_line import refused
from numpy.testing import assert_allclose, assert_array_equal
from row_runs import CHAIN_OF_TWO, PAIR

import jaxshroud as js
from jaxshroud.model.modes import Status

IN_X = 'parts.motion=["x"]'
CHAIN = [IN_X, *CHAIN_OF_TWO]
HOW = {"n_periods": 4, "transient": 2, "method": js.RungeKutta("rk4", steps=200)}
ALONG = {"contact.gamma": [2.0, 3.0, 4.0]}
ALL_KEPT = {"ledger": True, "forces": True, "amplitudes": True}


@pytest.fixture(scope="module")
def swept():
    return js.sweep(js.load("row_ring12", CHAIN).scene, ALONG, **ALL_KEPT, **HOW)


@pytest.mark.full
def test_a_chain_of_two_is_swept_like_the_pair(swept):
    pair = js.sweep(js.load("table1", [IN_X, *PAIR]).scene, ALONG, **ALL_KEPT, **HOW)
    for name in ("P", "P_0", "x_peak", "x_rms", "v_max", "time_apart", "energy_residual"):
        got, want = getattr(swept, name), getattr(pair, name)
        # Rounding alone: sums are taken in another order.
        assert_allclose(got, want, rtol=1e-9, atol=1e-9 * np.max(np.abs(want)), err_msg=name)
    assert_allclose(swept.motion.x, pair.motion.x, rtol=0, atol=1e-11 * np.max(np.abs(pair.motion.x)))
    assert_array_equal(swept.period_number, pair.period_number)
    for name, counts in pair.counters.items():
        assert_array_equal(swept.counters[name], counts)


@pytest.mark.full
def test_the_wear_of_the_faces_is_told_for_each_interface():
    run = js.simulate(js.load("row_ring12", CHAIN).scene, n_periods=4, method=HOW["method"])
    pair = js.sweep(
        js.load("table1", [IN_X, *PAIR]).scene, {"contact.gamma": [2.6]}, forces=True, **HOW | {"transient": 0}
    )
    for name, got in {"slip": run.slip, "N_mean": run.N_mean, "friction_work": run.loss_friction / 4}.items():
        assert_allclose(got, getattr(pair, name), rtol=1e-9, err_msg=name)
    assert np.all(run.N_slip > run.N_mean)  # which counts the time apart too


def test_the_reduction_of_a_row_is_that_of_all_its_blades(swept):
    each = 100 * (1 - swept.P / swept.P_0)
    assert_allclose(swept.P_d, 100 * (1 - swept.P.sum(axis=-1) / swept.P_0.sum(axis=-1)), rtol=1e-12)
    assert_allclose(swept.P_d_worst, each.min(axis=-1), rtol=1e-12)


def test_a_stored_sweep_of_a_row_is_that_in_memory(swept, tmp_path):
    scene = js.load("row_ring12", CHAIN).scene
    stored = js.sweep(scene, ALONG, **ALL_KEPT, store=tmp_path / "row.zarr", **HOW)
    assert stored.data["N_max"].dims == ("gamma", "interface")
    assert_array_equal(stored.N_max, swept.N_max)
    assert_array_equal(stored.motion.x, swept.motion.x)
    assert_array_equal(stored.P_d, swept.P_d)


@pytest.mark.release(only=["row_ring12"])
@pytest.mark.full
@pytest.mark.parametrize("name", ["row_chain5", "row_ring12"])
def test_a_shipped_row_is_simulated_stored_and_drawn(name, reopened):
    scene, how = js.load(name).scene, {"n_periods": 1, "method": js.RungeKutta("dopri8", steps=100)}
    run = js.simulate(scene, **how)
    blades, interfaces = scene.row.blades, scene.row.interfaces
    assert run.status == Status.OK
    assert abs(run.energy_residual) < 1e-3
    assert run.motion.theta.shape == (101, blades)
    assert run.N.shape == run.contact_point.shape == (101, interfaces)
    assert run.counters["onset_slip"].shape == run.loss_friction.shape == (interfaces,)
    assert np.all((run.N > 0) == (run.mode > 0))
    assert 1 / blades <= run.participation_ratio <= 1
    again = reopened(run)
    assert isinstance(again, js.Trajectory)
    assert_array_equal(again.F, run.F)
    for panel in ("map", "amplitudes", "diameters"):
        again.plot(panel=panel)
    again.plot()
    on = js.simulate(scene, run.last, **how)
    assert_array_equal(on.motion.x[0], run.motion.x[-1])


def test_what_rows_do_not_have_is_refused_in_one_line(tmp_path, capsys):
    words = f"simulate row_ring12 --set parts.contact=none --out {tmp_path}/run.nc"
    assert "many single blades" in refused(capsys, words)
    assert not (tmp_path / "run.nc").exists()


@pytest.mark.full
@pytest.mark.parametrize("level", [1e-3, 1e-6, 1e-9])
def test_an_accuracy_of_a_row_is_kept(level):
    # Against a march with eight times the steps and bisected events.
    scene = js.load("row_ring12", CHAIN).scene
    run = js.simulate(scene, n_periods=96, method=level)
    assert run.accuracy.startswith(f"accuracy {level:.0e}: ")
    assert "not" not in run.accuracy
    method = js.method_for(scene, level)
    assert method.steps == run.steps_per_period
    exact = js.simulate(scene, n_periods=3, method=js.RungeKutta("dopri8", 8 * method.steps, "bisection"))
    short = js.simulate(scene, n_periods=3, method=method)
    for name in ("x", "v_x"):
        got, want = (getattr(one.last.motion, name) for one in (short, exact))
        assert np.abs(got - want).max() <= level * np.abs(want).max()


@pytest.mark.full
def test_a_row_by_default_is_marched_as_balanced():
    scene = js.load("row_ring12", CHAIN).scene
    run, balanced = js.simulate(scene, n_periods=96), js.simulate(scene, n_periods=96, method="balanced")
    assert run.accuracy == balanced.accuracy
    assert_array_equal(run.motion.x, balanced.motion.x)
    silent = js.simulate(scene, n_periods=1)  # too short for a trial; a warning is an error here
    assert silent.accuracy is None


@pytest.mark.release(only=["tune", "diagnose"])
@pytest.mark.full
@pytest.mark.parametrize("verb", ["sweep", "power", "table", "scatter", "tune", "diagnose"])
def test_verbs_say_once_that_a_run_is_too_short_for_an_accuracy(verb):
    scene, run = js.load("row_ring12", CHAIN).scene, {"n_periods": 2, "transient": 1}
    designs, search = {"contact.gamma": [2.0, 3.0]}, js.SearchOptions(4, 1, 1)
    args, more = {
        "sweep": ((designs,), run),
        "power": ((), run),
        "table": ((designs,), run),
        "scatter": (({"shroud.gap": 1e-6},), run | {"draws": 8}),
        "tune": (({"contact.gamma": (2.0, 3.0)},), run | {"search": search}),
        "diagnose": ((), {"transient": 1}),
    }[verb]
    with pytest.warns(js.AccuracyWarning) as warned:
        found = getattr(js, verb)(scene, *args, **more, method="balanced")
    said = [str(one.message) for one in warned if one.category is js.AccuracyWarning]
    assert said == [found.accuracy]
    assert "not examined, and maybe missed, as a trial would take more than a tenth of the run" in found.accuracy
