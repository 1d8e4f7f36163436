"""The bilinear friction element of Eq. (2)."""

import equinox as eqx
import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from pair_views import contact_of, view_in

from jaxshroud.march.event import first_kind
from jaxshroud.march.events import EVENTS, transition
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State, prepared_law
from jaxshroud.model.row import RowModel, prepared_row
from jaxshroud.model.spring_contact import BilinearContact, slip_sign
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.vary import vary

K, K_D, MU = 1e6, 1e6, 0.5
LAW = BilinearContact(*(jnp.asarray(value) for value in (K, K_D, MU, MU * K / K_D)))
MODES = jnp.arange(4, dtype=jnp.int32)
AMPLITUDE, STEPS = 2e-4, 64  # [m]; steps in a quarter of a cycle


@eqx.filter_jit
def led(row: RowModel, motions: Motion) -> tuple[jax.Array, jax.Array]:
    """Friction force and slide along a prescribed motion, under the transitions of `events`."""

    def step(held: State, z: Motion) -> tuple[State, tuple[jax.Array, jax.Array]]:
        stayed = State(z, held.u_s, held.mode, held.case)
        view = view_in(stayed, row)
        violated = {kind: view.guards.value[kind] > 0 for kind in range(len(EVENTS))}
        due = jnp.any(jnp.stack(list(violated.values())))
        fired = transition(
            stayed, view, first_kind(violated), jnp.asarray(0.0), jnp.asarray(0.0), contact_of(row)
        ).after
        held = jax.tree.map(lambda a, b: jnp.where(due, a, b), fired, stayed)
        return held, (contact_of(row).law.friction_force(view.at.v, view.at.u, held.u_s, held.mode), view.at.u)

    first = jax.tree.map(lambda a: a[0], motions)
    apart = State(first, jnp.zeros(()), jnp.int32(Mode.APART), jnp.int32(0))
    return jax.lax.scan(step, apart, motions)[1]


def rubbed(scene, N: float) -> tuple[np.ndarray, np.ndarray]:
    """Force and slide over one cycle, after a first one, of the left block led up and down the right one's face."""
    ready = prepared_row(vary(vary(vary(scene, "contact.k", K), "friction.k_d", K_D), "friction.mu", MU))
    sides = exact.Sides(*(float(value) for value in vars(scene.shroud).values() if value is not None))
    way = np.concatenate([np.arange(STEPS), np.arange(STEPS, -STEPS, -1), np.arange(-STEPS, 0)])
    u = AMPLITUDE / STEPS * np.tile(way, 2)
    ahead = np.sign(np.roll(u, -1) - u)
    along = exact.approach(sides, 3, (0.0, 0.0), 0.0, 1.0)
    middle = exact.placed(sides, 3, (0.0, 0.0), N / K, 1e-3)  # 1 mm above the corner: case 3 all the way
    q, rate = middle[:, None] + np.outer(along, u), np.outer(along, ahead)
    F, slide = led(ready, exact.motion(jnp.asarray(q), jnp.asarray(rate)))
    return np.asarray(F)[4 * STEPS :], np.asarray(slide)[4 * STEPS :]


def loop_area(F: np.ndarray, u: np.ndarray) -> float:
    return float(np.sum((F + np.roll(F, -1)) / 2 * (np.roll(u, -1) - u)))


@pytest.mark.parametrize("steps_of_stretch", [4, 16, 48])
def test_the_hysteresis_loop_has_the_area_of_a_parallelogram(table1, steps_of_stretch):
    # Constant N: corners of the loop at whole steps, so that the trapezoidal rule is exact for it.
    slack = AMPLITUDE * steps_of_stretch / STEPS  # mu N / k_d
    N = slack * K_D / MU
    F, u = rubbed(table1, N)
    area = 4 * MU * N * (AMPLITUDE - slack)
    assert_allclose(loop_area(F, u), area, rtol=1e-11)  # v = 1e-5 m is known to 1e-17 m
    assert_allclose([F.max(), -F.min()], MU * N, rtol=1e-11)
    assert loop_area(F, u) < 0.97 * 4 * MU * N * AMPLITUDE  # control: rigid Coulomb friction would lose more


