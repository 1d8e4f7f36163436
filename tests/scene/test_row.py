"""Rows of blades as a user writes them down: files, keys, engine orders, mistuning and what is refused."""

import inspect
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.io.scene_numbers import dimension, key_label
from jaxshroud.scene.checks import InputError, KeyNameError, SceneError
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.drive_orders import order_of_phases
from jaxshroud.scene.keys import ALL_KEYS, ROW_KEYS, find_key, number_shape
from jaxshroud.scene.layout import MISPRINTS, row_layout
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Row
from jaxshroud.scene.vary import level_of, numbers_of, numbers_that_count, with_numbers
from jaxshroud.verbs.arguments import resolve_options
from jaxshroud.verbs.lanes import leading_axes

RING, CHAIN = "row_ring12", "row_chain5"
BARE = """
[blades]
m = 0.08
I = 2.46e-5
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
omega = 536.0
beta = 0.5
F_0 = 60.0
M_0 = 0.3
phase = 0.0
[run]
periods = 10
"""


def bare(row, old="", new=""):
    """A file with a row, and one line replaced."""
    assert not old or BARE.count(old) == 1
    return f"[row]\n{row}\n{BARE.replace(old, new) if old else BARE}"


def scene_of(row, old="", new="", overrides=()):
    return parse(bare(row, old, new), "my.toml", overrides).scene


def same(one, other):
    """Whether two scenes are of the same numbers, bit for bit."""
    return bool(eqx.tree_equal(one, other))


@pytest.mark.parametrize(("row", "interfaces"), [("blades = 2", 1), ("blades = 2\nclosed = true", 2)])
def test_a_row_of_two_has_one_interface_and_a_closed_one_two(row, interfaces):
    scene = scene_of(row)
    assert scene.row is not None
    assert (scene.row.interfaces, scene.shroud.gap.shape, scene.k.shape) == (interfaces, (interfaces,), (interfaces,))


@pytest.mark.parametrize("name", [RING, CHAIN])
def test_every_number_has_the_shape_of_its_key(name):
    scene = load(name).scene
    blades, interfaces = scene.row.blades, scene.row.interfaces
    for key, value in numbers_of(scene).items():
        per_blade = key.startswith(("blades", "initial", "row")) or key.split(".")[1] in ("beta", "F_0", "M_0", "phase")
        per_interface = key.startswith(("contact", "friction")) or key == "shroud.gap"
        want = (blades,) if per_blade else (interfaces,) if per_interface else ()
        assert value.shape == want == number_shape(ALL_KEYS[key], scene.layout), key
    assert leading_axes(scene) == ()
    assert {value.dtype for value in jax.tree.leaves(scene)} == {jnp.result_type(float)}


def test_the_pair_is_as_it_was(table1):
    assert table1.row is None
    assert not [key for key in numbers_of(table1) if key in ROW_KEYS]
    assert "row" not in tomllib.loads(load("table1").text())
    assert table1.shroud.gap.shape == table1.k.shape == ()


def test_lists_are_one_per_blade_and_one_per_interface():
    scene = scene_of("blades = 3", "gap = 2.2e-5", 'gap = ["20 um", "25 um"]', ["blades.k_x=[1e5, 2e5, 3e5]"])
    assert_array_equal(scene.shroud.gap, [20e-6, 25e-6])
    assert_array_equal(scene.blades.k_x, [1e5, 2e5, 3e5])
    assert_array_equal(scene.k, [2.5e5, 5e5])  # k_x of the blade on the left
    ring = scene_of("blades = 3\nclosed = true\nmistuning = 0.1", overrides=["blades.k_x=[1e5, 2e5, 3e5]"])
    assert_array_equal(ring.k, [2.5e5, 5e5, 7.5e5])  # of the nominal blade: mistuning is no part of gamma


