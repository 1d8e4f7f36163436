"""The largest frequency of a scene and what it asks of the step."""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxshroud.march.stability import largest_eigenvalue, largest_frequency, step_report, steps_for, stiffest
from jaxshroud.march.tableau import RK4
from jaxshroud.scene.checks import StepTooLongError
from jaxshroud.scene.vary import vary


def changed(scene, **keys):
    for key, value in keys.items():
        scene = vary(scene, key.replace("__", "."), jnp.asarray(value))
    return scene


@pytest.fixture(scope="module")
def unequal(table1):
    blades = {
        "m": (0.05, 0.2),
        "m_y": (0.3, 0.08),
        "I": (2e-5, 2e-3),
        "k_x": (1e5, 4e5),
        "k_T": (900.0, 2e3),
        "c_T": (0.05, 0.5),
    }
    return changed(table1, **{f"blades__{name}": value for name, value in blades.items()}, shroud__gap=5e-4)


def gradients(scene, upper: bool) -> tuple[np.ndarray, np.ndarray]:
    """dv/dq and du/dq at q = 0 by hand: the corners' levers, and the turning of the right block's face."""
    s = scene.shroud
    alpha, gap = float(s.alpha), float(s.gap)
    l_ap, l_ob, varphi_1, varphi_2 = exact.lengths(exact.Sides(alpha, float(s.l_oa), float(s.l_ab), gap))
    a = l_ap / 2 * np.array([np.cos(varphi_1), np.sin(varphi_1)])
    b = l_ob / 2 * np.array([np.cos(varphi_2), -np.sin(varphi_2)])
    left, right = (a, -b) if upper else (b, -a)
    n, t = np.array([np.sin(alpha), -np.cos(alpha)]), np.array([np.cos(alpha), np.sin(alpha)])

    def gradient(axis, turning):
        left_turn, right_turn = (np.array([r[1], -r[0]]) @ axis for r in (left, right))  # clockwise
        return np.array([axis[0], -axis[0], axis[1], -axis[1], left_turn, -right_turn + turning])

    # v = e.n, u = e.t with e = (-gap, 0); A' = -theta_2'
    return gradient(n, gap * np.cos(alpha)), gradient(t, -gap * np.sin(alpha))


def frequency_by_hand(scene, friction: bool = True) -> float:
    """Square root of the largest eigenvalue of M^-1 K over both corner pairs, by an unsymmetric solver."""
    b = scene.blades
    inverse = np.diag(1 / np.concatenate([b.m, b.inertia_y, b.I]))
    springs = np.diag(np.concatenate([b.k_x, b.k_y, b.k_T]))
    k, k_d = float(scene.k), float(scene.friction.k_d) if friction else 0.0
    pairs = [gradients(scene, upper) for upper in (True, False)]
    stiffness = [springs + k * np.outer(v, v) + k_d * np.outer(u, u) for v, u in pairs]
    return np.sqrt(max(np.linalg.eigvals(inverse @ K).real.max() for K in stiffness))


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-9, 1e-12, 1e-15, 0.0])
def test_squares_find_the_largest_eigenvalue_beside_others(gap):
    # 2^40 products leave 2^-40 / e = 3e-13 of it, where the next one is as near as that.
    random = np.random.default_rng(7)
    turned = np.linalg.qr(random.standard_normal((64, 6, 6)))[0]
    M = 1e9 * turned @ (np.array([1, 1 - gap, 0.3, 0.1, 0, 0])[:, None] * turned.swapaxes(-1, -2))
    assert_allclose(largest_eigenvalue(jnp.asarray(M))[:, 0], np.linalg.eigvalsh(M)[:, -1], rtol=1e-12)
    assert float(largest_eigenvalue(jnp.zeros((6, 6)))[0]) == 0


@pytest.mark.parametrize("gamma", [0.0, 2.5, 100.0])
def test_it_is_that_of_a_system_of_six_springs(unequal, gamma):
    scene = vary(unequal, "contact.gamma", gamma)
    assert_allclose(largest_frequency(scene), frequency_by_hand(scene, gamma > 0), rtol=1e-10)


def test_no_friction_leaves_its_spring_out(unequal):
    loose = vary(unequal, "friction.mu", 0.0)
    assert_allclose(largest_frequency(loose), frequency_by_hand(loose, friction=False), rtol=1e-10)
    assert_allclose(largest_frequency(loose), largest_frequency(vary(unequal, "friction.k_d", 0.0)))
    # Control: the spring does count where there is friction.
    assert float(largest_frequency(unequal)) > 1.01 * float(largest_frequency(loose))


