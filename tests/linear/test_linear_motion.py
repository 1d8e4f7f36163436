"""Contact that stays apart or stuck: the closed form of the settled motion against the march."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxshroud as js
from jaxshroud.cli import commands as cli
from jaxshroud.linear.held_contact import held_contact
from jaxshroud.linear.linear_motion import linear_motions
from jaxshroud.linear.linear_sector import settled_linear_motions
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError
from jaxshroud.verbs.settled import in_state

STUCK = ["shroud.gap=-0.4 mm", 'parts.motion=["x","y"]', "drive.F_0=2", "drive.M_0=0", "friction.mu=0.9"]
RING = ["shroud.gap=-0.4 mm", 'parts.motion=["x","y"]', "drive.F_0=2", "row.mistuning={sigma=0.02,seed=1}"]
SHORT = {"n_periods": 2, "transient": 0}
MARCH = js.RungeKutta("dopri8", steps=400)


def stuck(*settings):
    return js.load("table1", [*STUCK, "initial.start=static", *settings]).scene


def closed(scene, **options):
    return js.power(scene, **SHORT, linear="stuck", amplitudes=True, forces=True, **options)


def numbers(result, *names):
    return np.concatenate([np.ravel(np.asarray(result.data[name], float)) for name in names])


NAMES = ("final_P", "x_mean", "x_rms", "x_peak", "y_rms", "y_peak", "N_max", "N_mean", "F_max")


@pytest.mark.full(but=["pair"])
@pytest.mark.parametrize(("name", "settings"), [("table1", STUCK), ("row_ring12", RING)], ids=["pair", "ring"])
def test_the_closed_form_is_where_the_march_settles(name, settings):
    scene = js.load(name, [*settings, "initial.start=static"]).scene
    how = {"n_periods": 2, "transient": 250, "method": MARCH, "amplitudes": True, "forces": True}
    marched, slid = (js.power(one, **how) for one in (scene, js.vary(scene, "friction.mu", 0.0)))
    found = closed(scene)
    # The transient has faded by exp(-0.02 * 2 * 10^3 * 3) and the march's step leaves some 1e-13.
    assert_allclose(numbers(found, *NAMES), numbers(marched, *NAMES), rtol=1e-9, atol=1e-18)
    assert not np.allclose(numbers(slid, "x_rms"), numbers(found, "x_rms"), rtol=1e-3)  # the control: without friction


@pytest.mark.full
def test_near_the_limit_sticking_is_not_claimed_where_the_march_slips():
    loads = np.linspace(4.0, 60.0, 40)
    scenes = js.scenes_from({"drive.F_0": loads}, stuck())
    held = linear_motions(scenes, held_contact(scenes, "stuck")).margins.holds
    run = js.sweep(scenes, n_periods=8, transient=100, method=MARCH)
    slips = np.asarray(run.data["stick_slip"]).reshape(40, -1).sum(axis=1) > 0
    assert held.any()
    assert not held.all()
    assert not (held & slips).any()


def test_a_lane_whose_contact_leaves_its_state_stops():
    with pytest.warns(js.LaneWarning, match="NOT_LINEAR"):
        found = closed(stuck("drive.F_0=400"))
    assert found.final["status"] == Status.NOT_LINEAR
    assert np.isnan(found.final["P_d"])


@pytest.mark.full
def test_derivatives_are_those_of_the_closed_form():
    scene, keys = stuck(), ["contact.gamma", "drive.omega"]
    found = js.gradient(scene, keys, of="x_peak", linear="stuck")
    assert found.flags == ("linear",)
    for key in keys:
        value = js.value_of(scene, key)
        h, level = 1e-3 * abs(value), lambda at: numbers(closed(js.vary(scene, key, at)), "x_peak")[0]  # noqa: B023
        slope = np.dot([1, -8, 8, -1], [level(value + i * h) for i in (-2, -1, 1, 2)]) / (12 * h)
        # differences of fourth order miss some 1e-9 of the slope, and rounding 1e-13 of the level over h
        assert_allclose(found.value[key], slope, rtol=1e-6, atol=1e-10 * found.level / abs(value))


def test_apart_blades_move_as_without_contact():
    scene = js.load("table1", ['parts.motion=["x","y"]', "shroud.gap=3 mm", "drive.M_0=0"]).scene
    found = js.power(scene, **SHORT, linear="apart", amplitudes=True)
    assert_allclose(found.final["P"], found.final["P_0"], rtol=1e-12)
    assert found.final["status"] == Status.OK
    with pytest.warns(js.LaneWarning, match="NOT_LINEAR"):
        js.power(js.vary(scene, "shroud.gap", 1e-5), **SHORT, linear="apart")


@pytest.mark.full
def test_tuning_and_tables_take_the_closed_form():
    scene = stuck()
    found = js.tune(scene, {"contact.gamma": (1.0, 4.0)}, linear="stuck", search=js.SearchOptions(4, 1, 2), **SHORT)
    best = js.power(js.vary(scene, "contact.gamma", found.design["contact.gamma"]), linear="stuck", **SHORT)
    assert_allclose(found.objective, best.final["P_d_vibration"], rtol=1e-12)
    assert 'contact = "stuck"' in found.scene
    rows = js.table(scene, {"contact.gamma": [1.0, 2.5]}, linear="stuck", **SHORT)
    assert_allclose(rows.x_peak[1], numbers(closed(scene), "x_peak"), rtol=1e-12)


@pytest.mark.full
def test_a_response_has_the_peaks_of_the_closed_form():
    scene = stuck("drive.F_0=0.02")
    found = js.response(scene, "drive.omega", 2500.0, 6000.0, num=40, linear="stuck", **SHORT)
    (peak,) = found.peaks[:1]
    beside = [
        numbers(closed(js.vary(scene, "drive.omega", peak["value"] * (1 + e))), "x_peak")[0] for e in (-1e-4, 1e-4)
    ]
    assert all(one < peak["amplitude"] for one in beside)
    assert 0.002 < peak["zeta"] < 0.03  # the blades have 2 %, of their own frequencies


def test_check_tells_the_state_and_its_margins():
    told = js.check(stuck()).settled
    assert told is not None
    assert (told.state, told.exact, told.equilibria) == ("stuck", True, 1)
    assert 0 < told.slip < told.N < np.inf
    assert js.check(stuck("drive.F_0=400")).settled.state == ""
    assert js.check(stuck("friction.mu=0")).settled.state == "in contact"
    assert js.check(js.load("table1")).settled is None


def test_other_verbs_refuse_a_closed_form():
    scene = js.load("table1", [*STUCK, 'parts.contact="stuck"']).scene
    for verb in (js.simulate, js.orbit, js.lyapunov):
        with pytest.raises(InputError, match="closed form"):
            verb(scene)
    with pytest.raises(InputError, match="linear"):
        js.power(js.load("table1", ['parts.contact="none"']).scene, linear="stuck", **SHORT)


@pytest.mark.full
def test_with_torsion_the_error_falls_with_the_loads():
    errors = []
    for size in (1.0, 0.1):
        settings = [
            f"drive.F_0={2 * size}",
            f"drive.M_0={0.02 * size}",
            f"shroud.gap={-0.4e-3 * size}",
            "friction.mu=0.9",
        ]
        scene = js.load("table1_points", [*settings, "initial.start=static"]).scene
        marched = js.power(
            scene, n_periods=2, transient=250, method=js.RungeKutta("dopri8", steps=1600), amplitudes=True
        )
        found = closed(scene)
        pair = [numbers(one, "x_rms", "theta_rms") for one in (found, marched)]
        errors.append(np.max(np.abs(pair[0] / pair[1] - 1)))
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("verb", ["power", "gradient"])
@pytest.mark.full
def test_nothing_is_solved_within_compiled_programs(verb, monkeypatch):
    # Those of jaxlib that solve many systems at once may wait for each other without end, as for 60 blades they did.
    def refuse(*_):
        raise AssertionError

    monkeypatch.setattr(jax.numpy.linalg, "solve", refuse)
    scene = stuck('parts.motion=["x"]')
    if verb == "power":
        assert js.power(scene, **SHORT, linear="stuck").final["status"] == Status.OK
    else:
        assert js.gradient(scene, ["contact.gamma"], of="P", linear="stuck").kind == "periodic"


@pytest.mark.full
def test_a_tuned_ring_swings_as_the_smallest_ring_that_does():
    settings = ["row.blades=4", "drive.engine_order=2", 'parts.motion=["x"]', "shroud.gap=-0.4 mm", "drive.F_0=2"]
    ring = in_state(js.load("row_ring12", settings).scene, "stuck")
    scenes = js.scenes_from({"drive.omega": [500.0, 900.0]}, ring)
    own, whole = settled_linear_motions(scenes), linear_motions(scenes, held_contact(scenes, "stuck"))
    for name in ("displacement", "power", "second", "highest", "N", "N_max", "F_max"):
        one, other = getattr(own, name), getattr(whole, name)
        assert one.shape == other.shape
        assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())  # rounding
    assert_allclose(own.margins.slip, whole.margins.slip, rtol=1e-12)


@pytest.mark.full
def test_a_closed_form_in_all_directions_is_computed_once():
    told = []
    found = js.sweep(
        stuck(),
        {"drive.omega": [500.0, 900.0]},
        direction="both",
        linear="stuck",
        progress=lambda done, of: told.append((done, of)),
        **SHORT,
    )
    assert told[-1] == (2 * SHORT["n_periods"],) * 2
    assert (np.asarray(found.status) == Status.OK).all()
    assert np.ptp(found.P_d_vibration, axis=0).max() == 0


# Faces are open above 300 rpm sqrt(5 / 65), and asked for at 286 and 430 rpm.
UNTWIST = ["shroud.gap=-5um", "shroud.gap_at=60um", "shroud.gap_at_speed=300 rpm", "drive.engine_order=2"]
SPEEDS = {"drive.omega": [60.0, 90.0]}


@pytest.mark.full(but=["power"])
@pytest.mark.parametrize(
    "run",
    [
        lambda scene: js.sweep(scene, SPEEDS, linear="stuck"),
        lambda scene: js.response(scene, "drive.omega", 60.0, 90.0, num=3, linear="stuck"),
        lambda scene: js.tune(scene, {"friction.mu": (0.1, 0.2)}, conditions=SPEEDS, linear="stuck"),
        lambda scene: js.power(scene, linear="stuck"),
        lambda scene: js.gradient(scene, ["friction.mu"], linear="stuck"),
        lambda scene: js.table(scene, {"friction.mu": [0.1, 0.2]}, linear="stuck"),
        lambda scene: js.scatter(scene, {"friction.mu": 0.1}, draws=4, linear="stuck"),
    ],
    ids=["sweep", "response", "tune", "power", "gradient", "table", "scatter"],
)
def test_faces_that_open_at_rest_are_refused_with_the_speed_above_which(run):
    with pytest.raises(InputError, match=r"not pressed together above 83\.205 rpm") as error:
        run(stuck(*UNTWIST))
    assert "\n" not in str(error.value)


@pytest.mark.full
def test_what_no_scene_keeps_at_rest_is_refused(tmp_path, capsys):
    open_pair, pressed_pair = (js.load("table1", [*STUCK, gap]).scene for gap in ("shroud.gap=10um", STUCK[0]))
    with pytest.raises(InputError, match="does not keep its faces stuck: at rest they are not pressed together; "):
        js.power(open_pair, linear="stuck")
    with pytest.raises(InputError, match="apart: at rest they are pressed together"):
        js.power(pressed_pair, linear="apart")
    gaps = {"shroud.gap": [-4e-4, 1e-5]}  # one of two is enough
    with pytest.warns(js.LaneWarning, match="1 of 2"):
        assert js.sweep(pressed_pair, gaps, linear="stuck", **SHORT).status.tolist() == [Status.OK, Status.NOT_LINEAR]
    words = ["sweep", "table1", "--along", "shroud.gap", "--values", "1e-5,2e-5", "--linear", "stuck"]
    sets = [word for setting in STUCK for word in ("--set", setting)]
    assert cli.main([*words, "--out", str(tmp_path / "out"), *sets]) == 2
    assert "None of 2 scenes keeps its faces stuck" in capsys.readouterr().err


@pytest.mark.full
def test_a_tuning_that_no_design_survives_ends_after_its_scan():
    small = js.SearchOptions(4, 1, 1)
    with pytest.raises(InputError, match="No design of the scan keeps its contact stuck"):
        js.tune(stuck("drive.F_0=400"), {"contact.gamma": (1.0, 4.0)}, linear="stuck", search=small, **SHORT)