def test_an_engine_order_gives_the_phases_and_with_a_speed_the_frequency():
    index = np.arange(12)
    assert_array_equal(load(RING).scene.drive.phase, 2 * np.pi * 3 * index / 12)
    turned = load(RING, ["drive.speed=1706 rpm"])
    assert float(turned.scene.drive.omega) == 3 * turned.given["drive.speed"]
    for order in (0, -1, 11):
        assert_allclose(load(RING, [f"drive.engine_order={order}"]).scene.drive.phase, np.pi * order * index / 6)
    # By f or omega the frequency stays where the order changes, by speed it follows.
    by_f = load(RING, ["drive.f=85 Hz", "drive.engine_order=2"]).scene
    assert float(by_f.drive.omega) == 2 * np.pi * 85.0
    assert float(js.vary(turned.scene, "drive.engine_order", 2.0).drive.omega) == 2 * turned.given["drive.speed"]
    assert_array_equal(load(CHAIN).scene.drive.phase, 2 * np.pi * 1.5 * np.arange(5) / 5)


def test_phases_and_engine_order_replace_each_other():
    scene = js.vary(load(RING).scene, "drive.phase[3]", 0.25)
    assert "drive.engine_order" not in scene.given
    want = 2 * np.pi * 3 * np.arange(12) / 12
    assert_array_equal(scene.drive.phase, np.where(np.arange(12) == 3, 0.25, want))
    assert same(js.vary(scene, "drive.engine_order", 3.0), load(RING).scene)
    # A speed says nothing without an order: the frequency that it gave is a number then.
    turned = js.vary(load(RING, ["drive.speed=1706 rpm"]).scene, "drive.phase", 0.0)
    assert not turned.given.keys() & {"drive.speed", "drive.engine_order"}
    assert turned.drive.omega == load(RING, ["drive.speed=1706 rpm"]).scene.drive.omega


def test_mistuning_is_drawn_by_its_seed():
    drawn = load(CHAIN).scene.row.mistuning
    assert_array_equal(drawn, 0.03 * np.random.default_rng(1).standard_normal(5))
    assert_array_equal(load(CHAIN).scene.row.mistuning, drawn)
    assert not np.array_equal(load(CHAIN, ["row.mistuning={sigma=0.03, seed=2}"]).scene.row.mistuning, drawn)
    listed = tomllib.loads(load(CHAIN).text())["row"]["mistuning"]
    assert_array_equal(listed, drawn)
    assert_array_equal(scene_of('blades = 2\nmistuning = ["3 %", -0.01]').row.mistuning, [0.03, -0.01])


def test_one_blade_of_many_lanes():
    lanes = js.vary(js.scenes_from({"shroud.gap[1]": [1e-5, 2e-5]}, load(CHAIN)), "blades.m[4]", jnp.array([0.1, 0.2]))
    assert_array_equal(lanes.blades.m[:, 4], [0.1, 0.2])
    assert_array_equal(lanes.blades.m[:, :4], 0.08)
    assert_array_equal(lanes.shroud.gap[:, 1], [1e-5, 2e-5])


def test_a_traced_row_varies_as_a_plain_one():
    scene = load(CHAIN).scene
    traced = jax.jit(lambda v: js.vary(js.vary(scene, "shroud.gap[2]", v), "drive.engine_order", v))(0.5)
    plain = js.vary(js.vary(scene, "shroud.gap[2]", 0.5), "drive.engine_order", 0.5)
    assert_array_equal(traced.shroud.gap, plain.shroud.gap)
    assert_allclose(traced.drive.phase, plain.drive.phase, rtol=1e-15)  # XLA may contract products


def test_numbers_are_read_by_their_keys():
    scene = load(CHAIN).scene
    assert js.value_of(scene, "shroud.gap[2]") == 30e-6
    assert js.value_of(scene, "blades.m") == 0.08
    assert js.value_of(with_numbers(scene, ["contact.k"]), "contact.k[3]") == js.value_of(scene, "contact.k") == 2.6e5
    with pytest.raises(KeyNameError, match=r"differs between the interfaces; name one of shroud\.gap\[0\] to .*\[3\]"):
        js.value_of(scene, "shroud.gap")
    counted = numbers_that_count(scene)
    assert {"shroud.gap[0]", "shroud.gap[3]", "row.mistuning[4]", "drive.phase[4]", "contact.gamma"} <= {*counted}
    assert not {"shroud.gap", "shroud.gap[4]", "row.mistuning", "drive.phase[0]"} & {*counted}


