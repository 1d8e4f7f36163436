"""Orbits and derivatives of rows of blades against differences, and what they must satisfy."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.verbs.gradient import differences

METHOD = js.RungeKutta("dopri8", steps=100)
WRT = ("shroud.gap", "row.mistuning[1]", "drive.omega")
IN_X = ["row.blades=3", "drive.engine_order=1", 'parts.motion=["x"]']


def settled(*options):
    found = js.orbit(js.load("row_ring12", [*IN_X, *options]).scene, method=METHOD, most_periods=128)
    assert found.flags == ()
    return found


@pytest.fixture(scope="module")
def mistuned():
    return settled("row.mistuning=[0,0.04,-0.03]")


def error(found, of, value, step=3e-5):
    slopes = differences(found, WRT, step, of)
    return max(abs(slopes[key] / value[key] - 1) for key in WRT)


@pytest.mark.full
@pytest.mark.parametrize("of", ["P_d", "P_d_worst", "P", "x_rms"])
def test_derivatives_are_those_of_differences(mistuned, of):
    slope = js.gradient(mistuned.scene, WRT, of=of, orbit=mistuned)
    assert slope.kind == "periodic"
    assert slope.flags == ()
    assert error(mistuned, of, slope.value) < 1e-6
    # Control: the derivatives of what the other quantity is.
    other = js.gradient(mistuned.scene, WRT, of="P_d" if of != "P_d" else "P_d_worst", orbit=mistuned)
    assert error(mistuned, of, other.value) > 1e-2


@pytest.mark.full
def test_all_blades_together_are_the_sum_of_each(mistuned, reopened):
    wrt = ("row.mistuning", *(f"row.mistuning[{i}]" for i in range(3)))
    slope = js.gradient(mistuned.scene, wrt, orbit=mistuned)
    together, *each = slope.value.values()
    assert together == pytest.approx(sum(each), rel=1e-9)  # a linear map of rounding errors
    again = reopened(slope)
    assert type(again.orbit) is js.Orbit
    assert again.value == slope.value
    np.testing.assert_array_equal(again.orbit.mode, mistuned.mode)
    assert again.orbit.cycle().free_sliders.shape == (3,)
    again.plot()


@pytest.mark.full
def test_the_reduced_map_has_the_multipliers_of_the_period():
    # Anti-phase: the map over half a period and the shift by one blade. Both maps take the same steps.
    options = ["row.blades=4", "drive.engine_order=2", 'parts.motion=["x"]', "blades.c_x=20"]
    found = js.orbit(js.load("row_ring12", options).scene, method=METHOD, most_periods=128)
    assert (found.wave_parts, found.q) == (2, 1)
    assert found.wave_residual < 1e-11
    reduced = np.sort(np.abs(found.wave_multipliers)) ** found.wave_parts
    np.testing.assert_allclose(reduced, np.sort(np.abs(found.multipliers)), rtol=0, atol=1e-8)
    # Control: the multipliers themselves, without the power.
    assert np.max(np.abs(np.sort(np.abs(found.wave_multipliers)) - np.sort(np.abs(found.multipliers)))) > 0.1
    assert found.wave_bifurcation[0] == "localisation"  # a pair, which no travelling wave belongs to


@pytest.mark.full
def test_blades_that_tie_are_told():
    # In a tuned ring all blades are equally bad, and a number of one of them moves each in another way.
    found = settled("blades.c_x=40")
    each = [f"row.mistuning[{i}]" for i in range(len(found.P))]
    single = js.gradient(found.scene, each, of="P_d_worst", orbit=found)
    assert single.flags == ("blades tie",)
    # Blades of a ring are alike: by whichever the worst one gets worse, on its steepest side, it does so equally.
    slopes = np.array([single.value[key] for key in each])
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-5)
    assert single.side == "the slopes are one-sided, of the side on which P_d_worst falls"
    alike = js.gradient(found.scene, ["shroud.gap"], of="P_d_worst", orbit=found)
    assert alike.flags == ()
    assert alike.side == ""
    whole = js.gradient(found.scene, ["shroud.gap"], orbit=found)
    assert alike.value["shroud.gap"] == pytest.approx(whole.value["shroud.gap"], rel=1e-6)


def test_a_pair_has_no_worst_blade():
    with pytest.raises(ValueError, match="'P_d_worst' is of rows of blades alone"):
        js.gradient(js.load("table1", ['parts.motion=["x"]']).scene, ["shroud.gap"], of="P_d_worst")
