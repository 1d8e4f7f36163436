"""Smooth contact: no events, and the spring law in the limit of a small width."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from side_by_side import EXACT, ends, relative_error, run, sizes, with_parts

import jaxshroud as js
from jaxshroud.march.method import FAST_WITH_LEDGER
from jaxshroud.march.stability import largest_frequency
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import prepared_law
from jaxshroud.scene.vary import vary

MODE = jnp.int32(Mode.SMOOTH)
GAMMA = np.linspace(0.5, 8.0, 8)


def test_the_laws_are_the_corners_hyperbolas(table1):
    law = prepared_law(with_parts(table1, 1e-6, contact="smooth"))
    v = jnp.asarray([-1e-4, 0.0, 1e-4])
    N = jax.vmap(law.normal_force)(v)
    k = float(law.k)
    # Far away the force is the spring's, or width^2 / 4 abs(v) of it; in between it is k width / 2.
    np.testing.assert_allclose(N, k * np.array([1e-12 / 4e-4, 5e-7, 1e-4 + 1e-12 / 4e-4]), rtol=1e-4)
    energy = lambda v: law.stored_energy(v, jnp.zeros(()), MODE)
    np.testing.assert_allclose(jax.vmap(jax.grad(energy))(v), N, rtol=1e-9)
    limit = float(law.lag) * 1e-4
    F = lambda w: float(law.friction_force(jnp.asarray(1e-4), jnp.asarray(w), jnp.zeros(()), MODE))
    assert F(0.0) == 0.0
    assert F(0.1 * limit) == pytest.approx(float(law.k_d) * 0.1 * limit, rel=1e-2)
    assert F(5 * limit) == pytest.approx(-F(-5 * limit)) == pytest.approx(float(law.k_d) * limit, rel=1e-3)
    assert float(law.stretch(jnp.asarray(-1e-3), jnp.asarray(1e-4), jnp.zeros(()), MODE)) < 1e-8  # apart


def differences(table1, widths, periods=1, **parts):
    """Median over gamma of the relative difference from the spring law, for each width; both with errors below it."""
    scenes = [with_parts(vary(table1, "contact.gamma", g), **parts) for g in GAMMA]
    exact = run(scenes, periods, 2000, EXACT["dopri8-cubic"])
    errors = []
    for width in widths:
        smooth = [with_parts(vary(table1, "contact.gamma", g), width, contact="smooth", **parts) for g in GAMMA]
        steps = int(max(float(largest_frequency(s)) for s in smooth) * float(table1.drive.period) / 0.5)
        got = run(smooth, periods, steps, FAST_WITH_LEDGER)
        assert np.all(got.last.status == Status.OK)
        assert np.all(np.abs(got.samples.residual.sum(-1) / got.samples.work.sum(-1)) < 40 * width / 2.2e-5)
        errors.append(np.median(relative_error(ends(got), ends(exact), np.maximum(sizes(exact), 1e-30))))
    return np.array(errors)


@pytest.mark.release(only=["no friction", "full"])
@pytest.mark.full
@pytest.mark.parametrize(
    ("parts", "rate"),
    [({"motion": ("x",), "friction": "none"}, 1.6), ({"friction": "none"}, 1.4), ({}, 0.6)],
    ids=["x", "no friction", "full"],
)
def test_it_converges_to_the_spring_law(table1, parts, rate):
    # The impulse of an impact is off by width^2 log(width), the slider late by some widths.
    widths = 1e-6 * np.array([3.0, 1.0, 0.3])
    errors = differences(table1, widths, **parts)
    assert np.all(np.diff(np.log(errors)) / np.diff(np.log(widths)) > rate), errors
    # Control: a width of the gap's own size is another scene.
    assert differences(table1, [2e-5], **parts)[0] > 5 * errors[-1]


@pytest.mark.full
def test_it_is_integrated_at_the_order_of_the_method(table1):
    # Smooth to all orders: no event is located, and RK4 keeps its order across the impacts.
    scene = with_parts(table1, 2e-6, contact="smooth")
    truth, *runs = (run([scene], 1, n, FAST_WITH_LEDGER) for n in (32000, 8000, 16000))
    error = [relative_error(ends(r), ends(truth), sizes(truth))[0] for r in runs]
    assert np.log2(error[0] / error[1]) > 3.6


@pytest.mark.full
def test_its_derivatives_are_those_of_the_computed_map(table1):
    scene = with_parts(vary(table1, "contact.gamma", 0.3), 5e-5, contact="smooth")
    found = js.orbit(scene, most_periods=300, method=js.RungeKutta(steps=400))
    assert found.found
    slope = js.gradient(scene, ["shroud.gap", "contact.width"], orbit=found, method=js.RungeKutta(steps=400)).value
    from jaxshroud.verbs.gradient import differences as by_differences

    check = by_differences(found, ["shroud.gap", "contact.width"], 1e-4)
    for key, value in slope.items():
        assert value == pytest.approx(check[key], rel=1e-5)


def test_steps_know_how_fast_the_slider_follows(table1):
    scene = with_parts(table1, 1e-8, contact="smooth")
    with pytest.raises(ValueError, match="unstable"):
        js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=400))


@pytest.mark.full
def test_it_pushes_before_anything_touches(table1):
    # An artefact: below grazing nothing touches and P_d is 0, but smooth contact already pushes.
    apart = vary(vary(table1, "shroud.gap", 2e-4), "contact.gamma", 20.0)
    parts = {"motion": ("x",), "friction": "none"}
    force = {"drive.F_0": [8.8]}  # the blades graze at 8.896 N
    how = {"n_periods": 8, "transient": 300, "method": js.RungeKutta(steps=4000)}
    exact, smooth = (
        js.sweep(with_parts(apart, width, **kind, **parts), force, **how)
        for width, kind in ((None, {}), (5e-6, {"contact": "smooth"}))
    )
    assert abs(exact.P_d[0]) < 1e-6
    assert smooth.P_d[0] > 1.0
