"""Drives of several harmonics: closed forms without contact, the march against the plain integrator, identities."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

import jaxshroud as js
from jaxshroud.model.linear import area, free_power, steady_amplitudes
from jaxshroud.scene.drive import Drive, Harmonic

PLAIN = reference.table1(M_0=0.1, gamma=2.5)
F_2, M_2, PHASE_2 = (25.0, 40.0), (0.04, 0.07), (0.3, 1.9)
COORDINATES = ("x", "y", "theta")


def with_orders(scene, *harmonics, phase=None, omega=None):
    """The scene driven by harmonics (order, F, M, phase) in the directions of its own force."""
    d = scene.drive
    own = tuple(Harmonic(n, F, d.beta, M, psi) for n, F, M, psi in harmonics)
    drive = Drive(
        d.omega if omega is None else omega, None, None, None, d.phase if phase is None else phase, harmonic=own
    )
    return js.vary(_replaced(scene, drive), "drive.omega", drive.omega)


def _replaced(scene, drive):
    return type(scene)(
        scene.blades, scene.shroud, scene.contact, scene.friction, drive, scene.initial, scene.parts, row=scene.row
    )


def table1(*changes):
    return js.load("table1", ["drive.M_0=0.1", "contact.gamma=2.5", *changes]).scene


def twice(scene):
    """The scene with its own force as the first of two harmonics."""
    return with_orders(scene, (1, scene.drive.F_0, scene.drive.M_0, None), (2, F_2, M_2, PHASE_2))


class ReferenceRun(reference._Run):
    """The second opinion with the same forces added to Eq. (1)."""

    def rhs(self, t, y):
        rates, p = super().rhs(t, y), self.p
        for i in (0, 1):
            swing = math.sin(2 * (p.omega * t + p.phase[i]) + PHASE_2[i])
            rates[6 + i] += F_2[i] * math.cos(p.beta[i]) * swing / p.m[i]
            rates[8 + i] += F_2[i] * math.sin(p.beta[i]) * swing / p.m_y[i]
            rates[10 + i] += M_2[i] * swing / p.I[i]
        return rates


def positions(scene, method, periods=3):
    """Positions (periods, 3 blades) at the ends of periods."""
    run = js.simulate(scene, n_periods=periods, method=method)
    assert not np.any(run.status)
    each = method.steps
    return np.concatenate([np.asarray(getattr(run.motion, name))[each::each] for name in COORDINATES], axis=-1)


@pytest.mark.full
def test_one_harmonic_of_order_1_is_the_drive_bit_for_bit():
    scene, method = table1(), js.RungeKutta(steps=200)
    again = with_orders(scene, (1, scene.drive.F_0, scene.drive.M_0, None))
    assert_array_equal(positions(again, method), positions(scene, method))
    assert_array_equal(free_power(again), free_power(scene))


@pytest.mark.full(but=["rk4"])
@pytest.mark.parametrize("name", ["rk4", "series"])
def test_two_harmonics_march_as_the_plain_integrator_says(name):
    # From rest over three periods, from 2e-9 (measured) to rounding of the events; without harmonic 2 all differs.
    run, wanted = ReferenceRun(PLAIN, 1e-12), []
    for period in (1, 2, 3):
        run.advance(period * run.period)
        wanted.append(run.y[:6].copy())
    wanted, size = np.array(wanted), np.abs(wanted).max(axis=0)
    method = {"rk4": js.RungeKutta("rk4", 12800), "series": js.Taylor(tolerance=1e-12, steps=400)}[name]
    assert_array_less(np.abs(positions(twice(table1()), method) - wanted).max(axis=0) / size, 1e-8)
    assert np.all(np.abs(positions(table1(), method) - wanted).max(axis=0) / size > 0.01)


@pytest.mark.full
def test_a_row_feels_harmonics_as_a_pair_does():
    pair = twice(table1())
    row = js.load("table1", ["drive.M_0=0.1", "contact.gamma=2.5", "row.blades=2", "row.closed=false"]).scene
    method = js.RungeKutta(steps=400)
    found, wanted = positions(twice(row), method, 2), positions(pair, method, 2)
    assert_allclose(found, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.full
def test_order_3_of_a_third_of_the_frequency_is_the_drive():
    # One base period is three periods of the drive; phi / 3 times 3 is phi.
    scene = table1()
    slow = with_orders(
        scene, (3, scene.drive.F_0, scene.drive.M_0, None), phase=scene.drive.phase / 3, omega=scene.drive.omega / 3
    )
    wanted = positions(scene, js.RungeKutta(steps=800))[2]
    assert_allclose(positions(slow, js.RungeKutta(steps=2400), 1)[0], wanted, rtol=0, atol=1e-12)


@pytest.mark.full
def test_the_second_harmonic_of_opposite_phases_is_in_phase():
    alike = with_orders(table1(), (2, 30.0, 0.05, None))
    motion = js.simulate(alike, n_periods=2, method=js.RungeKutta(steps=100)).motion
    assert np.abs(motion.x[:, 0]).max() > 1e-5
    for name in COORDINATES:
        left, right = np.asarray(getattr(motion, name)).T
        assert_allclose(left, right, rtol=0, atol=1e-13 * max(np.abs(left).max(), 1e-9))


def test_power_and_amplitudes_without_contact_are_those_of_all_harmonics():
    # The mean of sin^2(theta/2) against four times as many points; angles up to 30 rad.
    scene = with_orders(table1("parts.contact=none"), (1, 60.0, 3e4, None), (4, 9.0, 1e5, 0.7), (7, 20.0, 5e5, None))
    free, tau = steady_amplitudes(scene), 2 * np.pi * np.arange(8192) / 8192
    at = lambda name: np.imag(
        sum(np.asarray(getattr(one, name))[:, None] * np.exp(1j * n * tau) for n, one in free.items())
    )
    gyration = float(scene.shroud.l_oa**2 + scene.shroud.l_ab**2) / 12
    square = np.mean(at("x") ** 2 + at("y") ** 2 + 4 * gyration * np.sin(at("theta") / 2) ** 2, axis=1)
    assert 5 < np.abs(at("theta")).max() < 50
    assert_allclose(free_power(scene), float(area(scene.shroud)) * square, rtol=1e-13)
    slow = jax.tree.map(np.asarray, free[4])
    stiff = 1e5 - 0.08 * (4 * 536.0) ** 2 + 4j * 536.0 * 3.57
    assert_allclose(slow.x[0], 9.0 * np.cos(np.pi / 6) * np.exp(0.7j) / stiff, rtol=1e-3)


def test_check_tells_all_orders_and_their_resonances():
    scene = with_orders(table1("drive.omega=300"), (1, 1.0, 0.0, None), (4, 1.0, 0.0, None))
    near = js.vary(scene, "drive.omega", float(math.tau * 177.94 / 4))
    sheet = js.check(near)
    assert sheet.harmonics == (1, 4)
    assert {1.0, 4.0} <= set(sheet.engine_orders)
    assert any("harmonic 4 of the drive is at the resonance of bending along x" in doubt for doubt in sheet.doubts)
    assert not any("the drive is at the resonance" in d for d in js.check(table1()).doubts)


@pytest.mark.full
def test_gradients_by_harmonics_are_differences():
    # A settled motion of period 1: the slope of P_d by each number, against central differences.
    scene = js.vary(
        twice(table1("blades.c_x=100", "contact.gamma=0.6", "shroud.gap=-0.2 mm", 'parts.motion=["x", "y"]')),
        "drive.level",
        1.0,
    )
    keys = ["drive.level", "drive.harmonic[1].F[0]", "drive.harmonic[1].phase[1]", "drive.harmonic[0].F"]
    method = js.RungeKutta(steps=400)
    found = js.gradient(scene, keys, of="P_d", method=method)
    assert found.kind == "periodic", found
    for key in keys:
        step = 1e-4 * (abs(js.value_of(scene, key)) or 1.0)
        ends = [
            js.power(
                js.vary(scene, key, js.value_of(scene, key) + side * step), n_periods=4, transient=400, method=method
            )
            for side in (-1, 1)
        ]
        wanted = (ends[1].P_d - ends[0].P_d) / (2 * step)
        assert_allclose(found.value[key], np.mean(wanted), rtol=1e-5)
    assert jnp.isfinite(found.value["drive.level"])