def test_a_cycle_within_the_slack_loses_nothing(table1):
    # mu N / k_d beyond the amplitude (and the stretch left by the first approach): stick throughout.
    F, u = rubbed(table1, 2.5 * AMPLITUDE * K_D / MU)
    assert abs(loop_area(F, u)) < 1e-12 * K_D * AMPLITUDE**2
    assert_allclose(F - F.mean(), K_D * (u - u.mean()), atol=1e-10 * K_D * AMPLITUDE)


def test_force_and_stretch_by_mode():
    v, u, u_s = (jnp.asarray(value) for value in (3e-4, 5e-4, 4e-4))
    F = [float(LAW.friction_force(v, u, u_s, mode)) for mode in MODES]
    w = [float(LAW.stretch(v, u, u_s, mode)) for mode in MODES]
    assert_allclose(F, [0.0, 100.0, 150.0, -150.0], rtol=1e-12)  # k_d (u - u_s); +- mu k v
    assert_allclose(w, np.array(F) / K_D, rtol=1e-12)  # Eq. (2) in every mode
    assert_allclose([LAW.normal_force(v, mode) for mode in MODES], [0.0, 300.0, 300.0, 300.0])
    assert [float(slip_sign(mode, v.dtype)) for mode in MODES] == [0.0, 0.0, 1.0, -1.0]
    energy = [float(LAW.stored_energy(v, jnp.asarray(s), mode)) for s, mode in zip(w, MODES, strict=True)]
    assert_allclose(energy, [0.0, *(300.0**2 / (2 * K) + f**2 / (2 * K_D) for f in F[1:])], rtol=1e-12)


def test_the_slider_moves_as_the_corner_less_the_stretch():
    # u_s = u - w along any motion v(t), u(t), whatever N does.
    v, u, v_rate, u_rate = jnp.asarray(np.random.default_rng(6).normal(size=(4, 500)))

    @jax.jit
    @jax.vmap
    def both(v, u, v_rate, u_rate):
        def moved(mode):
            slider = lambda v, u: u - LAW.stretch(v, u, u, mode)
            return jax.jvp(slider, (v, u), (v_rate, u_rate))[1], LAW.slider_speed(v_rate, u_rate, mode)

        return [moved(mode) for mode in MODES[2:]]

    for derivative, speed in both(v, u, v_rate, u_rate):
        assert_allclose(speed, derivative, rtol=1e-13, atol=1e-14)
    assert not any(float(LAW.slider_speed(v[0], u[0], mode)) for mode in MODES[:2])  # no slider, or a held one


@pytest.mark.parametrize("key", ["contact.k", "friction.k_d", "friction.mu"])
def test_no_stiffness_or_no_coefficient_is_no_friction(table1, key):
    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def summed(value):
        law = prepared_law(vary(table1, key, value))
        v, u, u_s = jnp.asarray(1e-4), jnp.asarray(3e-4), jnp.asarray(1e-4)
        F = jnp.stack([law.friction_force(v, u, u_s, mode) for mode in MODES[2:]])
        speed = law.slider_speed(v, u, MODES[2])
        return jnp.sum(F**2) + law.mu + law.lag + 0.0 * speed

    value, slope = summed(jnp.asarray(0.0))
    # Friction is switched, so the slope at 0 is that of no friction; what matters is that 0/0 leaves no NaN behind.
    assert float(value) == 0.0
    assert np.isfinite(slope)
    value, slope = summed(jnp.asarray(0.3))  # control: with friction there is both
    assert float(value) > 0
    assert np.isfinite(slope)
    assert float(slope) != 0
