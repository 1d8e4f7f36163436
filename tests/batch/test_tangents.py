"""Tangents through stick, slip, impact and case switches against differences, and what they must satisfy."""

import importlib
import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from side_by_side import with_parts

import jaxshroud as js
from jaxshroud import load, period_map, value_of, vary
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import final_states, from_vector, to_vector
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.tangents import direction, run_flow, tangents
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march import row_step, taylor_trial
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import initial_state
from jaxshroud.orbits.batched_algorithms import run_alone
from jaxshroud.orbits.lyapunov import MAX_ALIGNMENT_PERIODS, state_after

STEPS, SIZE = 400, 13  # of a state
orbit, lyapunov = (partial(verb, method=js.RungeKutta(steps=STEPS)) for verb in (js.orbit, js.lyapunov))
CHAOTIC = {"gamma 4.8": 4.8, "gamma 5.5": 5.5, "gamma 10": 10.0}


def scene_at(gamma):
    return load("table1", [f"contact.gamma={gamma}", "drive.F_0=60"]).scene


def alone(tree):
    return repeat_lane(tree, 1)


def settled_state(scene):
    """The state after a transient from the scene's start."""
    return run_alone(state_after(scene, initial_state(scene.initial), 64, STEPS, FAST))


def states_of(scene, n):
    """States of a settled motion at `n` successive period ends."""
    state, states = settled_state(scene), []
    for _ in range(n):
        runs = run_lanes(alone(scene), alone(state), Plan(0, 1, STEPS, 0.0, FAST), lambda _: None)
        state = jax.tree.map(lambda a: a[0], final_states(runs.last.state))
        states.append(state)
    return jax.tree.map(lambda *a: np.stack(a), *states)


def flow_of(scenes, states, along=None, steps=STEPS, method=FAST):
    """One period of many lanes; `along`: tangent vectors of the states (lanes, 13)."""
    still = jax.tree.map(np.zeros_like, scenes)
    unit = from_vector(np.zeros((len(states.u_s), SIZE)) if along is None else along, None, None, scenes)
    got = run_flow(Dual(scenes, still), Dual(states, unit), 1, steps, as_differentiable(method))
    assert np.all(got.value.status == Status.OK)
    return got


def sizes_of(states):
    z = np.abs(to_vector(states))[:, :12].reshape(-1, 6, 2).max(axis=(0, 2))
    z = np.where(z > 0, z, 1.0)  # what does not move in this model
    return np.append(np.repeat(z, 2), z[0])


def differences(scene, states, along, h, steps=STEPS, method=FAST):
    """Fourth-order central differences of the one-period map along one direction for each state, (lanes, 13)."""
    lanes = len(states.u_s)
    z = to_vector(states)
    ends = []
    for c in (-2, -1, 1, 2):
        shifted = from_vector(z + c * h * along, states.mode, states.case, scene)
        ends.append(to_vector(flow_of(repeat_lane(scene, lanes), shifted, None, steps, method).value.state))
    return (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)


def error_of(scene, states, along, steps=STEPS, method=FAST):
    """Largest difference of tangents and differences over the largest tangent, with the best of three step sizes."""
    sizes = sizes_of(states)
    lanes = len(states.u_s)
    tangent = to_vector(flow_of(repeat_lane(scene, lanes), states, along, steps, method).tangent.state)
    scale = np.abs(tangent / sizes).max(axis=1)
    slopes = [differences(scene, states, along, h, steps, method) for h in (1e-5, 1e-6, 1e-7)]
    return np.min([np.abs((slope - tangent) / sizes).max(axis=1) / scale for slope in slopes], axis=0)


def error_along(scene, lanes, seed, steps=STEPS, method=FAST):
    """The error of each of so many states of a settled motion, along a random direction."""
    states = states_of(scene, lanes)
    along = np.random.default_rng(seed).standard_normal((lanes, SIZE)) * sizes_of(states)
    return error_of(scene, states, along, steps, method)


