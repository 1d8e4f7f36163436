"""Results keep their numbers and where they come from, through files and pictures."""

import json
import subprocess
import sys

import jax
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_array_equal, assert_equal

import jaxshroud as js
import jaxshroud.results
from jaxshroud.scene.checks import StoreError
from jaxshroud.scene.config import parse

SCENE = js.load("table1", ['parts.motion=["x"]']).scene
SHORT = {"method": js.RungeKutta(steps=200)}


@pytest.fixture(scope="module")
def results():
    return {
        "run": js.simulate(SCENE, n_periods=3, **SHORT),
        "curve": js.sweep(SCENE, {"contact.gamma": [1.0, 2.0, 4.0]}, n_periods=2, transient=1, **SHORT),
        "grid": js.sweep(
            SCENE, {"contact.gamma": [1.0, 2.0], "shroud.gap": [1e-5, 2e-5]}, n_periods=2, transient=1, **SHORT
        ),
        "power": js.power(SCENE, n_periods=64, transient=8, **SHORT),
        "lanes": js.simulate(js.scenes_from({"contact.gamma": [1.0, 2.0]}, SCENE), n_periods=2, **SHORT),
    }


@pytest.mark.parametrize("name", ["run", "curve", "grid", "power", "lanes"])
def test_what_is_saved_is_what_is_opened(name, results, tmp_path, reopened):
    result = results[name]
    again = reopened(result)
    assert js.open(tmp_path).data.identical(again.data)  # the folder of a command
    assert type(again) is type(result)
    assert repr(again) == repr(result)
    assert json.dumps(again.summary(), allow_nan=False) == json.dumps(result.summary(), allow_nan=False)
    for number in result.variables:
        assert_equal(getattr(again, number), getattr(result, number))
    scene = parse(again.scene, "again").scene
    assert float(scene.shroud.gap) == float(SCENE.shroud.gap)
    assert "<" in again._repr_html_()


def test_summaries_tell_how_lanes_ended_and_from_which_scene(results):
    run = results["run"].summary()
    assert run["status"] == {"OK": 1}
    assert "gamma" in run["scene"]
    assert results["curve"].summary()["runs"] == 3


def test_another_kind_is_told(results, tmp_path):
    results["run"].save(tmp_path / "a.nc")
    with pytest.raises(StoreError, match="holds a Trajectory, not a SweepResult"):
        js.SweepResult.load(tmp_path / "a.nc")


def test_a_file_without_a_kind_is_no_result(results, tmp_path):
    data = results["run"].to_xarray().copy()
    del data.attrs["kind"]
    data.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with pytest.raises(js.StoreError, match="not a result of jaxshroud"):
        js.open(tmp_path / "run.nc")


@pytest.mark.parametrize(
    ("name", "panels"),
    [
        ("run", ["history", "phase", "poincare", "spectrum"]),
        ("curve", ["samples", "P_d"]),
        ("grid", ["P_d", "motions"]),
    ],
)
def test_panels_are_drawn_on_the_users_axes(name, panels, results):
    assert isinstance(results[name].plot(), Figure)
    for panel in panels:
        figure = Figure()
        ax = figure.subplots()
        assert results[name].plot(ax=ax, panel=panel) is figure
        assert ax.has_data()
    with pytest.raises(ValueError, match="`panel` cannot be"):
        results[name].plot(ax=Figure().subplots(), panel="nonsense")


def test_a_panel_alone_needs_no_axes(results):
    figure = results["run"].plot(panel="phase")
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["phase portrait"]


@pytest.mark.full
def test_no_jax_is_needed_to_read_and_draw():
    program = """
import pkgutil, sys, jaxshroud.io, jaxshroud.plotting, jaxshroud.results
for room in (jaxshroud.io, jaxshroud.plotting, jaxshroud.results):
    for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
        __import__(module.name)
        if "jax" in sys.modules:
            sys.exit(f"{module.name} imports JAX")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.full
def test_a_lane_of_many_is_a_result_of_its_own():
    base = js.load("table1", ['parts.motion=["x"]'])
    scenes = js.scenes_from({"drive.omega": [536.0, 600.0], "drive.F_0[1]": [60.0, 50.0]}, base)
    how = {"n_periods": 2, "method": js.RungeKutta(steps=100)}
    many = js.simulate(scenes, **how)
    lane = many.lane(1)
    alone = js.simulate(jax.tree.map(lambda a: a[1], scenes), **how)
    assert_array_equal(lane.motion.x, alone.motion.x)
    assert_array_equal(lane.data["time"], alone.data["time"])
    assert (lane.status, lane.counters, lane.gap) == (alone.status, alone.counters, alone.gap)
    assert parse(lane.scene, "lane").tables == parse(alone.scene, "alone").tables
    assert parse(lane.scene, "lane").tables != base.tables  # control: the text of the first lane
    assert lane.plot().axes
    with pytest.raises(ValueError, match="1 leading axes, but 2"):
        many.lane(0, 1)
    assert_array_equal(js.simulate(scenes, many.last, **how).motion.x[:, 0], many.motion.x[:, -1])
