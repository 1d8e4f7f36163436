"""A drive of one's own, with a second harmonic: it is defined here and drives a pair as it stands."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.model.arithmetic import sincos_turns
from jaxshroud.model.drive import excitation
from jaxshroud.model.linear import area, free_power, steady_amplitudes
from jaxshroud.model.series import Series
from jaxshroud.scene.config import parse
from jaxshroud.scene.drive import DriveHarmonic
from jaxshroud.scene.fields import PerBlade, per_blade
from jaxshroud.scene.keys import Motion

F_2, M_2, PHASE_2 = (25.0, 40.0), (0.04, 0.07), (0.3, 1.9)
COORDINATES = ("x", "y", "theta")


class TwoHarmonics(js.Drive):
    """The drive of the article, and a force and a moment of twice its frequency in the same direction."""

    F_2: PerBlade = eqx.field(converter=per_blade)  # [N]
    M_2: PerBlade = eqx.field(converter=per_blade)  # [N m]
    phase_2: PerBlade = eqx.field(converter=per_blade)  # [rad]

    def harmonics(self) -> dict[int, DriveHarmonic]:
        return {**super().harmonics(), 2: DriveHarmonic(self.beta, self.F_2, self.M_2, self.phase_2)}


def driven_twice(scene, F=F_2, M=M_2, phase=PHASE_2):
    """The scene with the second harmonic added to its drive."""
    d = scene.drive
    return eqx.tree_at(lambda s: s.drive, scene, TwoHarmonics(d.omega, d.beta, d.F_0, d.M_0, d.phase, F, M, phase))


def table1(*changes):
    return js.load("table1", ["drive.M_0=0.1", "contact.gamma=2.5", *changes]).scene


def closed_form(scene):
    """The complex amplitudes of the free blades by coordinate and order of the harmonic, by NumPy alone."""
    b, d, omega = (jax.tree.map(np.asarray, a) for a in (scene.blades, scene.drive, scene.drive.omega))
    inertia = {"x": (b.m, b.c_x, b.k_x), "y": (b.m, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    found = {}
    for n, F, M, phase in ((1, d.F_0, d.M_0, d.phase), (2, d.F_2, d.M_2, d.phase_2)):
        loads = {"x": F * np.cos(d.beta), "y": F * np.sin(d.beta), "theta": M}
        for name, (m, c, k) in inertia.items():
            stiffness = k - m * (n * omega) ** 2 + 1j * n * omega * c
            found[name, n] = loads[name] * np.exp(1j * phase) / stiffness
    return found


def at_phase(amplitudes, name, tau, rate=False):
    """The free displacement (times, blades) at phases `tau`, or its rate per radian."""
    parts = [(1j * n if rate else 1) * amplitudes[name, n] * np.exp(1j * n * tau[:, None]) for n in (1, 2)]
    return np.imag(sum(parts))


def on_steady_motion(scene, amplitudes):
    """The scene started on the steady motion of the free blades."""
    zero, omega = np.zeros(1), float(scene.drive.omega)
    places = [at_phase(amplitudes, name, zero)[0] for name in COORDINATES]
    rates = [omega * at_phase(amplitudes, name, zero, rate=True)[0] for name in COORDINATES]
    return eqx.tree_at(lambda s: s.initial, scene, Motion(*map(jnp.asarray, places + rates)))


def test_free_blades_follow_both_harmonics():
    # In closed form, to rounding: the steady amplitudes, the motion, and the power P_0 by the trapezoidal rule.
    scene = driven_twice(table1("parts.contact=none"))
    expected, s = closed_form(scene), scene.shroud
    for n, found in steady_amplitudes(scene).items():
        for name in COORDINATES:
            assert_allclose(getattr(found, name), expected[name, n], rtol=1e-12, atol=0)
    run = js.simulate(on_steady_motion(scene, expected), n_periods=3, method=js.RungeKutta(steps=64))
    tau = np.asarray(run.t) * float(scene.drive.omega)
    for name in COORDINATES:
        wanted = at_phase(expected, name, tau)
        assert_allclose(getattr(run.motion, name), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    tau = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    x, y, theta = (at_phase(expected, name, tau) for name in COORDINATES)
    gyration = float(s.l_oa**2 + s.l_ab**2) / 12
    square = np.mean(x**2 + y**2 + gyration * 4 * np.sin(theta / 2) ** 2, axis=0)
    assert_allclose(free_power(scene), float(area(s)) * square, rtol=1e-12)
    # Control: the first harmonic alone.
    assert np.all(np.abs(free_power(table1()) / free_power(scene) - 1) > 0.01)


def test_waves_have_the_rates_and_the_series_of_their_harmonics():
    orders = {n: DriveHarmonic(*(jnp.asarray([0.2, 0.9]) * k for k in range(1, 5))) for n in (0, 1, 2, 3, 6)}

    class Many(js.Drive):
        def harmonics(self):
            return orders

    both, turns = excitation(Many(536.0, 0.0, 1.0, 1.0, 0.0)), jnp.asarray(0.137)
    blades = [jax.tree.map(lambda a, i=i: a[i], both) for i in (0, 1)]
    start = [Series(lambda n, a=a: a) for a in sincos_turns(turns)]
    for i, blade in enumerate(blades):
        rates, series = blade.wave_rate(*sincos_turns(turns + 0.25)), blade.wave(*start)
        for (n, one), rate, terms in zip(orders.items(), rates, series, strict=True):
            angle = lambda tau, n=n, phase=float(one.phase[i]): n * tau + phase
            tau, later = 2 * math.pi * 0.137, 2 * math.pi * 0.137 + 0.05
            assert float(rate) == pytest.approx(n * math.cos(angle(tau)), abs=1e-14 * (1 + n))
            total = sum(float(terms[k]) * 0.05**k for k in range(16))
            assert total == pytest.approx(math.sin(angle(later)), abs=1e-13)
    force = blades[1].force("y", blades[1].wave(*sincos_turns(turns)))
    tau = 2 * math.pi * 0.137
    wanted = sum(float(one.F_y[1]) * math.sin(n * tau + float(one.phase[1])) for n, one in orders.items())
    assert float(force) == pytest.approx(wanted, rel=1e-13)


def test_it_marches_as_the_list_of_harmonics_that_says_the_same():
    own = driven_twice(table1())
    second = js.Harmonic(2, F_2, own.drive.beta, M_2, PHASE_2)  # phases of the drive times 2 are whole turns
    first = js.Harmonic(1, own.drive.F_0, own.drive.beta, own.drive.M_0)
    listed = js.Drive(own.drive.omega, None, None, None, own.drive.phase, harmonic=(first, second))
    scenes = own, eqx.tree_at(lambda s: s.drive, own, listed)
    found, wanted = (js.simulate(scene, n_periods=2, method=js.RungeKutta(steps=400)) for scene in scenes)
    assert found.counters["separation"] > 0
    assert_allclose(found.motion.x, wanted.motion.x, rtol=0, atol=1e-11 * np.abs(wanted.motion.x).max())


def test_what_concerns_all_harmonics_follows_from_them():
    drive = driven_twice(table1()).drive
    later, larger = drive.advanced(0.1), drive.scaled(2.0)
    assert_allclose(later.phase_2, np.asarray(drive.phase_2) + 0.2)
    assert_allclose(later.phase, np.asarray(drive.phase) + 0.1)
    assert_array_equal(larger.F_2, 2 * np.asarray(drive.F_2))
    assert_array_equal(larger.M_0, 2 * np.asarray(drive.M_0))
    assert_array_equal(larger.phase, drive.phase)


def test_a_file_cannot_name_it():
    run = js.simulate(driven_twice(table1("parts.contact=none")), n_periods=3, method=js.RungeKutta(steps=64))
    with pytest.raises(js.SceneError, match="no key `own`"):
        parse(run.scene, "the scene")