@pytest.mark.release
@pytest.mark.full
def test_one_period_jacobian_in_chaos():
    # A random direction at each of 200 states of a chaotic orbit. Where an event falls on the end of a step, the
    # computed map is not smooth, by its error of truncation; another number of steps then shows the rest.
    scene = scene_at(5.5)
    states = states_of(scene, 200)
    along = np.random.default_rng(1).standard_normal((200, SIZE)) * sizes_of(states)
    error = error_of(scene, states, along)
    assert np.sum(error > 1e-7) <= 2
    for lane in np.flatnonzero(error > 1e-7):
        only = jax.tree.map(lambda a, lane=lane: np.repeat(np.asarray(a)[lane : lane + 1], 16, axis=0), states)
        assert np.max(error_of(scene, only, np.repeat(along[lane : lane + 1], 16, axis=0), STEPS + 1)) <= 1e-7


@pytest.mark.release(only=["dopri8-cubic-motion2", "tsit5-cubic-motion1"])
@pytest.mark.full(but=["rk4-bisection-motion0"])
@pytest.mark.parametrize(
    ("name", "locate", "motion"),
    [("rk4", "bisection", ("x",)), ("tsit5", "cubic", ("x", "y", "theta")), ("dopri8", "cubic", ("x", "y"))],
)
def test_jacobian_of_other_methods(name, locate, motion):
    method = Choices(tableau(name), locate)
    scene = with_parts(scene_at(5.5), motion=motion)
    steps = {"rk4": 400, "tsit5": 200, "dopri8": 100}[name]
    assert np.max(error_along(scene, 12, 2, steps, method)) <= 1e-6


@pytest.mark.release(only=["motion1"])
@pytest.mark.full
@pytest.mark.parametrize("motion", [("x",), ("x", "y", "theta")])
def test_jacobian_by_series(motion):
    method = Choices(TaylorOptions(10, 1e-12), "series")
    assert np.max(error_along(with_parts(scene_at(5.5), motion=motion), 12, 2, method=method)) <= 1e-6


@pytest.mark.release
@pytest.mark.full
def test_naive_tangents_by_series_are_wrong(monkeypatch):
    # Control: events whose instants have no derivative. They count where the sliding begins or ends within the period;
    # at an onset forces are continuous, so that its instant does not matter.
    monkeypatch.setattr(taylor_trial, "at_event", lambda quantity, *_: quantity)
    method = Choices(TaylorOptions(11, 1e-12), "series")  # another order: compiled anew
    assert np.mean(error_along(scene_at(5.5), 24, 3, method=method) > 1e-3) > 0.5


@pytest.fixture
def naive(monkeypatch):
    """A method whose events' instants have no derivative, as differentiating through the search would leave it."""
    monkeypatch.setattr(row_step, "at_event", lambda quantities, *_: quantities)
    return FAST._replace(tableau=FAST.tableau._replace(name="naive"))  # another name: compiled anew


@pytest.mark.full
def test_naive_tangents_are_wrong(naive):
    # Control: without the derivative of the events' instants, tangents through chaos miss by more than 1 %.
    assert np.median(error_along(scene_at(5.5), 24, 3, method=naive)) > 0.01


def two_trajectories(scene, state, n, apart=1e-7):
    """Growth of the distance between two motions over each of `n` periods, brought back to `apart` after each."""
    gap = np.random.default_rng(4).standard_normal(SIZE) * sizes_of(alone(state))
    gap, growth = gap * apart / np.linalg.norm(gap), []
    for _ in range(n):
        z = to_vector(state)
        other = from_vector(z + gap, state.mode, state.case, scene)
        ends = flow_of(repeat_lane(scene, 2), jax.tree.map(lambda *a: np.stack(a), state, other)).value.state
        state = jax.tree.map(lambda a: a[0], from_vector(to_vector(ends), ends.mode, ends.case, scene))
        gap = np.diff(to_vector(ends), axis=0)[0]
        growth.append(np.linalg.norm(gap) / apart)
        gap = gap / growth[-1]
    return np.log(growth)


