"""One table of a scene's numbers, from which all that lists them is made."""

import subprocess
import sys

import jax.numpy as jnp
import keys as documented
import pytest

from jaxshroud.io.scene_numbers import key_attrs
from jaxshroud.io.variable import MOTION
from jaxshroud.plotting.style import QUANTITIES
from jaxshroud.scene.blades import Blades, Coupling
from jaxshroud.scene.checks import KeyNameError
from jaxshroud.scene.config import load
from jaxshroud.scene.keys import (
    ALL_KEYS,
    INPUT_KEYS,
    KEYS,
    LIMIT_KEYS,
    ROW_KEYS,
    SCENE_KEYS,
    Motion,
    find_key,
    key_parts,
    keys_of_table,
)
from jaxshroud.scene.scene import Contact, Drive, Friction, Shroud
from jaxshroud.scene.schema import PHYSICS_TABLES, TABLE_MODELS
from jaxshroud.scene.units import _parsed_unit
from jaxshroud.scene.vary import NUMERIC_KEYS, vary

CLASSES = {
    "blades": Blades,
    "shroud": Shroud,
    "contact": Contact,
    "friction": Friction,
    "coupling": Coupling,
    "drive": Drive,
    "initial": Motion,
}
# The whole of what a new number takes, but for the field of its class: it is in files, keys, units and pictures then.
NEW = """
import jaxshroud.scene.keys as keys
row = keys.scene_key("friction.k_e", "N/m", keys.FROM_0, "k_e", "other stiffness", "3 N/mm", "another stiffness")
keys.KEYS[row.name] = row
"""
USES = """
from jaxshroud.scene.config import axis, load
from jaxshroud.scene.schema import TABLE_MODELS
from jaxshroud.plotting.style import quantity
file = load("table1", ["friction.k_e=2 N/mm"])
print(file.tables["friction"]["k_e"])
print(tomllib.loads(file.text())["friction"]["k_e"])
print(axis(file, "friction.k_e", ["1 N/m", "2"  " N/m"]).values)
print(keys.key_parts("friction.k_e"))
print(quantity("friction.k_e"))
for override in ("friction.mu=0.5", "friction.k_e=-1", "friction.k_e=1 mm", "friction.k_f=1"):
    try:
        load("table1", [override])
    except ValueError as error:
        print(error)
"""


def test_the_table_and_the_classes_hold_the_same_numbers(table1):
    fields = [f"{table}.{name}" for table, kind in CLASSES.items() for name in kind.__annotations__]
    words = ("contact.reading", "contact.points", "drive.harmonic")
    assert [name for name in fields if name not in words] == [row.name for row in SCENE_KEYS] == list(KEYS)
    for row in SCENE_KEYS:
        value = getattr(getattr(table1, row.parts[0]), row.parts[1])
        assert value is None or jnp.shape(value) == ((2,) if row.pair else ()), row.name


def test_all_that_lists_numbers_is_made_from_the_table():
    assert list(NUMERIC_KEYS) == list(KEYS)
    assert list(QUANTITIES) == list(ALL_KEYS) == [*KEYS, *(row.name for row in INPUT_KEYS), *ROW_KEYS, *LIMIT_KEYS]
    assert [key_attrs(key)["units"] for key in KEYS] == [row.netcdf for row in SCENE_KEYS]
    assert list(MOTION) == [row.parts[1] for row in keys_of_table("initial")] == list(Motion._fields)
    words = {"contact.reading", "contact.points", "contact.shares", "initial.start", "initial.friction"}
    words |= {f"parts.{name}" for name in TABLE_MODELS["parts"].model_fields}
    assert {f"{table}.{name}" for table in PHYSICS_TABLES for name in TABLE_MODELS[table].model_fields} - words == set(
        KEYS
    )
    assert documented.FILE.read_text(encoding="utf-8") == documented.page()


@pytest.mark.full
def test_a_new_number_is_one_line():
    program = "import tomllib\n" + NEW + USES
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    example = 'e.g. k_e = "3 N/mm" (another stiffness)'
    assert told.splitlines() == [
        *["2000.0"] * 2,
        "[1. 2.]",
        "('friction', 'k_e', None)",
        "('other stiffness $k_e$ [kN/m]', 0.001)",
        f"table1.toml: [friction] lacks `k_e`; add it, {example}",
        f"--set: [friction] k_e = -1 must be greater than or equal to 0, {example}",
        f'--set: [friction] k_e = "1 mm" is a length, but a stiffness is needed, {example}',
        "--set: [friction] has no key `k_f`; did you mean `k_e`?",
    ]


@pytest.mark.parametrize("row", SCENE_KEYS, ids=lambda row: row.name)
def test_units_are_of_one_dimension_everywhere(row):
    needed = _parsed_unit(row.unit).dimensionality
    netcdf = row.netcdf.replace("-1", "^-1").replace("m2", "m^2")
    picture, factor = row.shown
    assert _parsed_unit("" if netcdf == "1" else netcdf).dimensionality == needed
    assert _parsed_unit(picture.replace("²", "^2")).dimensionality == needed
    one = (1 * _parsed_unit(row.unit)).to(_parsed_unit(picture.replace("²", "^2")))
    assert float(one.magnitude) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("blades.k_T", "N m rad-1"),
        ("blades.c_T", "N m s rad-1"),
        ("blades.I", "kg m2"),
        ("blades.c_x", "N s m-1"),
        ("drive.M_0", "N m"),
        ("friction.mu", "1"),
        ("initial.v_x", "m s-1"),
    ],
)
def test_units_of_stored_files(key, unit):
    assert KEYS[key].netcdf == unit


def test_what_a_key_may_have_meant():
    assert key_parts("blades.m[1]") == ("blades", "m", 1)
    assert find_key("shroud.gap") == (KEYS["shroud.gap"], None)
    for key, told in {
        "contact.gama": "^the scene has no number `contact.gama`; did you mean `contact.gamma`?$",
        "gap": "^the scene has no number `gap`; did you mean `shroud.gap`?$",
        "zzz": r"^the scene has no number `zzz`; known are those of \[blades\], .*\[initial\], such as shroud.gap$",
        "drive.zzzz": "^the scene has no number `drive.zzzz`; known are drive.omega, [^[]*, drive.speed$",
        "row.mistuning": r"^the scene has no number `row.mistuning`, which is one of rows of blades; give it a",
        "shroud.gap[1]": r"^shroud\.gap is one number, not one per blade; drop the \[1\]$",
        "a\nb": "^the scene has no number `a b`; known are ",
    }.items():
        with pytest.raises(KeyNameError, match=told.replace("?$", r"\?$")):
            find_key(key)
    with pytest.raises(KeyNameError, match=r"^--along gap: the scene has no number"):
        find_key("gap", "--along gap")


def test_vary_knows_every_key_of_the_table():
    # Control of the first test: a class without the field is found out.
    scene = load("table1", ["drive.engine_order=4", "shroud.gap_at=5 um", "shroud.gap_at_speed=3000 rpm"]).scene
    for row in SCENE_KEYS:
        if row.name != "contact.width":
            assert vary(scene, row.name, 1.0) is not scene
