"""A scene made in Python is checked as one in a file is: the same ranges in the same words."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.scene.blades import Blades, Coupling
from jaxshroud.scene.checks import SceneError
from jaxshroud.scene.config import parse
from jaxshroud.scene.keys import SCENE_KEYS, Motion
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud
from jaxshroud.scene.vary import vary

BLADES = dict(m=0.08, I=2.46e-3, k_x=1e5, k_y=3e6, k_T=2000.0, c_x=3.57, c_y=19.6, c_T=0.506)
MAKE = {
    "blades": lambda **n: Blades(**{**BLADES, **n}),
    "shroud": lambda **n: Shroud(**{**dict(alpha=1.0, l_oa=0.05, l_ab=0.035, gap=2.2e-5), **n}),
    "contact": lambda **n: Contact(**{**dict(k=None if "gamma" in n else 1e5, gamma=None), **n}),
    "friction": lambda **n: Friction(**{**dict(k_d=1e6, mu=0.5), **n}),
    "drive": lambda **n: Drive(**{**dict(omega=536.0, beta=0.5, F_0=60.0, M_0=100.0, phase=(0.0, 3.0)), **n}),
    "coupling": Coupling,
    "initial": lambda **n: scene(initial=Motion(**{**dict.fromkeys(Motion._fields, 0.0), **n})),
}


def scene(initial=None) -> Scene:
    parts = [MAKE[table]() for table in ("blades", "shroud", "contact", "friction", "drive")]
    return Scene(*parts) if initial is None else Scene(*parts, initial)


def told(make, *arguments, **numbers) -> str:
    with pytest.raises(SceneError) as caught:
        make(*arguments, **numbers)
    assert isinstance(caught.value, ValueError)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def outside(row) -> list[float]:
    """Numbers out of a range, and right beyond its ends."""
    ends = [
        np.nextafter(e, s) for e, s in ((row.range.minimum, -np.inf), (row.range.maximum, np.inf)) if np.isfinite(e)
    ]
    return [np.nan, np.inf, -np.inf, *([0.0] if row.range.open else []), *map(float, ends)]


@pytest.mark.parametrize("row", SCENE_KEYS, ids=lambda row: row.name)
def test_what_files_refuse_is_refused_in_python(row, table1):
    table, name = row.parts
    text = js.load("table1").text()
    more = ["parts.contact=smooth"] if row.name == "contact.width" else []
    for bad in outside(row):
        with pytest.raises(SceneError) as caught:
            parse(text, "my.toml", [f"{row.name}={bad!r}", *more])
        in_file = re.search(r" must be (.*), e\.g\. ", str(caught.value))
        assert in_file is not None
        in_python = told(MAKE[table], **{name: bad})
        assert in_python.startswith(f"{row.name} = {str(bad).removesuffix('.0')} must be {in_file[1]}, e.g. ")
        assert f"({row.about}{f' [{row.unit}]' if row.unit else ''})" in in_python
        if row.name != "contact.width":
            assert told(vary, table1, row.name, bad) == in_python
            if row.pair:
                assert told(vary, table1, f"{row.name}[1]", bad) == in_python


@pytest.mark.parametrize("row", SCENE_KEYS, ids=lambda row: row.name)
def test_the_ends_of_ranges_are_inside(row, table1):
    table, name = row.parts
    for end in (row.range.minimum, row.range.maximum):
        if np.isfinite(end) and not (row.range.open and end == row.range.minimum):
            made = MAKE[table](**{name: end})
            assert jax.tree.leaves(made)


def test_messages_name_the_place():
    negative = "must be greater than 0, e.g. 0.08 (mass [kg])"
    assert told(MAKE["blades"], m=-1) == f"blades.m = -1 {negative}"
    assert told(MAKE["blades"], m=(1, -2.5)) == f"blades.m[1] = -2.5 {negative}"
    lanes = np.ones((3, 2))
    lanes[2, 0] = -4
    assert told(MAKE["blades"], m=lanes) == f"blades.m[2, 0] = -4 {negative}"
    assert told(MAKE["drive"], omega=np.array([1.0, 0.0])).startswith("drive.omega[1] = 0 must be greater than 0")
    assert told(MAKE["drive"], phase=np.inf).endswith("e.g. 0, 3.14159 (phases of the drive [rad])")
    assert told(MAKE["blades"], m="80 g").startswith("blades.m = '80 g' must be a valid number, e.g. 0.08")
    assert told(MAKE["blades"], m=np.ones(3)).startswith("blades.m must be one number or a pair [left, right], but ")
    assert told(MAKE["shroud"], gap=True).startswith("shroud.gap = True must be a valid number")


def test_a_right_angle_is_right_in_both_precisions():
    assert MAKE["shroud"](alpha=np.pi / 2).alpha == np.pi / 2
    with jax.enable_x64(False):
        assert MAKE["shroud"](alpha=np.pi / 2).alpha == np.float32(np.pi / 2)  # which is larger than pi / 2


def test_leading_axes_are_those_of_many_scenes():
    lanes = Scene(
        MAKE["blades"](m=np.full((4, 3, 2), 0.1)),
        MAKE["shroud"](gap=np.zeros((4, 3))),
        MAKE["contact"](),
        MAKE["friction"](),
        MAKE["drive"](F_0=(np.ones((4, 3)), np.zeros((4, 3)))),
    )
    assert lanes.drive.F_0.shape == (4, 3, 2)  # left before right in the last axis
    np.testing.assert_array_equal(lanes.drive.F_0[..., 0], 1.0)


def test_what_is_traced_is_not_looked_at(table1):
    gaps = jnp.array([-1.0, 1.0])
    masses = jax.vmap(lambda m: vary(table1, "blades.m", m).blades.m)(gaps)  # a negative mass among them
    np.testing.assert_array_equal(masses[:, 0], gaps)
    assert jax.jit(lambda mu: Friction(1e6, mu).mu)(-1.0) == -1.0
    slope = jax.grad(lambda mu: MAKE["friction"](mu=mu).mu * 2.0)(0.5)
    assert slope == 2.0
    assert jax.vmap(lambda b: vary(table1, "drive.beta", [b, 0.0]).drive.beta)(gaps).shape == (2, 2)


def test_tree_functions_are_not_in_the_way(table1):
    broken = eqx.tree_at(lambda s: s.blades.m, table1, jnp.array([-1.0, np.nan]))
    assert broken.blades.m[0] == -1
    assert jax.tree.map(jnp.negative, table1).shroud.gap == -table1.shroud.gap
    shapes = jax.eval_shape(lambda: table1)
    assert shapes.blades.m.shape == (2,)


def test_a_grid_is_checked_before_it_is_traced(table1):
    with pytest.raises(SceneError, match=r"^contact\.gamma = -1 must be greater than or equal to 0, e\.g\. 2\.5"):
        js.sweep(table1, {"contact.gamma": [1.0, -1.0]}, n_periods=1)
