"""Every way to give a number is a key, along every verb: each gives, bit for bit, the scenes of overrides."""

import argparse
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.tangents import direction
from jaxshroud.cli.option_table import Along
from jaxshroud.cli.run_options import bounds, operating_conditions, scatters
from jaxshroud.cli.sweep import with_axes
from jaxshroud.io.scene_numbers import dimension, key_attrs, scene_text_of_lane, scenes_from_dataset
from jaxshroud.orbits.branch import ContinuationProblem
from jaxshroud.scene.checks import InputError, KeyNameError
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.keys import ALL_KEYS, ROW_KEYS
from jaxshroud.scene.vary import numbers_of, numbers_that_count, with_numbers
from jaxshroud.signals.effects import flat_text
from jaxshroud.verbs.arguments import resolve_options
from jaxshroud.verbs.design_problem import Problem, problem_of, scenes_of
from jaxshroud.verbs.scattering import scatter_bounds, scattering_of

pytestmark = pytest.mark.full

SMOOTH = ("parts.contact=smooth", "contact.width=1 um")
COUPLED = ("coupling.k_x=2e4", "coupling.k_y=1e4", "coupling.k_T=50", *(f"coupling.c_{name}=1" for name in "xyT"))
OPENING = ("shroud.gap_at=60 um", "shroud.gap_at_speed=3000 rpm")
FILES = {  # a scene as a designer has it, with different blades, and one of plain numbers
    "given": ("engine_order", ("blades.f_x=[95, 97]", "blades.zeta_y=[0.003, 0.004]", *SMOOTH, *COUPLED, *OPENING)),
    "plain": ("table1", (*SMOOTH, *COUPLED)),
}
PAIR_KEYS = [key for key in ALL_KEYS if key not in ROW_KEYS]
# Which need each other:
SPEED = ("drive.speed", "drive.engine_order", "blades.B_x", "blades.B_y", "blades.B_T")
SPEED += ("shroud.gap_at", "shroud.gap_at_speed")
CASES = [(name, key) for name in FILES for key in PAIR_KEYS if not (name == "plain" and key in SPEED)]
every_key = pytest.mark.parametrize(("name", "key"), CASES, ids=lambda word: word)


@cache
def file_of(name, *overrides):
    """One of the files, with overrides."""
    scene, own = FILES[name]
    return load(scene, [*own, *overrides])


@cache
def two_values(name, key):
    """Two values of a number that are not round, the smaller first."""
    level = float(np.mean(own_values(file_of(name).scene, key))) or 0.01
    return tuple(sorted((level * 1.0371, level * 1.0917)))


def own_values(scene, key):
    """A number of a scene, or those of both blades."""
    numbered = with_numbers(scene, [key])
    blades = [f"{key}[0]", f"{key}[1]"] if ALL_KEYS[key].pair else [key]
    return [js.value_of(numbered, one) for one in blades]


def overridden(name, key, value):
    """The scene of an override: what all others are compared with."""
    return file_of(name, f"{key}={value!r}").scene


def lane(scenes, *at):
    return jax.tree.map(lambda a: np.asarray(a)[at], scenes)


def assert_same(got, want):
    """The same numbers, given in the same way, bit for bit."""
    assert jax.tree.structure(got) == jax.tree.structure(want)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        assert_array_equal(a, b)


def assert_same_numbers(got, want):
    """The same numbers, bit for bit, however they are given."""
    got, want = numbers_of(got), numbers_of(want)
    assert got.keys() == want.keys()
    for key, value in want.items():
        assert_array_equal(got[key], value, err_msg=key)


@every_key
def test_vary_and_sweeps_and_tables(name, key):
    scene, values = file_of(name).scene, two_values(name, key)
    wanted = [overridden(name, key, value) for value in values]
    grid = grid_of_scenes(scene, {key: np.array(values)})
    table = js.scenes_from({key: list(values)}, file_of(name))
    for i, (value, want) in enumerate(zip(values, wanted, strict=True)):
        one = js.vary(scene, key, value)
        assert_same(one, want)
        assert set(own_values(one, key)) == {value}
        assert_same(lane(grid, i), want)
        assert_same(lane(table, i), want)


@every_key
def test_designs_conditions_and_branches(name, key):
    scene, (low, high) = file_of(name).scene, two_values(name, key)
    other = "friction.mu" if key != "friction.mu" else "shroud.gap"
    tuned = problem_of(scene, {key: (low, high)}, {})
    conditions = problem_of(scene, {other: (0.1, 0.2)}, {key: (low, high)})
    along = ContinuationProblem(with_numbers(scene, [key]), key, low, high, None, None)
    designs = scenes_of(tuned, np.array([[low], [high]]))
    in_conditions = scenes_of(conditions, np.array([[js.value_of(scene, other)]]))
    for i, value in enumerate((low, high)):
        want = overridden(name, key, value)
        assert_same_numbers(lane(designs, i), want)
        assert_same_numbers(lane(in_conditions, i), want)
        assert_same_numbers(along.at(value), want)