def test_results_name_blades_and_interfaces_of_rows_by_number():
    names = {
        key: dimension(key, row_layout(5, True).names)
        for key in ("shroud.gap[0]", "blades.m[1]", "initial.x[3]", "drive.omega")
    }
    assert [*names.values()] == ["gap_0", "m_1", "initial_x_3", "omega"]
    assert key_label("shroud.gap[0]", row_layout(5, True).names) == r"initial gap, interface 0 $\Delta$"
    assert (dimension("blades.m[1]"), key_label("blades.m[1]")) == ("m_right", "mass, right blade $m$")
    lanes = js.scenes_from({"shroud.gap[3]": [1e-5, 2e-5], "blades.m[0]": [0.1, 0.2]}, load(CHAIN))
    more = resolve_options(lanes).provenance(100)[1]
    assert {name: dims for name, (dims, *_) in more.items()} == {"gap": ("lane", "interface"), "m": ("lane", "blade")}


def test_titles_of_long_lists_are_short():
    gaps = ", ".join(["25 um"] * 11 + ["26 um"])
    assert load(RING, [f"shroud.gap=[{gaps}]"]).title.endswith(", but gap = 12 values")
    assert load(RING, ["row.blades=6", "row.closed=false"]).title.endswith(", but blades = 6, closed = false")


@pytest.mark.parametrize(
    "overrides", [["row.blades=6", "drive.engine_order=2"], ["drive.engine_order=2", "row.blades=6"]]
)
def test_the_pair_becomes_a_row_by_overrides_in_any_order(overrides):
    scene = load("table1", overrides).scene
    assert (scene.row.blades, scene.shroud.gap.shape, float(scene.drive.omega)) == (6, (5,), 536.0)
    assert_array_equal(scene.drive.phase, 2 * np.pi * 2 * np.arange(6) / 6)


WRONG_FILES = {
    "one blade": (bare("blades = 1\nclosed = true"), "[row] blades = 1 must be greater than or equal to 2"),
    "many": (bare("blades = 1000000"), "[row] blades = 1000000 must be less than or equal to 512"),
    "half a blade": (bare("blades = 2.5"), "[row] blades = 2.5 must be a valid integer"),
    "no number": (bare("closed = true"), "[row] lacks `blades`; add it, e.g. blades = 12 (number of blades)"),
    "not closed": (bare("blades = 3\nclosed = 1"), "[row] closed = 1 must be a valid boolean"),
    "unknown key": (bare("blades = 3\nclose = true"), "[row] has no key `close`; did you mean `closed`?"),
    "no table": (f"row = 3\n{BARE}", "[row] must be a table of keys"),
    "blades": (
        bare("blades = 3", "m = 0.08", "m = [1, 2]"),
        "[blades] m = [1, 2] must be one number or a list of 3, one",
    ),
    "interfaces": (bare("blades = 3", "gap = 2.2e-5", "gap = [1, 2, 3]"), "a list of 2, one for each interface, e.g."),
    "a unit": (bare("blades = 3", "gap = 2.2e-5", 'gap = ["1 um", "1 kg"]'), "is a mass, but a length is needed"),
    "scalar": (
        bare("blades = 3", "alpha = 1.0", "alpha = [1, 1, 1]"),
        "[shroud] alpha = [1, 1, 1] must be a valid number",
    ),
    "mistuning": (bare("blades = 3\nmistuning = [0, 0]"), "[row] mistuning = [0, 0] must be one number or a list of 3"),
    "below -1": (bare("blades = 2\nmistuning = [0, -1]"), "must be greater than -1"),
    "sigma": (bare("blades = 2\nmistuning = {sigma = -1, seed = 1}"), "must be greater than or equal to 0"),
    "seed": (bare("blades = 2\nmistuning = {sigma = 1, seed = 1.5}"), "must be a valid integer"),
    "no seed": (
        bare("blades = 2\nmistuning = {sigma = 1}"),
        "must be a number, a list of them, or {sigma = 0.03, seed = 1}",
    ),
    "order": (
        bare("blades = 3\nclosed = true", "phase = 0.0", "engine_order = 2.5"),
        "[drive] engine_order = 2.5 must be a whole number",
    ),
    "phase": (
        bare("blades = 3", "phase = 0.0", "phase = 0.0\nengine_order = 1"),
        "gives both `engine_order` and `phase`",
    ),
    "frequency": (
        bare("blades = 3", "phase = 0.0", "engine_order = 1\nspeed = 100"),
        "[drive] gives both `speed` and `omega`; keep one of them",
    ),
    "no order": (
        bare("blades = 3", "omega = 536.0", "speed = 100"),
        "[drive] lacks `engine_order`, which `speed` needs",
    ),
    "order 0": (
        bare("blades = 3", "omega = 536.0", "speed = 100").replace("phase = 0.0", "engine_order = 0"),
        "drive.engine_order must be greater than 0 where drive.speed gives the frequency",
    ),
    "speed": (
        bare("blades = 3", "omega = 536.0", 'omega = "1300 rpm"').replace("phase = 0.0", "engine_order = 2"),
        "is a speed of rotation, but omega is the frequency of a drive with engine order 2",
    ),
    "reading": (
        bare("blades = 3", "gamma = 2.5", 'gamma = 2.5\nreading = "printed"'),
        "`contact.reading` but consistent is of the pair alone",
    ),
    "rigid": (bare("blades = 3") + '[parts]\nneighbour = "rigid"', '`parts.neighbour` = "rigid" is of the pair alone'),
}


