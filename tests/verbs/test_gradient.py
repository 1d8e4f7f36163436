"""Smoothed gradients in chaos, and the choice between them and exact ones."""

from functools import partial

import numpy as np
import pytest
from quotients import on_orbit

import jaxshroud as js
from jaxshroud import load, sweep
from jaxshroud.batch.plan import Plan
from jaxshroud.march.method import FAST
from jaxshroud.orbits.gradient import scenes_around, smoothed_gradient
from jaxshroud.scene.vary import with_numbers
from jaxshroud.verbs.gradient import differences

PLAN = Plan(16, 32, 200, 0.0, FAST)
SIGMA = 0.01
orbit, gradient = (partial(verb, method=js.RungeKutta(steps=400)) for verb in (js.orbit, js.gradient))
CHAOTIC = {"gamma 5.5": 5.5, "gamma 10": 10.0}


def scene_at(gamma):
    return load("table1", [f"contact.gamma={gamma}", "drive.F_0=60"]).scene


def kernel_weighted_slope(scene, gamma):
    """Slope of the normally weighted average of P_d, by a dense sweep."""
    xi = np.linspace(-4.5, 4.5, 3001)
    dense = sweep(
        scene,
        {"contact.gamma": gamma * (1 + SIGMA * xi)},
        n_periods=PLAN.kept,
        transient=PLAN.transient,
        method=js.RungeKutta(steps=PLAN.steps_per_period),
    )
    weight = np.exp(-(xi**2) / 2)
    P_d = dense.P_d - np.average(dense.P_d, weights=weight)
    return np.sum(weight * xi * P_d) / np.sum(weight * xi**2) / (SIGMA * gamma)


@pytest.mark.release(only=["gamma 5.5"])
@pytest.mark.full
@pytest.mark.parametrize("gamma", CHAOTIC.values(), ids=CHAOTIC)
def test_the_interval_covers_the_slope_of_a_dense_sweep(gamma):
    scene, keys = with_numbers(scene_at(gamma), ["contact.gamma"]), ["contact.gamma"]
    nothing, true = orbit(scene, most_periods=8).cycle(), kernel_weighted_slope(scene, gamma)
    found = [smoothed_gradient(scene, keys, "P_d", nothing, SIGMA, 128, PLAN, seed) for seed in range(20)]
    covers = [abs(g.value[0] - true) <= g.ci[0] for g in found]
    assert np.mean(covers) >= 0.9
    # Control: intervals a quarter as wide do not.
    assert np.mean([abs(g.value[0] - true) <= g.ci[0] / 4 for g in found]) < 0.7


@pytest.mark.full
def test_the_smoothed_gradient_tends_to_the_exact_one():
    scene = with_numbers(scene_at(2.5), ["contact.gamma"])
    found = orbit(scene)
    exact = on_orbit(found, ["contact.gamma"]).value["contact.gamma"]
    plan = Plan(128, 4, 400, 0.0, FAST)
    errors = []
    for sigma in (1e-2, 1e-3, 1e-4):
        got = smoothed_gradient(scene, ["contact.gamma"], "P_d", found.cycle(), sigma, 16, plan, 0)
        errors.append(abs(got.value[0] / exact - 1))
    assert errors[1] < errors[0] / 20
    assert errors[2] < 1e-6
    assert "structured" not in got.flags


@pytest.mark.full
def test_chaos_is_told_from_order():
    calm = gradient(scene_at(2.5), ["shroud.gap"])
    assert (calm.kind, calm.flags, calm.ci) == ("periodic", (), {"shroud.gap": 0.0})
    assert calm.level == calm.orbit.P_d
    wild = gradient(scene_at(5.5), ["shroud.gap"], pairs=16, n_periods=32, transient=16, most_periods=64)
    assert wild.kind == "smoothed"
    assert wild.sigma == 0.01
    assert wild.ci["shroud.gap"] > 0
    assert "aperiodic" in wild.flags


@pytest.mark.full
def test_a_neighbourhood_with_bifurcations_is_structured():
    # Around gamma = 4.4 lie a period doubling and windows.
    scene = with_numbers(scene_at(4.4), ["contact.gamma"])
    got = smoothed_gradient(scene, ["contact.gamma"], "P_d", orbit(scene).cycle(), 0.05, 32, PLAN, 0)
    assert "structured" in got.flags


def test_unlike_blades_change_together_by_the_same_amount():
    scene = load("table1", ['parts.motion=["x"]', "blades.c_x=[40, 44]"]).scene
    keys = ["blades.c_x", "blades.c_x[0]", "blades.c_x[1]"]
    found = js.gradient(scene, keys, method=js.RungeKutta(steps=100))
    both, left, right = (found.value[key] for key in keys)
    assert both == pytest.approx(left + right, rel=1e-9)
    assert min(abs(both - left), abs(both - right)) > 1e-3 * abs(both)
    assert differences(found.orbit, keys[:1], 1e-4)[keys[0]] == pytest.approx(both, rel=1e-6)
    around = scenes_around(scene, keys[:1], np.array([[42.0], [43.0]]))  # of a smoothed one
    np.testing.assert_allclose(around.blades.c_x, [[40, 44], [41, 45]])


@pytest.mark.full
def test_a_number_that_is_0_does_not_take_the_slopes_of_others_away():
    short = {"most_periods": 16, "pairs": 8, "n_periods": 4, "transient": 4, "method": js.RungeKutta(steps=100)}
    found = gradient(scene_at(5.5), ["drive.phase[0]", "shroud.gap"], **short)
    assert found.kind == "smoothed"
    assert "no width" in found.flags
    assert np.isnan(found.value["drive.phase[0]"])
    assert np.isfinite(found.value["shroud.gap"])
    assert [effect.key for effect in found.effects] == ["shroud.gap", "drive.phase[0]"]
    assert found.plot() is not None
    with pytest.raises(ValueError, match="is 0"):
        gradient(scene_at(5.5), ["drive.phase[0]"], most_periods=16)
