"""What verbs tell of faces with several points: of orbits, exponents and coexisting motions, and inside JAX."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.plotting.run_data import places_of_points
from jaxshroud.verbs.gradient import differences

pytestmark = pytest.mark.full

IN_X = ('parts.motion=["x"]', "blades.c_x=40")
LISTED = ('contact.points=["-15 mm", "17 mm"]', "contact.shares=[0.4, 0.6]")
METHOD = js.RungeKutta("rk4", steps=200)
WRT = ["contact.k", "friction.k_d", "friction.mu", "shroud.gap"]


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", [*IN_X, *LISTED]).scene


def test_an_orbit_has_a_slider_at_each_point(scene, reopened):
    found = js.orbit(scene, method=METHOD)
    assert not found.flags
    assert found.multipliers.shape == (14,)
    assert list(found.data["component"].to_numpy()[-2:]) == ["slider_0", "slider_1"]
    exact, quotients = js.gradient(scene, WRT, orbit=found).value, differences(found, WRT, 1e-4)
    np.testing.assert_allclose([exact[key] for key in WRT], [quotients[key] for key in WRT], rtol=1e-6)
    start = reopened(found).start
    assert start.u_s.shape == start.mode.shape == (2,)
    exponents = js.lyapunov(scene, n_periods=8, transient=32, state=start, method=METHOD)
    assert abs(exponents.exponents[0] - np.log(abs(found.multipliers[0]))) < 0.05  # an average over eight periods
    assert exponents.last.u_s.shape == (2,)


def test_attractors_of_points(scene):
    found = js.attractors(scene, starts=4, method=METHOD)
    assert found.period_number.tolist() == [1]
    assert found.point_mode.shape == (1, 2)


def test_derivatives_inside_jax_are_those_of_differences(scene):
    how = {"n_periods": 2, "every": 50, "method": METHOD, "save": lambda at: at.N}
    largest = lambda gap: js.rollout(js.vary(scene, "shroud.gap", gap), **how).saved.max()
    slope = jax.grad(largest)(22e-6)
    assert abs(slope / ((largest(22e-6 + 1e-10) - largest(22e-6 - 1e-10)) / 2e-10) - 1) < 1e-6


def test_pictures_show_each_point(tmp_path):
    scene = js.load("table1", ["blades.I=2.46e-5", "drive.M_0=0.3", *LISTED])
    run = js.simulate(scene, n_periods=2, every=4, method=METHOD)
    np.testing.assert_allclose(places_of_points(run.data), [-0.015, 0.017])
    for panel in ("ribbon", "loop", "path"):
        run.plot(panel=panel).savefig(tmp_path / f"{panel}.png")
    (axes,) = run.plot(panel="path").axes
    drawn = {float(line.get_ydata()[0]) for line in axes.lines if np.ptp(line.get_ydata()[:2]) == 0}
    assert {-15.0, 17.0} <= drawn  # mm, beside the ends of the face
