"""Fits to measurements: exact slopes, numbers that are found again, and what cannot be fitted, in one line."""

import json

import numpy as np
import pytest
from command_line import read_json, refused, run
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.io.measurements import measurements_from
from jaxshroud.march.method import FAST
from jaxshroud.scene.scene import without_given
from jaxshroud.verbs.arguments import plan_march, resolve_options
from jaxshroud.verbs.fit import fit_problem
from jaxshroud.verbs.fit_models import HistoryModel, ResponseModel

STEPS = 200
HOW = js.RungeKutta(steps=STEPS)
SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
OVER = {"contact.gamma": (1.0, 6.0), "shroud.gap": (1e-5, 6e-5), "blades.c_x": (20.0, 80.0)}
TRUTH = {"contact.gamma": 2.5, "shroud.gap": 2.2e-5, "blades.c_x": 40.0}
OVER_MU = {"friction.mu": (0.1, 1.0)}
PERIODS = 3


def history(scene, every=10, noise=0.0, seed=0):
    """What is measured of x of both blades, at times between the steps of the march."""
    twin = js.simulate(scene, n_periods=PERIODS, every=every, method=js.RungeKutta("rk4", steps=7 * STEPS))
    x = twin.motion.x
    x = 1e3 * (x + noise * np.sqrt(np.mean(x**2)) * np.random.default_rng(seed).standard_normal(x.shape))
    return {"t [ms]": 1e3 * twin.t, "x_left [mm]": x[:, 0], "x_right [mm]": x[:, 1]}


def choices_of(scene):
    resolved = resolve_options(scene, method=HOW)
    return plan_march(resolved, resolved.lanes, FAST, tangents=True).method


def quotients(model, u, step):
    """Fourth-order central differences of a model's values along each number of the cube."""
    offsets, weights = np.array([-2, -1, 1, 2]), np.array([1, -8, 8, -1]) / 12 / step
    rows = [u + step * offset * unit for unit in np.eye(len(u)) for offset in offsets]
    values = np.concatenate([model(row[None])[0] for row in rows])
    return np.einsum("koin,o->ink", values.reshape(len(u), 4, *values.shape[1:]), weights)


def error(found, exact):
    """The largest error of slopes, over the largest slope of each number."""
    return np.max(np.abs(found - exact) / np.max(np.abs(exact), axis=(0, 1)))


@pytest.mark.full
def test_slopes_of_a_history_are_those_of_its_values():
    over = {**OVER, "drive.omega": (400.0, 700.0), "initial.x[0]": (-1e-5, 1e-5), "friction.mu": (0.2, 0.6)}
    data = measurements_from(history(SCENE, every=97))
    problem = fit_problem(SCENE, data, over)
    model = HistoryModel(problem, data, STEPS, choices_of(SCENE), 2 * np.pi / 700)
    u = np.full(len(over), 0.45)
    slopes = model(u[None])[1][0]
    exact = quotients(model, u, 1e-4)
    # Differences of a motion with events, whose second derivatives jump: some 1e-6 of the slopes are left.
    assert error(slopes, exact) < 1e-5
    assert error(model(u[None] + 0.02)[1][0], exact) > 1e-2  # control: slopes a fiftieth of the range away


def response(scene, omegas):
    """Amplitudes of the left blade on the orbits of a scene, by the verb that measures them from its own march."""
    found = js.orbit(js.scenes_from({"drive.omega": omegas}, scene), method=HOW, amplitudes=True)
    measured = {f"x_{of}_left [mm]": 1e3 * getattr(found, f"x_{of}")[:, 0] for of in ("rms", "peak")}
    return {"omega [rad/s]": omegas, **measured}


OMEGAS = [480.0, 536.0, 620.0]


@pytest.mark.full
def test_a_scene_given_by_frequencies_is_fitted_like_one_of_numbers():
    given = js.load("engine_order", ['parts.motion=["x"]']).scene
    run = js.simulate(given, n_periods=1, every=20, method=HOW)
    data = measurements_from({"t [s]": run.t, "x_left [m]": run.motion.x[:, 0]})
    models = [
        HistoryModel(
            fit_problem(scene, data, OVER_MU), data, STEPS, choices_of(scene), 2 * np.pi / float(scene.drive.omega)
        )
        for scene in (given, without_given(given))
    ]
    u = np.array([[0.4]])
    for of_given, of_numbers in zip(*(model(u) for model in models), strict=True):
        assert_array_equal(of_given, of_numbers)


