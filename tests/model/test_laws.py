"""Own laws of contact and friction: their energy and work, how they are marched, and what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from side_by_side import with_parts

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march import stability
from jaxshroud.march.method import FAST_WITH_LEDGER
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StepTooLongError

K = 2.5e5
NORMALS = {"hertz": js.Hertz(K / 1e-5**0.5), "damped": js.DampedSpring(K, 3 * K, 2e-5, 20.0)}
FRICTIONS = {
    "coulomb": js.RegularisedCoulomb(0.3, 5e-2),
    "lugre": js.LuGre(1e5, 5.0, 0.3, 10.0),
}
LAWS = {
    "hertz, coulomb": (NORMALS["hertz"], FRICTIONS["coulomb"]),
    "damped, lugre": (NORMALS["damped"], FRICTIONS["lugre"]),
}
GAPS = jnp.asarray([1e-5, 2.2e-5, 4e-5])


class Spring(eqx.Module):
    """The built-in spring as an own law."""

    k: jax.Array

    def __call__(self, v, v_t):
        return self.k * v, self.k * v * v / 2


class Leak(eqx.Module):
    """Control: a friction law whose energy forgets half of what its bristles store."""

    law: js.LuGre

    def __call__(self, z, u_t, N):
        F, z_t, energy = self.law(z, u_t, N)
        return F, z_t, 0.5 * energy


def with_laws(scene, normal, friction=None, z=0.0):
    return js.with_contact_law(scene, js.Laws(normal, friction, z))


def at_gaps(scene):
    return jax.vmap(lambda gap: js.vary(scene, "shroud.gap", gap))(GAPS)


def imbalance(scene, steps):
    """Largest residual of the energy balance of any period over the drive's mean gross work in one."""
    scenes = at_gaps(scene)
    run = run_lanes(scenes, initial_states(scenes), Plan(0, 2, steps, 0.0, FAST_WITH_LEDGER), lambda _: None)
    assert np.all(run.last.status == Status.OK)
    assert np.all(run.log.counters.separation > 0)
    return np.max(np.abs(run.samples.residual).max(axis=-1) / run.samples.gross.mean(axis=-1))


@pytest.mark.release(only=["cases-damped, lugre", "cases-hertz, coulomb"])
@pytest.mark.full
@pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize(
    ("options", "motion"),
    [([], ("x",)), ([], ("x", "y", "theta")), (['blades.I="block"', 'drive.M_0="0.5 N m"'], ("x", "y", "theta"))],
    ids=["x", "cases", "flat"],
)
def test_energy_is_balanced_by_the_laws_own(options, motion, laws):
    # RK4 misses by a corner of a law (v = 0 of Hertz, the depth of the other) inside a step: 1e-8 takes small steps.
    base = with_parts(js.load("table1", ["contact.gamma=2.5", "drive.F_0=60", *options]).scene, motion=motion)
    assert imbalance(with_laws(base, *laws), 32000) < 1e-8


def test_a_law_that_forgets_energy_is_seen_in_no_balance_but_in_its_work():
    # What is not stored counts as dissipated, so that the balance closes for any energy; the law's own losses tell.
    base = with_parts(js.load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene, motion=("x",))
    js.check_laws(with_laws(base, *LAWS["damped, lugre"]))
    with pytest.raises(js.InputError, match="friction law gives out more work"):
        js.check_laws(with_laws(base, NORMALS["hertz"], Leak(js.LuGre(1e5, 0.0, 0.3, 10.0))))


@pytest.mark.parametrize("normal", NORMALS.values(), ids=NORMALS)
@pytest.mark.parametrize("friction", [None, *FRICTIONS.values()], ids=["none", *FRICTIONS])
def test_the_laws_that_are_shipped_are_passive(table1, normal, friction):
    js.check_laws(with_laws(table1, normal, friction))


