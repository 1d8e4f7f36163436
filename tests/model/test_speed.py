"""Stiffnesses that grow with the speed, and gaps that untwist changes: against closed forms and scenes at rest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.model.linear import free_power, static_position, steady_amplitudes
from jaxshroud.scene.speed import SPEED_KEYS

GROWTH = ("blades.B_x=[1.3, 0.8]", "blades.B_y=0.7", "blades.B_T=-0.4")
UNTWIST = ("shroud.gap_at=-15 um", "shroud.gap_at_speed=1500 rpm")


def scene_of(*changes, name="fig16_best"):
    return js.load(name, ["drive.engine_order=4", *GROWTH, *UNTWIST, *changes]).scene


def at_rest(scene):
    """The scene with the stiffnesses and the gap of its speed as those at rest, from which nothing grows."""
    running = scene.mistuned_blades, scene.running_shroud, scene.k, None
    places = lambda s: (s.blades, s.shroud, s.contact.k, s.contact.gamma)
    plain = eqx.tree_at(places, scene, running, is_leaf=lambda part: part is None)
    if scene.row is not None:
        plain = eqx.tree_at(lambda s: s.row.mistuning, plain, jnp.zeros_like(scene.row.mistuning))
    return eqx.tree_at(lambda s: s.given, plain, {}, is_leaf=lambda part: isinstance(part, dict))


def test_numbers_grow_as_the_formulas_say():
    scene = scene_of()
    b, square = scene.blades, (float(scene.drive.omega) / 4) ** 2
    running = scene.running_blades
    assert_allclose(running.k_x, b.k_x + np.array([1.3, 0.8]) * b.m * square, rtol=1e-15)
    assert_allclose(running.k_y, b.k_y + 0.7 * b.m * square, rtol=1e-15)
    assert_allclose(running.k_T, b.k_T - 0.4 * b.I * square, rtol=1e-15)
    share = square / (1500 * np.pi / 30) ** 2
    assert_allclose(scene.running_shroud.gap, 22e-6 - 37e-6 * share, rtol=1e-14)
    # Gamma is that of the stiffness at rest, and dampers do not change.
    assert_allclose(scene.k, scene.contact.gamma * b.k_x[0], rtol=1e-15)
    assert_array_equal(running.c_x, b.c_x)


def test_frequencies_ratios_and_mistuning_are_those_at_rest():
    given = js.load("engine_order", ["blades.B_x=1.1"]).scene
    plain = js.load("engine_order").scene
    assert_array_equal(given.blades.k_x, plain.blades.k_x)
    assert_array_equal(given.blades.c_x, plain.blades.c_x)
    row = js.load("table1", ["row.blades=3", "row.mistuning=[0.1, 0.0, -0.1]", "blades.B_x=1.1", *ENGINE_ROW]).scene
    square = (float(row.drive.omega) / 4) ** 2
    wanted = np.array([1.1, 1.0, 0.9]) * 1e5 + 1.1 * 0.08 * square
    assert_allclose(row.mistuned_blades.k_x, wanted, rtol=1e-15)


ENGINE_ROW = ("drive.engine_order=4", "row.closed=true")


@pytest.mark.full
@pytest.mark.parametrize("layout", ["pair", "row"])
def test_every_closed_form_is_that_of_a_scene_at_rest_with_these_numbers(layout):
    row = ("row.blades=3", "row.mistuning=[0.1, 0.0, -0.1]", "row.closed=true", "blades.B_x=1.3")
    changes = row if layout == "row" else ()
    scene = scene_of("drive.F_x_mean=2.0", *changes, name="table1" if layout == "row" else "fig16_best")
    plain = at_rest(scene)
    assert_allclose(free_power(scene), free_power(plain), rtol=1e-14)
    for n, one in steady_amplitudes(scene).items():
        for a, b in zip(one, steady_amplitudes(plain)[n], strict=True):
            assert_allclose(a, b, rtol=1e-13)
    assert_allclose(static_position(scene).x, static_position(plain).x, rtol=1e-14)
    sheets = [js.check(s, start=0, stop=300.0) for s in (scene, plain)]
    names = ("approach", "slide", "gap", "pressed", *(["omega_max"] if scene.row is None else []))
    for name in names:  # the bound of a row is that of pairs without mistuning
        assert_allclose(getattr(sheets[0], name), getattr(sheets[1], name), rtol=1e-12, err_msg=name)


METHOD = js.RungeKutta(steps=200)


def test_contact_is_that_of_a_scene_at_rest_with_these_numbers():
    scene = scene_of('parts.motion=["x", "y"]')
    runs = [js.simulate(s, n_periods=2, method=METHOD) for s in (scene, at_rest(scene))]
    found, wanted = (np.asarray(run.motion.x) for run in runs)
    assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    assert np.any(np.asarray(runs[0].mode) > 0)


@pytest.mark.full
def test_a_sweep_along_the_speed_follows_each_lane():
    scene = scene_of()
    speeds = [120.0, 150.0]
    swept = js.sweep(scene, {"drive.speed": speeds}, n_periods=1, transient=3, method=METHOD)
    assert js.sweep(scene, {"drive.omega": [4 * s for s in speeds]}, n_periods=1, transient=3, method=METHOD).P_d.shape
    for i, speed in enumerate(speeds):
        one = at_rest(js.vary(scene, "drive.speed", speed))
        alone = js.sweep(one, {"drive.level": [1.0, 1.1]}, n_periods=1, transient=3, method=METHOD)
        assert_allclose(swept.P_d[i], alone.P_d[0], rtol=1e-9)


def test_derivatives_of_the_closed_form_are_exact():
    # Omega = omega / e: growth moves the stiffness with the frequency, a speed with both, and the order alone not.
    scene = scene_of()

    def P_0(key, value):
        return jnp.sum(free_power(js.vary(scene, key, value)))

    for key in ("drive.omega", "blades.B_x", "blades.k_x", "drive.speed"):
        at = 134.0 if key == "drive.speed" else js.value_of(scene, f"{key}[0]" if key == "blades.B_x" else key)
        exact, h = float(jax.grad(lambda v, key=key: P_0(key, v))(at)), 1e-4 * abs(at)
        by_steps = np.array([float(P_0(key, at + n * h)) for n in (-2, -1, 1, 2)]) @ [1, -8, 8, -1] / (12 * h)
        assert_allclose(exact, by_steps, rtol=1e-8, err_msg=key)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["blades.B_x=1"], r"^--set: blades.B_x needs drive.engine_order"),
        (["shroud.gap_at=0", "shroud.gap_at_speed=100"], r"^--set: shroud.gap_at needs drive.engine_order"),
        (["shroud.gap_at=0"], r"^--set: shroud.gap_at needs shroud.gap_at_speed"),
        (["drive.engine_order=4", "blades.B_T=-900"], r"^--set: blades.B_T = -900 makes k_T negative at 1280 rpm"),
        (["drive.engine_order=4", "blades.B_x=nan"], "B_x = NaN"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(changes, told):
    with pytest.raises(js.SceneError, match=told) as error:
        js.load("table1", changes)
    assert "\n" not in str(error.value)


def test_a_range_of_speeds_with_a_negative_stiffness_is_refused():
    scene = js.load("table1", ["drive.engine_order=4", "blades.B_x=-20"]).scene
    with pytest.raises(js.SceneError, match="makes k_x negative at 2865 rpm"):
        js.sweep(scene, {"drive.speed": [100.0, 300.0]}, n_periods=1)
    with pytest.raises(js.SceneError, match=r"^blades.B_x needs drive.engine_order"):
        js.vary(js.load("table1").scene, "blades.B_x", 1.0)


def test_zero_growth_is_none():
    plain = js.load("table1", [f"{key}=0" for key in SPEED_KEYS[:3]]).scene
    assert jax.tree.structure(plain) == jax.tree.structure(js.load("table1").scene)


def test_files_give_back_what_they_were_given(tmp_path):
    file = js.load("table1", ["drive.engine_order=4", *GROWTH, *UNTWIST])
    assert {"drive.engine_order"} == set(file.given)  # beside omega, as the speed needs it
    (tmp_path / "again.toml").write_text(file.text(), encoding="utf-8")
    again = js.load(str(tmp_path / "again.toml"))
    assert again.text() == file.text()
    for a, b in zip(jax.tree.leaves(again.scene), jax.tree.leaves(file.scene), strict=True):
        assert_array_equal(a, b)
    faster = js.vary(file.scene, "drive.f", 100.0)
    assert set(faster.given) == {"drive.engine_order", "drive.f"}


def growing_pair(*changes):
    """Faces pressed together at rest that untwist parts at 1,369 rpm."""
    pressed = ("shroud.gap=-50 um", "shroud.gap_at=10 um", "shroud.gap_at_speed=1500 rpm")
    return js.load("engine_order", ["blades.B_x=1.1", "blades.B_T=0.4", *pressed, *changes]).scene


def test_crossings_are_where_natural_frequencies_at_that_speed_are_multiples_of_it():
    scene = growing_pair()
    sheet = js.check(scene, stop=300.0)
    assert len(sheet.crossings) > 4
    for crossing in sheet.crossings:
        there = js.check(js.vary(scene, "drive.speed", crossing.speed), stop=300.0)
        frequencies = [mode.frequency for mode in there.modes if mode.contact == crossing.contact]
        met = crossing.engine_order * crossing.speed / (2 * np.pi)
        assert min(abs(f / met - 1) for f in frequencies) < 1e-12, crossing
    lines = sheet.over_speed
    apart = [i for i, mode in enumerate(sheet.modes) if (mode.contact, mode.motion) == ("apart", "x")]
    # Apart: omega^2 = k / m + B Omega^2, met at Omega^2 = k / m / (e^2 - B); by order 1 never, as 1 <= B.
    k, m = float(scene.blades.k_x[0]), float(scene.blades.m[0])
    speeds, curve = np.array(lines.speeds), np.array(lines.frequencies[apart[0]])
    assert_allclose(
        curve[-9:], np.sqrt(k / m + 1.1 * speeds[-9:] ** 2) / (2 * np.pi), rtol=1e-13
    )  # fmt: skip
    for order, speed in zip(sheet.engine_orders, lines.crossings[apart[0]], strict=True):
        wanted = np.sqrt(k / m / (order**2 - 1.1)) if order > 1 else np.nan
        ends = lines.pressed[0][1]
        assert_allclose(speed, wanted if wanted > ends else np.nan, rtol=1e-13)


@pytest.mark.full
def test_lines_in_contact_end_where_untwist_parts_the_faces():
    sheet = js.check(growing_pair(), stop=300.0)
    ((start, end),) = sheet.over_speed.pressed
    assert start == 0.0
    assert_allclose(end, 1500 * np.pi / 30 * np.sqrt(5 / 6), rtol=1e-12)
    speeds = np.array(sheet.over_speed.speeds)
    for mode, curve in zip(sheet.modes, sheet.over_speed.frequencies, strict=True):
        shown = np.isfinite(curve)
        assert np.array_equal(shown, speeds > end if mode.contact == "apart" else speeds <= end)
    assert not [one for one in sheet.crossings if (one.contact == "apart") != (one.speed > end)]
    # A mean force that presses moves the end: N vanishes where the gap is what the springs of that speed close.
    pushed = growing_pair("drive.F_x_mean=[1.0, -1.0]")
    end = js.check(pushed, stop=300.0).over_speed.pressed[0][1]
    at_end = js.vary(pushed, "drive.speed", end)
    closed = 2.0 / float(at_end.running_blades.k_x[0])
    assert_allclose(at_end.running_shroud.gap, closed, rtol=1e-9)
    # Faces that nothing presses at any speed keep the lines of a state of contact.
    open_faces = js.load("engine_order", ["blades.B_x=1.1"]).scene
    assert js.check(open_faces, stop=300.0).over_speed.pressed == ()


def test_a_range_beyond_a_stable_stiffness_is_refused():
    scene = js.load("engine_order", ["blades.B_x=-3"]).scene
    with pytest.raises(ValueError, match=r"^blades.B_x = -3 makes k_x negative at 5730 rpm"):
        js.check(scene, stop=600.0)


@pytest.mark.full
def test_the_gaps_of_lanes_of_rows_are_those_of_each():
    ring = ["row.blades=3", "drive.engine_order=1", "shroud.gap_at=30 um", "shroud.gap_at_speed=400"]
    alone = [js.vary(js.load("row_ring12", ring).scene, "drive.omega", omega) for omega in (500.0, 540.0)]
    gaps, lanes = [np.asarray(one.running_shroud.gap) for one in alone], js.stack_scenes(alone)
    assert_allclose(lanes.running_shroud.gap, gaps, rtol=1e-15)
    assert not np.allclose(gaps[0], gaps[1], rtol=1e-3)  # control: they differ
