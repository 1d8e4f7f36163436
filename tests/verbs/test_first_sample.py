"""The first sample of a run is the state after what happens at its instant: contact of blocks that overlap begins."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.scene.keys import Motion

RK4 = js.RungeKutta("rk4", steps=100)
PRESSED = ["shroud.gap=-0.2mm", 'parts.motion=["x"]']
STARTS = {  # settings, and how contact is at first
    "stick": (PRESSED, (Mode.STICK, 1)),
    "no friction": ([*PRESSED, "friction.mu=0"], (Mode.SLIP_PLUS, 1)),
    "corner": (["shroud.gap=-0.2mm", "initial.theta=[1e-3,0]"], (Mode.STICK, None)),
    "flat": (["shroud.gap=-0.2mm", "drive.M_0=0"], (Mode.STICK, FLAT)),
}


@pytest.mark.parametrize(
    "march", [RK4, pytest.param(js.Taylor(steps=100), marks=[pytest.mark.release, pytest.mark.full])], ids=str
)
@pytest.mark.parametrize("start", [pytest.param(s, marks=pytest.mark.full) if s != "stick" else s for s in STARTS])
def test_first_sample_is_after_the_onset(start, march):
    # Bit for bit what the march itself has after its events at t = 0, which are before that sample; and N = k v.
    settings, (mode, case) = STARTS[start]
    run = js.simulate(js.load("table1", settings).scene, n_periods=1, every=20, method=march, events=True)
    at_once = int((run.events.t == 0).sum())
    assert at_once >= 2
    for name in ("mode", "case", "u_s", "N", "F", "v", "u"):
        events = getattr(run.events, name)
        assert_array_equal(getattr(run, name)[0], events[at_once - 1], err_msg=name)
        assert_array_equal(getattr(run.with_events(), name)[at_once], events[at_once - 1], err_msg=name)
    assert run.events.mode[0] == Mode.APART  # the side before it
    assert run.mode[0] == mode
    assert case is None or run.case[0] == case
    assert run.v[0] > 0
    assert_allclose(run.N[0], float(js.load("table1", settings).scene.k) * run.v[0], rtol=1e-12)
    assert run.counters["onset_stick"] + run.counters["onset_slip"] >= 1
    assert_array_equal(run.motion.x[0], 0.0)  # as given


def test_onset_of_overlap_is_no_impact():
    # The contact that begins at once is counted, and is none of those that begin from a gap.
    scene = js.load("table1", PRESSED).scene
    run = js.sweep(scene, {"drive.F_0": [1.0]}, forces=True, n_periods=1, transient=0, method=RK4)
    assert run.counters["onset_stick"][0] + run.counters["onset_slip"][0] == run.impacts[0] + 1


def test_apart_and_given_modes_are_kept():
    # Blocks apart stay so; a state that says how it is in contact keeps its mode, its slider and so its friction.
    apart = js.simulate(js.load("table1", ['parts.motion=["x"]']).scene, n_periods=1, every=20, method=RK4)
    assert apart.mode[0] == Mode.APART
    assert apart.N[0] == 0
    scene = js.load("table1", PRESSED).scene
    first = js.simulate(scene, n_periods=1, every=20, method=RK4)
    given = js.State(Motion(*[jnp.zeros(2)] * 6), jnp.asarray(first.u[0] - 1e-9), jnp.int32(Mode.STICK), jnp.int32(1))
    again = js.simulate(scene, given, n_periods=1, every=20, method=RK4)
    assert (again.mode[0], again.u_s[0]) == (Mode.STICK, float(given.u_s))
    assert again.counters["onset_stick"] == 0


RING = ['parts.motion=["x"]', "row.blades=3", "row.closed=true", "drive.engine_order=1"]


@pytest.mark.full
def test_first_sample_of_a_ring():
    # Pressed all round, every interface has N = k v, where it had 0 beside v > 0, and sticks.
    scene = js.load("table1", ["shroud.gap=-0.2mm", *RING]).scene
    ring = js.simulate(scene, n_periods=1, every=20, method=RK4)
    assert np.all(ring.mode[0] == Mode.STICK)
    assert_allclose(ring.v[0], 0.2e-3 * np.sin(float(scene.shroud.alpha)), rtol=1e-12)
    assert_allclose(ring.N[0], np.asarray(scene.k) * ring.v[0], rtol=1e-12)
    assert_array_equal(ring.u_s[0], ring.u[0])
    assert_array_equal(ring.counters["onset_stick"] >= 1, True)


@pytest.mark.release
@pytest.mark.full
@pytest.mark.parametrize("motion", ['["x"]', '["x","y","theta"]'])
def test_first_sample_of_a_chain_is_that_of_the_pair(motion):
    # With torsion all faces are flat at first, where theta_1 = theta_2.
    march = dict(n_periods=1, every=20, method=RK4)
    settings = ["shroud.gap=-0.2mm", f"parts.motion={motion}", "drive.M_0=0"]
    pair = js.simulate(js.load("table1", settings).scene, **march)
    more = ["row.blades=2", "drive.phase=[0,3.141592653589793]"]
    chain = js.simulate(js.load("table1", [*settings, *more]).scene, **march)
    for name in ("mode", "case", "N", "F", "v", "u", "u_s"):
        one, other = getattr(chain, name)[0, 0], getattr(pair, name)[0]
        assert_allclose(one, other, rtol=1e-12, atol=1e-14, err_msg=name)