@pytest.mark.full
def test_slopes_of_a_response_are_those_of_orbits():
    data = measurements_from(response(SCENE, OMEGAS))
    problem = fit_problem(SCENE, data, OVER)
    model = ResponseModel(problem, data, STEPS, choices_of(SCENE), 512)
    u = problem.cube(np.array([list(TRUTH.values())]))[0]
    values, slopes = (a[0] for a in model(u[None]))
    # The same from moments and extremes kept in the march; between samples the cubic errs by some 1e-6.
    assert_allclose(values, data.values, rtol=1e-5)
    exact = quotients(model, u, 1e-4)
    assert error(slopes, exact) < 1e-5
    assert error(model(u[None] + 0.02)[1][0], exact) > 1e-2  # control


@pytest.mark.full
def test_numbers_are_found_again_in_a_history():
    # Without noise what is left is the error of the march, RK4 at 200 steps against 1400: 1e-5 in these numbers.
    found = js.fit(SCENE, history(SCENE), OVER, scan=16, starts=2, method=HOW)
    assert_allclose(list(found.value.values()), list(TRUTH.values()), rtol=1e-3)
    noisy = js.fit(SCENE, history(SCENE, noise=0.02), OVER, scan=16, starts=2, method=HOW)
    assert all(abs(noisy.value[key] / value - 1) > 1e-4 for key, value in TRUTH.items())  # control: noise tells
    assert noisy.failed == 0
    assert not noisy.sigma_is_known


@pytest.mark.full
def test_steps_that_err_more_than_the_noise_are_refined():
    # Noise of 1e-4, of which RK4 at the fewest steps errs by more.
    found = js.fit(SCENE, history(SCENE, noise=1e-4), OVER, scan=16, starts=2, method=js.RungeKutta(steps=64))
    assert found.steps_per_period == 4 * 102  # the fewest between whose samples a cubic is accurate, refined
    assert all(number.is_determined for number in found.numbers.values())
    # Three intervals of 95 % hold the truth; a tenth of their half widths is what the march may err.
    assert all(
        n.low - 0.05 * (n.high - n.low) <= TRUTH[key] <= n.high + 0.05 * (n.high - n.low)
        for key, n in found.numbers.items()
    )


@pytest.mark.full
def test_numbers_are_found_again_in_a_response():
    over = {"contact.gamma": (1.0, 6.0), "blades.c_x": (20.0, 80.0)}
    found = js.fit(SCENE, response(SCENE, OMEGAS), over, scan=4, starts=1, method=HOW)
    assert_allclose(list(found.value.values()), [2.5, 40.0], rtol=1e-3)  # as above
    assert found.data_kind == "response"


@pytest.mark.full
def test_numbers_of_faces_with_points_are_found_again_in_a_history():
    scene = js.load("table1_points").scene
    run = js.simulate(scene, n_periods=1, every=20, method=js.RungeKutta("rk4", steps=7 * STEPS))
    data = {"t [s]": run.t, "x_left [m]": run.motion.x[:, 0], "theta_left [rad]": run.motion.theta[:, 0]}
    over = {"contact.gamma": (1.5, 4.0), "friction.mu": (0.2, 0.9)}
    found = js.fit(scene, data, over, method=HOW, starts=4, seed=1)
    for key, true in (("contact.gamma", js.value_of(scene, "contact.gamma")), ("friction.mu", 0.5)):
        assert found.value[key] == pytest.approx(true, rel=1e-3)
    other = js.fit(js.load("table1_points", ["contact.points=3"]).scene, data, over, method=HOW, starts=4, seed=1)
    assert other.chi2 > 10 * found.chi2  # a control: faces of another number of points


@pytest.mark.full
def test_friction_that_always_sticks_is_not_measured():
    stuck = js.vary(SCENE, "friction.mu", 50.0)
    over = {"friction.mu": (20.0, 80.0), "blades.c_x": (20.0, 80.0)}
    found = js.fit(stuck, history(stuck, noise=0.01), over, scan=4, starts=1, method=HOW)
    assert found.notes == ("the data do not depend on friction.mu here",)
    assert not found.numbers["friction.mu"].is_determined
    assert found.summary()["over"]["friction.mu"]["low"] is None
    assert "(not determined)" in repr(found)
    assert found.numbers["blades.c_x"].holds(40.0)
    alone = js.fit(stuck, history(stuck, noise=0.01), {"friction.mu": (20.0, 80.0)}, scan=4, starts=1, method=HOW)
    assert alone.notes == found.notes