@every_key
def test_numbers_that_scatter(name, key):
    scene, level = file_of(name).scene, np.unique(own_values(file_of(name).scene, key))
    if len(level) > 1:  # a number that differs between the blades scatters for one blade
        with pytest.raises(KeyNameError, match="differs between the blades"):
            scatter_bounds(scene, {key: 1e-9})
        return
    low, high = scatter_bounds(scene, {key: 1e-9})[key]
    assert low <= level[0] <= high
    scattering = scattering_of({key: 1e-9}, 1, 0)._replace(others={key: level[0]})
    draws = scenes_of(Problem(with_numbers(scene, [key]), {}, {}, scattering=scattering), np.zeros((1, 0)))
    drawn = float(scattering.of([key], level[None])[0, 0])
    assert_same_numbers(lane(draws, 0), overridden(name, key, drawn))


@pytest.mark.parametrize("key", PAIR_KEYS)
def test_options_of_commands_take_every_key_with_units(key):
    # The values of a file: what [drive] speed = "1300 rpm" gives, --along, --over, --range and --tolerance give.
    file, row = file_of("given"), ALL_KEYS[key]
    unit = {"blades.zeta_x": "%", "drive.speed": "rpm", "drive.f": "kHz", "shroud.alpha": "deg"}.get(key, row.unit)
    low, high = f"3 {unit}".strip(), f"4 {unit}".strip()
    wanted = [js.value_of(overridden("given", key, end), f"{key}[0]" if row.pair else key) for end in (low, high)]
    ends = {key: tuple(wanted)}
    assert bounds(file, [f"{key}={low}:{high}"]) == ends
    assert operating_conditions(file, argparse.Namespace(range=[f"{key}={low},{high}"])) == {key: list(ends[key])}
    options = argparse.Namespace(along=[Along(key, start=low, stop=high, num="2")], direction=None)
    (axis,) = with_axes(file, options).axes
    assert (axis.key, tuple(axis.values)) == (key, ends[key])
    (table,) = parse(f'{file.text()}\n[sweep]\nalong = "{key}"\nvalues = ["{low}", "{high}"]', "own").axes
    assert (table.key, tuple(table.values)) == (key, ends[key])
    width = argparse.Namespace(tolerance=[f"{key}={high}"], spread=[])
    assert scatters(file, width) == {key: wanted[1]}


@pytest.mark.parametrize("key", PAIR_KEYS)
def test_a_lane_of_a_stored_result_is_the_scene_of_an_override(key):
    value = two_values("given", key)[1]
    axis = xr.Variable((), value, key_attrs(key))
    data = xr.Dataset(coords={dimension(key): axis}, attrs={"scene": file_of("given").text()})
    assert_same(parse(scene_text_of_lane(data), "stored").scene, overridden("given", key, value))


@pytest.mark.parametrize("key", PAIR_KEYS)
def test_scenes_of_many_lanes_are_stored_and_read(key):
    # Rows that differ in one number, and in all that is worked out from it, come back bit for bit.
    scenes = js.scenes_from({key: list(two_values("given", key))}, file_of("given"))
    attrs, more = resolve_options(scenes).provenance(100)
    again = scenes_from_dataset(xr.Dataset(more, attrs=attrs), (2,), "float64")
    assert list(more) == [dimension(key)]
    assert_same(again, scenes)


@pytest.mark.parametrize("key", PAIR_KEYS)
def test_tangents_are_those_of_overrides(key):
    # Central differences of quadratic formulas, square roots and products: exact to 1e-9 where a step of 1e-4 is 1e-8.
    scene = with_numbers(file_of("given").scene, [f"{key}[1]" if ALL_KEYS[key].pair else key])
    level, along = own_values(scene, key)[-1], f"{key}[1]" if ALL_KEYS[key].pair else key
    step = 1e-4 * (abs(level) or 1.0)
    ends = [numbers_of(js.vary(scene, along, level + sign * step)) for sign in (1, -1)]
    got = numbers_of(direction(scene, along))
    for name, slope in got.items():
        difference = (ends[0][name] - ends[1][name]) / (2 * step)
        assert_allclose(slope, difference, rtol=1e-6, atol=1e-9 * np.abs(ends[0][name]).max() / step)
    # Control: a number that others are worked out from moves these too.
    moves = [name for name, slope in got.items() if np.any(slope)]
    assert (len(moves) > 1) == (key in MOVES_OTHERS)


