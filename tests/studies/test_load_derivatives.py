"""A sample of the study of derivatives by loads, and that it can fail."""

import load_derivatives
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.orbits import amplitude_slopes

pytestmark = [pytest.mark.studies, pytest.mark.full]

TURNS = 2 * np.pi * np.arange(5760) / 5760


@pytest.fixture(scope="module")
def found():
    scene = next(load_derivatives.random_scenes(np.random.default_rng(5)))
    return js.orbit(scene, method=load_derivatives.METHOD_FOR_PEAKS)


def test_derivatives_by_loads_are_those_of_differences():
    told = load_derivatives.study(1)
    for by_number in told["largest relative error"].values():
        assert max(by_number.values()) < 1e-6, told


def test_a_peak_in_the_wrong_place_is_seen(found, monkeypatch):
    # Control: the same differences, but the derivative of the displacement a ten-thousandth of a period later.
    assert max(load_derivatives.errors_of_peak(found)[0].values()) < 1e-6
    true_place = amplitude_slopes.turning_points
    late = lambda *args: [e._replace(turns=e.turns + 1e-4) for e in true_place(*args)]
    monkeypatch.setattr(amplitude_slopes, "turning_points", late)
    monkeypatch.setattr(amplitude_slopes, "MAX_SECANTS", 0)
    assert max(load_derivatives.errors_of_peak(found)[0].values()) > 1e-4


def test_the_peak_of_samples_is_that_of_a_known_motion():
    turns = TURNS - 0.7003
    top = load_derivatives.top_of(2 - np.cos(turns) - 0.25 * np.cos(2 * turns))
    assert top.height == pytest.approx(1.25, rel=1e-13)
    assert not top.tied


def test_peaks_that_tie_are_told():
    assert load_derivatives.top_of(np.cos(2 * TURNS) + 1e-4 * np.cos(TURNS)).tied


def test_the_scene_is_left_out_where_contact_changes_at_the_peak(found, monkeypatch):
    assert load_derivatives.why_no_peak(found) == ""
    # A change is 82 samples after the peak.
    monkeypatch.setattr(load_derivatives, "FIT_HALF", 200)
    assert load_derivatives.why_no_peak(found) == "the contact changes at the peak"


def test_differences_are_extrapolated_and_unknown_ones_left_out():
    steps = load_derivatives.HALVED_STEPS * 50
    quotients = (np.exp(1 + steps) - np.exp(1 - steps)) / (2 * steps)
    whole = load_derivatives.extrapolated(quotients)
    assert whole.value == pytest.approx(np.e, rel=1e-12)
    quotients[0] = np.nan
    assert load_derivatives.extrapolated(quotients).value == pytest.approx(np.e, rel=1e-12)
    assert np.isnan(load_derivatives.extrapolated(np.full(6, np.nan)).value)