@pytest.mark.full
def test_a_fit_is_stored_and_drawn(reopened):
    found = js.fit(SCENE, history(SCENE, noise=0.02), {"blades.c_x": (20.0, 80.0)}, scan=2, starts=1, method=HOW)
    again = reopened(found)
    assert isinstance(again, js.Fit)
    assert again.numbers == found.numbers
    assert again.summary() == found.summary()
    assert repr(again) == repr(found)
    assert [len(again.plot().axes), len(again.plot(panel="profile blades.c_x").axes)] == [4, 1]
    json.dumps(found.summary(), allow_nan=False)


@pytest.mark.parametrize(
    ("table", "over", "told"),
    [
        ({"t [s]": [0.0], "x_left [m]": [1.0]}, OVER, "1 values cannot determine 3 numbers"),
        ({"t [s]": [0.0, 1.0], "y_left [m]": [1.0, 1.0]}, OVER, "y_left is measured, but does not move"),
        ({"t [s]": [0.0, 1.0], "x_left [m]": [0.0, 0.0]}, {"friction.mu": (0.1, 1.0)}, "x_left is 0 throughout"),
        ({"t [s]": [0.0, 1.0], "x_left [m]": [1.0, 0.0]}, {"friction.mu": (-1.0, 1.0)}, "friction.mu, at its bounds"),
        ({"t [s]": [0.0, 1.0], "x_left [m]": [1.0, 0.0]}, {"friction.mu": (1.0, 0.5)}, "in order"),
        ({"t [s]": [0.0, 1.0], "x_left [m]": [1.0, 0.0]}, {"friction.nu": (0.1, 0.5)}, "no number `friction.nu`"),
        ({"t [s]": [0.0, 1.0], "x_left [m]": [1.0, 0.0]}, {}, "at least one number"),
        ({"f [Hz]": [80.0, 90.0], "x_rms_left [m]": [1.0, 1.0]}, {"drive.omega": (5e2, 6e2)}, "cannot be fitted"),
        ({"t [s]": [0.0, 1e9], "x_left [m]": [1.0, 0.0]}, {"friction.mu": (0.1, 1.0)}, "GiB"),
    ],
)
def test_what_cannot_be_fitted_is_told_in_one_line(table, over, told):
    with pytest.raises(js.InputError, match=told) as error:
        js.fit(SCENE, table, over, method=HOW)
    assert "\n" not in str(error.value)


ASKED = f"--steps-per-period {STEPS} --over blades.c_x=20:80 --scan 2 --starts 1"
SCENE_WORDS = "table1 --set parts.motion=[x] --set blades.c_x=30 --set drive.F_0=60"


@pytest.fixture
def measured(tmp_path):
    """The file of a history of the scene."""
    table = history(SCENE, noise=0.02)
    rows = [",".join(map(repr, row)) for row in np.stack([*table.values()], axis=1).tolist()]
    (tmp_path / "measured.csv").write_text("\n".join([",".join(table), *rows]) + "\n", "utf-8")
    return tmp_path / "measured.csv"


@pytest.mark.full
def test_the_command_writes_the_fit_and_the_scene_that_it_found(measured, tmp_path, capsys):
    out = tmp_path / "fit"
    run(f"fit {SCENE_WORDS} {measured} {ASKED} --out {out}")
    assert "blades.c_x" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"fit.nc", "fit.png", "summary.json", "best.toml"}
    found = js.open(out / "fit.nc")
    assert js.value_of(js.load(out / "best.toml").scene, "blades.c_x") == found.value["blades.c_x"]
    summary = read_json(out / "summary.json")
    assert summary["over"]["blades.c_x"]["value"] == found.value["blades.c_x"]
    assert found.numbers["blades.c_x"].holds(40.0)
    run(f"plot {out}/fit.nc --out {tmp_path}/again.png")


@pytest.mark.parametrize(
    ("change", "words", "told"),
    [
        # What is wrong in the file itself is told by what reads it: tests/io/test_measurements.py.
        (("x_left [mm]", "x_left [kg]"), "", "is a mass, but a length is needed"),
        ((), "--over blades.k_x=-1:1e5", "must be greater than 0"),
        ((), "--over shroud.gap=1kg:2kg", "is a mass, but a length is needed"),
        (("x_right", "y_right"), "", "y_right is measured, but does not move"),
    ],
)
def test_wrong_input_of_the_command_is_one_line(change, words, told, measured, tmp_path, capsys):
    if change:
        measured.write_text(measured.read_text("utf-8").replace(*change), "utf-8")
    assert told in refused(capsys, f"fit {SCENE_WORDS} {measured} {ASKED} {words} --out {tmp_path}/fit")