@pytest.mark.release
@pytest.mark.full
@pytest.mark.parametrize("gamma", CHAOTIC.values(), ids=CHAOTIC)
def test_largest_exponent_is_that_of_two_trajectories(gamma, monkeypatch):
    # Along one and the same motion, so that nothing but the derivative differs; the first periods align the directions.
    scene, n = scene_at(gamma), 300
    monkeypatch.setattr(
        importlib.import_module("jaxshroud.orbits.lyapunov"), "ALIGNMENT_TOLERANCE", -1.0
    )  # never alike: the longest alignment
    found = lyapunov(scene, n_periods=n)
    by_distance = two_trajectories(scene, settled_state(scene), MAX_ALIGNMENT_PERIODS + n)[-n:].mean()
    by_tangents = found.growth[:, 0].mean()
    assert by_tangents > 0.1
    assert by_tangents == pytest.approx(by_distance, rel=0.03)


@pytest.mark.release(only=["0"])
@pytest.mark.full
@pytest.mark.parametrize("transient", [0, 64])
def test_the_largest_exponent_of_an_orbit_is_that_of_floquet(transient):
    # A complex pair of multipliers: both exponents are ln abs(multiplier), found to a hundredth in 32 periods.
    scene = scene_at(2.5)
    found = lyapunov(scene, n_periods=32, transient=transient)
    exact = np.log(np.abs(orbit(scene).multipliers[:2]))
    np.testing.assert_allclose(exact, -0.2616, atol=5e-5)
    assert np.all(np.abs(found.exponents[:2] - exact) <= found.ci[:2])
    assert np.all(found.ci[:2] < 0.01)


@pytest.mark.full
def test_multipliers_without_contact_have_the_dampers_product():
    # Liouville: det M = exp(-T sum(c / m)), here with unlike blades and without ever touching.
    scene = load("table1", ['shroud.gap="5 mm"', "contact.gamma=2.5", "drive.F_0=60"]).scene
    for key, value in {"blades.m[1]": 0.5, "blades.c_y[0]": 3.0, "blades.I[1]": 2e-4}.items():
        scene = vary(scene, key, value)
    at = tangents(scene, initial_state(scene.initial), [], n=1, steps=2000, method=as_differentiable(FAST))
    b = scene.blades
    rate = sum(float(jnp.sum(c / m)) for c, m in ((b.c_x, b.m), (b.c_y, b.inertia_y), (b.c_T, b.I)))
    expected = np.exp(-float(scene.drive.period) * rate)
    assert np.all(at.by_state[SIZE - 1] == 0)
    assert np.prod(np.linalg.eigvals(at.by_state[:12, :12])).real == pytest.approx(expected, rel=1e-8)


@pytest.mark.full
def test_no_contact_gives_exact_zeros():
    scene = load("table1", ['shroud.gap="5 mm"', "contact.gamma=2.5", "drive.F_0=60"]).scene
    keys = ["shroud.gap", "contact.gamma", "friction.mu", "friction.k_d"]
    along = [direction(scene, key) for key in keys]
    at = tangents(scene, initial_state(scene.initial), along, n=2, steps=100, method=as_differentiable(FAST))
    assert np.all(at.by_parameter == 0)
    assert np.all(at.power_by_parameter == 0)
    assert np.all(np.isfinite(at.by_state))


@pytest.mark.full
def test_no_nan_at_the_corners_of_the_model():
    # theta = 0, v = 0, w = 0 and all rates zero: the blocks just touch and nothing moves yet.
    scene = vary(load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene, "shroud.gap", 0.0)
    along = [direction(scene, key) for key in ("shroud.gap", "contact.gamma", "friction.mu", "drive.M_0")]
    at = tangents(scene, initial_state(scene.initial), along, n=1, steps=200, method=as_differentiable(FAST))
    assert at.status == Status.OK
    assert np.all(np.isfinite(at.by_state))
    assert np.all(np.isfinite(at.by_parameter))


