"""The peak of an amplitude with contact against the peak without."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.verbs.response import VALUES, free_peak, peak_ratio

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
RUN = {"n_periods": 8, "transient": 32, "method": js.RungeKutta(steps=100)}


def test_the_free_peak_is_that_of_a_damped_oscillator():
    m, c, k = (float(np.ravel(getattr(SCENE.blades, name))[0]) for name in ("m", "c_x", "k_x"))
    force = 60 * np.cos(SCENE.drive.beta)
    omega = np.sqrt(k / m - c**2 / (2 * m**2))
    found = free_peak(SCENE, "drive.omega", 0.5 * omega, 2 * omega, "x_peak")
    assert found.value == pytest.approx(omega, rel=1e-6)
    assert found.amplitude == pytest.approx(force / abs(k - m * omega**2 + 1j * omega * c), rel=1e-9)
    assert not found.at_end
    assert free_peak(SCENE, "drive.omega", 0.5 * omega, 0.9 * omega, "x_peak").at_end


@pytest.mark.release
@pytest.mark.full
def test_peaks_are_those_of_a_fine_sweep():
    low, high = 900.0, 1500.0
    found = peak_ratio(SCENE, "drive.omega", low, high, "x_peak", RUN)
    near = {"drive.omega": found.contact.value + np.linspace(-40, 40, VALUES)}
    fine = js.sweep(SCENE, near, direction="both", amplitudes=True, **RUN)
    assert found.contact.amplitude >= np.nanmax(fine.x_peak[..., 0]) * (1 - 1e-3)
    assert found.contact.amplitude < found.free.amplitude
    assert found.apart < 1.0
    for number in (found.contact.amplitude, found.free.amplitude):
        assert f"{number:.5g} m" in found.words
    assert "rad/s" in found.words
