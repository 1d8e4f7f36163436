"""Periodic orbits by shooting, and exact gradients on them."""

import numpy as np
import pytest

from jaxshroud import load, orbit, simulate, value_of
from jaxshroud.gradient import differences, on_orbit

PARAMETERS = (
    [
        "shroud.gap",
        "contact.gamma",
        "friction.k_d",
        "friction.mu",
        "drive.omega",
        "shroud.alpha",
        "shroud.l_oa",
        "shroud.l_ab",
    ]
    + [f"drive.{n}[{i}]" for n in ("F_0", "M_0", "beta", "phase") for i in (0, 1)]
    + [f"blades.{n}[{i}]" for n in ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T") for i in (0, 1)]
)
UNLIKE = ("blades.m=[0.08, 0.085]", "drive.phase=[0, 2.9]")
PRINTED = ('contact.reading="printed"',)
# Overrides of Table 1 with F_0 = 60 N, the period number, and events that the orbit must have.
SCENES = {
    "slip onset": (("contact.gamma=1",), 1, ("onset_slip", "stick_slip", "slip_stick")),
    "stick onset": (("contact.gamma=3.5",), 1, ("onset_stick",)),
    "loaded switch 1-2": (("contact.gamma=0.3",), 1, ("switch_12", "switch_23", "switch_34")),
    "loaded switch 1-4": (("contact.gamma=4.2",), 2, ("switch_14", "onset_stick")),
    "all switches": (("contact.gamma=6.6",), 2, ("switch_14", "switch_12", "switch_23", "switch_34")),
    "period 3": (("contact.gamma=5", "drive.omega=1535"), 3, ("onset_slip",)),
    "unlike blades": (("contact.gamma=6", *UNLIKE), 1, ("onset_stick", "switch_34")),
    "printed": (("contact.gamma=2.5", *PRINTED), 1, ("switch_12", "switch_23")),
    "printed, unlike blades": (("contact.gamma=1", *PRINTED, *UNLIKE), 1, ("onset_slip",)),
}


def scene_of(overrides):
    return load("table1", ["drive.F_0=60", *overrides]).scene


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES)
def case(request):
    """An orbit, its period number and its events."""
    overrides, q, events = request.param
    return orbit(scene_of(overrides)), q, events


def test_orbits_of_every_kind_are_found(case):
    found, q, events = case
    assert found.q == q
    assert found.flags == ()
    assert found.residual <= 1e-8
    run = simulate(found.scene, found.start, n_periods=found.q, method=found.method)
    for event in events:
        assert run.counters[event] > 0, event
    np.testing.assert_allclose(run.last.motion.x, found.start.motion.x, rtol=1e-6)


def scaled(values: dict, scene) -> np.ndarray:
    """Derivatives times the values of the parameters (or 1): changes of P_d for a relative change of each."""
    return np.array([slope * (abs(value_of(scene, key)) or 1) for key, slope in values.items()])


def test_exact_gradient_of_all_parameters(case):
    found, _, _ = case
    exact = scaled(on_orbit(found, PARAMETERS).value, found.scene)
    largest = np.abs(exact).max()
    for step in (3e-5, 1e-5, 3e-6):
        assert np.abs(scaled(differences(found, PARAMETERS, step), found.scene) - exact).max() <= 1e-6 * largest