@pytest.mark.release
@pytest.mark.full
def test_jax_differentiates_the_period_map():
    # Forward and reverse mode of the plain function against the fused tangents, with respect to a parameter and to the
    # starting state.
    scene, steps = with_parts(scene_at(4.2), motion=("x",)), 100
    first = initial_state(scene.initial)

    def power(gap, x, most=None):
        moved = vary(scene, "shroud.gap", gap)
        state = eqx.tree_at(lambda s: s.motion.x, first, x)
        return period_map(moved, state, method=js.RungeKutta(steps=steps), most_trials=most).power[0]

    gap = jnp.asarray(value_of(scene, "shroud.gap"))
    forward = jax.jit(lambda gap: jax.jvp(lambda gap: power(gap, first.motion.x), (gap,), (jnp.ones(()),))[1])(gap)
    reverse = jax.jit(jax.grad(lambda gap, x: power(gap, x, 300), argnums=(0, 1)))(gap, first.motion.x)
    at = tangents(scene, first, [direction(scene, "shroud.gap")], n=1, steps=steps, method=as_differentiable(FAST))
    np.testing.assert_allclose([forward, reverse[0]], at.power_by_parameter[0, 0], rtol=1e-7)
    np.testing.assert_allclose(reverse[1], at.power_by_state[0, :2], rtol=1e-7)


@pytest.mark.full
def test_too_few_trials_are_told():
    scene = with_parts(scene_at(4.2), motion=("x",))
    flow_end = period_map(scene, initial_state(scene.initial), method=js.RungeKutta(steps=50), most_trials=20)
    assert np.isnan(flow_end.power[0])


@pytest.mark.full
def test_second_derivatives_through_events_are_refused():
    # Ignoring how the slopes at an event move with its instant, JAX would give -6.627 here for -6.643.
    scene = with_parts(scene_at(4.2), motion=("x",))
    power = lambda gap: period_map(
        vary(scene, "shroud.gap", gap), initial_state(scene.initial), method=js.RungeKutta(steps=100), most_trials=300
    ).power[0]
    gap = jnp.asarray(value_of(scene, "shroud.gap"))
    with pytest.raises(TypeError, match="first order only"):
        jax.hessian(power)(gap)
    with pytest.raises(TypeError, match="first order only"):
        jax.jvp(jax.jacfwd(power), (gap,), (jnp.ones(()),))


def error_of_derivative(motion, order=14):
    """The error of the derivative of two periods by their start, by power series: of light blades that do not touch."""
    apart = ["shroud.gap=5mm", "blades.c_T=0.005", "drive.M_0=0", f"drive.F_0={60 if motion == 'bends' else 0}"]
    scene = load("table1_light", apart).scene
    method = as_differentiable(Choices(TaylorOptions(order, 1e-7), "series"))
    found = tangents(scene, initial_state(scene.initial), [], n=2, steps=STEPS, method=method)
    period = math.tau / float(scene.drive.omega)
    exact, size = np.zeros((SIZE, SIZE)), np.ones(SIZE)
    for place, (m, c, k) in enumerate(scene.blades.oscillators.values()):
        for blade in (0, 1):
            at = 2 * place + blade + np.array([0, 6])
            one = np.array([[0.0, 1.0], [-k[blade] / m[blade], -c[blade] / m[blade]]])
            exact[np.ix_(at, at)] = scipy.linalg.expm(2 * period * one)
            size[at] = 1, math.sqrt(k[blade] / m[blade])
    return np.max(np.abs(found.by_state - exact) * size / size[:, None])


@pytest.mark.parametrize("motion", ["rests", "bends"])
def test_tangents_of_what_does_not_move(motion):
    # No torsion, or nothing, moves: coefficients that are zero bound no trial, and light blocks turn 17 times a radian.
    assert error_of_derivative(motion) < 1e-5


def test_tangents_that_no_trial_follows_are_wrong(monkeypatch):
    # Control: trials as long as the motion allows.
    monkeypatch.setattr(taylor_trial, "_followed_angle", lambda *_: np.inf)
    assert error_of_derivative("rests", order=13) > 10
