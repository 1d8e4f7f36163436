"""A drive of several harmonics, in files, overrides and keys."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.io.scene_numbers import dimension, key_label
from jaxshroud.scene.checks import SceneError
from jaxshroud.scene.config import axis, load, parse
from jaxshroud.scene.drive_orders import order_of_drive
from jaxshroud.scene.text import tables_of, text_of, words_of
from jaxshroud.scene.vary import numbers_of, numbers_that_count, with_numbers

FIRST = '[[drive.harmonic]]\norder = 1\nF = 60\nbeta = "30 deg"\nM = 0.1\n'
SECOND = '[[drive.harmonic]]\norder = 2\nF = [25.0, 40.0]\nbeta = "30 deg"\nphase = [0.3, 1.9]\n'
SINGLE = ("beta", "F_0", "M_0")


def file_with(harmonics=FIRST + SECOND, overrides=()):
    """A shipped scene with its drive replaced by harmonics."""
    kept = [line for line in load("table1").text().splitlines() if line.split(" = ")[0] not in SINGLE]
    return parse("\n".join([*kept, harmonics]), "two.toml", list(overrides))


def test_files_give_harmonics_as_tables_and_keep_them():
    file = file_with(overrides=["drive.harmonic[1].F[1]=7 N", "drive.level=2"])
    assert [one.order for one in file.scene.drive.harmonic] == [1, 2]
    assert_array_equal(file.scene.drive.harmonic[1].F, [25.0, 7.0])
    for text in (file.text(), text_of(file.scene, {"periods": 3})):
        again = parse(text, "again.toml").scene
        for key, value in numbers_of(file.scene).items():
            assert_array_equal(numbers_of(again)[key], value, err_msg=key)
    assert tables_of(file.scene)["drive"]["harmonic[1].order"] == 2
    assert words_of(file.text())["drive.harmonic[1].order"] == "2"
    assert file.title.endswith("but level = 2, harmonic[1].F = 25 and 7 N")


def test_harmonics_have_the_phase_of_the_drive_times_their_order():
    harmonics = file_with().scene.drive.harmonics()
    assert list(harmonics) == [1, 2]
    assert_array_equal(harmonics[1].phase, [0.0, np.pi])
    assert_allclose(harmonics[2].phase, [0.3, 2 * np.pi + 1.9], rtol=1e-15)
    louder = js.vary(file_with().scene, "drive.level", 3.0).drive.harmonics()
    assert_array_equal(louder[2].F_0, 3 * harmonics[2].F_0)
    assert_array_equal(louder[1].M_0, 3 * harmonics[1].M_0)


def test_keys_of_harmonics_are_like_all_others():
    file = file_with()
    key = "drive.harmonic[1].F[0]"
    assert_array_equal(axis(file, key, ["1 N", "2 N"]).values, [1.0, 2.0])
    scenes = js.scenes_from({key: [1.0, 2.0], "drive.harmonic[0].phase": [0.0, 0.5]}, file)
    assert_array_equal(scenes.drive.harmonic[1].F, [[1.0, 40.0], [2.0, 40.0]])
    assert_array_equal(scenes.drive.harmonic[0].phase, [[0.0, 0.0], [0.5, 0.5]])
    assert js.value_of(file.scene, key) == 25.0
    assert dimension(key) == "harmonic_1_F_left"
    assert key_label("drive.harmonic[1].M") == "moment amplitude of harmonic [1] $M_{1}$"
    counted = numbers_that_count(file.scene)
    assert {key, "drive.harmonic[1].F[1]", "drive.harmonic[0].M", "drive.omega"} <= set(counted)
    assert not {"drive.F_0", "drive.level"} & set(counted)
    numbered = with_numbers(file.scene, ["drive.level", "drive.harmonic[0].phase"])
    assert (float(numbered.drive.level), numbered.drive.harmonic[0].phase.tolist()) == (1.0, [0.0, 0.0])


def test_the_level_is_a_number_of_every_drive():
    scene = load("table1").scene
    assert js.value_of(scene, "drive.level") == 1.0
    assert_array_equal(js.vary(scene, "drive.level", 2.0).drive.harmonics()[1].F_0, [120.0, 120.0])
    assert load("table1", ["drive.level=2"]).scene.drive.level == 2.0


def test_engine_orders_of_harmonics_give_that_of_the_drive():
    orders = (FIRST + SECOND).replace("order = 1", "engine_order = 4").replace("order = 2", "engine_order = 8")
    file = parse(_ring(orders), "ring.toml")
    assert file.given["drive.engine_order"] == 4
    assert [one.order for one in file.scene.drive.harmonic] == [1, 2]
    assert_allclose(file.scene.drive.phase, 2 * np.pi * 4 * np.arange(12) / 12, rtol=1e-15)
    assert parse(file.text(), "again.toml").given == file.given
    for base, multiples in ((2, [2, 4]), (1, [4, 8])):
        told = parse(_ring(orders, f"engine_order = {base}"), "ring.toml").scene
        assert [one.order for one in told.drive.harmonic] == multiples
    backward = parse(_ring(orders.replace("= 4", "= -4").replace("= 8", "= -8")), "ring.toml")
    assert backward.given["drive.engine_order"] == -4


def _ring(harmonics, drive=""):
    """A ring of 12 blades, alike, with harmonics."""
    tables = ["[row]\nblades = 12\nclosed = true\n"]
    text = load("table1").text()
    head, _, rest = text.partition("[drive]\n")
    _, _, tail = rest.partition("[initial]")
    tables += [head.partition("\n")[2], f"[drive]\nomega = 536.0\n{drive}\n", harmonics.replace("[25.0, 40.0]", "25")]
    return "".join(tables).replace("[0.3, 1.9]", "0.3") + "\n[initial]" + tail


def test_a_ring_under_several_orders_has_their_symmetry():
    alike = parse(_ring(FIRST + SECOND, "engine_order = 4"), "ring.toml").scene
    assert order_of_drive(alike.drive) == 4
    apart = js.vary(alike, "drive.harmonic[1].phase", np.linspace(0.0, 1.0, 12))
    assert order_of_drive(apart.drive) is None


@pytest.mark.parametrize(
    ("harmonics", "overrides", "told"),
    [
        ("[drive.harmonic]\norder = 1\n", [], "must be a list of tables with keys, e.g. [[drive.harmonic]] with order"),
        (FIRST + FIRST, [], "two.toml: [[drive.harmonic]] 0 and 1 both have order 1; make one of them"),
        (FIRST + "[[drive.harmonic]]\n", [], "must be a list of tables with keys"),
        (FIRST + SECOND.replace("order", "ordr"), [], "[drive] has no key `harmonic[1].ordr`"),
        (FIRST.replace("= 1", "= 1.5"), [], "[drive] harmonic[0].order = 1.5 must be a valid integer"),
        (FIRST.replace("= 1", "= 0"), [], "harmonic[0].order = 0 must be greater than or equal to 1"),
        (FIRST.replace("= 60", "= nan"), [], "[drive] harmonic[0].F = NaN must be a finite number"),
        (FIRST + SECOND, ["drive.F_0=3"], "--set: the scene has no drive.F_0, as its drive is a list of 2 harmonics; "),
        (FIRST, ["drive.harmonic[3].F=3"], "--set: the scene has no drive.harmonic[3].F: its drive has 1 harmonic, "),
        (FIRST, ["drive.harmonic[0].F[2]=3"], "--set: drive.harmonic[0].F[2]: the scene has 2 blades"),
        (
            FIRST + SECOND.replace("order", "engine_order"),
            [],
            "two.toml: [[drive.harmonic]]: some have an order and some an engine order; give drive.engine_order too",
        ),
        (
            FIRST.replace("order", "engine_order") + SECOND.replace("order = 2", "engine_order = 2.5"),
            [],
            "[[drive.harmonic]] 1: engine_order = 2.5 must be a whole number but 0, e.g. 8",
        ),
        (FIRST + "engine_order = 2\n", [], "[[drive.harmonic]] 0 gives both `order` and `engine_order`; keep one"),
    ],
)
def test_wrong_harmonics_are_refused_in_one_line(harmonics, overrides, told):
    with pytest.raises(SceneError) as error:
        file_with(harmonics, overrides=overrides)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["drive.F_0", "drive.harmonic[2].F", "drive.beta[1]"])
def test_numbers_that_a_drive_lacks_are_refused_by_name(key):
    file = file_with()
    for call in (
        lambda: js.vary(file.scene, key, 1.0),
        lambda: js.value_of(file.scene, key),
        lambda: axis(file, key, [1.0, 2.0]),
        lambda: js.scenes_from({key: [1.0, 2.0]}, file),
        lambda: with_numbers(file.scene, [key]),
    ):
        with pytest.raises(SceneError, match=r"the scene has no drive\."):
            call()
    with pytest.raises(SceneError, match="its drive has no list of harmonics; add a table"):
        js.vary(load("table1").scene, "drive.harmonic[0].F", 1.0)


def test_a_drive_in_python_has_one_form():
    harmonic = js.Harmonic(2, 20.0, 0.5)
    drive = js.Drive(536.0, None, None, None, 0.0, harmonic=(js.Harmonic(1, 60.0, 0.5), harmonic))
    assert list(drive.harmonics()) == [1, 2]
    for wrong in (
        lambda: js.Drive(536.0, None, None, None, 0.0, harmonic=(harmonic, harmonic)),
        lambda: js.Drive(536.0, 0.5, 60.0, 0.0, 0.0, harmonic=(harmonic,)),
        lambda: js.Drive(536.0, None, None, None, 0.0),
        lambda: js.Drive(536.0, None, None, None, 0.0, harmonic=(js.Harmonic(2, np.nan, 0.5),)),
    ):
        with pytest.raises(SceneError.__mro__[1]):
            wrong()
