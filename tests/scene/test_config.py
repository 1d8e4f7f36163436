"""Scene files: every mistake is told in one line with its place and its cure; right ones load."""

import math
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from numpy.testing import assert_allclose, assert_array_equal

from jaxshroud.cli.terminal import MAX_MESSAGE_LENGTH
from jaxshroud.scene import units
from jaxshroud.scene.checks import SceneError
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.layout import MISPRINTS
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.schema import TABLE_MODELS
from jaxshroud.scene.shipped import aliases, shipped
from jaxshroud.scene.units import COMMON_FACTORS, _registry, to_si

GOOD = """
title = "test"
[blades]
m = 0.08
I = 2.46e-3
k_x = 1e5
k_y = 3e6
k_T = 2000.0
c_x = 3.57
c_y = 19.6
c_T = 0.506
[shroud]
alpha = 1.0
l_oa = 0.05
l_ab = 0.035
gap = 2.2e-5
[contact]
gamma = 2.5
[friction]
k_d = 1e6
mu = 0.5
[drive]
omega = 536
beta = 0.5
F_0 = 60
M_0 = 100.0
phase = [0.0, 3.0]
[run]
periods = 10
steps_per_period = 400
"""
SWEEP = """
[sweep]
along = "contact.gamma"
start = 0.0
stop = 8.0
num = 5
"""