@pytest.mark.parametrize(
    ("normal", "friction", "told"),
    [
        (lambda v, v_t: (K * v - 10 * v_t, K * v**2 / 2), None, "normal law gives out more work"),
        (lambda v, v_t: (K * v, K * v**2 / 2 + 1e-3), None, "nothing is pressed"),
        (lambda v, v_t: (K * v + 9 * v_t, K * v**2 / 2 + v_t**2), None, "depend on nothing but"),
        (Spring(jnp.asarray(K)), lambda z, u_t, N: (u_t / N, 0 * z, 0 * z), "not finite"),
        (Spring(jnp.asarray(K)), lambda z, u_t, N: (-N * jnp.tanh(u_t), 0 * z, 0 * z), "friction law gives out"),
        # Bristles that cannot follow where N ends: k_d N_0 / c is 10 N/s. Their rate is 1e6 times the cycle's.
        (Spring(jnp.asarray(K)), js.LuGre(1e6, 100, 0.5, 1e-3), "friction law gives out"),
        (lambda v, v_t: (v / (v - v), 0 * v), FRICTIONS["lugre"], "normal law is not finite"),
        (Spring(jnp.asarray(K)), lambda z, u_t, N: (u_t, 0 * z, 1e-3 + 0 * z), "friction law stores energy"),
        # Only beyond 10 m/s, where a tenth of a millimetre at the drive's frequency does not come.
        (Spring(jnp.asarray(K)), lambda z, u_t, N: (N * u_t * (1 - u_t**2 / 100), 0 * z, 0 * z), "friction law gives"),
    ],
)
def test_laws_that_no_contact_has_are_refused(table1, normal, friction, told):
    with pytest.raises(js.InputError, match=told):
        js.check_laws(with_laws(table1, normal, friction))


@pytest.mark.parametrize(
    ("law", "numbers", "told"),
    [
        (js.LuGre, (-1e6, 100.0, 0.5, 10.0), "`k_d` of LuGre must be greater than 0, but is -1e+06"),
        (js.LuGre, (1e6, -1.0, 0.5, 10.0), "`c` of LuGre must be greater than or equal to 0"),
        (js.LuGre, (1e6, 100.0, 0.5, 0.0), "`N_0` of LuGre must be greater than 0"),
        (js.LuGre, (1e6, 100.0, float("nan"), 10.0), "`mu` of LuGre must be a finite number"),
        (js.RegularisedCoulomb, (0.5, 0.0), "`speed` of RegularisedCoulomb must be greater than 0"),
        (js.RegularisedCoulomb, (np.array([0.5, -0.1]), 1.0), "`mu` of RegularisedCoulomb must be greater than or"),
        (js.Hertz, (0.0,), "`k` of Hertz must be greater than 0"),
        (js.DampedSpring, (1e5, 1e5, 1e-5, -1.0), "`c` of DampedSpring must be greater than or equal to 0"),
    ],
)
def test_numbers_of_laws_have_ranges(law, numbers, told):
    with pytest.raises(js.InputError) as error:
        law(*numbers)
    assert told in str(error.value)


def test_ranges_do_not_bind_numbers_that_are_traced():
    assert float(jax.grad(lambda k: js.Hertz(k)(jnp.asarray(1.0), 0.0)[0])(jnp.asarray(4e7))) == 1.0


def test_what_is_not_an_own_law_is_refused(table1):
    with pytest.raises(js.InputError, match=r"must return \(N, energy\)"):
        js.Laws(lambda v, v_t: K * v)
    with pytest.raises(js.InputError, match=r"must return \(F, z_t, energy\)"):
        js.Laws(NORMALS["hertz"], lambda z, u_t, N: (N, 0 * u_t, 0 * N), z=jnp.zeros(2))
    with pytest.raises(js.InputError, match="consistent"):
        with_laws(js.load("table1", ['contact.reading="printed"']).scene, NORMALS["hertz"])
    own = with_laws(table1, NORMALS["hertz"])
    with pytest.raises(js.InputError, match="Runge-Kutta"):
        js.simulate(own, n_periods=1, method=js.Taylor())
    with pytest.raises(js.InputError, match="not for own laws"):
        js.simulate(own, n_periods=1, method="balanced")
    with pytest.raises(js.InputError, match=r"js\.with_contact_law"):
        js.load("table1", ['parts.contact="own"']).scene.parts  # noqa: B018  built when it is asked for


