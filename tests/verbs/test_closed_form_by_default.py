"""Verbs take the closed form of contact that keeps its state for certain, and march where it is not certain."""

import jax
import numpy as np
import pytest
from command_line import run, sets

import jaxshroud as js
from jaxshroud.linear.held_contact import held_contact
from jaxshroud.linear.linear_motion import linear_motions
from jaxshroud.scene.scene import without_given
from jaxshroud.verbs.gradient import differences
from jaxshroud.verbs.settled import default_state, settling_periods

STUCK = [
    "shroud.gap=-0.4 mm",
    'parts.motion=["x","y"]',
    "drive.F_0=2",
    "drive.M_0=0",
    "friction.mu=0.9",
    "initial.start=static",
]
MARCH = js.RungeKutta("dopri8", steps=200)
SHORT = {"n_periods": 2, "transient": 0}


def stuck(*settings):
    return js.load("table1", [*STUCK, *settings]).scene


def form_of(result):
    return result.data.attrs["method"]


@pytest.mark.parametrize(
    ("settings", "state"),
    [
        ([], "stuck"),
        (["shroud.gap=3 mm"], "apart"),
        (["shroud.gap=3 mm", "drive.F_0=0"], "apart"),
        (["friction.mu=0"], "stuck"),
        (["drive.F_0=400"], None),  # slips
        (['parts.motion=["x","y","theta"]', "drive.M_0=0.01"], None),  # not exact
        (["blades.c_x=0", "blades.c_y=0"], None),  # what does not die out
    ],
    ids=["stuck", "apart", "undriven", "frictionless", "slips", "turns", "undamped"],
)
def test_the_state_that_is_kept(settings, state):
    scene = stuck(*settings)
    assert default_state(scene, None) == state
    assert default_state(scene, MARCH) is None  # asked to march


def test_no_state_is_claimed_of_a_start_in_the_unloaded_position():
    scene = js.load("table1", STUCK[:-1]).scene
    assert default_state(scene, None) is None


@pytest.mark.full
def test_what_is_claimed_does_not_slip_on_the_way():
    loads = np.linspace(5.0, 14.0, 24)
    scenes = js.scenes_from({"drive.F_0": loads}, stuck())
    motion = linear_motions(scenes, held_contact(scenes, "stuck"))
    keeps = np.array([default_state(stuck(f"drive.F_0={load}"), None) == "stuck" for load in loads])
    swept = js.sweep(scenes, n_periods=120, transient=0, method=MARCH)
    leaves = np.asarray(swept.data["stick_slip"]).reshape(24, -1).sum(axis=1) > 0
    assert not (keeps & leaves).any()
    assert keeps.any()
    assert leaves.any()
    # A control: by the settled motion alone, contact would be said to stay where the way there slips.
    assert (motion.margins.holds & leaves).any()


@pytest.mark.full
def test_a_mixed_batch_is_marched():
    scenes = js.scenes_from({"drive.F_0": [2.0, 400.0]}, stuck())
    assert default_state(scenes, None) is None


@pytest.mark.full
def test_power_says_so_and_agrees_with_the_march():
    found = js.power(stuck(), **SHORT)
    assert "stuck" in form_of(found)
    marched = js.power(stuck(), n_periods=2, transient=250, method=MARCH)
    assert "stuck" not in form_of(marched)
    np.testing.assert_allclose(found.final["P"], marched.final["P"], rtol=1e-9)


@pytest.mark.full
def test_a_gradient_its_multipliers_and_a_given_start():
    found = js.gradient(stuck(), ["contact.gamma"])
    assert "linear" in found.flags
    marched, size = js.orbit(stuck(), method=MARCH), 8  # of places and rates
    decays = np.sort(np.abs(np.ravel(marched.multipliers)))[::-1]
    assert decays[0] == pytest.approx(1.0, abs=1e-9)  # of the slider, which stays where it starts
    own = np.sort(np.abs(np.ravel(found.orbit.multipliers)))[::-1]
    np.testing.assert_allclose(own[:size], decays[1 : size + 1], rtol=1e-8)  # the march errs by some 1e-9
    assert "stuck" not in form_of(js.power(stuck(), **SHORT, state=marched.cycle().start))