def told(text, overrides=()):
    """The message that `text` gives, which must be one line."""
    with pytest.raises(SceneError) as caught:
        parse(text, "my.toml", overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def edited(old, new, text=GOOD):
    assert text.count(old) == 1
    return text.replace(old, new)


def set_key(name, value):
    """`GOOD` with one line `name = ...` replaced; the value None removes it."""
    lines = GOOD.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith(f"{name} =")]
    lines[at] = "" if value is None else f"{name} = {value}"
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (edited("k_d =", "kd ="), "my.toml: [friction] has no key `kd`; did you mean `k_d`?"),
        (edited("I = 2", "i = 2"), "my.toml: [blades] has no key `i`; did you mean `I`?"),
        (edited("mu =", "zzz = 1\nmu ="), "my.toml: [friction] has no key `zzz`; known are k_d, mu"),
        (edited("[friction]", "[fricton]"), "my.toml: there is no table [fricton]; did you mean `friction`?"),
        (edited("[friction]", "[contact.x]"), "my.toml: [contact] has no key `x`"),
        (
            set_key("mu", None),
            "my.toml: [friction] lacks `mu`; add it, e.g. mu = 0.5 (friction coefficient)",
        ),
        (set_key("m", None), 'my.toml: [blades] lacks `m`; add it, e.g. m = "0.08 kg" (mass)'),
        (
            edited("[friction]\nk_d = 1e6\nmu = 0.5\n", ""),
            "my.toml: [friction] is missing; add this table with k_d, mu",
        ),
        (
            "friction = 3\n" + edited("[friction]\nk_d = 1e6\nmu = 0.5\n", ""),
            "my.toml: [friction] must be a table",
        ),
        (edited('"test"', '"""a\nb"""'), "my.toml: title must be one line of text"),
        (edited('"test"', "3"), "my.toml: title must be one line of text"),
        (edited('"test"', r'"a\u0000b"'), "my.toml: title must be one line of text without control characters"),
    ],
)
def test_unknown_and_missing_names(text, expected):
    assert told(text).startswith(expected)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        (
            "gap",
            '"0.022 kg"',
            'my.toml: [shroud] gap = "0.022 kg" is a mass, but a length is needed, e.g. gap = "0.022 mm" '
            "(initial gap along x; negative: interference)",
        ),
        ("gap", '"0.022"', "is a pure number, but a length is needed"),
        ("gap", '"0.022 K^2"', "is of dimension [temperature] ** 2, but a length is needed"),
        ("gap", '"0.022 foo"', "has an unknown unit `foo`"),
        ("gap", '"0.022 m-m"', "has an unknown unit `m-m`"),
        ("gap", '"small"', 'gap = "small" is not a number with a unit'),
        ("gap", '"nan mm"', "is not a number with a unit"),
        ("gap", '"2 ** 9 mm"', "has an unknown unit"),
        ("gap", '""', "is not a number with a unit"),
        ("gap", '"1e999 mm"', "must be a finite number"),
        ("gap", "nan", "[shroud] gap = NaN must be a finite number"),
        ("gap", "-inf", "must be a finite number"),
        ("gap", "true", "[shroud] gap = true must be a valid number"),
        ("gap", "[1e-5, 1e-5]", "must be a valid number"),
        ("gap", "1979-05-27", "must be a valid number"),
        ("gap", "{a = 1}", "must be a valid number"),
        ("mu", '"3 N"', '[friction] mu = "3 N" is a force, but a pure number is needed'),
        ("omega", '"85 Hz"', 'is a frequency, but a circular frequency is needed, e.g. omega = "536 rad/s"'),
        ("m", "-0.08", 'my.toml: [blades] m = -0.08 must be greater than 0, e.g. m = "0.08 kg" (mass)'),
        ("m", "[0.08, -0.09]", "[blades] m = [0.08, -0.09] must be greater than 0"),
        ("m", "[0.08, 0.08, 0.08]", "must be one number or a pair [left, right]"),
        ("m", "[0.08]", "must be one number or a pair [left, right]"),
        ("m", "[[0.08, 0.08], 0.08]", "must be a valid number"),
        ("m", "false", "must be a valid number"),
        ("I", '"2.46e-3 kg m"', "but a moment of inertia is needed"),
        ("k_T", '"2000 N/m"', "is a stiffness, but a torsion stiffness is needed"),
        ("c_x", "-1e-9", "must be greater than or equal to 0"),
        ("F_0", "[60, nan]", "[drive] F_0 = [60, NaN] must be a finite number"),
        ("F_0", '["60 N", "60 J"]', "is a moment, but a force is needed"),
        ("phase", '"180 m"', "is a length, but an angle is needed"),
        ("gamma", "2.5\nk = 1e5", "my.toml: [contact] gives both `k` and `gamma`; keep one of them"),
        ("gamma", None, "my.toml: [contact] lacks a stiffness; add one of them, e.g. gamma = 2.5"),
        ("gamma", '2.5\nreading = "prnted"', "names the unknown misprint `prnted`; did you mean `printed`?"),
        (
            "gamma",
            '2.5\nreading = ["gapsign"]',
            "names the unknown misprint `gapsign`; did you mean `gap_sign`?",
        ),
        ("gamma", "2.5\nreading = 3", 'must be "consistent", "printed" or a list of misprints'),
        ("gamma", "2.5\nreading = [[1]]", "names the unknown misprint"),
        ("periods", "0", "my.toml: [run] periods = 0 must be greater than or equal to 1, e.g. periods = 100"),
        ("periods", "1.5", "must be a valid integer"),
        ("periods", "true", "must be a valid integer"),
        ("periods", "10\ntransient = -1", "[run] transient = -1 must be greater than or equal to 0"),
        ("steps_per_period", "0", "must be greater than or equal to 1"),
    ],
)
def test_wrong_values(name, value, expected):
    message = told(set_key(name, value))
    assert message.startswith("my.toml: [")
    assert expected in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "contact.gamma",
            "contact.gama",
            "my.toml: [sweep] contact.gama: the scene has no number `contact.gama`; did you mean `contact.gamma`?",
        ),
        ("contact.gamma", "contact.reading", "the scene has no number `contact.reading`"),
        ("contact.gamma", "run.periods", "the scene has no number `run.periods`"),
        ("contact.gamma", "shroud.gap[0]", "shroud.gap is one number, not one per blade; drop the [0]"),
        ("contact.gamma", "blades.m[2]", "blades.m[2]: the scene has 2 blades, from [0] to [1]"),
        ("contact.gamma", "blades.m", "my.toml: [sweep] blades.m: 0.0 must be greater than 0"),
        ('"contact.gamma"', "3", "[sweep] along = 3 must be a valid list"),
        ("num = 5", "num = 1", "1 different value given; a sweep needs at least two"),
        ("num = 5", "num = 0", "0 different values given; a sweep needs at least two"),
        ("num = 5", "num = 2.5", "[sweep] num = 2.5 must be a valid integer"),
        ("stop = 8.0", "stop = 0.0", "1 different value given; a sweep needs at least two"),
        ("stop = 8.0", 'stop = "8 mm"', '"8 mm" is a length, but a pure number is needed'),
        ("stop = 8.0", "stop = nan", "NaN must be a finite number"),
        ("stop = 8.0", "stop = true", "true must be a valid number"),
        ("stop = 8.0", "", "my.toml: [sweep] needs either `start`, `stop` and `num`, or `values`"),
        ("stop = 8.0", "stop = 8.0\nvalues = [1, 2]", "needs either `start`, `stop` and `num`, or `values`"),
        ("start = 0.0\nstop = 8.0\nnum = 5", "values = []", "0 different values given"),
        ("start = 0.0\nstop = 8.0\nnum = 5", "values = [2.5]", "1 different value given"),
        ("start = 0.0\nstop = 8.0\nnum = 5", "values = [1, [2, 3]]", "must be one number per value"),
        ("start = 0.0\nstop = 8.0\nnum = 5", "values = 3", "[sweep] values = 3 must be a valid list"),
        ("num = 5", 'num = 5\ndirection = "up"', "must be 'independent', 'forward', 'backward' or 'both'"),
        ("num = 5", "num = 5\nkeep = 0", "[sweep] keep = 0 must be greater than or equal to 1"),
        ("num = 5", "nun = 5", "[sweep] has no key `nun`; did you mean `num`?"),
        ('"contact.gamma"', '["contact.gamma", "shroud.gap"]', "must be a valid list"),
        ('along = "contact.gamma"', "", "[sweep] lacks `along`; add it"),
    ],
)
def test_wrong_sweeps(old, new, expected):
    message = told(GOOD + edited(old, new, SWEEP))
    assert message.startswith("my.toml: [sweep]")
    assert expected in message


