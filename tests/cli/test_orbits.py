"""The commands `orbit` and `lyapunov`: what they write is what the verbs return."""

import numpy as np
import pytest
from command_line import read_json, run, sets

import jaxshroud as js
from jaxshroud.scene.config import load
from jaxshroud.signals.effects import with_interval

pytestmark = pytest.mark.full

CHANGES = ['parts.motion=["x"]', "blades.c_x=40", "drive.M_0=0"]  # settles on an orbit within a few periods
SCENE = f"table1 {sets(*CHANGES)} --steps-per-period 100"
METHOD = js.RungeKutta(steps=100, locate="cubic")


@pytest.fixture(scope="module")
def scene():
    return load("table1", CHANGES).scene


def test_an_orbit_is_written_as_the_verb_returns_it(scene, tmp_path, capsys):
    run(f"orbit {SCENE} --most-periods 128 --out {tmp_path}/out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["orbit.nc", "summary.json"]
    stored, orbit = js.Orbit.load(tmp_path / "out" / "orbit.nc"), js.orbit(scene, method=METHOD)
    np.testing.assert_array_equal(stored.multipliers, orbit.multipliers)  # the same program with the same numbers
    np.testing.assert_array_equal(stored.start.motion, orbit.start.motion)
    summary = read_json(tmp_path / "out" / "summary.json")
    assert summary["period_number"] == 1
    assert summary["P_d"] == orbit.P_d
    assert summary["flags"] == []
    assert summary["multipliers"][0] == [orbit.multipliers[0].real, orbit.multipliers[0].imag]
    assert summary["source"] == "table1.toml"
    table = capsys.readouterr().out
    for part in ("period 1, stable", "flags", "multipliers", f"{orbit.P_d:.6g} %", "orbit.nc, summary.json"):
        assert part in table


def test_an_orbit_of_blades_that_stick_at_rest_is_stable(tmp_path, capsys):
    """The multiplier of their slider, which stays wherever it starts, is 1."""
    at_rest = sets("drive.F_0=0", "shroud.gap=-0.02 mm")
    run(f"orbit {SCENE} {at_rest} --most-periods 256 --out {tmp_path}/out")
    summary = read_json(tmp_path / "out" / "summary.json")
    assert summary["flags"] == ["not unique"]
    assert np.hypot(*summary["multipliers"][0]) >= 1
    assert "period 1, stable" in capsys.readouterr().out


def test_exponents_are_written_as_the_verb_returns_them(scene, tmp_path, capsys):
    run(f"lyapunov {SCENE} --periods 8 --transient 4 --out {tmp_path}/out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["lyapunov.nc", "summary.json"]
    stored = js.Lyapunov.load(tmp_path / "out" / "lyapunov.nc")
    found = js.lyapunov(scene, n_periods=8, transient=4, method=METHOD)
    np.testing.assert_array_equal(stored.exponents, found.exponents)
    summary = read_json(tmp_path / "out" / "summary.json")
    known = np.isfinite(found.exponents)
    assert np.array(summary["exponents"], float)[known].tolist() == found.exponents[known].tolist()
    assert len(summary["ci"]) == len(summary["exponents"]) == 5  # x and its rate of both blades, and the slider
    assert summary["exponents"][-1] == "-inf"  # the slider, which every onset sets anew
    assert summary["ci"][-1] is None
    assert summary["unit"] == "per drive period"
    printed = capsys.readouterr().out
    assert with_interval(found.exponents[0], found.ci[0]) in printed
    assert "-inf" in printed
    assert "per drive period" in printed


@pytest.mark.release
def test_options_reach_the_verb(tmp_path, capsys):
    run(f"orbit {SCENE} --tolerance 1e-3 --out {tmp_path}/loose")
    run(f"orbit {SCENE} --out {tmp_path}/close")
    loose, close = (read_json(tmp_path / name / "summary.json") for name in ("loose", "close"))
    assert loose["updates"] < close["updates"]
    assert loose["residual"] > close["residual"]


@pytest.mark.parametrize("verb", ["orbit", "lyapunov"])
def test_a_scene_that_stops_is_a_warning(verb, tmp_path, capsys):
    # Two blocks turned beyond their angle range within the first period.
    run(f"{verb} fig10b --set drive.M_0=3000 --steps-per-period 200 --out {tmp_path}/out")
    printed = capsys.readouterr()
    assert "warning: 1 of 1 runs stopped with ANGLE_OUT_OF_RANGE" in printed.err
    assert "ANGLE_OUT_OF_RANGE: 1" in printed.out