@pytest.mark.full
def test_own_laws_are_differentiable_in_both_modes():
    # Jumps of N at touches, a corner of the spring, a state of friction that starts anew: 1e-6 of the largest slope.
    scene = with_parts(js.load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene, motion=("x",))

    def observed(p):
        laws = js.DampedSpring(p[1], 3 * p[1], 2e-5, p[2]), js.LuGre(1e5, 5.0, p[3], 10.0)
        own = with_laws(js.vary(scene, "shroud.gap", p[0]), *laws)
        run = js.rollout(own, None, 2, every=100, save=lambda m: (m.N / 100, m.F / 100, m.state.motion.x / 1e-4))
        return jnp.concatenate([jnp.ravel(a) for a in (*run.saved, run.power / 1e-8)])

    p, h = jnp.asarray([2.2e-5, K, 20.0, 0.3]), 1e-5
    f, slopes = jax.jit(observed), jax.jit(jax.jacfwd(observed))(p)
    for i in range(len(p)):
        ends = [f(p.at[i].multiply(1 + c * h)) for c in (-2, -1, 1, 2)]
        found = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h * p[i])
        assert_allclose(found, slopes[:, i], rtol=0, atol=1e-6 * np.max(np.abs(slopes[:, i])))
    weights = jnp.linspace(-1.0, 1.0, len(slopes))
    reverse = jax.jit(jax.grad(lambda p: observed(p) @ weights))(p)
    assert_allclose(reverse, weights @ slopes, rtol=1e-9)


@pytest.mark.full
def test_a_law_may_be_of_arrays():
    # A network and a state of two numbers: not one kernel, but the same trajectory as that of the law in scalars.
    scene = with_parts(js.load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene, motion=("x",))
    one, weights = FRICTIONS["lugre"], jnp.eye(2)

    def two(z, u_t, N):
        F, z_t, energy = one((weights @ z)[0], u_t, N)
        return F, jnp.stack([z_t, 0 * z_t]), energy

    laws = {"scalar": (one, 0.0), "array": (two, jnp.zeros(2))}
    own = {name: with_laws(scene, NORMALS["hertz"], law, z) for name, (law, z) in laws.items()}
    runs = {name: jax.jit(lambda s: js.rollout(s, None, 2))(scene) for name, scene in own.items()}
    a, b = runs["scalar"], runs["array"]
    assert a.status == b.status == Status.OK
    assert_allclose(b.saved.F, a.saved.F, rtol=1e-8)
    assert_allclose(b.state.motion.x, a.state.motion.x, rtol=1e-8)
    assert b.state.u_s.shape == (2,)


@pytest.mark.parametrize(
    "law",
    [js.Hertz(4e7), js.DampedSpring(2e5, 6e5, 3e-5, 0.0), lambda v, v_t: (1e6 * v, 5e5 * v**2)],
    ids=["hertz", "undamped", "spring"],
)
@pytest.mark.parametrize("gap", [2.2e-5, 5e-5])
def test_conservative_laws_are_passive(table1, law, gap):
    # What such a law loses is rounding alone: it is judged by the power that the law is given.
    js.check_laws(with_laws(js.vary(table1, "shroud.gap", gap), law))


def fast_bristles():
    """Bristles that follow within a thousandth of a step of 400 a period, as contact begins."""
    base = js.load("table1", ['parts.motion=["x"]', 'parts.neighbour="rigid"', "contact.k=1e6", "friction.k_d=1e6"])
    return with_laws(base.scene, js.DampedSpring(2e5, 6e5, 3e-5, 20.0), js.LuGre(1e6, 30.0, 0.3, 1.0))


@pytest.mark.full
def test_the_rate_of_an_internal_state_belongs_to_the_check_of_the_step():
    scene = fast_bristles()
    with pytest.raises(StepTooLongError, match=r"internal state of the friction law follows at up to 36\.5 per step"):
        js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=400))
    auto, fine = (js.simulate(scene, n_periods=3, method=js.RungeKutta(steps=steps)) for steps in ("auto", 12800))
    assert 1200 < auto.steps_per_period < 6400
    size = np.abs(fine.motion.x).max()
    assert_allclose(auto.motion.x[-1], fine.motion.x[-1], rtol=0, atol=1e-4 * size)


@pytest.mark.full
def test_a_march_whose_energy_does_not_balance_is_not_ok(monkeypatch):
    # Control: without that check the march is wrong by a third of the motion.
    monkeypatch.setattr(stability, "MAX_RELAXATION_RATE", np.inf)
    with pytest.warns(js.LaneWarning, match="UNBALANCED"):
        run = js.simulate(fast_bristles(), n_periods=3, method=js.RungeKutta(steps=400))
    assert run.status == Status.UNBALANCED
    with pytest.warns(js.LaneWarning, match="UNBALANCED"):
        js.sweep(fast_bristles(), {"shroud.gap": [2.2e-5]}, n_periods=3, transient=0, method=js.RungeKutta(steps=400))