def test_all_that_is_missing_is_named_at_once():
    message = told('title = "a"\n[blades]\nm = 0.08\nI = 1.0\nk_y = 1.0\nk_T = 1.0\nc_x = 1.0\n[contact]\n[run]\n')
    assert message.startswith("my.toml: [blades] lacks `k_x`, `c_y`, `c_T`; ")
    assert "[shroud] is missing, with alpha, l_oa, l_ab, gap; [contact] lacks `gamma`; " in message
    assert "[friction] is missing, with k_d, mu; [drive] is missing, with omega, beta, F_0, M_0, phase; " in message
    assert "[run] lacks `periods`; add all of them, e.g. in [blades] k_x = " in message
    assert len(told("")) < MAX_MESSAGE_LENGTH  # everything is still a line


def test_an_unknown_scene_is_told_of_every_shipped_one():
    with pytest.raises(SceneError) as caught:
        load("nothing")
    assert all(name in str(caught.value) for name in shipped())
    assert len(str(caught.value)) < MAX_MESSAGE_LENGTH


@pytest.mark.parametrize("keys", [("contact.k", "contact.gamma"), ("blades.m", "blades.m[0]"), ("drive.F_0",) * 2])
def test_a_grid_needs_independent_keys(keys):
    grid = f"[sweep]\nalong = {list(keys)}\nvalues = [[1, 2], [3, 4]]"
    assert "is no grid; give one or two independent keys" in told(GOOD + grid)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("contact.gamma", '--set: "contact.gamma" is not table.key=value, e.g. --set contact.gamma=3'),
        ("gamma=3", "is not table.key=value"),
        ("contact.gamma=", "is not table.key=value"),
        ("blades.m[2]=1", "the scene has 2 blades, from [0] to [1]"),
        ("", "is not table.key=value"),
        ("friction.kd=1", "--set: [friction] has no key `kd`; did you mean `k_d`?"),
        ("frictoin.mu=1", "--set: there is no table [frictoin]; did you mean `friction`?"),
        ("shroud.gap=0.03 kg", '--set: [shroud] gap = "0.03 kg" is a mass, but a length is needed'),
        ("shroud.gap[0]=1", "--set: shroud.gap is one number, not one per blade; drop the [0]"),
        ("blades.m[1]=-1", "--set: [blades] m = [0.08, -1] must be greater than 0"),
        ("run.periods=0", "--set: [run] periods = 0"),
        ("contact.reading=gap_sign,lever", "did you mean `levers`?"),
        ("contact.gamma=true", "--set: [contact] gamma = true must be a valid number"),
        ("contact.gamma=nan", "--set: [contact] gamma = NaN must be a finite number"),
        ("sweep.num=1", "--set: [sweep] contact.gamma: 1 different value given"),
        ("sweep.along=contact.gama", "--set: [sweep] contact.gama: the scene has no number"),
    ],
)
def test_wrong_overrides_name_set(override, expected):
    assert expected in told(GOOD + SWEEP, [override])


