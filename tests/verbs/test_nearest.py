"""Sweeps in rounds, in which each value starts from where the nearest one done has ended."""

import json

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.runs import rounds
from jaxshroud.cli import commands as cli

SHORT = {"n_periods": 4, "transient": 3, "method": js.RungeKutta(steps=100)}
KEY, GAMMA = "contact.gamma", np.linspace(0.5, 3.0, 11)


@pytest.fixture
def scene():
    return js.load("table1", ['parts.motion=["x"]']).scene


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 46, 200])
def test_rounds_run_every_value_and_begin_where_one_is_done(count):
    done, run = set(), []
    for values, neighbours in rounds("nearest", count):
        assert {*neighbours} <= done
        assert all(min(abs(i - j) for j in done) == abs(i - n) for i, n in zip(values, neighbours, strict=False))
        done |= {*values}
        run += values
    first = -(-count // 8)
    assert sorted(done) == list(range(count))
    assert len(run) == count + first


def test_each_value_starts_where_the_nearest_one_ended(scene):
    nearest = js.sweep(scene, {KEY: GAMMA}, direction="nearest", **SHORT)
    ways = {0: [0, 0], 8: [8, 8], 4: [0, 0, 4], 2: [0, 0, 2], 10: [8, 8, 10], 6: [0, 0, 4, 6], 7: [0, 0, 4, 6, 7]}
    for place, way in ways.items():
        forward = js.sweep(scene, {KEY: GAMMA[way]}, direction="forward", **SHORT)
        np.testing.assert_allclose(nearest.motion.x[place], forward.motion.x[-1], rtol=1e-9)
    rest = js.sweep(scene, {KEY: GAMMA}, **SHORT)
    assert np.abs(rest.motion.x - nearest.motion.x).max() > 1e-6  # else the starts would not be told apart
    assert nearest.direction_of == nearest.summary()["direction"] == "nearest"
    assert "direction" not in rest.summary()


@pytest.mark.parametrize("keep", [True, False])
def test_a_store_of_scenes_has_the_same_numbers(scene, tmp_path, keep):
    scenes = js.scenes_from({"shroud.gap": [1e-5, 2e-5, 3e-5]}, scene)
    memory = js.sweep(scenes, {KEY: GAMMA}, direction="nearest", **SHORT)
    stored = js.sweep(scenes, {KEY: GAMMA}, direction="nearest", store=tmp_path / "a.zarr", keep_samples=keep, **SHORT)
    np.testing.assert_array_equal(memory.P_d, stored.P_d)
    again = js.sweep(
        scenes, {KEY: GAMMA}, direction="nearest", store=tmp_path / "a.zarr", keep_samples=keep, resume=True, **SHORT
    )
    np.testing.assert_array_equal(memory.P_d, again.P_d)


def test_progress_counts_the_values_that_run_twice(scene):
    told = []
    js.sweep(scene, {KEY: GAMMA}, direction="nearest", progress=lambda done, all_: told.append((done, all_)), **SHORT)
    assert told[-1] == (91, 91)


def test_the_command_says_where_lanes_start(tmp_path):
    axis = ["--along", KEY, "--start", "1", "--stop", "2", "--num", "3", "--direction", "nearest"]
    run = ["--set", 'parts.motion=["x"]', "--periods", "2", "--transient", "2", "--steps-per-period", "100"]
    assert cli.main(["sweep", "table1", *axis, *run, "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["direction"] == "nearest"


def test_patterns_of_mistuning_start_so_too():
    row = js.load("row_ring12", ['parts.motion=["x"]'])
    speeds = {"drive.omega": [1100.0, 1200.0]}
    short = {"n_periods": 2, "transient": 1, "n_patterns": 2, "method": js.RungeKutta(steps=100)}
    nearest = js.mistune(row, speeds, direction="nearest", **short)
    rest = js.mistune(row, speeds, **short)
    assert nearest.amplitude.shape == rest.amplitude.shape
    assert (nearest.amplitude != rest.amplitude).all()
