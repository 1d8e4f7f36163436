"""Amplitudes without contact: the closed form against a march that never touches, and against the steady response."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxshroud as js

SERIES = js.Taylor(order=16, tolerance=1e-14)
NAMES = [f"{q}_{kind}" for q in ("x", "y", "theta") for kind in ("mean", "rms", "peak", "free")]


def amplitudes(scene, transient, **how):
    """All amplitudes of a scene, by name, over two periods."""
    found = js.sweep(scene, {"drive.F_0": [40.0]}, n_periods=2, transient=transient, amplitudes=True, **how)
    return {name: np.asarray(getattr(found, name)[0]) for name in NAMES}


@pytest.fixture(scope="module")
def scene():
    """Blades that a gap of 1 m keeps apart."""
    return js.load("table1", ["shroud.gap=1", "drive.M_0=5"]).scene


@pytest.mark.release
@pytest.mark.full
def test_a_march_that_never_touches_has_the_closed_form(scene):
    # In the transient, from rest: neither a sine nor of mean zero. Series err by their tolerance, and squares by more.
    exact = amplitudes(js.load("table1", ["parts.contact=none", "drive.M_0=5"]).scene, 1)
    marched, coarse = amplitudes(scene, 1, method=SERIES), amplitudes(scene, 1, method=js.RungeKutta(steps=200))
    for name, a in exact.items():
        size = exact[f"{name.partition('_')[0]}_peak"].max()
        assert_allclose(marched[name], a, rtol=0, atol=1e-10 * size, err_msg=name)
    # Control: steps of RK4 that suit contact miss it by ten thousand tolerances.
    assert np.max(np.abs(coarse["y_peak"] - exact["y_peak"])) > 1e-6 * exact["y_peak"].max()


@pytest.mark.full
def test_in_the_long_run_the_closed_form_is_the_steady_response():
    scene = js.load("table1", ["parts.contact=none", "drive.M_0=5"]).scene
    late, early = amplitudes(scene, 2000), amplitudes(scene, 1)
    for q in ("x", "y", "theta"):
        free = late[f"{q}_free"]
        assert_allclose(late[f"{q}_peak"], free, rtol=1e-11)
        assert_allclose(late[f"{q}_rms"], free / np.sqrt(2), rtol=1e-11)
        assert_allclose(late[f"{q}_mean"], 0, rtol=0, atol=1e-11 * free.max())
        # Control: the transient is no steady response.
        assert np.max(np.abs(early[f"{q}_peak"] / free - 1)) > 1e-3