def test_an_override_is_not_blamed_for_the_file():
    assert told(set_key("m", "-1"), ["friction.mu=0.3"]).startswith("my.toml: [blades] m")
    assert told(set_key("m", "[1, 2, 3]"), ["blades.m[1]=1"]).startswith("my.toml: [blades] m = [1, 2, 3]")
    assert told(set_key("m", None), ["blades.m[1]=1"]).startswith("my.toml: [blades] lacks `m`")


def test_wrong_files(tmp_path):
    assert told(edited("m = 0.08", "m 0.08")).startswith("my.toml: not valid TOML: Expected '=' after a key")
    assert "(at line 4, column 3)" in told(edited("m = 0.08", "m 0.08"))
    with pytest.raises(SceneError, match=r"^fig9: no such file .*; did you mean `fig09`\?; `jaxshroud scenes` lists"):
        load("fig9")
    with pytest.raises(SceneError, match=r"no such file or shipped scene; known are dry_friction_2dof, engine_order"):
        load(tmp_path / "zzz.toml")
    (tmp_path / "latin.toml").write_bytes(b'title = "\xe9"')
    with pytest.raises(SceneError, match=r"latin\.toml: cannot be read as UTF-8 text"):
        load(tmp_path / "latin.toml")


@pytest.mark.parametrize(
    ("name", "text", "number"),
    [
        ("gap", "0.022 mm", 2.2e-5),
        ("gap", "-22µm", -2.2e-5),
        ("m", "80 g", 0.08),
        ("I", "24.6 kg cm^2", 2.46e-3),
        ("k_x", "100 N/mm", 1e5),
        ("k_T", "2 kN*m/rad", 2000.0),
        ("c_T", "0.506 N*m*s/rad", 0.506),
        ("c_x", "3.57 N·s/m", 3.57),
        ("mu", "50 %", 0.5),
        ("omega", "3000 rpm", 100 * math.pi),
        ("omega", "536 /s", 536.0),
        ("alpha", "90 deg", math.pi / 2),
        ("beta", ".5 rad", 0.5),
        ("F_0", "0.06 kN", 60.0),
    ],
)
def test_units_equal_si_numbers(name, text, number):
    # Conversion is decimal, so the two agree to the last bit, not just nearly.
    with_unit, plain = parse(set_key(name, f'"{text}"'), "a"), parse(set_key(name, repr(number)), "b")
    assert eqx.tree_equal(with_unit.scene, plain.scene)
    assert with_unit.text() == plain.text()


