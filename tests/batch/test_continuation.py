"""Forward and backward sweeps sampled at a phase: the next value goes on where the one before ended."""

import jax
import numpy as np
import pytest

from jaxshroud import load, sweep
from jaxshroud.batch.lanes import final_states, initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST, RungeKutta
from jaxshroud.scene.grids import grid_of_scenes

PHASE, STEPS = 1.0, 200
ALIKE = np.array([2.5, 2.5 * (1 + 1e-12)])  # values of gamma


def quiet(_):
    """A ticker."""


@pytest.fixture(scope="module")
def scene():
    """One coordinate; forgets a push within some ten periods."""
    return load("table1", ['parts.motion=["x"]', "contact.gamma=2.5", "blades.c_x=10"]).scene


@pytest.fixture(scope="module")
def scenes(scene):
    """The scene at two values as good as equal, one lane each."""
    return grid_of_scenes(scene, {"contact.gamma": ALIKE})


def lane(tree, i):
    """One lane of a tree, with its leading axis."""
    return jax.tree.map(lambda a: np.asarray(a)[i : i + 1], tree)


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_the_next_value_goes_on_from_the_last_sample(scene, direction):
    kept = dict(n_periods=40, method=RungeKutta(steps=STEPS), direction=direction, phase=PHASE)
    x = sweep(scene, {"contact.gamma": ALIKE}, **kept).motion.x
    before, after = (x[0], x[1]) if direction == "forward" else (x[1], x[0])
    # Period 1, closed to 1e-9 by then; the first sample of the next value is one period later.
    np.testing.assert_allclose(after[0], before[-1], rtol=0, atol=1e-8 * np.abs(x).max())


@pytest.mark.full
def test_a_lead_in_from_another_phase_kicks_the_branch(scenes):
    # Control: the same state taken as one at phase 0, which it is not.
    plan = Plan(0, 40, STEPS, PHASE, FAST)
    first = run_lanes(lane(scenes, 0), initial_states(lane(scenes, 0)), plan, quiet)
    last = first.samples.motion.x[0, -1, 0]
    for arrived, off in ((np.ones(1, bool), 0.0), (None, 0.3)):
        then = run_lanes(lane(scenes, 1), final_states(first.last.state), plan, quiet, arrived)
        kick = abs(then.samples.motion.x[0, 0, 0] - last) / np.abs(first.samples.motion.x).max()
        assert kick < 1e-8 if off == 0 else kick > off


@pytest.mark.full
def test_lanes_that_start_afresh_are_led_in_beside_those_that_go_on(scenes):
    plan = Plan(1, 3, STEPS, PHASE, FAST)
    end = final_states(run_lanes(scenes, initial_states(scenes), plan, quiet).last.state)
    states = jax.tree.map(lambda a, b: np.stack([a[0], b[1]]), end, initial_states(scenes))
    both = run_lanes(scenes, states, plan, quiet, np.array([True, False]))
    for i, arrived in enumerate((True, False)):
        one = run_lanes(lane(scenes, i), lane(states, i), plan, quiet, np.array([arrived]))
        close = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-14)
        jax.tree.map(close, lane(both.samples.motion, i), one.samples.motion)


@pytest.mark.full
def test_closed_forms_go_on_at_a_phase_too(scene):
    free = load("table1", ["parts.contact=none"]).scene
    along = {"drive.F_0": [60.0, 60.0]}
    # Two values as good as equal are one run twice as long.
    x = sweep(
        free, along, n_periods=5, direction="forward", phase=PHASE, method=RungeKutta(steps=400), transient=0
    ).motion.x
    whole = sweep(
        free, {"drive.F_0": [60.0]}, n_periods=10, phase=PHASE, method=RungeKutta(steps=400), transient=0
    ).motion.x[0]
    np.testing.assert_allclose(x.reshape(whole.shape), whole, rtol=0, atol=1e-12 * np.abs(whole).max())
