"""`rollout` and `sweep_function` of rows of blades: the numbers of the verbs, and what is refused."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
    # With derivatives, events of one instant are crossed one after the other: to the error of these steps.
    for got, want in ((saved.state.motion.x, run.motion.x), (saved.N, run.N), (saved.F, run.F), (saved.u, run.u)):
        assert_allclose(got, want[1:], rtol=0, atol=1e-7 * np.abs(want).max())
    assert_array_equal(saved.state.mode, run.mode[1:])
    assert_allclose(saved.t, run.t[1:], rtol=1e-15)
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
    assert_array_equal(got.motion.x, swept.motion.x)
    assert_allclose(got.P_0, swept.P_0, rtol=1e-15)
    assert_allclose(got.P, swept.P, rtol=1e-14)
    assert_allclose(got.P_d, swept.P_d, rtol=1e-14)
    assert_allclose(got.P_d_vibration, swept.P_d_vibration, rtol=1e-13)
    assert np.all(got.status == Status.OK)
    assert found.status[1].tolist() == [Status.OK, Status.BAD_INPUT, Status.OK]  # the others go on
    per_gap = js.sweep(ring, {"shroud.gap": GAPS}, n_periods=3, transient=0, method=RK4)
    assert_allclose(area(ring.shroud) * rolled.power, per_gap.P, rtol=1e-7)


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


@pytest.mark.full
@pytest.mark.parametrize("of_sweep", [False, True], ids=["rollout", "sweep_function"])
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd], ids=["grad", "jacfwd"])
def test_derivatives_of_rows_are_differences(ring, derivative, of_sweep):
    def loss(gap):
        if not of_sweep:
            run = run_at(ring, gap)
            return run.saved.N[-1].sum() + 1e9 * run.power.sum()
        scenes = jax.vmap(lambda k: js.vary(js.vary(ring, "contact.gamma", k), "shroud.gap", gap))(np.array([2.0, 3.0]))
        return js.sweep_function(n_periods=1, transient=0, method=RK4)(scenes).P_d.sum()

    slope, h = derivative(loss)(22e-6), 1e-10
    difference = (8 * (loss(22e-6 + h) - loss(22e-6 - h)) - (loss(22e-6 + 2 * h) - loss(22e-6 - 2 * h))) / (12 * h)
    assert slope != 0
    assert float(slope) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.full
def test_a_bound_of_trials_of_a_row_is_enough_nearby_and_running_out_is_a_status(ring):
    most = js.most_trials(ring, 2, method=RK4)
    free, bounded = (js.rollout(ring, None, 2, every=10, method=RK4, most_trials=n) for n in (None, most))
    assert_array_equal(bounded.saved.N, free.saved.N)
    assert js.rollout(ring, None, 2, every=10, method=RK4, most_trials=most // 4).status == Status.OUT_OF_TRIALS


@pytest.mark.full
def test_the_period_map_of_a_row_is_its_rollout(ring):
    start = js.rollout(ring, None, 1, method=RK4).state
    mapped, rolled = js.period_map(ring, start, method=RK4), js.rollout(ring, start, 1, method=RK4)
    assert_array_equal(mapped.state.motion.x, rolled.state.motion.x)
    assert_array_equal(mapped.power, rolled.power)


def test_what_pure_functions_of_rows_refuse(ring):
    pair_start = js.rollout(js.load("table1", ['parts.motion=["x"]']).scene, method=js.RungeKutta(steps=50)).state
    bare = js.load("row_chain5", ["parts.contact=none"]).scene
    lanes = jax.tree.map(lambda a: np.asarray(a)[None], bare)
    for ask, told in (
        (lambda: js.rollout(bare, method=RK4), "many single blades"),
        (lambda: js.sweep_function(1, 0, RK4)(lanes), "many single blades"),
        (lambda: js.rollout(ring, pair_start, method=RK4), "the motion of 3 blades and contact at 3"),
    ):
        with pytest.raises(InputError, match=told):
            ask()