@pytest.mark.parametrize(("unit", "text"), COMMON_FACTORS)
def test_common_units_are_those_of_pint(unit, text, monkeypatch):
    numbers = [f"{x}{e}" for x in ("0", "-1", "60", "180", "0.022", "-.7", "3.3333333333333335") for e in ("", "e-3")]
    at_hand = [to_si(unit, f"{number} {text}") for number in numbers]
    monkeypatch.setattr(units, "COMMON_FACTORS", {})
    assert at_hand == [to_si(unit, f"{number} {text}") for number in numbers]


def test_defaults():
    got = parse(GOOD, "a")
    assert_array_equal(got.scene.blades.inertia_y, got.scene.blades.m)
    assert got.scene.contact.reading == frozenset()
    assert all(np.all(np.asarray(leaf) == 0) for leaf in got.scene.initial)
    assert (got.run.transient, got.axes, got.direction, got.keep) == (64, (), "independent", None)
    assert_array_equal(parse(GOOD, "a", ["blades.m=[1, 2]"]).scene.blades.inertia_y, [1.0, 2.0])
    assert tomllib.loads(parse(GOOD, "a", ["blades.m_y[1]=2"]).text())["blades"]["m_y"] == [0.08, 2.0]
    # Every number takes JAX's float type: float64 where x64 is on.
    assert {leaf.dtype for leaf in jax.tree.leaves(got.scene)} == {jnp.result_type(float)}


def test_gamma_and_k_replace_each_other():
    by_gamma = parse(GOOD, "a")
    by_k = parse(GOOD, "a", ["contact.k=2.5e5"])
    assert by_k.scene.contact.gamma is None
    assert_allclose(by_k.scene.k, by_gamma.scene.k, rtol=1e-7)  # equal but for rounding, float32 included
    assert parse(by_k.text(), "b", ["contact.gamma=3"]).scene.contact.k is None


def test_overrides():
    settings = ["blades.m[1]=0.09", "shroud.gap=0.03 mm", "run.periods=7", "drive.phase=[0, 3.14]"]
    settings += ["drive.beta=[10 deg, 0.5]", "initial.v_x[0]=.25", "contact.reading=gap_sign,levers"]
    settings += ["drive.F_0 = 50."]
    got = tomllib.loads(parse(GOOD, "a", settings).text())
    assert got["blades"]["m"] == [0.08, 0.09]
    assert "m_y" not in got["blades"]
    assert got["shroud"]["gap"] == 3e-5
    assert got["run"]["periods"] == 7
    assert got["drive"]["phase"] == [0.0, 3.14]
    assert got["drive"]["beta"] == pytest.approx([math.pi / 18, 0.5], rel=1e-15)
    assert got["initial"]["v_x"] == [0.25, 0.0]
    assert got["contact"]["reading"] == ["gap_sign", "levers"]
    assert got["drive"]["F_0"] == 50.0


@pytest.mark.parametrize(
    ("reading", "kept"),
    [
        ("consistent", ()),
        ("printed", MISPRINTS),
        ("levers", ("levers",)),
        ("[]", ()),
        ('["gap_sign"]', ("gap_sign",)),
        ('["levers", "corner_angles", "M_N1_sign"]', ("levers", "corner_angles", "M_N1_sign")),
    ],
)
def test_readings(reading, kept):
    got = parse(GOOD, "a", [f"contact.reading={reading}"])
    assert got.scene.contact.reading == frozenset(kept)
    assert parse(got.text(), "a").scene.contact.reading == frozenset(kept)


def test_later_overrides_win_and_drop_what_they_replace():
    got = parse(GOOD + SWEEP + "keep = 50", "a", ["sweep.values=[0.3, 2.5]", "contact.gamma=1", "contact.gamma=2"])
    assert_array_equal(got.axes[0].values, [0.3, 2.5])
    assert float(got.scene.contact.gamma) == 2.0
    assert (got.run.periods, got.sweep_run.periods) == (10, 50)
    got = parse(GOOD + SWEEP + "keep = 50", "a", ["run.periods=20"])
    assert (got.run.periods, got.sweep_run.periods) == (20, 20)


