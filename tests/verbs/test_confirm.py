"""Lanes of a sweep that a finer march settles elsewhere."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.threads import Interrupted
from jaxshroud.verbs import sweep_run as confirm
from jaxshroud.verbs.accuracy import Setting, by_series
from jaxshroud.verbs.sweep_run import confirmed_run

SMALL = dict(n_periods=4, transient=2, method=js.RungeKutta(steps=100))
ALONG = {"contact.gamma": [1.0, 2.0, 3.0]}


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene


@pytest.fixture(scope="module")
def swept(scene):
    return js.sweep(scene, ALONG, confirm=True, **SMALL)


def test_the_numbers_are_those_of_the_sweep_alone(scene, swept):
    alone = js.sweep(scene, ALONG, **SMALL)
    assert alone.unconfirmed is None
    np.testing.assert_array_equal(swept.P_d, alone.P_d)
    assert swept.unconfirmed.dtype == bool
    assert swept.steps_per_period == alone.steps_per_period == 100


def test_a_store_marks_the_same_lanes(scene, swept, tmp_path):
    stored = js.sweep(scene, ALONG, confirm=True, store=tmp_path / "a.zarr", **SMALL)
    np.testing.assert_array_equal(stored.unconfirmed, swept.unconfirmed)
    with pytest.raises(js.StoreError, match="confirm"):
        js.sweep(scene, ALONG, store=tmp_path / "a.zarr", resume=True, **SMALL)


@pytest.mark.parametrize(
    ("name", "moved", "marked"),
    [("P_d", 0.5, True), ("P_d", 1e-4, False), ("period_number", 1, True), ("v_max", 1, False)],
)
def test_another_motion_is_marked_where_p_d_had_settled(swept, name, moved, marked, monkeypatch):
    data = swept.data.drop_vars("unconfirmed")
    data["P_d_settled"][:] = [1, 0, 1]
    data["P_d_ci"][:] = [1e-6, 1e-6, 1.0]  # the last one's interval holds what P_d is moved by
    runs = iter([data, data.assign({name: data[name] + moved})])
    settings = js.verbs.sweep_run.SweepSettings
    monkeypatch.setattr(confirm, "_finer_settings", lambda how: how)
    result = confirmed_run(lambda _: js.SweepResult(next(runs)), settings(None, None, 1e-3, None, confirm=True))
    assert result.unconfirmed.tolist() == [marked, False, marked and name != "P_d"]


def test_an_interruption_of_the_second_run_keeps_the_first(swept):
    def run(how):
        if how.plan.steps_per_period == 200:
            raise Interrupted(None)
        return js.SweepResult(swept.data.drop_vars("unconfirmed"))

    plan = js.batch.plan.Plan(2, 4, 100, 0.0, js.march.method.Choices())
    march = js.verbs.arguments.MarchPlan(100, plan.method)
    with pytest.raises(Interrupted) as stopped:
        confirmed_run(run, js.verbs.sweep_run.SweepSettings(plan, march, 1e-3, None, confirm=True))
    assert stopped.value.done.unconfirmed is None


@pytest.mark.parametrize("setting", [by_series(14, 1e-8), Setting("dopri8", "cubic", "float64", 0.25)])
def test_what_confirms_a_sweep_is_finer_as_what_tries_a_method(setting):
    # One rule: half the step, a tenth of the tolerance, and a quarter of the share within which faces become flat.
    plan = js.batch.plan.Plan(2, 4, 100, 0.0, setting.method)
    march = js.verbs.arguments.MarchPlan(100, plan.method)
    finer = confirm._finer_settings(js.verbs.sweep_run.SweepSettings(plan, march, 1e-3, None, confirm=True)).plan
    assert finer.steps_per_period == 200
    assert finer.method == setting.finer(1).method
    assert finer.method.flat_return == setting.flat_return / 4


def test_lanes_that_follow_others_are_not_confirmed(scene):
    with pytest.raises(ValueError, match="`confirm` is of independent lanes"):
        js.sweep(scene, ALONG, confirm=True, direction="forward", **SMALL)


@pytest.mark.full
def test_exponents_are_of_the_march_itself(scene, swept):
    done = []
    with_exponents = js.sweep(scene, ALONG, confirm=True, lyapunov=True, progress=lambda *at: done.append(at), **SMALL)
    assert np.isfinite(with_exponents.lyapunov).all()
    np.testing.assert_array_equal(with_exponents.unconfirmed, swept.unconfirmed)
    assert done[-1][0] == done[-1][1]  # nothing is projected that is not run


@pytest.mark.full
def test_an_attractor_that_hangs_on_the_tolerance_is_marked():
    scene, kept = js.load("table1", ["drive.M_0=0.1"]).scene, {"n_periods": 48, "transient": 48, "confirm": True}
    value = {"contact.gamma": [4.71875, 0.5]}
    marked = set()
    for tolerance in (8e-9, 4e-9, 2e-9, 1e-9, 5e-10, 1e-10):
        method = js.Taylor(order=14, tolerance=tolerance, steps=200)
        finer = js.Taylor(order=14, tolerance=tolerance / 10, steps=400, flat_return=method.flat_return / 4)
        found, again = (js.sweep(scene, value, method=one, **kept) for one in (method, finer))
        # Which of two orbits a march reaches hangs on its tolerance, and on the rounding of the machine.
        for P_d in (found.P_d[0], again.P_d[0]):
            assert min(abs(P_d - orbit) for orbit in (49.927018, 49.805682)) < 1e-5
        assert found.settled[0]
        elsewhere = bool(abs(found.P_d[0] - again.P_d[0]) > 0.1)
        assert found.unconfirmed.tolist() == [elsewhere, False]
        marked.add(elsewhere)
    assert marked == {True, False}
