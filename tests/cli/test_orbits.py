"""The commands `orbit` and `lyapunov`: what they write is what the verbs return."""

import json

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli import commands as cli
from jaxshroud.scene.config import load
from jaxshroud.signals.effects import with_interval

CHANGES = ['parts.motion=["x"]', "blades.c_x=40", "drive.M_0=0"]  # settles on an orbit within a few periods
SCENE = ["table1", *(word for change in CHANGES for word in ("--set", change)), "--steps-per-period", "100"]
METHOD = js.RungeKutta(steps=100, locate="cubic")


@pytest.fixture(scope="module")
def scene():
    return load("table1", CHANGES).scene


@pytest.mark.full
def test_an_orbit_is_written_as_the_verb_returns_it(scene, tmp_path, capsys):
    assert cli.main(["orbit", *SCENE, "--most-periods", "128", "--out", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["orbit.nc", "summary.json"]
    stored, orbit = js.Orbit.load(tmp_path / "out" / "orbit.nc"), js.orbit(scene, method=METHOD)
    np.testing.assert_array_equal(stored.multipliers, orbit.multipliers)  # the same program with the same numbers
    np.testing.assert_array_equal(stored.start.motion, orbit.start.motion)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["period_number"] == 1
    assert summary["P_d"] == orbit.P_d
    assert summary["flags"] == []
    assert summary["multipliers"][0] == [orbit.multipliers[0].real, orbit.multipliers[0].imag]
    assert summary["source"] == "table1.toml"
    table = capsys.readouterr().out
    for part in ("period 1, stable", "flags", "multipliers", f"{orbit.P_d:.6g} %", "orbit.nc, summary.json"):
        assert part in table


@pytest.mark.full
def test_an_orbit_of_blades_that_stick_at_rest_is_stable(tmp_path, capsys):
    """The multiplier of their slider, which stays wherever it starts, is 1."""
    at_rest = "--set", "drive.F_0=0", "--set", "shroud.gap=-0.02 mm"
    assert cli.main(["orbit", *SCENE, *at_rest, "--most-periods", "256", "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["flags"] == ["not unique"]
    assert np.hypot(*summary["multipliers"][0]) >= 1
    assert "period 1, stable" in capsys.readouterr().out


@pytest.mark.full
def test_exponents_are_written_as_the_verb_returns_them(scene, tmp_path, capsys):
    words = ["lyapunov", *SCENE, "--periods", "8", "--transient", "4", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["lyapunov.nc", "summary.json"]
    stored = js.Lyapunov.load(tmp_path / "out" / "lyapunov.nc")
    found = js.lyapunov(scene, n_periods=8, transient=4, method=METHOD)
    np.testing.assert_array_equal(stored.exponents, found.exponents)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
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
@pytest.mark.full
def test_options_reach_the_verb(tmp_path, capsys):
    assert cli.main(["orbit", *SCENE, "--tolerance", "1e-3", "--out", str(tmp_path / "loose")]) == 0
    assert cli.main(["orbit", *SCENE, "--out", str(tmp_path / "close")]) == 0
    loose, close = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("loose", "close"))
    assert loose["updates"] < close["updates"]
    assert loose["residual"] > close["residual"]


@pytest.mark.full
@pytest.mark.parametrize("verb", ["orbit", "lyapunov"])
def test_a_scene_that_stops_is_a_warning(verb, tmp_path, capsys):
    # Two blocks turned beyond their angle range within the first period.
    scene = ["fig10b", "--set", "drive.M_0=3000", "--steps-per-period", "200"]
    assert cli.main([verb, *scene, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert "warning: 1 of 1 runs stopped with ANGLE_OUT_OF_RANGE" in printed.err
    assert "ANGLE_OUT_OF_RANGE: 1" in printed.out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["orbit", "--tolerance", "0"], "must be a number above zero"),
        (["orbit", "--most-periods", "3"], "at least 64"),
        (["orbit", "--accuracy", "fast", "--locate", "cubic"], "--accuracy chooses --locate itself"),
        (["lyapunov", "--periods", "0"], "at least 1"),
        (["lyapunov", "--transient=-1"], "at least 0"),
        (["lyapunov", "--set", "shroud.gp=1"], "`gap`"),
    ],
)
def test_wrong_input_is_one_line(words, expected, tmp_path, capsys):
    verb, *rest = words
    assert cli.main([verb, "table1", *rest, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert expected in error
    assert "\n" not in error


@pytest.mark.parametrize("verb", ["orbit", "lyapunov"])
def test_results_are_kept_unless_forced(verb, tmp_path, capsys):
    (tmp_path / "summary.json").touch()
    assert cli.main([verb, *SCENE, "--out", str(tmp_path)]) == 2
    assert "summary.json: exists and is kept; give --force" in capsys.readouterr().err
