"""Every shipped scene runs, at reduced size."""

import pytest

from jaxshroud import Status, load, shipped, simulate
from jaxshroud.march.method import RungeKutta
from jaxshroud.march.stability import ACCURACY_LIMIT, largest_frequency


@pytest.mark.parametrize("name", list(shipped()))
def test_shipped_scene_runs(name):
    file = load(name)
    # An onset happens within the first period of every shipped scene, so its whole program runs.
    run = simulate(file.scene, n_periods=2, method=RungeKutta(steps=file.run.steps_per_period))
    assert run.status == Status.OK
    assert abs(run.energy_residual) < 1e-3


@pytest.mark.parametrize("name", list(shipped()))
def test_shipped_steps_are_accurate(name):
    file = load(name)
    h = float(file.scene.drive.period) / file.run.steps_per_period
    assert float(largest_frequency(file.scene)) * h <= ACCURACY_LIMIT
