"""Files, keys and bad input of coupled blades."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.scene.blades import Aero
from jaxshroud.scene.config import parse

COUPLED = ["row.blades=4", "drive.engine_order=1", "row.coupling.k_x=2e4", "row.aero.L1=[-500, 10 N/mm]"]


def test_a_file_with_a_row_has_them_in_its_table_and_reads_what_it_writes():
    file = js.load("row_ring12", [*COUPLED, "row.coupling.c_T[2]=0.1"])
    text = file.text()
    assert "[row.coupling]" in text
    assert "[row.aero]" in text
    again = parse(text, "again")
    assert again.text() == text
    np.testing.assert_array_equal(again.scene.coupling.k_x, np.full(4, 2e4))
    np.testing.assert_array_equal(again.scene.coupling.c_T, [0, 0, 0.1, 0])
    assert again.scene.coupling.k_y is None
    assert [float(again.scene.aero.L1_re), float(again.scene.aero.L1_im)] == [-500, 1e4]
    outside = parse(text.replace("[row.coupling]", "[coupling]").replace("[row.aero]", "[aero]"), "outside")
    assert outside.text() == text


def test_a_pair_has_springs_between_its_blades_in_a_table_of_their_own():
    file = js.load("table1", ["coupling.k_x=3 N/mm"])
    assert float(file.scene.coupling.k_x) == 3000
    assert "\n[coupling]\nk_x = 3000.0\n" in file.text()
    assert "coupling" not in js.load("table1").text()


def test_keys_vary_what_a_scene_is_without():
    ring = js.load("row_ring12", COUPLED).scene
    assert js.value_of(ring, "row.coupling.k_x[3]") == js.value_of(ring, "coupling.k_x") == 2e4
    assert js.value_of(ring, "coupling.c_y") == js.value_of(ring, "aero.L_1_im") == 0.0
    more = js.vary(js.vary(ring, "coupling.c_y[1]", 5.0), "aero.L_1_im", -7.0)
    np.testing.assert_array_equal(more.coupling.c_y, [0, 5, 0, 0])
    assert float(more.aero.L_1_im) == -7
    assert js.value_of(js.load("table1").scene, "coupling.k_T") == 0.0


@pytest.mark.parametrize(
    ("name", "changes", "told"),
    [
        ("table1", ["coupling.k_x=-1"], r"\[coupling\] k_x = -1 must be greater than or equal to 0"),
        ("table1", ["coupling.k=1"], r"\[coupling\] has no key `k`; known are k_x, k_y"),
        ("table1", ["coupling.k_x=1", "parts.contact=none"], 'drop `parts.contact` = "none"'),
        ("table1", ["aero.L0=[0, 1]"], r"\[aero\] is of rows of blades alone"),
        ("row_ring12", ["row.coupling.k_x=[1, 2]"], "one number or a list of 12, one for each interface"),
        ("row_ring12", ["row.coupling.k_x[12]=1"], "the scene has 12 interfaces"),
        ("row_ring12", ["row.aero.L0=5"], r"\[row.aero\] L0 = 5 must be a pair \[real, imaginary\]"),
        ("row_ring12", ["row.aero.L0=[0, inf]"], "L0_im = Infinity must be a finite number"),
        ("row_ring12", ["row.aero.L2=[0, 1]"], r"\[aero\] has no key `L2`"),
    ],
)
def test_bad_input_gets_one_line(name, changes, told):
    with pytest.raises(js.SceneError if "aero.L0=[0, 1]" not in changes else ValueError, match=told) as error:
        js.load(name, changes)
    assert "\n" not in str(error.value)


def test_a_table_is_given_once():
    text = js.load("row_ring12", COUPLED).text() + "\n[coupling]\nk_x = 1\n"
    with pytest.raises(js.SceneError, match=r"gives both \[row.coupling\] and \[coupling\]; keep one of them"):
        parse(text, "twice")


def test_python_has_the_same_bounds():
    pair = js.load("table1").scene
    with pytest.raises(js.SceneError, match=r"coupling.c_x = -1 must be greater"):
        js.vary(pair, "coupling.c_x", -1.0)
    with pytest.raises(KeyError, match=r"the scene has no number `aero.L0_re`"):
        js.vary(pair, "aero.L0_re", 1.0)
    with pytest.raises(js.SceneError, match=r"aero.L0_re = nan must be a finite number"):
        Aero(L0_re=np.nan)
