"""Many scenes in one: from tables of any kind, and from lists."""

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import jaxshroud as js
from jaxshroud.scene.checks import InputError, KeyNameError, SceneError
from jaxshroud.scene.config import load
from jaxshroud.scene.grids import scenes_from, stack_scenes
from jaxshroud.scene.vary import vary

COLUMNS = {"contact.gamma": [1.0, 2.5, 4.0], "blades.m[1]": [0.08, 0.09, 0.1], "drive.F_0": [60.0, 50.0, 0.0]}


def structured() -> np.ndarray:
    table = np.zeros(3, [(key, float) for key in COLUMNS])
    for key, values in COLUMNS.items():
        table[key] = values
    return table


@pytest.mark.parametrize(
    "table",
    [
        COLUMNS,
        {key: np.array(values) for key, values in COLUMNS.items()},
        pd.DataFrame(COLUMNS, index=[7, 8, 9]),
        structured(),
        xr.Dataset({key: ("lane", values) for key, values in COLUMNS.items()}, {"lane": [3, 4, 5]}),
    ],
    ids=["lists", "arrays", "frame", "structured", "dataset"],
)
def test_a_table_is_a_loop_over_its_rows(table, table1):
    scenes = scenes_from(table, table1)
    for lane in range(3):
        one = table1
        for key, values in COLUMNS.items():
            one = vary(one, key, values[lane])
        for got, want in zip(jax.tree.leaves(scenes), jax.tree.leaves(one), strict=True):
            np.testing.assert_array_equal(got[lane], want)


def test_the_base_is_a_file_or_a_scene():
    file = js.load("table1", ["parts.contact=smooth", "contact.width=1 um"])
    by_file, by_scene = (scenes_from({"contact.width": [1e-6, 2e-6]}, base) for base in (file, file.scene))
    np.testing.assert_array_equal(by_file.contact.width, by_scene.contact.width)
    assert by_file.parts == file.scene.parts


@pytest.mark.parametrize(
    ("table", "kind", "told"),
    [
        ({"contact.gama": [1.0]}, KeyNameError, "the scene has no number `contact.gama`; did you mean `contact.gamma`"),
        ({"shroud.gap[0]": [1.0]}, KeyNameError, "shroud.gap is one number, not one per blade; drop the [0]"),
        ({"contact.width": [1.0]}, KeyNameError, "the scene has no contact.width: its contact is not smooth"),
        ({"contact.k": [1.0], "contact.gamma": [1.0]}, KeyNameError, "contact.k and contact.gamma are one number"),
        ({"shroud.gap": [1.0, 2.0], "friction.mu": [1.0]}, SceneError, "has shroud.gap: 2, friction.mu: 1"),
        ({}, SceneError, "a table needs columns of one length and at least one row, but has no column"),
        ({"shroud.gap": []}, SceneError, "at least one row, but has shroud.gap: 0"),
        ({"shroud.gap": ["1 mm"]}, SceneError, "column shroud.gap must hold numbers in SI units (m)"),
        ({"blades.m": [[1.0, 2.0]]}, SceneError, "column blades.m must be one value per row, but its shape is (1, 2)"),
        ({"friction.mu": [0.0, 0.5, -0.1]}, SceneError, "row 2: friction.mu = -0.1 must be greater than or equal to 0"),
        ({"blades.m[0]": [1.0, np.nan]}, SceneError, "row 1: blades.m[0] = nan must be a finite number, e.g. 0.08"),
    ],
)
def test_wrong_tables(table, kind, told, table1):
    with pytest.raises(kind) as caught:
        scenes_from(table, table1)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_scenes_are_stacked(table1):
    listed = [vary(table1, "shroud.gap", gap) for gap in (1e-5, 2e-5)]
    stacked = stack_scenes(listed)
    for lane, one in enumerate(listed):
        for got, want in zip(jax.tree.leaves(stacked), jax.tree.leaves(one), strict=True):
            np.testing.assert_array_equal(got[lane], want)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["contact.k=1e5"], "scene 1 has contact.k where the first has contact.gamma"),
        (["blades.m_y=1"], "scene 1 has blades.m_y where the first has nothing"),
        (
            ['parts.motion=["x"]'],
            "scene 1 has parts.motion = ('x',) where the first has parts.motion = ('x', 'y', 'theta')",
        ),
        (
            ['contact.reading="printed"'],
            "scene 1 has the reading 'printed' where the first has the reading 'consistent'",
        ),
        (['blades.f_x="178 Hz"'], "scene 1 has blades.f_x where the first has nothing"),
    ],
)
def test_scenes_that_cannot_be_stacked_say_why(table1, overrides, told):
    with pytest.raises(InputError) as error:
        stack_scenes([table1, load("table1", overrides).scene])
    assert str(error.value).startswith("scenes are stacked if they have the same parts")
    assert told in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="leading axes"):
        stack_scenes([table1, stack_scenes([table1, table1])])
    with pytest.raises(InputError, match="there is none"):
        stack_scenes([])
