"""Events of a tuned ring, which symmetry makes simultaneous, are in one trial of power series."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes, initial_states, lane_models, lanes_last
from jaxshroud.batch.periods import march
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march import taylor_trial
from jaxshroud.march.carry import Fixed, time_grid
from jaxshroud.march.method import Choices, TaylorOptions
from jaxshroud.scene.grids import scenes_at

MOST, STEPS, PERIODS = 100_000, 100, 2


def marched(blades):
    """The trials of a ring with two points on each face, and the motion of its first blade afterwards."""
    ring = [f"row.blades={blades}", "row.closed=true", f"drive.engine_order={blades // 4}", "shroud.gap=0.1 mm"]
    scene = js.load("table1_points", ring).scene
    scenes = scenes_at(scene, ["drive.F_0"], np.array([[50.0]]))
    method = Choices(TaylorOptions(12, 1e-8), "series", False)
    models, periods = lane_models(scenes)
    grid = time_grid(jnp.zeros_like(periods), jnp.full_like(periods, STEPS), periods)
    fixed = Fixed(models, grid, jnp.full(periods.shape, PERIODS * STEPS, jnp.int32))
    lanes = lanes_last(begin_lanes(scenes, initial_states(scenes), method))
    run = jax.jit(lambda lanes, fixed: march(lanes, fixed, method, best_mapping(), passes=jnp.int32(MOST)))
    lanes, left = run(lanes, fixed)
    assert np.all(lanes.status == js.Status.OK)
    return MOST - int(left), np.array([lanes.state.motion.x[0, 0], lanes.state.motion.theta[0, 0]])


@pytest.mark.full
def test_a_tuned_ring_takes_as_many_trials_as_a_small_one(monkeypatch):
    few, end = marched(4)
    many, same = marched(16)
    assert many <= 1.01 * few
    np.testing.assert_allclose(same, end, rtol=1e-12)
    monkeypatch.setattr(taylor_trial, "SYMMETRIC", taylor_trial.SIMULTANEOUS)
    assert marched(16)[0] > 1.05 * few
