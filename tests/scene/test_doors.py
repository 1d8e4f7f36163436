"""One scene by whichever door: what `vary`, grids, tables and stored lanes make of a key is what `--set` makes."""

from functools import cache
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
import xarray as xr

import jaxshroud as js
from jaxshroud.io.scene_numbers import dimension, key_attrs, scene_text_of_lane, scenes_from_dataset
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.designs import read_designs
from jaxshroud.scene.drive_orders import check_continuous
from jaxshroud.scene.grids import grid_of_scenes, scenes_at, stack_scenes
from jaxshroud.scene.keys import ALL_KEYS, LIMIT_KEYS, Motion, number_shape
from jaxshroud.scene.shipped import shipped
from jaxshroud.scene.text import text_of
from jaxshroud.scene.vary import fields_of, inputs_of, with_numbers
from jaxshroud.verbs.arguments import resolve_options

BLADES = {  # by numbers, and as a designer gives them
    "numbers": 'm = 0.08\nI = "block"\nk_x = 1e5\nk_y = 3e6\nk_T = 2000.0\nc_x = 3.57\nc_y = 19.6\nc_T = 0.506',
    "inputs": 'm = 0.12\nI = "block"\nf_x = 95\nf_y = 520\nf_T = 380\nzeta_x = 0.003\nzeta_y = 0.003\nzeta_T = 0.003',
}
SHROUD = '[shroud]\nalpha = "55 deg"\nl_oa = "60 mm"\nl_ab = "30 mm"\n'
CONTACT = "[contact]\n{}\n[friction]\nk_d = 1e6\nmu = 0.5\n"


def harmonics(entry, orders):
    """Two harmonics, alike but for their orders."""
    loads = "F = 60\nbeta = 0.5\nM = 0.3", "F = 20\nbeta = 0.4"
    return "".join(f"[[drive.harmonic]]\n{entry} = {n}\n{load}\n" for n, load in zip(orders, loads, strict=True))


def scene_text(blades="numbers", shroud="gap = 22e-6", contact="gamma = 2.6", drive="", orders="", row="", growth=""):
    """A scene file."""
    tables = f"[blades]\n{BLADES[blades]}\n{growth}\n", f"{SHROUD}{shroud}\n", CONTACT.format(contact)
    return "".join((row, *tables, f"[drive]\n{drive}\n{orders}", "[run]\nperiods = 4\n"))


OPPOSITE = "phase = [0, 3.0]"
RING = "[row]\nblades = 6\nclosed = true\n"
OWN = {
    "two orders": scene_text(
        drive=f"omega = 536\nF_x_mean = 200\n{OPPOSITE}", orders=harmonics("order", (1, 2)), shroud="gap = 0.5"
    ),
    "orders 4 and 8": scene_text(
        drive=f"speed = 134\n{OPPOSITE}", orders=harmonics("engine_order", (4, 8)), contact="gamma = 2.6\npoints = 2"
    ),
    "wheel": scene_text(
        blades="inputs",
        growth="B_x = 1.1",
        row=f"{RING}coupling = {{k_x = 2e4}}\n",
        shroud='gap = "-5 um"\ngap_at = "60 um"\ngap_at_speed = "1800 rpm"',
        contact="k = 2e6\npoints = 2",
        drive='speed = "1450 rpm"',
        orders=harmonics("engine_order", (4, 8)),
    ),
    "ring at a speed": scene_text(
        row=RING, drive="speed = 150\nengine_order = 1", orders=harmonics("engine_order", (2, 4))
    ),
}
SCENES = (*OWN, *shipped())

