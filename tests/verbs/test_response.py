"""Frequency responses: peaks against closed forms and fine sweeps, half-power widths, and what is refused."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli.orbits import _jump_rows, _place_text
from jaxshroud.scene.checks import InputError

ONE = ['parts.motion=["x"]', 'parts.neighbour="rigid"', "drive.M_0=0"]
SERIES = js.Taylor(order=10, tolerance=1e-10, steps=200)
SHORT = {"n_periods": 8, "transient": 40, "method": SERIES}


@pytest.fixture(scope="module")
def touching():
    """A blade against a rigid neighbour, heavily damped: one smooth peak that contact has shifted."""
    sets = [*ONE, "blades.c_x=25", "contact.gamma=0.5", "friction.mu=0.3", "shroud.gap=-0.2mm"]
    scene = js.load("table1", sets).scene
    return scene, js.response(scene, "drive.omega", 900.0, 2200.0, num=12, **SHORT)


@pytest.fixture(scope="module")
def apart():
    """A blade that a gap of 1 m keeps apart."""
    scene = js.load("table1", [*ONE, "blades.c_x=7", "shroud.gap=1m"]).scene
    return scene, js.response(scene, "drive.omega", 900.0, 1400.0, num=3, n_periods=2, transient=60, method=SERIES)


@pytest.mark.release
@pytest.mark.full
def test_a_peak_without_contact_has_the_place_and_the_width_of_the_closed_form(apart):
    scene, found = apart
    ((peak,), free) = found.peaks, float(found.free_amplitude[0])
    k, m, c = (float(np.ravel(a)[0]) for a in (scene.blades.k_x, scene.blades.m, scene.blades.c_x))
    zeta, omega = c / (2 * np.sqrt(k * m)), np.sqrt(k / m)
    assert peak["value"] == pytest.approx(omega * np.sqrt(1 - 2 * zeta**2), rel=1e-5)  # flat at its top
    assert peak["amplitude"] == pytest.approx(free, rel=1e-9)
    roots = np.sqrt(1 - 2 * zeta**2 + np.array([-1, 1]) * 2 * zeta * np.sqrt(1 - zeta**2))  # of amplitude peak / sqrt 2
    assert (peak["low"], peak["high"]) == pytest.approx(omega * roots, rel=1e-7)
    assert peak["ratio"] == pytest.approx(1, rel=1e-9)
    assert peak["zeta"] == pytest.approx(zeta, rel=zeta)  # the half-power rule itself is of first order
    # Control: the width at half of the amplitude, not of the power, would be sqrt(3) times as large.
    assert abs(peak["zeta"] * np.sqrt(3) / zeta - 1) > 0.5


@pytest.mark.full
def test_a_peak_is_that_of_a_fine_sweep(touching):
    scene, found = touching
    tallest = max(found.peaks, key=lambda peak: peak["amplitude"])
    near = np.linspace(tallest["value"] * 0.99, tallest["value"] * 1.01, 41)
    fine = js.sweep(scene, {"drive.omega": near}, amplitudes=True, keep_samples=False, **SHORT | {"transient": 100})
    levels = fine.x_peak[:, 0]
    assert tallest["amplitude"] == pytest.approx(levels.max(), rel=1e-4)
    assert abs(tallest["value"] - near[levels.argmax()]) <= near[1] - near[0]
    # Control: the largest lane of the coarse sweep misses it.
    coarse = np.nanmax(found.sweep().x_peak[..., 0])
    assert coarse < tallest["amplitude"] * (1 - 1e-3)


@pytest.mark.full
def test_the_largest_amplitude_is_that_of_a_stable_peak_between_the_values(touching):
    _, found = touching
    tallest, largest = max(found.peaks, key=lambda peak: peak["amplitude"]), found.largest()
    assert tallest["stable"]
    assert (largest.value, largest.place) == (tallest["amplitude"], {"drive.omega": tallest["value"]})
    assert largest.blades == ("left",)
    assert (largest.free, largest.free_place) == (found.free_amplitude[0], {"drive.omega": found.free_value[0]})
    (told,) = found.summary()["largest and smallest"]
    assert [*told] == ["largest amplitude of x", f"smallest {found.reduction}"]
    # Control: of a peak that is not stable, where no motion stays, the largest lane counts.
    unstable = js.results.response.Response(found.data.assign(peak_stable=0 * found.data["peak_stable"]))
    assert unstable.largest().value == np.nanmax(found.sweep().x_peak[..., 0]) < largest.value


@pytest.mark.full
def test_a_peak_without_contact_that_is_out_of_view_is_told_in_the_picture(touching):
    _, found = touching
    words = [text.get_text() for text in found.plot().axes[0].texts]
    assert words == []  # it is in view
    beyond = {name: 50 * found.data[name] for name in ("x_free", "free_amplitude")}
    amplitude = type(found)(found.data.assign(beyond)).plot().axes[0]
    (told,) = [text.get_text() for text in amplitude.texts if text.get_text()]
    assert told == f"{50e3 * found.free_amplitude[0]:.3g} mm\nat {found.free_value[0]:.4g} rad/s"


@pytest.mark.full
def test_a_response_is_stored_and_drawn_again(touching, reopened):
    _, found = touching
    again = reopened(found)
    assert again.peaks == found.peaks
    assert again.summary() == found.summary()
    assert again.branch().special == found.branch().special
    np.testing.assert_array_equal(again.sweep().x_peak, found.sweep().x_peak)
    assert len(again.plot().axes) == 2


@pytest.mark.release
@pytest.mark.full
def test_a_family_has_a_branch_and_a_peak_for_each_member():
    scene = js.load("table1", [*ONE, "blades.c_x=7", "shroud.gap=1m"]).scene
    short = {"num": 3, "n_periods": 2, "transient": 60, "method": SERIES}
    found = js.response(scene, "drive.omega", 900.0, 1400.0, over={"blades.c_x": [7.0, 14.0]}, **short)
    assert [peak["member"] for peak in found.peaks] == [0, 1]
    assert found.peaks[0]["amplitude"] == pytest.approx(2 * found.peaks[1]["amplitude"], rel=0.02)
    assert {found.branch(i).value[0] for i in (0, 1)} == {900.0}


@pytest.mark.full
def test_jumps_are_told_by_direction_in_the_unit_of_the_picture(apart):
    _, found = apart
    assert found.jumps == [{}]
    marks = found.sweep().data["jump"].copy(deep=True)
    marks.loc[{"direction": "forward"}] = [0, 1, 0]
    told = js.Response(found.data.assign(jump=marks.expand_dims("member")))
    assert told.jumps == told.summary()["jumps"] == [{"forward": [found.values[1]]}]
    assert _jump_rows(told) == {"jumps forward": "1150 rad/s"}
    assert _place_text(js.Response(told.data.assign_attrs(along="drive.speed")), 100.0) == "954.93 rpm"


def test_wrong_responses_are_refused_in_one_line():
    scene = js.load("table1", ONE).scene
    for arguments, words in (
        ({"start": 2.0, "stop": 2.0}, "range"),
        ({"start": 1.0, "stop": 2.0, "of": "x"}, "of"),
        ({"start": 1.0, "stop": 2.0, "over": {"drive.omega": [1.0]}}, "another one"),
        ({"start": 1.0, "stop": 2.0, "num": 1}, "num"),
    ):
        with pytest.raises((InputError, ValueError), match=words):
            js.response(scene, "drive.omega", **arguments)


LIGHT = [*ONE, "blades.c_x=2", "shroud.gap=1m"]
COARSE = {"num": 3, "n_periods": 2, "transient": 150, "method": js.RungeKutta("rk4", steps=60)}


@pytest.mark.release
@pytest.mark.full
def test_a_branch_goes_on_to_the_ends_of_its_range():
    # A lightly damped peak is long in units of the motion where the branch begins: longer than 400 points, at which it
    # used to end below its top. The height is the closed form's; those steps err by less than 1e-3.
    scene = js.load("table1", LIGHT).scene
    found = js.response(scene, "drive.omega", 900.0, 1300.0, at=900.0, **COARSE)
    assert found.branch().ends == [("start", "stop")]
    assert found.messages == []
    assert len(found.branch().value) > 400
    (peak,) = found.peaks
    assert peak["amplitude"] == pytest.approx(float(found.free_amplitude[0]), rel=1e-3)
    assert np.isfinite(peak["zeta"])
    assert peak["reason"] == ""


@pytest.mark.full
def test_a_branch_that_may_have_more_points_says_so():
    # Whoever asks for few points is told where they ended, and how to go on: of a response as of a branch.
    scene = js.load("table1", LIGHT).scene
    found = js.response(scene, "drive.omega", 900.0, 1300.0, at=900.0, most_points=5, **COARSE)
    assert found.branch().ends == [("start", "most points")]
    (line,) = found.messages
    assert f"{found.branch().value[-1]:.6g}" in line
    assert "as many points as `most_points` allows" in line
    with pytest.raises(InputError, match="most_points"):
        js.response(scene, "drive.omega", 900.0, 1300.0, most_points=1)