@pytest.mark.parametrize("case", WRONG_FILES)
def test_wrong_rows_are_told_in_one_line(case):
    text, expected = WRONG_FILES[case]
    with pytest.raises(SceneError) as caught:
        parse(text, "my.toml")
    message = str(caught.value)
    assert message.startswith("my.toml: ")
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["shroud.gap[12]=1 um"], "--set: shroud.gap[12]: the scene has 12 interfaces, from [0] to [11]"),
        (["blades.m[12]=1"], "--set: blades.m[12]: the scene has 12 blades, from [0] to [11]"),
        (["shroud.alpha[3]=1"], "--set: shroud.alpha is one number, not one per blade; drop the [3]"),
        (["contact.k[3]=1e5"], "--set: the scene is given by contact.gamma; name contact.k for all interfaces, or con"),
        (["blades.f_x[3]=95"], "--set: the scene does not give blades.f_x; name it for all blades, or blades.k_x[3]"),
        (["row.closed[0]=true"], "--set: [row] closed is not one per blade; drop the [0]"),
        (["row.blades=1"], "--set: [row] blades = 1 must be greater than or equal to 2"),
        (["drive.engine_order=2.5"], "--set: [drive] engine_order = 2.5 must be a whole number"),
        (["drive.omega=1300 rpm"], "engine order 3; name drive.speed"),
        (
            ["shroud.gap=[1,2]"],
            "--set: [shroud] gap = [1, 2] must be one number or a list of 12, one for each interface",
        ),
    ],
)
def test_wrong_overrides_of_rows(overrides, expected):
    with pytest.raises(SceneError) as caught:
        load(RING, overrides)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_python_refuses(table1):
    ring, size = load(RING).scene, row_layout(12, True)
    for ask, told in (
        (lambda: js.vary(ring, "shroud.gap[12]", 1.0), r"the scene has 12 interfaces, from \[0\] to \[11\]"),
        (lambda: js.vary(ring, "shroud.alpha[0]", 1.0), "is one number, not one per blade"),
        (lambda: js.vary(ring, "contact.k[0]", 1e5), r"given by contact\.gamma; name contact\.k for all interfaces"),
        (
            lambda: js.vary(ring, "blades.m", np.ones(2)),
            r"one number or a list of 12, one for each blade, but its shape is \(2,\)",
        ),
        (lambda: js.vary(ring, "drive.engine_order", 2.5), "must be a whole number"),
        (lambda: js.vary(ring, "drive.engine_order", np.inf), "must be a finite number"),
        (lambda: js.vary(ring, "drive.f[0]", 2.5), "is one number, not one per blade"),
        (lambda: js.vary(js.vary(ring, "drive.speed", 9.0), "drive.engine_order", 0.0), "must be greater than 0 where"),
        (lambda: js.vary(ring, "row.mistuning[0]", -1.0), "must be greater than -1"),
        (lambda: js.vary(table1, "row.mistuning[0]", 0.0), "the scene has no number `row.mistuning"),
        (lambda: js.vary(table1, "blades.m[2]", 0.1), "the scene has 2 blades"),
        (lambda: with_numbers(ring, ["drive.engine_order", "drive.phase"]), "are one number; name one of them"),
        (lambda: js.value_of(js.vary(ring, "drive.phase", 0.0), "drive.engine_order"), r"does not give drive\.engine_"),
        (lambda: find_key("row.mistuing", layout=size), "did you mean `row.mistuning`"),
        (lambda: Row(1), "A row has from 2 to 512 blades, not 1"),
        (
            lambda: Row(3, mistuning=np.zeros(2)),
            r"one number or a list of 3, one for each blade, but its shape is \(2,\)",
        ),
        (lambda: _replaced(ring, row=None), r"must be one number or a pair \[left, right\], but its shape is \(12,\)"),
        (
            lambda: _replaced(table1, row=Row(3)),
            r"blades\.m must be one number or a list of 3, one for each blade, but its shape",
        ),
        (
            lambda: _replaced(ring, contact=js.Contact(None, np.ones(12), MISPRINTS)),
            "`contact.reading` but consistent is of the pair",
        ),
        (
            lambda: _replaced(ring, parts=js.Parts(neighbour="rigid")),
            "every blade of a row has a neighbour that is a blade",
        ),
    ):
        with pytest.raises(InputError, match=told):
            ask()