def test_without_any_contact_it_is_the_fastest_blades_own(unequal):
    free = vary(vary(unequal, "contact.k", 0.0), "friction.mu", 0.0)
    own = np.sqrt(unequal.blades.k_T / unequal.blades.I).max()  # torsion of the light left block
    assert_allclose(largest_frequency(free), own, rtol=1e-12)


def test_a_step_is_refused_warned_of_or_passed():
    # omega_max h at 100 steps of a period of 0.1 s: 1 ms times omega_max.
    assert step_report(499.0, 0.1, 100) is None
    warning = step_report(800.0, 0.1, 100)
    assert warning == (
        "steps_per_period = 100 is inaccurate: omega_max h = 0.8 (omega_max = 800 rad/s with contact and friction "
        "springs) exceeds 0.51; 157 steps would meet it"
    )
    assert step_report(2780.0, 0.1, 100).startswith("steps_per_period = 100 is inaccurate")
    with pytest.raises(StepTooLongError) as refused:
        step_report(2900.0, 0.1, 100)
    assert str(refused.value) == (
        "steps_per_period = 100 is unstable: omega_max h = 2.9 (omega_max = 2900 rad/s with contact and friction "
        "springs) exceeds 2.8; use at least 569"
    )


@pytest.mark.parametrize("steps", [1, 7, 400])
def test_the_cure_of_the_message_cures(steps):
    omega_max, period = 0.9 * 2.8 * steps / 0.01, 0.01
    need = int(step_report(omega_max, period, steps).split("; ")[1].split()[0])
    assert step_report(omega_max, period, need) is None
    assert step_report(omega_max, period, need - 1) is not None  # and no more than is needed
    assert omega_max * period / need <= 0.51


def test_the_stiffest_lane_is_the_one_that_needs_most_steps(table1):
    # The slow drive needs more steps per period than the stiffer scene with a fast one.
    lanes = jax.vmap(lambda k, w: vary(vary(table1, "contact.gamma", k), "drive.omega", w))
    scenes = lanes(jnp.array([2.5, 100.0, 1.0]), jnp.array([100.0, 1000.0, 536.0]))
    omega_max, period = stiffest(scenes, 1)
    assert_allclose(omega_max, largest_frequency(vary(table1, "contact.gamma", 2.5)), rtol=1e-12)
    assert_allclose(period, 2 * np.pi / 100.0, rtol=1e-15)
    alone = (largest_frequency(table1), table1.drive.period)
    assert_allclose(stiffest(table1, 0), alone, rtol=1e-14)


def test_an_overdamped_motion_counts_by_its_fastest_decay(table1):
    heavy = vary(table1, "blades.c_x", 4e3)  # exp(-t c / m) nearly: 5e4 rad/s against 7.7e3
    fastest = np.abs(np.roots([0.08, 4e3, 1e5])).max()
    assert_allclose(largest_frequency(heavy), fastest, rtol=1e-12)
    # RK4 follows such a decay up to 2.78 of it a step, and no further.
    T = float(table1.drive.period)
    with pytest.raises(StepTooLongError):
        steps_for(heavy, 0, int(fastest * T / 2.85), RK4)
    assert steps_for(heavy, 0, int(fastest * T / 2.7), RK4) == int(fastest * T / 2.7)


def test_automatic_steps_follow_the_stiffness(table1):
    auto = [steps_for(vary(table1, "contact.gamma", g), 0, "auto", RK4) for g in (0.0, 10.0, 1e2, 1e4)]
    assert auto == sorted(auto)
    T = float(table1.drive.period)
    product = [
        float(largest_frequency(vary(table1, "contact.gamma", g))) * T / n
        for g, n in zip((0.0, 1e4), auto[::3], strict=True)
    ]
    assert_allclose(product, [0.2, 0.02], rtol=0.01)
    with pytest.raises(StepTooLongError, match="too slow"):
        steps_for(vary(table1, "drive.omega", 1e-3), 0, "auto", RK4)
    with pytest.raises(ValueError, match="at least 8"):
        steps_for(vary(table1, "drive.omega", 1e5), 0, 4, RK4)