MOVES_OTHERS = {"blades.m", "blades.I", "shroud.l_oa", "shroud.l_ab", "blades.f_x", "blades.f_y", "blades.f_T"} | {
    f"blades.{name}" for name in ("k_x", "k_y", "k_T", "m_y")
}


@pytest.mark.parametrize("given", ["1300 rpm", "20 turn/s", "8e3 revolutions_per_minute"])
def test_a_speed_of_rotation_is_no_frequency_of_a_drive_with_an_engine_order(given):
    file, told = file_of("given"), "is a speed of rotation, but omega is .* engine order 4; name drive.speed"
    options = argparse.Namespace(along=[Along("drive.omega", start=given, stop="1600 rpm", num="3")], direction=None)
    for ask in (
        lambda: file_of("given", f"drive.omega={given}"),
        lambda: with_axes(file, options),
        lambda: bounds(file, [f"drive.omega={given}:9e4 rpm"]),
        lambda: operating_conditions(file, argparse.Namespace(range=[f"drive.omega={given},9e4 rpm"])),
        lambda: scatters(file, argparse.Namespace(tolerance=[f"drive.omega={given}"], spread=[])),
    ):
        with pytest.raises(InputError, match=told):
            ask()
    # Control: without an engine order it is a circular frequency, and with one rad/s are.
    assert bounds(file_of("plain"), [f"drive.omega={given}:9e4 rpm"])
    assert bounds(file, ["drive.omega=500 rad/s:600 rad/s"]) == {"drive.omega": (500.0, 600.0)}


def test_what_a_scene_does_not_have_is_told_with_the_cure():
    scene = file_of("plain").scene
    for ask in (lambda: js.vary(scene, "drive.speed", 1.0), lambda: with_numbers(scene, ["drive.speed"])):
        with pytest.raises(
            KeyNameError, match=r"gives no drive\.engine_order, .* in its file or with --set, or name dr"
        ):
            ask()
    with pytest.raises(KeyNameError, match=r"does not give blades\.f_x; name it for both blades, or blades\.k_x"):
        js.vary(scene, "blades.f_x[0]", 90.0)
    with pytest.raises(KeyNameError, match=r"drive\.speed and drive\.omega are one number"):
        with_numbers(file_of("given").scene, ["drive.speed", "drive.omega"])


def test_numbers_that_were_replaced_by_other_means_are_no_longer_given():
    scene = eqx.tree_at(lambda s: s.blades.k_x, file_of("given").scene, jnp.array([4e4, 5e4]))
    assert_array_equal(js.vary(scene, "blades.m", 0.2).blades.k_x, [4e4, 5e4])
    assert js.value_of(scene, "blades.k_x[0]") == 4e4


def test_all_numbers_that_count_are_those_given():
    counted = numbers_that_count(file_of("given").scene)
    assert {"drive.speed", "blades.f_T", "blades.zeta_x", "blades.f_x[0]"} <= set(counted)
    assert not {"drive.omega", "blades.I", "blades.k_T", "blades.c_x", "drive.engine_order"} & set(counted)


def test_flat_is_said():
    # Noise of a standard deviation of 0.5 in intervals of +- 1 is a constant; a slope of ten intervals is none.
    values, half = np.random.default_rng(0).normal(0.0, 0.5, 400), np.ones(400)
    assert "cannot be told from a constant" in flat_text(values, half)
    assert flat_text(values + np.linspace(0.0, 10.0, 400), half) == ""
    assert flat_text(np.array([np.nan, 1.0]), half[:2]) == ""


def test_a_sweep_over_the_speed_is_the_runs_of_overrides(reopened):
    # One march: each lane is what an override gives, stored and opened it keeps its key, and its picture is in rpm.
    small = ('parts.motion=["x"]', "parts.friction=none", "blades.zeta_x=0.2")
    file, how = load("engine_order", small), {"n_periods": 2, "transient": 1, "method": js.RungeKutta(steps=100)}
    speeds = [140.0, 150.0]
    curve = reopened(js.sweep(file, {"drive.speed": speeds}, **how))
    assert curve.data["speed"].attrs["units"] == "rad s-1"
    for i, speed in enumerate(speeds):
        alone = js.sweep(
            js.scenes_from({"friction.mu": [0.25]}, load("engine_order", [*small, f"drive.speed={speed}"])), **how
        )
        assert curve.P_d[i] == alone.P_d[0]
        assert js.value_of(parse(curve.lane(i).scene, "lane").scene, "drive.speed") == speed
    picture = curve.plot()
    assert any("rpm" in panel.get_xlabel() for panel in picture.axes)
