"""The kind of motion of rows: waves, chains, and nearby runs."""

import numpy as np
import pytest
from command_line import run, sets

import jaxshroud as js

pytestmark = pytest.mark.full

RING = ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1"]
HOW = {"transient": 64, "method": js.RungeKutta("rk4", steps=100)}


@pytest.fixture(scope="module")
def wave():
    return js.diagnose(js.load("row_ring12", [*RING, "blades.c_x=40"]).scene, **HOW)


def test_a_tuned_ring_that_follows_its_drive_is_a_wave(wave, reopened):
    assert wave.verdict == "travelling wave of period 1"
    assert wave.period_number == 1
    assert wave.largest_exponent + wave.largest_exponent_ci < 0
    assert float(wave.wave_distance) < 1e-9
    np.testing.assert_allclose(wave.P, wave.P[0], rtol=1e-5)  # what is left of the transient
    np.testing.assert_allclose(wave.P_d[-1], 100 * (1 - wave.P.sum() / wave.P_0.sum()), rtol=1e-9)
    again = reopened(wave)
    assert (again.verdict, again.summary()) == (wave.verdict, wave.summary())


def test_a_wave_whose_shift_is_broken_is_told_from_one():
    # Table 1 in a ring of four under engine order 2 at 1300 rad/s: every harmonic has one nodal diameter alone, but not
    # the drive's, and the blades' means alternate.
    words = ['parts.motion=["x"]', "row.blades=4", "drive.engine_order=2", "drive.omega=1300"]
    found = js.diagnose(js.load("row_ring12", words).scene, transient=192, method=HOW["method"])
    means = found.motion.x[:-1].mean(axis=0)
    assert np.ptp(means) > 1e-6
    assert found.wave_distance > 1e-3
    assert "travelling wave" not in found.verdict
    assert found.summary()["wave"] == found.wave.words


def test_a_distance_that_rounding_hides_has_no_growth():
    # Critically damped blades, which never touch, forget by exp(-23) a period: 1e-7 of their size to below 1e-16.
    heavy = ["shroud.gap=1m", "blades.c_x=178", "drive.omega=300"]
    found = js.diagnose(js.load("row_ring12", [*RING, *heavy]).scene, **HOW)
    assert np.isnan(found.largest_exponent)
    assert "lost in rounding" in found.evidence


@pytest.mark.release
def test_a_row_that_mistuning_breaks_is_no_wave(tmp_path, capsys):
    changes = sets(*RING, "blades.c_x=40", "row.mistuning=[0.05, 0, -0.02]")
    run(f"diagnose row_ring12 {changes} --tableau rk4 --steps-per-period 100 --out {tmp_path}/out")
    assert "period 1" in (told := capsys.readouterr().out)
    assert "travelling wave of period 1" not in told
    assert (tmp_path / "out" / "diagnosis.png").stat().st_size > 10_000


def test_the_exponent_of_a_chain_of_two_is_that_of_the_pair():
    pair = ['parts.motion=["x"]', 'blades.I="block"', "contact.gamma=2.6", "drive.F_0=60", "drive.M_0=0.3"]
    chain = ['parts.motion=["x"]', "row.blades=2", "row.closed=false", "drive.engine_order=1"]
    exact = js.lyapunov(js.load("table1", pair).scene, n_periods=64, transient=128, method=HOW["method"])
    found = js.diagnose(js.load("row_ring12", chain).scene, **HOW)
    assert found.largest_exponent == pytest.approx(float(exact.exponents[0]), rel=1e-2)
