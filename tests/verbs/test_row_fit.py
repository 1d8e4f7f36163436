"""Numbers of rows of blades from measurements of some of them, by twins that another method marches."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.io.convert import convert
from jaxshroud.io.measurements import read_measurements

pytestmark = pytest.mark.full

METHOD = js.RungeKutta("dopri8", steps=60)
TWIN = js.RungeKutta("rk4", steps=800)
RING = ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1", "row.mistuning=[0.02, -0.03, 0.01]"]
SCENE = js.load("row_ring12", RING).scene
TRUE = {"contact.gamma": 3.0, "row.mistuning[1]": -0.02}
OVER = {"contact.gamma": (1.0, 6.0), "row.mistuning[1]": (-0.05, 0.05)}
NOISE = 1e-8


def with_noise(values):
    return values + NOISE * np.random.default_rng(1).standard_normal(values.shape)


def twin_history():
    run = js.simulate(SCENE.replace(TRUE), n_periods=2, every=100, method=TWIN)
    return run.t[1:], run.motion.x[1:]


def assert_found(found, data):
    for i, (key, true) in enumerate(TRUE.items()):
        assert found.low[i] < true < found.high[i], key
        assert found.high[i] - found.low[i] < 0.02 * (OVER[key][1] - OVER[key][0])
    assert found.chi2 < 2 * data


def test_a_history_of_two_blades_gives_numbers_of_the_ring():
    t, x = twin_history()
    signals = {"x_1 [m]": with_noise(x[:, 0]), "x_3 [m]": with_noise(x[:, 2])}
    noise = {f"x_{i}_sigma [m]": np.full(t.shape, NOISE) for i in (1, 3)}
    found = js.fit(SCENE, {"t [s]": t, **signals, **noise}, OVER, scan=8, starts=1, method=METHOD)
    assert_found(found, 2 * t.size)
    # Control: the columns of two other blades give no fit.
    wrong = {"t [s]": t, "x_2 [m]": signals["x_1 [m]"], "x_1 [m]": signals["x_3 [m]"]}
    wrong |= {"x_2_sigma [m]": noise["x_1_sigma [m]"], "x_1_sigma [m]": noise["x_3_sigma [m]"]}
    assert js.fit(SCENE, wrong, OVER, scan=1, starts=1, method=METHOD).chi2 > 1e3 * found.chi2


@pytest.mark.release
def test_a_response_of_one_blade_gives_numbers_of_the_ring():
    omega = np.array([500.0, 540.0, 580.0])
    twin = js.sweep(
        SCENE.replace(TRUE), {"drive.omega": omega}, n_periods=8, transient=200, amplitudes=True, method=TWIN
    )
    assert np.all(twin.period_number > 0)
    table = {"omega [rad/s]": omega, "x_rms_2 [m]": with_noise(twin.x_rms[:, 1])}
    table["x_rms_2_sigma [m]"] = np.full(omega.shape, NOISE)
    found = js.fit(SCENE, table, OVER, scan=2, starts=1, method=METHOD)
    assert_found(found, omega.size)


def test_a_run_of_a_row_that_convert_has_written_is_read(tmp_path):
    run = js.simulate(SCENE, n_periods=1, every=30, method=METHOD)
    convert(run.data, tmp_path / "run.csv")
    data = read_measurements(tmp_path / "run.csv")
    assert data.names == ("x_1", "x_2", "x_3")
    np.testing.assert_allclose(data.values, run.motion.x, rtol=1e-12)


@pytest.mark.parametrize(
    ("column", "told"),
    [
        ("x_4 [m]", "x_4 is measured, but the scene has 3 blades"),
        ("x_left [m]", "x_left: the blades of a row have numbers, from 1; write x_1, x_2"),
        ("y_2 [m]", "does not move"),
        ("x_0 [m]", "unknown"),
    ],
)
def test_columns_that_no_blade_of_the_row_has(column, told):
    with pytest.raises(js.InputError, match=told):
        js.fit(SCENE, {"t [s]": [0.0, 1e-3, 2e-3], column: [0.0, 1e-6, 2e-6]}, {"contact.gamma": (1, 2)}, method=METHOD)


def test_one_blade_has_one_column():
    table = {"t [s]": [0.0, 1e-3], "x_left [m]": [0.0, 1e-6], "x_1 [m]": [0.0, 1e-6]}
    with pytest.raises(js.InputError, match="x_1 is x_left by another name"):
        js.fit(js.load("table1").scene, table, {"contact.gamma": (1, 2)})