AERO = {f"aero.{name}_{part}" for name in ("L0", "L1", "L_1") for part in ("re", "im")}
OF_ROWS = AERO | {"row.mistuning", "row.mistuning[0]"}
GROWTHS = {f"blades.B_{name}{place}" for name in ("x", "y", "T") for place in ("", "[0]")}
SPEED = {"drive.speed", "drive.engine_order"}
UNTWIST = {"shroud.gap_at", "shroud.gap_at[0]", "shroud.gap_at_speed"}
INPUT_OF_ONE_BLADE = {f"blades.{name}_{of}[0]" for name in ("f", "zeta") for of in ("x", "y", "T")}
SINGLE_LOADS = {f"drive.{name}{place}" for name in ("beta", "F_0", "M_0") for place in ("", "[0]")}
LISTED_LOADS = {
    f"drive.harmonic[{i}].{name}{at}" for i in (0, 1) for name in ("F", "beta", "M", "phase") for at in ("", "[0]")
}
PLACES = {"contact.point[0].place", "contact.point[1].place"}
OF_MOTION = {f"initial.{name}{at}" for name in Motion._fields for at in ("", "[0]")}  # that a static start has not
OTHER_FORM = {f"drive.harmonic[{i}].F_x_re{at}" for i in (0, 1) for at in ("", "[0]")}
LIMITS = {f"{key}{at}" for key in LIMIT_KEYS for at in ("", "[0]")}
NEVER = PLACES | OTHER_FORM | LIMITS | {"contact.width", "contact.width[0]"}
OF_LUMPED_BLADES = {f"{key}{at}" for key in ALL_KEYS if key.startswith("blades.") for at in ("", "[0]")}
PAIR_OF_NUMBERS = NEVER | OF_ROWS | GROWTHS | SPEED | UNTWIST | INPUT_OF_ONE_BLADE | LISTED_LOADS
REFUSED = {  # what scenes have no number for
    "two orders": NEVER | OF_ROWS | GROWTHS | SPEED | UNTWIST | INPUT_OF_ONE_BLADE | SINGLE_LOADS,
    "orders 4 and 8": NEVER | OF_ROWS | UNTWIST | INPUT_OF_ONE_BLADE | SINGLE_LOADS,
    "wheel": NEVER | SINGLE_LOADS | {"contact.gamma[0]", "drive.phase", "drive.phase[0]"},
    "row_disk60": NEVER | SINGLE_LOADS | UNTWIST | OF_MOTION | {"contact.gamma[0]", "drive.phase", "drive.phase[0]"},
    "ring at a speed": NEVER | UNTWIST | INPUT_OF_ONE_BLADE | SINGLE_LOADS | {"contact.k[0]"},
    "fem_blade": NEVER - LIMITS | OF_LUMPED_BLADES - LIMITS | UNTWIST | LISTED_LOADS | {"contact.gamma[0]"},
    "engine_order": NEVER | OF_ROWS | UNTWIST | LISTED_LOADS,
    **dict.fromkeys(
        ("row_chain5", "row_ring12", "row_ring12_points", "row_ring6_flutter"),
        NEVER | UNTWIST | INPUT_OF_ONE_BLADE | LISTED_LOADS | {"contact.k[0]"},
    ),
}
# of which --set says what else is to be set beside them
NEED_MORE = AERO | UNTWIST | OF_MOTION | {"row.mistuning", "contact.width", "drive.speed", "drive.engine_order"}


@cache
def file_of(name, *overrides):
    """A shipped scene, or one of this module, with overrides."""
    return parse(OWN[name], name, list(overrides)) if name in OWN else load(name, list(overrides))


def keys_of(scene):
    """All keys that any scene has, numbers of one blade or interface among them."""
    numbered = [f"drive.harmonic[{i}].{name}" for i in (0, 1) for name in ("F", "beta", "M", "phase", "F_x_re")]
    for key in (*ALL_KEYS, *numbered, *PLACES):
        yield key
        if number_shape(ALL_KEYS[key], scene.layout):
            yield f"{key}[0]"


def values_of(scene, key):
    """Values for a key."""
    number = key.removesuffix("[0]")
    if number == "drive.engine_order":
        return (1.0, 2.0, 3.0)
    own = {**fields_of(scene), **inputs_of(scene)}.get(number)
    level = 0.0 if own is None else float(np.ravel(own)[0])
    return (level * (0.9637 if number == "shroud.alpha" else 1.0371) or 0.01,)


def answer(door):
    """What a door gives, and the line with which it refuses."""
    try:
        return door(), ""
    except js.Error as error:
        return None, str(error)


