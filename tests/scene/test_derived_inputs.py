"""Data as engineers have them: frequencies, damping ratios and speeds in place of stiffnesses, dampers and omega."""

import math
import re

import pytest

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.derived_inputs import DERIVED_BY_KEY, alternative_keys
from jaxshroud.scene.keys import INPUT_KEYS

TABLE1 = load("table1").text()
FREQUENCIES = """
f_x = ["92 Hz", 93.0]
f_y = "500 Hz"
f_T = "0.7 kHz"
zeta_x = [0.012, "1.5 %"]
zeta_y = 0.02
zeta_T = 0.03
"""


def engineers(**lines):
    """Table 1 with its springs and dampers given by frequencies and damping ratios; `lines` replace more lines."""
    text = re.sub(r"(?m)^[kc]_[xyT] = .*\n", "", TABLE1).replace("[blades]\n", "[blades]" + FREQUENCIES)
    for key, line in lines.items():
        text, count = re.subn(rf"(?m)^{key} = .*$", line, text)
        assert count == 1
    return text


def test_frequencies_and_ratios_are_those_of_the_scene():
    # The inverse of the formulas, to rounding.
    blades = parse(engineers(), "own").scene.blades
    for name, mass, f, zeta in (
        ("x", blades.m, (92.0, 93.0), (0.012, 0.015)),
        ("y", blades.m, (500.0, 500.0), (0.02, 0.02)),
        ("T", blades.I, (700.0, 700.0), (0.03, 0.03)),
    ):
        k, c = getattr(blades, f"k_{name}"), getattr(blades, f"c_{name}")
        for i in (0, 1):
            omega = math.sqrt(k[i] / mass[i])
            assert omega / (2 * math.pi) == pytest.approx(f[i], rel=1e-12)
            assert c[i] / (2 * math.sqrt(k[i] * mass[i])) == pytest.approx(zeta[i], rel=1e-12)


def test_the_drive_by_frequency_or_by_speed():
    by = {
        "f": 'f = "92 Hz"',
        "speed": 'engine_order = 4\nspeed = "1380 rpm"',
    }
    for line in by.values():
        omega = float(parse(engineers(omega=line), "own").scene.drive.omega)
        assert omega == pytest.approx(2 * math.pi * 92, rel=1e-12)


def test_the_inertia_of_the_block():
    # A rectangle's, as far as the article says what its block is: m (l_oa^2 + l_ab^2) / 12.
    blades = parse(engineers(I='I = "block"', m="m = [0.08, 0.1]"), "own").scene.blades
    assert blades.I.tolist() == pytest.approx([m * (0.05**2 + 0.035**2) / 12 for m in (0.08, 0.1)], rel=1e-12)


def test_what_is_written_loads_the_same_scene():
    file = parse(engineers(I='I = "block"', omega='f = "92 Hz"'), "own")
    assert parse(file.text(), "again").tables == file.tables


@pytest.mark.parametrize(
    ("overrides", "key", "value"),
    [
        (["blades.k_x=1e5"], "k_x", 1e5),
        (["blades.m=0.1"], "k_x", (0.1 * (2 * math.pi * 92) ** 2, 0.1 * (2 * math.pi * 93) ** 2)),
        (["blades.f_x[1]=95 Hz"], "k_x", (0.08 * (2 * math.pi * 92) ** 2, 0.08 * (2 * math.pi * 95) ** 2)),
        (["blades.c_y=3"], "c_y", 3.0),
        (["blades.k_x=1e5", "blades.f_x=92 Hz"], "k_x", 0.08 * (2 * math.pi * 92) ** 2),
    ],
)
def test_overrides_take_the_place_of_what_says_the_same(overrides, key, value):
    assert parse(engineers(), "own", overrides).tables["blades"][key] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("lines", "overrides", "message"),
    [
        ({"m": "m = 0.08\nk_x = 1e5"}, [], "own: [blades] gives both `f_x` and `k_x`; keep one of them"),
        ({"m": ""}, [], "own: [blades] lacks `m`"),
        ({"omega": "engine_order = 3"}, [], "own: [drive] lacks `speed`, which `engine_order` needs"),
        ({"omega": 'f = "578 rad/s"'}, [], "is a circular frequency, but a frequency is needed"),
        ({"omega": 'omega = "92 Hz"'}, [], "is a frequency, but a circular frequency is needed"),
        ({"f_x": "f_x = -3"}, [], "own: [blades] f_x = -3 must be greater than 0"),
        ({"I": 'I = "blok"'}, [], "is not a number with a unit"),
        ({}, ["blades.zeta_x=banana"], '--set: [blades] zeta_x = "banana" is not a number'),
        ({}, ["blades.c_x[2]=3"], "--set: blades.c_x[2]: the scene has 2 blades, from [0] to [1]"),
        ({}, ["blades.f_z=3"], "has no key `f_z`; did you mean `f_y`?"),
    ],
)
def test_what_is_wrong_is_told(lines, overrides, message):
    with pytest.raises(InputError) as told:
        parse(engineers(**lines), "own", overrides)
    assert message in str(told.value)


@pytest.mark.parametrize("key", [row.name for row in INPUT_KEYS])
def test_a_key_and_the_number_that_it_gives_exclude_each_other(key):
    number = DERIVED_BY_KEY[key].number.name
    assert number in alternative_keys(key)
    assert key in alternative_keys(number)
