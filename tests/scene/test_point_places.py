"""The places of points of contact as numbers of a scene, in files, overrides, sweeps and results."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.scene.config import parse
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.text import text_of
from jaxshroud.scene.vary import numbers_of, numbers_that_count, value_of

LISTED = ('contact.points=["-17.5 mm", 0, "15 mm"]', "contact.shares=[0.25, 0.5, 0.25]")
PLACE = "contact.point[2].place"


def test_a_place_is_a_number_of_the_scene():
    file = js.load("table1", [*LISTED, "contact.point[0].place=-16 mm"])
    assert [value_of(file.scene, f"contact.point[{m}].place") for m in range(3)] == [-0.016, 0.0, 0.015]
    moved = js.vary(file.scene, PLACE, 0.0125)
    assert float(moved.contact.points.places[2]) == 0.0125
    same = lambda a, b: jax.tree.all(jax.tree.map(np.array_equal, a, b))
    assert same(parse(file.text(), "text").scene, file.scene)
    assert same(parse(text_of(moved, {"periods": 3}), "text").scene, moved)
    grid = scenes_at(file.scene, [PLACE], np.array([[0.01], [0.012]]))
    np.testing.assert_array_equal(grid.contact.points.places[2], [0.01, 0.012])
    assert {"contact.point[0].place", PLACE} <= {*numbers_that_count(file.scene)}
    still = js.load("table1", [*LISTED, 'parts.motion=["x"]']).scene
    assert PLACE in numbers_of(still)
    assert PLACE not in numbers_that_count(still)  # which do not turn


def test_scenes_with_points_vary_in_compiled_functions():
    scene = js.load("table1", ["contact.points=2"]).scene
    assert float(jax.jit(lambda gap: js.vary(scene, "shroud.gap", gap).shroud.gap)(1e-5)) == 1e-5


@pytest.mark.parametrize(
    ("changes", "key", "value", "told"),
    [
        (LISTED, PLACE, 0.018, "beyond its end at 0.0175 m"),
        (LISTED, "contact.point[3].place", 0.0, r"no point \[3\] of contact: it lists 3 of them"),
        (("contact.points=3",), PLACE, 0.0, "lists no places of contact points"),
        ((), PLACE, 0.0, "lists no places of contact points"),
    ],
)
def test_wrong_places_are_told(changes, key, value, told):
    file = js.load("table1", [*changes])
    with pytest.raises(js.InputError, match=told):
        js.vary(file.scene, key, value)
    with pytest.raises(js.InputError, match=told):
        js.load("table1", [*changes, f"{key}={value}"])


@pytest.mark.parametrize("points", [2, 5])
def test_natural_modes_have_the_rotational_stiffness_of_the_face(points):
    file = js.load("table1", ["blades.I=block", f"contact.points={points}"])
    modes = {(mode.motion, mode.blades): mode for mode in js.check(file).modes if mode.contact == "sliding"}
    scene = file.scene
    of_face = float(scene.k) * float(scene.shroud.l_ab) ** 2 / 12 * (1 + 2 / (points - 1) ** 2)
    omega = np.sqrt((float(scene.blades.k_T[0]) + 2 * of_face) / float(scene.blades.I[0]))
    # to the coupling of torsion with bending along y, which the lever of a slid face would give
    assert abs(modes["theta", "out of phase"].frequency / (omega / (2 * np.pi)) - 1) < 1e-6
