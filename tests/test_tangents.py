"""Tangents through stick, slip, impact and case switches against differences, and what they must satisfy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batch import scene_of
from jax import lax

from jaxshroud import load, lyapunov, period_map, value_of, vary
from jaxshroud.integrate import FAST, Method
from jaxshroud.lanes import fused, plain
from jaxshroud.lyapunov import settled
from jaxshroud.state import Status, start
from jaxshroud.sweep import Plan, final_states, run_lanes
from jaxshroud.tableau import tableau
from jaxshroud.tangents import STATE, Dual, differentiable, direction, flow, from_vector, run_flow, tangents, to_vector

STEPS = 400
CHAOTIC = {"gamma 4.8": 4.8, "gamma 5.5": 5.5, "gamma 10": 10.0}


def scene_at(gamma):
    return load("table1", [f"contact.gamma={gamma}", "drive.F_0=60"]).scene


def many(tree, n):
    return jax.tree.map(lambda a: np.broadcast_to(a, (n, *np.shape(a))), tree)


def alone(tree):
    return many(tree, 1)


def states_of(scene, n, method=FAST):
    """States of a settled motion at `n` successive period ends."""
    state, states = settled(scene, 64, STEPS, method), []
    for _ in range(n):
        runs = run_lanes(alone(scene), alone(state), Plan(0, 1, STEPS, 0.0, method), lambda _: None)
        state = jax.tree.map(lambda a: a[0], final_states(runs.last))
        states.append(state)
    return jax.tree.map(lambda *a: np.stack(a), *states)


def flow_of(scenes, states, along=None, steps=STEPS, method=FAST):
    """One period of many lanes; `along`: tangent vectors of the states (lanes, 13)."""
    still = jax.tree.map(np.zeros_like, scenes)
    unit = from_vector(np.zeros((len(states.u_s), STATE)) if along is None else along, None, None)
    return run_flow(Dual(scenes, still), Dual(states, unit), 1, steps, differentiable(method))


def sizes_of(states):
    z = np.abs(to_vector(states))[:, :12].reshape(-1, 6, 2).max(axis=(0, 2))
    return np.append(np.repeat(z, 2), z[0])


def differences(scene, states, along, h):
    """Fourth-order central differences of the one-period map along one direction for each state, (lanes, 13)."""
    lanes = len(states.u_s)
    z = to_vector(states)
    ends = []
    for c in (-2, -1, 1, 2):
        shifted = from_vector(z + c * h * along, states.mode, states.case)
        ends.append(to_vector(flow_of(many(scene, lanes), shifted).value.state))
    return (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)


def test_one_period_jacobian_in_chaos():
    # A random direction at each of 200 states of a chaotic orbit. Differences lose their meaning where a shifted motion
    # meets other events; the best of three step sizes is compared.
    scene = scene_at(5.5)
    states = states_of(scene, 200)
    sizes = sizes_of(states)
    along = np.random.default_rng(1).standard_normal((200, STATE)) * sizes
    got = to_vector(flow_of(many(scene, 200), states, along).tangent.state) / sizes
    scale = np.abs(got).max(axis=1, keepdims=True)
    errors = [np.abs(differences(scene, states, along, h) / sizes - got).max(axis=1) / scale[:, 0] for h in (1e-5, 1e-6, 1e-7)]
    print(np.sort(np.min(errors, axis=0))[-10:], [np.median(e) for e in errors])
    assert np.max(np.min(errors, axis=0)) <= 1e-6