def same(one, other):
    """Whether two scenes have the same numbers, bit for bit, and are given in the same way."""
    if jax.tree.structure(one) != jax.tree.structure(other):
        return False
    return all(
        np.array_equal(np.asarray(a), np.asarray(b))
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


def first_lane(scenes):
    return jax.tree.map(lambda a: np.asarray(a)[0], scenes)


def stored_lane(file, key, value):
    data = xr.Dataset(coords={dimension(key): xr.Variable((), value, key_attrs(key))}, attrs={"scene": file.text()})
    return parse(scene_text_of_lane(data), "stored").scene


DOORS: dict[str, Any] = {
    "vary": lambda file, key, value: js.vary(file.scene, key, value),
    "grid": lambda file, key, value: first_lane(grid_of_scenes(file.scene, {key: np.array([value])})),
}
OTHER_DOORS: dict[str, Any] = {
    "designs": lambda file, key, value: first_lane(read_designs({key: [value]}, file.scene).scenes(file.scene)),
    "stored": stored_lane,
}


@pytest.mark.full(but=["orders 4 and 8"])
@pytest.mark.parametrize("name", SCENES)
def test_every_door_gives_the_scene_of_set_or_refuses_too(name):
    # Bit for bit, and given in the same way: an order of a harmonic is a number of its scene as all others are.
    assert refused_of(name, DOORS) <= REFUSED.get(name, PAIR_OF_NUMBERS)


@pytest.mark.full
@pytest.mark.parametrize("name", [*OWN, "engine_order", "table1_points", "row_chain5", "fem_blade"])
def test_tables_and_stored_lanes_give_it_too(name):
    assert refused_of(name, OTHER_DOORS) <= REFUSED.get(name, PAIR_OF_NUMBERS)


def refused_of(name, doors):
    """The keys that doors refuse; what they do not refuse, and only that, is the scene of --set."""
    file, refused = file_of(name), set()
    for key in keys_of(file.scene):
        for value in values_of(file.scene, key):
            want, line = answer(lambda key=key, value=value: file_of(name, f"{key}={value!r}").scene)
            # influence coefficients are written as pairs, with a 0 for the part that a scene does not have
            for door, of in ((door, of) for door, of in doors.items() if door != "stored" or key not in AERO):
                got, told = answer(lambda of=of, key=key, value=value: of(file, key, value))
                assert (got is None) == (want is None), (door, key, value, line, told)
                assert got is None or same(got, want), (door, key, value)
                assert got is not None or key in NEED_MORE or line.partition(": ")[2] in told
            refused |= {key} if want is None and not value_is_refused(line) else set()
    return refused


def value_is_refused(line):
    """Whether a line refuses a value, rather than a key."""
    return "no whole multiple" in line


@pytest.mark.full(but=["orders 4 and 8"])
@pytest.mark.parametrize("name", [*OWN, "engine_order", "row_chain5"])
def test_traced_numbers_give_the_scene_of_set(name):
    # To rounding: XLA computes what NumPy does for plain numbers.
    file = file_of(name)
    keys = {"blades.m", "blades.k_x", "blades.f_x", "drive.speed", "drive.omega", "shroud.gap", "drive.level"}
    for key in sorted(keys - REFUSED[name]):
        value = values_of(file.scene, key)[-1]
        want = file_of(name, f"{key}={value!r}").scene
        got = first_lane(jax.vmap(lambda v, key=key: js.vary(file.scene, key, v))(np.array([value])))
        assert jax.tree.structure(got) == jax.tree.structure(want)
        for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-14)


def orders(scene):
    return [one.order for one in scene.drive.harmonic]


def test_another_engine_order_gives_harmonics_other_orders():
    # Engine orders 4 and 8 stay what they are: twice and four times an engine order of 2, whose frequency is 2 x 134.
    scene = file_of("orders 4 and 8").scene
    half = js.vary(scene, "drive.engine_order", 2.0)
    assert (orders(scene), orders(half)) == ([1, 2], [2, 4])
    assert float(half.drive.omega) == 268.0
    assert orders(js.vary(half, "drive.engine_order", 4.0)) == [1, 2]
    # What gives the frequency itself leaves no engine order to follow, and orders as they are.
    assert orders(js.vary(half, "drive.omega", 500.0)) == [2, 4]
    told = file_of("orders 4 and 8", "drive.engine_order=2", "drive.omega=500").scene
    assert same(told, js.vary(half, "drive.omega", 500.0))
    # Control: orders that are given as such are multiples of omega, whatever the engine order.
    ring = parse(
        scene_text(row=RING, drive="omega = 500\nengine_order = 4", orders=harmonics("order", (1, 2))), "ring"
    ).scene
    assert orders(js.vary(ring, "drive.engine_order", 2.0)) == [1, 2]


