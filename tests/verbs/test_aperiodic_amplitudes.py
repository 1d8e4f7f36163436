"""What is told of amplitudes where motions are aperiodic: intervals, the periods a peak is of, and how many to keep."""

import numpy as np
import pytest
from command_line import read_json, run, sets

import jaxshroud as js
from jaxshroud.batch.threads import Interrupted
from jaxshroud.signals.period import UNKNOWN_IF_SETTLED

SETS = ['parts.motion=["x"]', "blades.c_x=4"]
SCENE = js.load("table1", SETS)
GAMMA = {"contact.gamma": [2.0, 4.0, 5.5]}  # period 1, period 2, aperiodic
HOW = {"n_periods": 32, "transient": 64, "method": js.RungeKutta("rk4", steps=200), "amplitudes": True}
MARCH = "--tableau rk4 --steps-per-period 200 --periods 32 --transient 64 --amplitudes"  # the same, of commands
TOO_FEW = "1 of 3 runs: too few periods to judge an aperiodic motion; keep at least 64 (--periods 64)"


@pytest.fixture(scope="module")
def swept():
    return js.sweep(SCENE, GAMMA, **HOW)


def test_root_mean_squares_have_intervals(swept, reopened):
    assert swept.period_number.tolist() == [1, 2, 0]
    assert swept.x_rms_ci.shape == swept.x_rms.shape
    assert np.all(swept.x_rms_ci[:2] < 1e-12 * swept.x_rms[:2])
    longer = js.sweep(SCENE, GAMMA, **{**HOW, "n_periods": 2000, "transient": 200})
    apart = np.abs(swept.x_rms[2] - longer.x_rms[2])
    assert np.all(apart <= swept.x_rms_ci[2] + longer.x_rms_ci[2])
    assert np.all(longer.x_rms_ci[2] < swept.x_rms_ci[2] / 3)
    np.testing.assert_array_equal(reopened(swept).x_rms_ci, swept.x_rms_ci)
    assert swept.data["x_rms_ci"].attrs["units"] == "m"
    assert js.sweep(SCENE, GAMMA, **{**HOW, "amplitudes": False}).x_rms_ci is None


@pytest.mark.full
def test_stores_and_maps_have_the_same_intervals(swept, tmp_path):
    stored = js.sweep(SCENE, GAMMA, store=tmp_path / "a.zarr", **HOW)
    in_map = js.sweep(SCENE, GAMMA, keep_samples=False, **HOW)
    table = js.table(SCENE, GAMMA, **{k: HOW[k] for k in HOW if k != "amplitudes"})
    for found in (stored, in_map, table):
        np.testing.assert_array_equal(found.x_rms_ci, swept.x_rms_ci)
        assert found.too_few_periods == TOO_FEW
    assert table.summary()["too few periods"] == TOO_FEW


@pytest.mark.full
def test_an_interrupted_sweep_has_no_interval_of_what_did_not_run():
    def stop(done, _):
        if done > HOW["transient"] + HOW["n_periods"]:  # of the first value
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        js.sweep(SCENE, GAMMA, direction="forward", progress=stop, **HOW)
    found = stopped.value.done
    ran = found.status == 0
    assert 0 < ran.sum() < 3
    assert np.isfinite(found.x_rms_ci[ran]).all()
    assert np.isnan(found.x_rms_ci[~ran]).all()


@pytest.mark.full
def test_the_summary_says_of_how_many_periods_a_peak_is_and_how_many_to_keep(swept, tmp_path, capsys):
    assert swept.settling[2] == UNKNOWN_IF_SETTLED
    assert swept.unjudged.tolist() == [False, False, True]
    told = swept.summary()
    assert told["amplitudes of aperiodic motions"] == "the largest of 32 periods"
    assert told["too few periods"] == TOO_FEW
    assert told["largest RMS of x"] == f"{1e3 * swept.x_rms.max():.6g} mm"
    periodic = js.sweep(SCENE, {"contact.gamma": [2.0, 3.0]}, **HOW).summary()
    assert not {"amplitudes of aperiodic motions", "too few periods"} & set(periodic)
    enough = js.sweep(SCENE, GAMMA, **{**HOW, "n_periods": 64})
    assert enough.too_few_periods == ""
    run(f"sweep table1 {sets(*SETS)} --along contact.gamma --values 4,5.5 {MARCH} --out {tmp_path}/out")
    shown = " ".join(capsys.readouterr().out.split())
    told = read_json(tmp_path / "out" / "summary.json")
    assert told["too few periods"] == TOO_FEW.replace("3 runs", "2 runs")
    for text in ("too few periods to judge an aperiodic motion", "the largest of 32 periods", told["largest RMS of x"]):
        assert text in shown


@pytest.mark.full
def test_power_tells_the_interval_of_an_aperiodic_motion(tmp_path, capsys):
    run(f"power table1 {sets(*SETS, 'contact.gamma=5.5')} {MARCH} --out {tmp_path}/out")
    shown = " ".join(capsys.readouterr().out.split())
    found = js.open(tmp_path / "out" / "power.nc")
    assert np.all(found.x_rms_ci > 1e-3 * found.x_rms)
    assert "largest RMS of x" in shown
    assert "the largest of 32 periods" in shown