def test_sweep_axes():
    (one,) = parse(GOOD + SWEEP, "a").axes
    assert one.key == "contact.gamma"
    assert one.values.dtype == np.float64
    assert_array_equal(one.values, [0.0, 2.0, 4.0, 6.0, 8.0])
    grid = '[sweep]\nalong = ["blades.m[1]", "shroud.gap"]\nstart = ["80 g", "1 mm"]\nstop = [0.1, 2e-3]\n'
    grid += "num = [2, 3]"
    got = parse(GOOD + grid, "a")
    assert_array_equal(got.axes[0].values, [0.08, 0.1])
    assert_array_equal(got.axes[1].values, [1e-3, 1.5e-3, 2e-3])
    assert parse(got.text(), "b").text() == got.text()


def test_axis_of_the_command_line():
    scene_file = parse(GOOD, "a")
    assert_array_equal(axis(scene_file, "shroud.gap", ["0.01 mm", "0.02mm"]).values, [1e-5, 2e-5])
    assert_array_equal(axis(scene_file, "shroud.gap", "1e-5, 0.02 mm").values, [1e-5, 2e-5])
    assert_array_equal(axis(scene_file, "blades.m", np.linspace(1, 2, 3)).values, [1, 1.5, 2])
    got = axis(scene_file, "drive.phase[1]", start="0 deg", stop=1, num=2)
    assert_array_equal(got.values, [0, 1])
    for key, values, expected in [
        (
            "contact.gama",
            [1, 2],
            r"^--along contact\.gama: the scene has no number .*did you mean `contact\.gamma`",
        ),
        (
            "blades.m",
            ["1", "-2"],
            r"^--along blades\.m: -2 must be greater than 0, e\.g\. \"0\.08 kg\" \(mass\)",
        ),
        ("blades.m", [], "a sweep needs at least two"),
        ("blades.m", None, "needs either values, or start, stop and num"),
    ]:
        with pytest.raises(SceneError, match=expected):
            axis(scene_file, key, values)
    swept = replace(scene_file, axes=(axis(scene_file, "initial.x", [0.0, 1e-5, 3e-5]),), direction="forward")
    again = parse(swept.text(), "b")
    assert_array_equal(again.axes[0].values, [0.0, 1e-5, 3e-5])
    assert again.direction == "forward"


@pytest.mark.parametrize("name", sorted(shipped()))
def test_shipped_scenes(name, tmp_path):
    got = load(name)
    assert got.title
    assert shipped()[name] == got.title
    (tmp_path / "copy.toml").write_text(got.text(), encoding="utf-8")
    again = load(tmp_path / "copy.toml")
    assert eqx.tree_equal(got.scene, again.scene)
    assert again.text() == got.text()
    for one, other in zip(got.axes, again.axes, strict=True):
        assert_array_equal(one.values, other.values)


def test_a_title_counts_modes_that_are_set_as_a_whole():
    modes = f"blades.modes={Path(__file__).parents[2] / 'configs' / 'fem_blade.csv'}"
    title = load("table1", [modes, "shroud.gap=5 mm"]).title
    assert title.endswith(", but blades = 6 modes, gap = 5 mm")
    assert load("fem_blade", ["blades.modes[0].f=100"]).title.endswith("modes[0].f = 100 Hz")


def test_a_title_tells_what_is_given_by_a_word():
    assert load("table1", ['blades.I="block"', 'drive.M_0="0.5 N m"']).title.endswith("I = block, M_0 = 0.5 N m")


def test_every_figure_is_shipped():
    figures = "09 10a 10b 10c 10d 11 12a 12b 12c 12d 13 14a 14b 14c 14d 15a 15b 16 17 18"
    best = "09 10 11 12 13 14 15a 15b 16 17 18"
    names = {*(f"fig{f}" for f in figures.split()), *(f"fig{f}_best" for f in best.split())}
    others = {"table1", "table1_light", "eq21", "griffin", "dry_friction_2dof", "engine_order"}
    others |= {"row_ring12", "row_chain5", "table1_points", "row_ring12_points", "row_ring6_flutter", "row_disk60"}
    others |= {"fem_blade"}
    assert set(shipped()) == others | names
    assert load("fig09.toml").name == "fig09.toml"


