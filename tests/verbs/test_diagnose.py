"""The page of a scene: verdict, numbers, panels of what the model has, and scenes that stop."""

import json

import numpy as np
import pytest
from command_line import read_json, run, sets

import jaxshroud as js
from jaxshroud.plotting.page import Page
from jaxshroud.plotting.plot_diagnosis import DIAGNOSIS_PANELS

# Bending along x alone, damped so that it settles soon.
SMALL = ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]
HOW = {"method": js.RungeKutta(steps=100), "transient": 16}
COARSE = HOW | {"method": js.RungeKutta(steps=100, precision="float32")}  # in which squares overflow


@pytest.fixture(scope="module")
def found():
    return js.diagnose(js.load("table1", SMALL), **HOW)


def panels(figure):
    """Titles of the axes that a page has."""
    return [ax.get_title() or ax.get_title(loc="left") for ax in figure.axes]


@pytest.mark.full
def test_verdict_and_numbers_are_those_of_the_other_verbs(found):
    scene = js.load("table1", SMALL).scene
    orbit = js.orbit(scene, method=js.RungeKutta(steps=100))
    assert found.verdict == "period 1" == f"period {orbit.q}"
    assert found.period_number == 1
    np.testing.assert_allclose(found.P_d[-1], orbit.P_d, atol=1e-8)  # of a run that is at rest on its orbit
    np.testing.assert_allclose(np.abs(found.multipliers[:2]), np.abs(orbit.multipliers[:2]), rtol=1e-6)
    # Another stretch, one tangent: an estimate of the same growth.
    assert abs(found.largest_exponent - np.log(abs(orbit.multipliers[0]))) <= found.largest_exponent_ci + 1e-3


@pytest.mark.full
def test_the_energy_goes_where_it_is_said_to_go(found):
    power = found.powers
    assert power["drive"] > 0
    # On an orbit nothing is stored: the balance is the residual's, RK4 at 100 steps.
    np.testing.assert_allclose(power["viscous"] + power["friction"], power["drive"], rtol=1e-3)
    assert found.time_apart + found.time_stick + found.time_slip == pytest.approx(1)
    assert found.largest_force == pytest.approx(np.hypot(found.N, found.F).max())


def test_a_page_has_panels_of_what_the_model_has(found):
    titles = panels(found.plot())
    assert {"time history", "friction loop", "Floquet multipliers", "summary"} <= set(titles)
    assert "where contact acts" not in titles  # blocks that do not turn


def test_a_panel_of_the_page_is_drawn_alone(found):
    assert panels(found.plot(panel="summary")) == ["summary"]


@pytest.mark.full
def test_a_page_without_contact():
    free = js.diagnose(js.load("table1", [*SMALL, 'parts.contact="none"']), transient=16)
    assert free.verdict == "period 1"
    titles = panels(free.plot())
    assert "friction loop" not in titles
    assert "time history" in titles


def test_a_diagnosis_opens_again(found, reopened):
    again = reopened(found)
    assert isinstance(again, js.Diagnosis)
    assert json.dumps(again.summary()) == json.dumps(found.summary())
    assert repr(again) == f"Diagnosis: {found.evidence}"


@pytest.mark.full
def test_a_scene_that_stops_says_so(tmp_path):
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        stopped = js.diagnose(js.load("table1", [*SMALL, "initial.x=[1e30, 0.0]"]), **COARSE)
    assert stopped.verdict == "stopped"
    assert stopped.multipliers is None
    assert "NOT_FINITE" in stopped.evidence
    assert "summary" in panels(stopped.plot())
    with pytest.raises(js.InputError, match="takes one scene"):
        js.diagnose(js.stack_scenes([js.load("table1", SMALL).scene] * 2))


@pytest.mark.full
def test_the_command_writes_page_and_numbers(tmp_path, capsys):
    out = tmp_path / "out"
    run(f"diagnose table1 {sets(*SMALL)} --steps-per-period 100 --transient 16 --out {out}")
    assert {p.name for p in out.iterdir()} == {f"diagnosis.{end}" for end in ("nc", "json", "png", "pdf")}
    assert read_json(out / "diagnosis.json")["verdict"] == "period 1"
    assert "period 1" in capsys.readouterr().out


def test_panels_fill_rows_of_three():
    names = ["history", "phase", "poincare", "ribbon", "loop", "summary"]
    panels = [panel for panel in DIAGNOSIS_PANELS if panel.name in names]
    rows = Page(None, panels, "", (1.0, 1.0), columns=3).rows
    assert rows == [["history"] * 3, ["phase", "poincare", ""], ["ribbon", "ribbon", "loop"], ["summary", "", ""]]