@pytest.mark.full
def test_a_table_a_scatter_and_a_tuning():
    table = js.table(stuck(), {"shroud.gap [mm]": [-0.4, -0.5]}, **SHORT)
    assert "stuck" in form_of(table)
    scatter = js.scatter(stuck(), {"shroud.gap": 1e-6}, draws=4, **SHORT)
    assert "stuck" in form_of(scatter)
    small = js.SearchOptions(4, 1, 1)
    tuned = js.tune(stuck(), {"shroud.gap": (-5e-4, -4e-4)}, search=small, motions=0, **SHORT)
    assert "stuck" in form_of(tuned)
    some_slip = js.tune(stuck("drive.F_0=30"), {"shroud.gap": (-5e-4, -1e-6)}, search=small, motions=0, **SHORT)
    assert "stuck" not in form_of(some_slip)


@pytest.mark.full
def test_a_response_is_marched_where_its_peak_slips():
    short = {"num": 3, "doublings": 0, "most_points": 2, **SHORT}
    swept = {"along": "drive.omega", "start": 1800.0, "stop": 3800.0}
    assert "stuck" in form_of(js.response(stuck("drive.F_0=0.01"), **swept, **short))
    assert default_state(js.scenes_from({"drive.omega": [1800.0, 2800.0, 3800.0]}, stuck()), None) == "stuck"
    assert "stuck" not in form_of(js.response(stuck(), **swept, **short))  # it slips at 3,300 rad/s


@pytest.mark.full(but=["nothing"])
@pytest.mark.parametrize(
    ("options", "form"),
    [
        ("", "stuck"),
        ("--steps-per-period 200", "rk4"),
        ("--accuracy fast", ""),
        ("--precision float64", "rk4"),
    ],
    ids=["nothing", "steps", "accuracy", "precision"],
)
def test_a_command_that_says_how_to_march_marches(options, form, tmp_path):
    run(f"power table1 {sets(*STUCK)} --periods 2 --transient 2 {options} --out {tmp_path}/power")
    method = js.open(tmp_path / "power" / "power.nc").data.attrs["method"]
    assert form in method
    assert ("closed form" in method) == (not options)


@pytest.mark.full
def test_a_warning_of_an_accuracy_is_printed_once(tmp_path, capsys):
    run(f"power row_chain5 --set parts.motion=[x] --accuracy fast --periods 2 --transient 2 --out {tmp_path}/power")
    assert capsys.readouterr().err.count("not examined") == 1


@pytest.mark.full
def test_nothing_that_moves_has_no_peak():
    scene = js.load("table1", [*STUCK, "drive.beta=90 deg"]).scene
    found = js.response(scene, "drive.omega", 100.0, 200.0, num=9, of="theta_peak", linear="stuck", **SHORT)
    assert not found.peaks


def test_how_long_free_vibration_takes_to_die_out():
    scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=0.3", "drive.omega=1000"]).scene
    rate = 0.3 / (2 * 0.08)
    lanes = jax.tree.map(lambda a: np.asarray(a)[None], without_given(scene))
    assert settling_periods(lanes) == pytest.approx(np.log(1e3) / rate * 1000 / (2 * np.pi))
    still = jax.tree.map(lambda a: np.asarray(a)[None], without_given(js.vary(scene, "blades.c_x", 0.0)))
    assert settling_periods(still) == np.inf
    creep = jax.tree.map(lambda a: np.asarray(a)[None], without_given(js.vary(scene, "blades.c_x", 1000.0)))
    slow = np.min(np.abs(np.roots([0.08, 1000.0, 1e5])))  # the slower of two decays
    assert settling_periods(creep) == pytest.approx(np.log(1e3) / slow * 1000 / (2 * np.pi))


@pytest.mark.full
def test_differences_of_a_closed_form():
    found = js.gradient(stuck(), ["contact.gamma", "friction.k_d"], of="x_peak")
    nearby = differences(found.orbit, list(found.value), 1e-3, "x_peak")
    for key, slope in found.value.items():
        assert nearby[key] == pytest.approx(slope, rel=1e-6)


def test_light_damping_is_told_with_what_to_do_where_faces_touch(tmp_path, capsys):
    light = ["blades.c_x=0.3", 'parts.motion=["x"]']
    told = js.check(js.load("table1", light)).advice[-1]
    assert "periods to decay to 0.1 %" in told
    assert "averages stand after some 40 periods: rather keep more of them" in told
    alone = js.check(js.load("table1", [*light, "parts.contact=none"])).advice[-1]
    assert alone == told.partition(";")[0]
    assert not any("to decay" in line for line in js.check(js.load("table1", light[1:])).advice)
    assert "never decays" in js.check(js.load("table1", ["blades.c_x=0"])).advice[-1]
    run(f"power table1 {sets(*light)} --periods 1 --transient 1 --steps-per-period 100 --out {tmp_path}/out")
    assert told.replace(":", ", 1 are discarded:", 1) in " ".join(capsys.readouterr().err.split())
