"""A drive of one's own, with a second harmonic: it is defined here and drives a pair as it stands."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from pair_views import rates_in

import jaxshroud as js
from jaxshroud.batch.xla import vmapped
from jaxshroud.model.arithmetic import sincos_turns
from jaxshroud.model.drive import excitation
from jaxshroud.model.linear import area, free_power, steady_amplitudes
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import prepared_row, row_rhs
from jaxshroud.model.series import Series
from jaxshroud.scene.config import parse
from jaxshroud.scene.drive import DriveHarmonic
from jaxshroud.scene.fields import PerBlade, per_blade
from jaxshroud.scene.keys import Motion

F_2, M_2, PHASE_2 = (25.0, 40.0), (0.04, 0.07), (0.3, 1.9)
PLAIN = reference.table1(M_0=0.1, gamma=2.5)
COORDINATES = ("x", "y", "theta")


class TwoHarmonics(js.Drive):
    """The drive of the article, and a force and a moment of twice its frequency in the same direction."""

    F_2: PerBlade = eqx.field(converter=per_blade)  # [N]
    M_2: PerBlade = eqx.field(converter=per_blade)  # [N m]
    phase_2: PerBlade = eqx.field(converter=per_blade)  # [rad]

    def harmonics(self) -> dict[int, DriveHarmonic]:
        return {**super().harmonics(), 2: DriveHarmonic(self.beta, self.F_2, self.M_2, self.phase_2)}


class ReferenceRun(reference._Run):
    """The second opinion with the same forces added to Eq. (1)."""

    def rhs(self, t, y):
        rates, p = super().rhs(t, y), self.p
        for i in (0, 1):
            swing = math.sin(2 * p.omega * t + PHASE_2[i])
            rates[6 + i] += F_2[i] * math.cos(p.beta[i]) * swing / p.m[i]
            rates[8 + i] += F_2[i] * math.sin(p.beta[i]) * swing / p.m_y[i]
            rates[10 + i] += M_2[i] * swing / p.I[i]
        return rates


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
            np.testing.assert_allclose(getattr(found, name), expected[name, n], rtol=1e-12, atol=0)
    run = js.simulate(on_steady_motion(scene, expected), n_periods=3, method=js.RungeKutta(steps=64))
    tau = np.asarray(run.t) * float(scene.drive.omega)
    for name in COORDINATES:
        wanted = at_phase(expected, name, tau)
        np.testing.assert_allclose(getattr(run.motion, name), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    tau = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    x, y, theta = (at_phase(expected, name, tau) for name in COORDINATES)
    gyration = float(s.l_oa**2 + s.l_ab**2) / 12
    square = np.mean(x**2 + y**2 + gyration * 4 * np.sin(theta / 2) ** 2, axis=0)
    np.testing.assert_allclose(free_power(scene), float(area(s)) * square, rtol=1e-12)
    # Control: the first harmonic alone.
    assert np.all(np.abs(free_power(table1()) / free_power(scene) - 1) > 0.01)


@pytest.mark.full
def test_power_of_free_blades_is_that_of_both_harmonics():
    # A run in closed form counts every harmonic in P, as P_0 does: there is no reduction.
    scene = driven_twice(table1("parts.contact=none", "blades.c_x=100", "blades.c_y=200", "blades.c_T=2"))
    power = js.power(scene, n_periods=2, transient=60, method=js.RungeKutta(steps=64))
    np.testing.assert_allclose(power.P_d, 0.0, rtol=0, atol=1e-9)


@pytest.mark.full
def test_a_constant_load_is_harmonic_0():
    scene = driven_twice(table1("parts.contact=none"))
    bent = eqx.tree_at(lambda s: s.drive, scene, Pressed(*jax.tree.leaves(scene.drive)))
    static = np.asarray(scene.drive.F_2 * jnp.cos(scene.drive.beta) * jnp.sin(scene.drive.phase_2) / scene.blades.k_x)
    np.testing.assert_allclose(np.imag(steady_amplitudes(bent)[0].x), static, rtol=1e-12)
    run = js.simulate(js.vary(bent, "blades.c_x", 200.0), n_periods=40, method=js.RungeKutta(steps=64))
    x = np.asarray(run.motion.x)[-64:]
    np.testing.assert_allclose(x.mean(axis=0), static, rtol=1e-9)


class Pressed(TwoHarmonics):
    """The second force is constant."""

    def harmonics(self) -> dict[int, DriveHarmonic]:
        first, second = super().harmonics().values()
        return {0: second, 1: first}


def test_waves_have_the_rates_and_the_series_of_their_harmonics():
    orders = {n: DriveHarmonic(*(jnp.asarray([0.2, 0.9]) * k for k in range(1, 5))) for n in (0, 1, 2, 3, 6)}

    class Many(js.Drive):
        def harmonics(self):
            return orders

    drive = excitation(Many(536.0, 0.0, 1.0, 1.0, 0.0))
    blades = [jax.tree.map(lambda a, i=i: a[i], drive) for i in (0, 1)]
    turns = jnp.asarray(0.137)
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


PERIODS, STEPS = 3, 12800
METHODS = {"rk4": js.RungeKutta("rk4", STEPS), "series": js.Taylor(tolerance=1e-12, steps=400)}


@pytest.fixture(scope="module")
def opinion():
    """Positions (periods, 6) of the plain integrator from rest, and its events."""
    run, found = ReferenceRun(PLAIN, 1e-12), []
    for period in range(1, PERIODS + 1):
        run.advance(period * run.period)
        assert run.status == "ok"
        found.append(run.y[:6].copy())
    return np.array(found), run.counts


def positions(scene, method):
    """Positions (periods, 6) at the ends of periods."""
    run = js.simulate(scene, n_periods=PERIODS, method=method)
    assert not run.status
    each = method.steps
    return np.concatenate([np.asarray(getattr(run.motion, name))[each::each] for name in COORDINATES], axis=-1), run


def error_of(found, opinion):
    """The largest difference of each coordinate over its size."""
    return np.max(np.abs(found - opinion), axis=0) / np.max(np.abs(opinion), axis=0)


@pytest.mark.full
@pytest.mark.parametrize("name", METHODS)
def test_a_pair_in_contact_is_that_of_a_plain_integrator(name, opinion):
    # Three periods from rest with some dozens of events. Both march to about 1e-11; contact lets that grow.
    wanted, counts = opinion
    assert counts["separation"] >= 3
    found, run = positions(driven_twice(table1()), METHODS[name])
    assert np.all(error_of(found, wanted) < 1e-8), error_of(found, wanted)
    assert abs(float(run.energy_residual)) < 1e-9
    # Control: without the second harmonic the motion is another.
    alone, _ = positions(table1(), METHODS[name])
    assert np.all(error_of(alone, wanted) > 0.05)


def test_what_concerns_all_harmonics_follows_from_them():
    drive = driven_twice(table1()).drive
    later, larger = drive.advanced(0.1), drive.scaled(2.0)
    np.testing.assert_allclose(later.phase_2, np.asarray(drive.phase_2) + 0.2)
    np.testing.assert_allclose(later.phase, np.asarray(drive.phase) + 0.1)
    np.testing.assert_array_equal(larger.F_2, 2 * np.asarray(drive.F_2))
    np.testing.assert_array_equal(larger.M_0, 2 * np.asarray(drive.M_0))
    np.testing.assert_array_equal(larger.phase, drive.phase)


def test_a_file_cannot_name_it():
    run = js.simulate(driven_twice(table1("parts.contact=none")), n_periods=3, method=js.RungeKutta(steps=64))
    with pytest.raises(js.SceneError, match="no key `own`"):
        parse(run.scene, "the scene")


def test_blades_of_a_row_feel_both_harmonics_as_those_of_a_pair():
    # Apart and at rest the accelerations are the drive alone: those of a row of two are those of the pair, to rounding.
    changes = ["row.blades=2", "row.closed=false", 'drive.phase=["0 deg","180 deg"]', "drive.beta=30 deg"]
    row, pair = driven_twice(table1(*changes)), prepared_row(driven_twice(table1()))
    wave, zero, apart = sincos_turns(jnp.asarray(0.137)), jnp.zeros((2, 1)), jnp.zeros((1, 1), jnp.int32)
    model = jax.tree.map(lambda a: a[..., None], prepared_row(row))
    now = State(Motion(*[zero] * 6), jnp.zeros((1, 1)), apart, apart)
    in_row, _ = row_rhs(tuple(a[None] for a in wave), now, None, model, Recorded(), vmapped)
    still = Motion(*[(jnp.asarray(0.0),) * 2] * 6)
    in_pair = rates_in(State(still, jnp.asarray(0.0), jnp.int32(0), jnp.int32(0)), pair, wave)
    for found, wanted in zip(in_row.acceleration, in_pair.acceleration, strict=True):
        np.testing.assert_allclose(found[:, 0], wanted, rtol=1e-14)
