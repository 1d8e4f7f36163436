"""Every shipped scene runs as it says, at reduced size."""

import pytest

from jaxshroud import Status, load, scenes_from, shipped, simulate, sweep
from jaxshroud.march.method import FAST, RungeKutta
from jaxshroud.march.stability import ACCURACY_LIMIT, largest_frequency
from jaxshroud.scene.layout import PAIR
from jaxshroud.verbs.arguments import plan_march, resolve_options

pytestmark = pytest.mark.full

OTHERS = [
    *(name for name in shipped() if name.endswith("_best")),
    *("table1_light", "griffin", "dry_friction_2dof", "engine_order", "row_ring12", "row_chain5"),
    *("table1_points", "row_ring12_points", "row_ring6_flutter", "row_disk60", "fem_blade"),
]
ROWS = [name for name in shipped() if load(name).layout != PAIR]  # run in verbs/test_row_verbs.py
PRINTED = [name for name in shipped() if name not in OTHERS]


def test_scenes_as_printed_say_steps_and_the_others_an_accuracy():
    for name in shipped():
        run = load(name).run
        assert (run.steps_per_period, run.accuracy) == ((400, None) if name in PRINTED else (None, "balanced")), name


@pytest.mark.full(but=[name for name in PRINTED if name != "eq21"])
@pytest.mark.parametrize("name", [name for name in shipped() if name not in ROWS])
def test_shipped_scene_runs(name):
    file = load(name)
    # An onset happens within the first period of every shipped scene, so its whole program runs.
    run = simulate(file, n_periods=2, method=file.run.accuracy or RungeKutta(steps=file.run.steps_per_period))
    assert run.status == Status.OK
    assert abs(run.energy_residual) < 1e-3


@pytest.mark.parametrize("name", PRINTED)
def test_shipped_steps_are_accurate(name):
    file = load(name)
    h = float(file.scene.drive.period) / file.run.steps_per_period
    assert float(largest_frequency(file.scene)) * h <= ACCURACY_LIMIT


@pytest.mark.release(only=["engine_order"])
@pytest.mark.parametrize("name", [name for name in OTHERS if name not in ROWS and not load(name).scene.points])
def test_shipped_accuracies_are_promised(name):
    file = load(name)
    lanes = scenes_from({axis.key: axis.values for axis in file.axes}, file.scene) if file.axes else file.scene
    resolved = resolve_options(lanes, method=file.run.accuracy)
    choice = plan_march(resolved, resolved.lanes, FAST).choice
    assert choice.promised
    assert choice.accuracy == 1e-6


def test_faces_of_the_disk_stick_and_slip_and_none_come_apart():
    disk = load("row_disk60").scene
    run = sweep(disk, n_periods=2, transient=8, forces=True, method=RungeKutta("dopri8", steps=150))
    assert run.status == Status.OK
    slips = run.slip[0] > 0
    assert 0 < slips.sum() < disk.row.interfaces
    assert run.time_apart == 0
    assert 0.9 < run.time_stick < 1
