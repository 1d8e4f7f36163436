"""`rollout` and `sweep_function` of rows of blades: the numbers of the verbs, and what is refused."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.model.linear import area
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError

pytestmark = pytest.mark.full

RK4 = js.RungeKutta("rk4", steps=100)
GAPS = np.array([22e-6, 10e-6])


@pytest.fixture(scope="module")
def ring():
    return js.load("row_ring12", ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1"]).scene


def run_at(scene, gap, **how):
    return js.rollout(js.vary(scene, "shroud.gap", gap), None, 3, every=10, method=RK4, **how)


@pytest.fixture(scope="module")
def rolled(ring):
    return jax.jit(jax.vmap(lambda gap: run_at(ring, gap)))(GAPS)


def test_a_rollout_of_a_row_has_the_numbers_of_simulate(ring, rolled):
    run = js.simulate(ring, n_periods=3, every=10, method=RK4)
    saved = jax.tree.map(lambda a: np.asarray(a)[0], rolled.saved)
    assert np.all(rolled.status == Status.OK)
    # The same kernels: to the last bit, with time to a rounding.
    for got, want in ((saved.state.motion.x, run.motion.x), (saved.N, run.N), (saved.F, run.F), (saved.u, run.u)):
        np.testing.assert_array_equal(got, want[1:])
    np.testing.assert_array_equal(saved.state.mode, run.mode[1:])
    np.testing.assert_allclose(saved.t, run.t[1:], rtol=1e-15)
    counted = {name: count for name, count in run.counters.items() if name != "grazing"}  # of onsets, counted already
    assert rolled.events[0] == sum(map(np.sum, counted.values())) > 0
    assert 0 < rolled.slowest_onset[0] < np.abs(run.motion.v_x).max() * 2
    assert np.all(np.isinf(rolled.slowest_switch))  # without torsion


def test_functions_of_rows_have_the_numbers_of_sweep(ring, rolled):
    gamma = {"contact.gamma": [2.0, 3.0, 4.0]}
    swept = js.sweep(ring, gamma, n_periods=2, transient=1, method=RK4)
    scenes, function = js.scenes_from(gamma, ring), js.sweep_function(n_periods=2, transient=1, method=RK4)
    omega = np.array([[536.0, 536.0, 536.0], [536.0, 0.0, 536.0]])
    found = jax.vmap(lambda omega: function(js.vary(scenes, "drive.omega", omega)))(omega)
    got = jax.tree.map(lambda a: np.asarray(a)[0], found)
    # The same kernels; means of two periods are summed in another order, and the closed form is fused otherwise.
    np.testing.assert_array_equal(got.motion.x, swept.motion.x)
    np.testing.assert_allclose(got.P_0, swept.P_0, rtol=1e-15)
    np.testing.assert_allclose(got.P, swept.P, rtol=1e-14)
    np.testing.assert_allclose(got.P_d, swept.P_d, rtol=1e-14)
    np.testing.assert_allclose(got.P_d_vibration, swept.P_d_vibration, rtol=1e-13)
    assert np.all(got.status == Status.OK)
    assert found.status[1].tolist() == [Status.OK, Status.BAD_INPUT, Status.OK]  # the others go on
    per_gap = js.sweep(ring, {"shroud.gap": GAPS}, n_periods=3, transient=0, method=RK4)
    np.testing.assert_allclose(area(ring.shroud) * rolled.power, per_gap.P, rtol=1e-14)


def test_unstable_steps_of_a_row_are_bad_input(ring):
    # The bound of the verbs, of pairs with contact twice as stiff.
    stiff = js.vary(ring, "contact.gamma", 1e3)
    with pytest.raises(js.InputError, match="step"):
        js.simulate(stiff, n_periods=1, method=RK4)
    run = js.rollout(stiff, None, 1, every=10, method=RK4)
    found = js.sweep_function(n_periods=1, transient=0, method=RK4)(jax.tree.map(lambda a: np.asarray(a)[None], stiff))
    assert run.status == found.status[0] == Status.BAD_INPUT
    assert np.all(np.isnan(run.saved.N))
    assert np.all(np.isnan([*found.P_d, *found.P_0[0]]))
    assert run.coarseness == found.coarseness[0] > 2.8 / 0.51


@pytest.mark.full(but=["rollout-grad"])
@pytest.mark.parametrize(
    "derivative", [jax.grad, jax.jacfwd, lambda f: jax.jit(jax.grad(f))], ids=["grad", "jacfwd", "jit"]
)
@pytest.mark.parametrize("of_sweep", [False, True], ids=["rollout", "sweep_function"])
def test_a_row_is_not_differentiated(ring, derivative, of_sweep):
    def loss(gap):
        if not of_sweep:
            return run_at(ring, gap).saved.N.max()
        scenes = jax.vmap(lambda k: js.vary(js.vary(ring, "contact.gamma", k), "shroud.gap", gap))(np.array([2.0, 3.0]))
        return js.sweep_function(n_periods=1, transient=0, method=RK4)(scenes).P_d.sum()

    with pytest.raises(TypeError, match="Rows of blades have no derivatives yet"):
        derivative(loss)(22e-6)


def test_what_pure_functions_of_rows_refuse(ring):
    pair_start = js.rollout(js.load("table1", ['parts.motion=["x"]']).scene, method=js.RungeKutta(steps=50)).state
    bare = js.load("row_chain5", ["parts.contact=none"]).scene
    lanes = jax.tree.map(lambda a: np.asarray(a)[None], bare)
    for ask, told in (
        (lambda: js.rollout(ring, method=js.Taylor(steps=50)), "Runge-Kutta methods, not by power series"),
        (lambda: js.rollout(bare, method=RK4), "many single blades"),
        (lambda: js.sweep_function(1, 0, RK4)(lanes), "many single blades"),
        (lambda: js.rollout(ring, most_trials=9, method=RK4), "`most_trials` does not know rows of blades yet"),
        (lambda: js.rollout(ring, pair_start, method=RK4), "the motion of 3 blades and contact at 3"),
    ):
        with pytest.raises(InputError, match=told):
            ask()
