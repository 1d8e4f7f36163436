"""Mean loads: static positions, power about them, and identities with a gap."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.model.linear import free_power, static_position, steady_amplitudes

BENDING = 'parts.motion=["x", "y"]'


def table1(*changes):
    return js.load("table1", ["drive.M_0=0.1", "contact.gamma=2.5", *changes]).scene


def under(scene, **loads):
    """The scene with mean loads."""
    for name, load in loads.items():
        scene = js.vary(scene, f"drive.{name}", load)
    return scene


def at_static(scene):
    """The scene started at the static position under its mean loads."""
    at = static_position(scene)
    for name, value in (("x", at.x), ("y", at.y)):
        scene = js.vary(scene, f"initial.{name}", value + getattr(scene.initial, name))
    return scene


def test_files_and_keys_have_mean_loads():
    file = js.load("table1", ["drive.F_x_mean=[5 N, -5 N]", "drive.M_mean=0.2"])
    assert_array_equal(file.scene.drive.F_x_mean, [5.0, -5.0])
    again = js.load("table1", ["drive.F_x_mean=[5, -5]"]).scene
    assert js.value_of(again, "drive.F_x_mean[1]") == -5.0
    assert js.value_of(again, "drive.F_y_mean") == 0.0
    assert again.drive.F_y_mean is None
    with pytest.raises(js.SceneError, match="F_x_mean = Infinity must be a finite number"):
        js.load("table1", ["drive.F_x_mean=inf"])


def test_the_static_position_is_that_of_the_springs():
    scene = under(table1(), F_x_mean=[5.0, -4.0], F_y_mean=30.0, M_mean=[0.2, 20.0])
    at = static_position(scene)
    assert_allclose(at.x, [5e-5, -4e-5], rtol=1e-14)
    assert_allclose(at.y, [1e-5, 1e-5], rtol=1e-14)
    assert_allclose(at.sin, np.sin([1e-4, 1e-2]), rtol=1e-14)
    assert static_position(table1()) is None
    row = under(js.load("table1", ["row.blades=2", "row.mistuning=[0.25, 0.0]"]).scene, F_x_mean=[5.0, 5.0])
    assert_allclose(static_position(row).x, [4e-5, 5e-5], rtol=1e-14)


@pytest.mark.full
def test_without_contact_power_is_about_the_static_position():
    # P = P_0, which the mean loads do not change; the motion is shifted by the static position.
    calm = ("parts.contact=none", "blades.c_x=100", "blades.c_y=200", "blades.c_T=2")
    scene = under(table1(*calm), F_x_mean=[5.0, -4.0], F_y_mean=30.0, M_mean=[0.2, 20.0])
    assert_array_equal(free_power(scene), free_power(table1(*calm)))
    power = js.power(scene, n_periods=2, transient=60, method=js.RungeKutta(steps=64))
    assert_allclose(power.P_d, 0.0, rtol=0, atol=1e-8)
    assert_allclose(power.final_P_d_vibration, 0.0, rtol=0, atol=1e-8)
    run = js.simulate(scene, n_periods=40, method=js.RungeKutta(steps=64)).motion
    assert_allclose(np.asarray(run.theta)[-64:].mean(axis=0), [1e-4, 1e-2], rtol=1e-7)
    assert steady_amplitudes(scene)[0].x[0].imag == pytest.approx(5e-5)


def motions(scene, method, periods=3):
    run = js.simulate(scene, n_periods=periods, method=method)
    assert not np.any(run.status)
    return np.concatenate([np.asarray(run.motion.x), np.asarray(run.motion.y)], axis=-1), run


@pytest.mark.full
@pytest.mark.parametrize("name", ["rk4", "series"])
def test_without_torsion_a_mean_force_is_a_gap(name):
    # gap' = gap - (x_s1 - x_s2) + (y_s1 - y_s2) cot(alpha): the same motion about the static position.
    method = {"rk4": js.RungeKutta(steps=400), "series": js.Taylor(tolerance=1e-10)}[name]
    plain = table1(BENDING, "initial.x=[1e-6, 2e-6]")
    loaded = under(plain, F_x_mean=[3.0, -2.0], F_y_mean=[20.0, -50.0])
    at = static_position(loaded)
    closed = at.x[0] - at.x[1] - (at.y[0] - at.y[1]) / jnp.tan(plain.shroud.alpha)
    moved = js.vary(plain, "shroud.gap", plain.shroud.gap - closed)
    wanted, _ = motions(moved, method)
    found, _ = motions(at_static(loaded), method)
    shift = np.concatenate([at.x, at.y])
    assert_allclose(found - shift, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    P, Q = (js.power(s, n_periods=4, transient=0, method=method) for s in (at_static(loaded), moved))
    assert_allclose(P.P_d, Q.P_d, rtol=0, atol=1e-6)
    assert_allclose(P.final_P_d_vibration, Q.final_P_d_vibration, rtol=0, atol=1e-6)


@pytest.mark.full
def test_a_ring_under_one_mean_force_moves_about_it():
    ring = js.load(
        "table1", [BENDING, "drive.phase=0", "row.blades=3", "row.closed=true", "drive.engine_order=1"]
    ).scene
    pressed = js.vary(ring, "shroud.gap", -1e-4)
    loaded = at_static(under(pressed, F_x_mean=7.0, F_y_mean=40.0))
    method, at = js.RungeKutta(steps=400), static_position(loaded)
    (wanted, alone), (found, both) = motions(pressed, method), motions(loaded, method)
    assert_allclose(found - np.concatenate([at.x, at.y]), wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    ends = [js.power(s, n_periods=3, transient=0, method=method) for s in (pressed, loaded)]
    assert_allclose(ends[1].P_d, ends[0].P_d, rtol=0, atol=1e-6)
    assert_allclose(ends[1].final_P_d_vibration, ends[0].final_P_d_vibration, rtol=0, atol=1e-6)
    assert alone.status == both.status


@pytest.mark.full
def test_gradients_by_mean_loads_are_differences():
    scene = under(table1(BENDING, "blades.c_x=100", "contact.gamma=0.6", "shroud.gap=0.4 mm"), F_x_mean=[30.0, -20.0])
    method, keys = js.RungeKutta(steps=400), ["drive.F_x_mean[0]", "drive.F_y_mean[1]"]
    for of in ("P_d", "P_d_vibration", "x_peak"):
        found = js.gradient(scene, keys, of=of, method=method)
        assert found.kind == "periodic", found
        for key in keys:
            step = 1e-3 * (abs(js.value_of(scene, key)) or 1.0)
            level = lambda side, key=key, step=step, of=of: float(
                js.gradient(
                    js.vary(scene, key, js.value_of(scene, key) + side * step), keys, of=of, method=method
                ).level
            )
            slope = (8 * (level(1) - level(-1)) - (level(2) - level(-2))) / (12 * step)
            assert_allclose(found.value[key], slope, rtol=1e-6, atol=1e-9 * abs(found.level))


@pytest.mark.full
def test_check_tells_the_static_gap_and_contacts_that_stay_open():
    sheet = js.check(under(table1("drive.F_0=1", "drive.M_0=0.01"), F_x_mean=[-50.0, 50.0]))
    assert sheet.static_gaps == pytest.approx((22e-6 + 1e-3,))
    assert sheet.gap == 22e-6
    assert any("under the mean loads every contact is open" in doubt for doubt in sheet.doubts)
    pressed = js.check(under(table1(), F_x_mean=[50.0, -50.0]))
    assert pressed.static_gaps == pytest.approx((22e-6 - 1e-3,))
    assert any("mean loads press a block aside" in doubt for doubt in pressed.doubts)