def test_engine_orders_of_harmonics_are_written_and_read():
    file = file_of("orders 4 and 8", "drive.engine_order=2")
    for written in (file.text(), text_of(file.scene, {"periods": 3})):
        assert "engine_order = 8" in written
        assert same(parse(written, "again").scene, file.scene)
        assert orders(parse(written, "again", ["drive.engine_order=1"]).scene) == [4, 8]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ([3.0], "[[drive.harmonic]] 0: engine_order = 4 is no whole multiple of drive.engine_order = 3; leave"),
        ([4.5], "[[drive.harmonic]] 0: engine_order = 4 is no whole multiple of drive.engine_order = 4.5; leave"),
        ([0.02], "[[drive.harmonic]] 0: engine_order = 4 is more than 99 times drive.engine_order = 0.02; give a"),
        (
            [2.0, 4.0],
            "drive.engine_order = 2 and 4 give harmonics of different orders, [2, 4] and [1, 2], which do not",
        ),
    ],
)
def test_engine_orders_that_give_no_orders_are_refused(values, told):
    file = file_of("orders 4 and 8")
    asked = [lambda: grid_of_scenes(file.scene, {"drive.engine_order": np.array(values)})]
    asked += [lambda: js.scenes_from({"drive.engine_order": values}, file)]
    asked += [
        lambda: scenes_at(
            with_numbers(file.scene, ["drive.engine_order"]), ["drive.engine_order"], np.array([values]).T
        )
    ]
    if len(values) == 1:
        asked += [lambda: file_of("orders 4 and 8", f"drive.engine_order={values[0]}")]
        asked += [lambda: js.vary(file.scene, "drive.engine_order", values[0])]
    for ask in asked:
        _, line = answer(ask)
        assert told in line


def test_an_engine_order_of_harmonics_is_neither_traced_nor_followed():
    scene = file_of("orders 4 and 8").scene
    with pytest.raises(js.InputError, match="which no compiled function can change"):
        jax.jit(lambda e: js.vary(scene, "drive.engine_order", e))(2.0)
    with pytest.raises(js.SceneError, match="a divisor of the engine orders of its harmonics here"):
        check_continuous("drive.engine_order", scene)
    # Control: the speed is a number like any other, inside JAX's transformations too.
    slope = jax.grad(lambda speed: js.vary(scene, "drive.speed", speed).drive.omega)(134.0)
    assert slope == 4.0


def test_scenes_of_several_engine_orders_are_stacked_and_stored():
    # Of the same orders they run together; stored, each comes back with its numbers.
    fours = file_of("orders 4 and 8").scene
    sixes = parse(OWN["orders 4 and 8"].replace("= 4\n", "= 6\n").replace("= 8\n", "= 12\n"), "sixes").scene
    stacked = stack_scenes([fours, sixes])
    attrs, more = resolve_options(stacked).provenance(100)
    again = scenes_from_dataset(xr.Dataset(more, attrs=attrs), (2,), "float64")
    for i, one in enumerate((fours, sixes)):
        lane = jax.tree.map(lambda a, i=i: np.asarray(a)[i], again)
        assert orders(lane) == [1, 2]
        assert (float(lane.drive.omega), float(lane.given["drive.engine_order"])) == (134.0 * (4, 6)[i], (4.0, 6.0)[i])
        assert eqx.tree_equal(lane.blades, one.blades)
    drive = f"speed = 134\nengine_order = 4\n{OPPOSITE}"
    plain = parse(
        scene_text(drive=drive, orders=harmonics("order", (1, 2)), contact="gamma = 2.6\npoints = 2"), "plain"
    )
    assert orders(stack_scenes([fours, plain.scene])) == [1, 2]


def test_phases_of_ones_own_leave_the_frequency_of_a_speed():
    # The phases take the place of the engine order, without which a speed tells no frequency: that is kept.
    for overrides in (["drive.phase=0.3"], ["drive.phase[2]=0.3"]):
        told = file_of("ring at a speed", *overrides).scene
        assert (float(told.drive.omega), orders(told), dict(told.given).keys()) == (150.0, [2, 4], {"blades.I"})


@pytest.mark.parametrize("key", ["drive.F_0[0]", "drive.beta[1]", "shroud.gap_at[0]", "contact.width[0]"])
def test_a_number_of_one_blade_that_a_scene_lacks_is_refused(key):
    with pytest.raises(js.SceneError, match=r"--set: the scene has no"):
        file_of("ring at a speed", f"{key}=0.01")


def test_replace_has_several_numbers_as_overrides_have_them():
    new = js.load("table1").scene.replace({"shroud.gap": 3e-5, "contact.k": 2e6, "blades.c_x[1]": 7.0})
    file = js.load("table1", ["shroud.gap=3e-5", "contact.k=2e6", "blades.c_x[1]=7"])
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(new), jax.tree.leaves(file.scene), strict=True))
    with pytest.raises(js.KeyNameError):
        new.replace({"contact.k": 2e6, "contact.gamma": 2.0})
