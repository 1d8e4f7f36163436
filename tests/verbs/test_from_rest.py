"""Scenes that begin where slowly applied loads leave blades that rub, by the verbs."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.model.modes import Mode, Status
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import parse

STUCK = ["shroud.gap=-0.4 mm", 'parts.motion=["x","y"]', "drive.F_0=2", "drive.M_0=0", "friction.mu=0.9"]
LOADS = ["drive.F_x_mean=[5,-5]", "drive.F_y_mean=[20,-30]"]
FROM_REST = ["initial.start=static", "initial.friction=from rest"]
LOST = ["shroud.gap=-0.4 mm", "drive.M_mean=[3,-1]"]  # corners that meet at one height, where the face's angle jumps
SHORT = {"n_periods": 2, "transient": 0}
MARCH = js.RungeKutta("dopri8", steps=300)


def scene_with(*settings):
    return js.load("table1", [*STUCK, *LOADS, *FROM_REST, *settings]).scene


def test_files_keep_the_friction_of_the_start():
    text = js.load("table1", [*STUCK, *LOADS, *FROM_REST]).text()
    assert parse(text, "a file").scene.start == "from rest"
    lines = [line for line in text.splitlines() if not line.startswith("start = ")]
    assert len(lines) < len(text.splitlines())
    assert parse("\n".join(lines), "without its start").scene.start == "from rest"


@pytest.mark.full
def test_verbs_begin_there():
    scene = scene_with()
    begin = js.simulate(scene, n_periods=1, method=MARCH)
    without = js.simulate(js.load("table1", [*STUCK, *LOADS, FROM_REST[0]]).scene, n_periods=1, method=MARCH)
    assert np.abs(begin.motion.x[0] - without.motion.x[0]).max() > 1e-3 * np.abs(begin.motion.x[0]).max()
    assert begin.mode[0] == Mode.STICK
    power = js.power(scene, **SHORT, method=MARCH)
    assert power.final["status"] == Status.OK
    swept = js.sweep(scene, {"friction.mu": [0.0, 0.2, 0.9]}, **SHORT, method=MARCH)
    assert (np.asarray(swept.data["status"]) == Status.OK).all()
    assert js.orbit(js.vary(scene, "blades.c_x", 40.0), method=MARCH).cycle().q == 1


def numbers(result):
    names = ("final_P", "x_mean", "x_rms", "x_peak", "y_peak", "N_max", "N_mean", "F_max")
    return np.concatenate([np.ravel(np.asarray(result.data[name], float)) for name in names])


@pytest.mark.full
def test_the_closed_form_holds_the_sliders_of_the_start():
    scene = scene_with("blades.c_x=40", "blades.c_y=200")
    wanted = {"amplitudes": True, "forces": True}
    marched = js.power(scene, n_periods=2, transient=50, method=MARCH, **wanted)
    found = js.power(scene, **SHORT, linear="stuck", **wanted)
    # The transient has faded by exp(-250 * 2 pi * 50 / 536); the march's step leaves some 1e-13.
    np.testing.assert_allclose(numbers(found), numbers(marched), rtol=1e-9, atol=1e-18)
    elsewhere = js.load("table1", [*STUCK, *LOADS, FROM_REST[0], "blades.c_x=40", "blades.c_y=200"]).scene
    other = js.power(elsewhere, **SHORT, linear="stuck", **wanted)
    assert not np.allclose(numbers(other), numbers(found), rtol=1e-3)  # the control: sliders set down without friction
    with pytest.raises(InputError, match="no derivatives"):
        js.gradient(scene, ["contact.gamma"], of="x_peak", linear="stuck")


@pytest.mark.full
def test_the_sheet_judges_the_motion_about_that_position():
    held = js.check(js.load("table1", [*STUCK, *LOADS, *FROM_REST])).settled
    without = js.check(js.load("table1", [*STUCK, *LOADS, FROM_REST[0]])).settled
    assert held.state == without.state == "stuck"
    assert held.slip < without.slip - 1.0  # the mean load takes a part of the limit [N]


@pytest.mark.full
def test_the_sheet_tells_what_slips_and_what_cannot_be_followed():
    slips = js.check(js.load("table1", [*STUCK, *FROM_REST, "drive.F_y_mean=[300,-500]", "friction.mu=0.3"])).settled
    assert slips.words.startswith("marched: ")
    lost = js.check(js.load("table1", [*LOST, *FROM_REST])).settled
    assert "cannot be followed" in lost.words


@pytest.mark.full
def test_a_lane_without_a_path_stops():
    with pytest.warns(js.LaneWarning, match="static start that was not found"):
        run = js.power(js.load("table1", [*LOST, *FROM_REST]).scene, **SHORT, method=MARCH)
    assert run.final["status"] == Status.NOT_FINITE


def test_other_contact_is_refused_by_name():
    refused = {"contact.reading=printed": "consistent reading", "initial.x=1e-5": "start in motion"}
    for setting, words in refused.items():
        with pytest.raises(ValueError, match=words) as error:
            js.load("table1", [*FROM_REST, setting])
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="static start"):
        js.vary(scene_with(), "initial.x", 1e-5)