def _replaced(scene, **parts):
    """A scene made anew with some of its parts replaced."""
    names = ("blades", "shroud", "contact", "friction", "drive", "initial", "parts", "laws", "given", "row")
    return js.Scene(**{name: getattr(scene, name) for name in names} | parts)


def test_smooth_contact_has_a_width_for_each_interface():
    smooth = load(RING, ["parts.contact=smooth", "contact.width=1 um", "contact.width[2]=2 um"]).scene
    assert smooth.contact.width.shape == (12,)
    assert js.vary(smooth, "contact.width[4]", 3e-6).contact.width[4] == 3e-6
    again = with_parts(load(RING).scene, smooth.parts, smooth.contact.width)
    assert same(again.contact, smooth.contact)


KNOW_ROWS = {
    *("simulate", "sweep", "power", "table", "explain", "check", "diagnose", "rollout"),
    *(
        "orbit",
        "gradient",
        "branch",
        "response",
        "tune",
        "mistune",
        "scatter",
        "report",
        "period_map",
        "most_trials",
        "check_laws",
        "largest_frequency",
        "lyapunov",
        "attractors",
        "basins",
        "fit",
        "method_for",
    ),
    *("value_of", "vary", "scenes_from", "stack_scenes"),
}


def test_every_public_function_of_scenes_knows_rows_or_refuses_them():
    public = {name: getattr(js, name) for name in dir(js) if not name.startswith("_")}
    functions = {name: f for name, f in public.items() if inspect.isfunction(f)}
    takes = lambda f: any("Scene" in str(of.annotation) for of in inspect.signature(f).parameters.values())
    of_scenes = {name for name, f in functions.items() if takes(f)}
    # `with_contact_law` knows rows but for `Laws`, which are refused in words of their own, see above.
    assert of_scenes == {"trade", *KNOW_ROWS, "with_contact_law"}


def test_the_largest_frequency_of_a_row_is_a_bound():
    # Of rows of the pair's blades: at most that of contact twice as stiff, by which a blade between two others is held.
    pair = js.largest_frequency(load("table1").scene)
    rows = [["row.blades=2", "row.closed=false"], ["row.blades=6", "row.closed=true"]]
    for row in rows:
        bound = js.largest_frequency(load("table1", [*row, "drive.phase=0"]).scene)
        assert pair < bound <= np.sqrt(2) * pair


def test_the_speed_of_a_row_counts_with_the_phases_of_its_engine_order():
    scene = js.load("row_ring12", ["drive.speed=1700 rpm"]).scene
    counted = numbers_that_count(scene)
    assert "drive.speed" in counted
    assert all(np.isfinite(level_of(with_numbers(scene, counted), key)) for key in counted)
    # Control: a number of a phase takes the place of the engine order, without which there is no speed.
    with pytest.raises(js.Error, match="engine_order"):
        level_of(with_numbers(scene, [*counted, "drive.phase[1]"]), "drive.speed")


def test_an_engine_order_is_known_of_phases_in_float32():
    phase = np.float32(2 * np.pi * 7 / 60) * np.arange(60, dtype=np.float32)
    assert order_of_phases(phase) == 7
    assert order_of_phases(np.where(np.arange(60) == 9, phase + np.float32(1e-3), phase)) is None
    assert order_of_phases(np.asarray(phase, float)) is None  # control: in float64 that would be another drive