def test_every_printed_figure_has_another_name():
    assert set(aliases()) == {f"{name}_printed" for name in shipped() if name.startswith("fig") and "_" not in name}
    for other, name in aliases().items():
        assert load(other).text() == load(name).text() == load(f"{other}.toml").text()
    with pytest.raises(SceneError, match=r"did you mean `fig09_printed`"):
        load("fig09_printd")


def test_eq21_puts_every_frequency_at_the_drives():
    blades, drive = load("eq21").scene.blades, load("eq21").scene.drive
    for stiffness, inertia in ((blades.k_x, blades.m), (blades.k_y, blades.inertia_y), (blades.k_T, blades.I)):
        # Five printed digits.
        assert_allclose(np.sqrt(np.asarray(stiffness / inertia)), float(drive.omega), rtol=2e-5)


def test_a_missing_pint_is_not_an_unknown_unit(monkeypatch):
    _registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    with pytest.raises(ImportError, match="pint"):
        load("table1", ["shroud.gap=22 nm"])


PARTS = '[parts]\nmotion = ["x"]\nfriction = "none"\n'


def test_messages_name_the_table_of_the_parts():
    text = GOOD + PARTS
    assert told(text.replace('"none"', '"nne"')).startswith('my.toml: [parts] friction = "nne" must be ')
    assert told(text, ["parts.fricton=none"]).startswith("--set: [parts] has no key `fricton`; did you mean")
    assert told(text, ["contact.width=1 um"]).endswith('drop it, or add [parts] contact = "smooth"')
    assert told(text, ["parts.motion[0]=1"]) == "--set: [parts] motion is not one per blade; drop the [0]"


def test_a_scene_is_built_once_in_the_precision_of_its_first_use():
    file = load("table1")
    again = replace(file, direction="forward")
    with jax.enable_x64(False):
        assert file.scene.blades.m.dtype == np.float32
    assert file.scene is file.scene
    assert file.scene.blades.m.dtype == np.float32
    assert again.scene.blades.m.dtype == np.float64
    assert again.text() == file.text()


ODD = ([[0.01], [0.02]], [], {"a": 1}, [{"a": 1}], [True, 1.0], ["x", 1], "a\0b", 10**400, -(10**400), 1e300, math.nan)


def refusal(text):
    """The message with which a file is refused; empty where it is read."""
    try:
        parse(text, "odd.toml")
    except SceneError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("order", ["order", "engine_order"])
def test_values_of_any_kind_are_read_or_refused_in_one_line(order):
    """Each key of each table, and of a harmonic, with values that are hardly meant for it."""
    document = tomllib.loads(load("engine_order", ["contact.points=[-0.01, 0.01]", "contact.shares=[0.5, 0.5]"]).text())
    document["drive"] = {"speed": 100.0, "engine_order": 4, "phase": [0.0, 3.0]}
    document["drive"]["harmonic"] = [{order: 4, "F": 5.0, "beta": 0.1}]
    harmonic = document["drive"]["harmonic"][0]
    parse(tomli_w.dumps(document), "good.toml")
    for table, model in TABLE_MODELS.items():
        rows = document.setdefault(table, {})
        for keys in (rows, harmonic) if table == "drive" else (rows,):
            for key in {*keys, *(model.model_fields if keys is rows else ("M", "phase")), "table"}:
                for odd in ODD:
                    given = keys.pop(key, None)
                    keys[key] = odd
                    text = tomli_w.dumps(document)
                    del keys[key]
                    keys |= {} if given is None else {key: given}
                    message = refusal(text)
                    assert len(message.splitlines()) < 2
                    assert len(message) < 600
        document = {name: rows for name, rows in document.items() if rows}
