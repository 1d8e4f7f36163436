"""Sweeps with the largest exponent of every lane."""

import numpy as np
import pytest

import jaxshroud as js

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
GAMMAS = [0.5, 2.5, 5.0]
HOW = {"n_periods": 16, "transient": 32, "method": js.RungeKutta(steps=100)}


@pytest.fixture(scope="module")
def curve():
    return js.sweep(SCENE, {"contact.gamma": GAMMAS}, lyapunov=True, **HOW)


def test_exponents_are_those_of_the_orbits(curve):
    orbits = [js.orbit(js.vary(SCENE, "contact.gamma", gamma), method=js.RungeKutta(steps=100)) for gamma in GAMMAS]
    exact = [np.log(np.abs(orbit.multipliers[0])) / orbit.q for orbit in orbits]
    # A pair of complex multipliers turns the tangent: its length swings within the interval.
    assert np.all(np.abs(curve.lyapunov - exact) <= curve.lyapunov_ci + 2e-3)
    assert np.all(curve.lyapunov < 0)


def test_nothing_else_changes(curve):
    plain = js.sweep(SCENE, {"contact.gamma": GAMMAS}, **HOW)
    assert plain.lyapunov is None
    left = curve.to_xarray().drop_vars(["lyapunov", "lyapunov_ci"])
    assert left.identical(plain.to_xarray())


def test_the_phase_of_the_samples_does_not_count(curve):
    other = js.sweep(SCENE, {"contact.gamma": GAMMAS}, lyapunov=True, phase=2.0, **HOW)
    np.testing.assert_allclose(other.lyapunov, curve.lyapunov, atol=2e-3)  # other periods of the same orbit


def test_pictures_have_one_panel_more(curve):
    assert len(curve.plot().axes) == 4
    grid = js.sweep(SCENE, {"contact.gamma": GAMMAS, "drive.F_0": [20.0, 60.0]}, lyapunov=True, **HOW)
    labels = [ax.get_ylabel() for ax in grid.plot().axes]
    assert sum("lambda" in label for label in labels) == 1
