"""Blades by modes in files: their tables, keys, round trips, and what is refused."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.scene.config import parse
from jaxshroud.scene.text import text_of

F, ZETA = [178.0, 508.0, 740.0], [0.002, 0.003, 0.004]
PHI = np.array([[3.5, 0.2, -0.4], [0.1, 4.0, 0.3], [5.0, -2.0, 21.0]])
HEAD = "f [Hz],zeta,phi_x,phi_y,phi_theta\n"
LINES = "".join(f"{f},{z},{','.join(map(str, shape))}\n" for f, z, shape in zip(F, ZETA, PHI.T, strict=True))
REST = """
[shroud]
alpha = "60 deg"
l_oa = 0.05
l_ab = 0.035
gap = 2e-5
[contact]
k = 2e5
[friction]
k_d = 1e6
mu = 0.5
[drive]
omega = 1000.0
beta = 0.5
F_0 = 10.0
M_0 = 0.1
phase = [0.0, 3.0]
[run]
periods = 2
"""
TABLES = "".join(
    f"[[blades.modes]]\nf = {f}\nzeta = {z}\nphi_x = {x}\nphi_y = {y}\nphi_theta = {t}\n"
    for f, z, (x, y, t) in zip(F, ZETA, PHI.T, strict=True)
)


def written(folder: Path, blades: str, csv: str = HEAD + LINES, rest: str = REST) -> Path:
    (folder / "blade.csv").write_text(csv)
    path = folder / "scene.toml"
    path.write_text(blades + rest)
    return path


def alike(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_array_equal(a, b)


def by_file(folder: Path, *overrides: str) -> js.Scene:
    return js.load(written(folder, '[blades]\nmodes = "blade.csv"\n'), overrides).scene


def test_a_file_a_table_and_arrays_give_one_scene(tmp_path):
    scene = by_file(tmp_path)
    alike(scene, parse(TABLES + REST, "tables").scene)
    alike(scene, dataclasses.replace(scene, blades=js.modal_blades(F, ZETA, PHI)))
    alike(scene, parse(text_of(scene, {"periods": 2}), "text").scene)
    squares = "omega2,zeta,phi_x,phi_y,phi_theta [deg m^-1 kg^-0.5],kind\n" + "".join(
        f"{(2 * np.pi * f) ** 2!r},{z},{x},{y},{float(np.degrees(t))!r},mode\n"
        for f, z, (x, y, t) in zip(F, ZETA, PHI.T, strict=True)
    )
    other = js.load(written(tmp_path, '[blades]\nmodes = "blade.csv"\n', squares)).scene
    for a, b in zip(jax.tree.leaves(scene), jax.tree.leaves(other), strict=True):
        assert_allclose(b, a, rtol=1e-14)


def test_an_override_names_another_table(tmp_path):
    written(tmp_path, "")
    over = f"blades.modes={tmp_path / 'blade.csv'}"
    lumped = js.load("table1", [over, "contact.k=2e5"]).scene
    assert_array_equal(np.stack([mode.f for mode in lumped.blades.modes]), np.repeat(F, 2).reshape(3, 2))
    set_too = js.load("table1", [over, "contact.k=2e5", "blades.modes[1].f=500"])
    assert js.value_of(set_too.scene, "blades.modes[1].f") == 500.0
    assert "blades.modes[1].f" not in set_too.title
    assert "500" in set_too.title


def test_numbers_of_modes_have_keys(tmp_path):
    scene = by_file(tmp_path, "blades.modes[2].zeta=1%", "blades.modes[0].phi_x[1]=3.6", "blades.modes[1].f=0.5 kHz")
    assert js.value_of(scene, "blades.modes[2].zeta") == 0.01
    assert_array_equal(scene.blades.modes[0].phi_x, [3.5, 3.6])
    assert js.value_of(scene, "blades.modes[1].f") == 500.0
    changed = js.vary(scene, "blades.modes[0].f[0]", 180.0)
    assert_array_equal(changed.blades.modes[0].f, [180.0, 178.0])
    assert changed.mode_numbers.stiffness[0][0] == (2 * np.pi * 180.0) ** 2
    many = js.scenes_from({"blades.modes[2].phi_theta": [20.0, 21.0]}, scene)
    assert_array_equal(many.blades.modes[2].phi_theta, [[20.0, 20.0], [21.0, 21.0]])

    def k(f):
        return js.vary(scene, "blades.modes[0].f", f).mode_numbers.stiffness[0][0]

    assert jax.grad(k)(jnp.asarray(178.0)) == pytest.approx(2 * (2 * np.pi) ** 2 * 178.0, rel=1e-13)


def test_a_rigid_motion_is_told_by_the_gap_above_it():
    rigid = TABLES.replace("f = 178.0", "omega2 = -0.5")
    assert js.value_of(parse(rigid + REST, "rigid").scene, "blades.modes[0].f") == 0.0
    with pytest.raises(js.SceneError, match="negative omega"):
        parse(TABLES.replace("f = 178.0", "omega2 = -1e5") + REST, "unstable")


def test_coordinates_that_no_mode_moves_are_absent(tmp_path):
    bending = HEAD.replace(",phi_theta", "") + "178,0.002,3.5,0.1\n508,0.003,0.2,4\n"
    path = written(tmp_path, '[blades]\nmodes = "blade.csv"\n', bending)
    assert js.load(path).scene.parts.motion == ("x", "y")
    scene = parse(TABLES + REST, "tables").scene
    with pytest.raises(js.InputError, match=r"No mode moves the shroud in theta.*parts\.motion"):
        dataclasses.replace(scene, blades=js.modal_blades(F, ZETA, PHI * [[1], [1], [0]]))


def test_equivalents_are_masses_and_springs_of_the_shroud(tmp_path):
    scene = by_file(tmp_path)
    k = (2 * np.pi * np.array(F)) ** 2
    assert_allclose(scene.left_k_x, 1 / np.sum(PHI[0] ** 2 / k), rtol=1e-13)
    assert_allclose(scene.resting_blades.I, 1 / np.sum(PHI[2] ** 2), rtol=1e-13)


WRONG = {
    "no such file": ('[blades]\nmodes = "none.csv"\n', HEAD + LINES, "none.csv: no such file"),
    "beside lumped": ('[blades]\nmodes = "blade.csv"\nm = 1.0\n', HEAD + LINES, "both modes and `m`"),
    "a number": ("[blades]\nmodes = 3\n", HEAD + LINES, "must be a list of tables"),
    "column": ('[blades]\nmodes = "blade.csv"\n', "freq,zeta\n1,2\n", "column 'freq' is unknown"),
    "cell": ('[blades]\nmodes = "blade.csv"\n', HEAD + "178,abc,1,2,3\n", r"mode \[0\]: zeta = abc"),
    "not finite": ('[blades]\nmodes = "blade.csv"\n', HEAD + "nan,0,1,2,3\n", "f = nan must be a finite number"),
    "ragged": ('[blades]\nmodes = "blade.csv"\n', HEAD + "178,0\n", "the row has 2 cells"),
    "no modes": ('[blades]\nmodes = "blade.csv"\n', HEAD, "has no modes"),
    "damping": ('[blades]\nmodes = "blade.csv"\n', HEAD + LINES.replace("0.002", "1.5"), "zeta"),
    "no frequency": ('[blades]\nmodes = "blade.csv"\n', "zeta,phi_x\n0.1,1\n", r"lacks `modes\[0\].f`"),
    "too many": ('[blades]\nmodes = "blade.csv"\n', HEAD + LINES * 6, "at most 16"),
    "both": ("[[blades.modes]]\nf = 1\nomega2 = 2\n", "", "both `f` and `omega2`"),
    "dependent": ("[[blades.modes]]\nf = 178\nphi_x = 3\nphi_y = 2\n", "", "in dependence on each other"),
    "unit": ('[blades]\nmodes = "blade.csv"\n', HEAD.replace("Hz", "kg") + LINES, "its unit is a mass"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_modes_get_one_line(tmp_path, case):
    blades, csv, words = WRONG[case]
    with pytest.raises((js.SceneError, js.InputError), match=words) as caught:
        js.load(written(tmp_path, blades, csv)).scene  # noqa: B018
    assert "\n" not in str(caught.value)


LACKING = {
    "blades.m": r"no blades\.m, as its blades are given by modes",
    "blades.f_x": r"no blades\.f_x, as its blades are given by modes",
    "blades.modes[3].f": "have 3 modes, numbered from 0",
}


@pytest.mark.parametrize("key", LACKING)
def test_numbers_that_are_not_there_are_refused(tmp_path, key):
    for ask in (lambda: by_file(tmp_path, f"{key}=1"), lambda: js.vary(by_file(tmp_path), key, 1.0)):
        with pytest.raises(js.KeyNameError, match=LACKING[key]):
            ask()
    with pytest.raises(js.KeyNameError, match="lumped"):
        js.load("table1", ["blades.modes[0].f=1"])


def test_arrays_of_other_shapes_are_refused():
    with pytest.raises(js.InputError, match="3 modes of 2 blades"):
        js.modal_blades(F, ZETA, PHI[:, :2])
    with pytest.raises(js.InputError, match=r"\(3, n\)"):
        js.modal_blades(F, ZETA, PHI[:2])


@pytest.mark.parametrize(
    ("change", "words"), [("contact.reading=printed", "misprints"), ("parts.contact=none", "none")]
)
def test_what_modes_do_not_go_with(tmp_path, change, words):
    with pytest.raises((js.SceneError, js.InputError), match=words):
        by_file(tmp_path, change)
