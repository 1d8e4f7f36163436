"""The vibration about the mean position, and means over whole orbits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import one_lane
from jaxshroud.march.method import FAST, FOR_P_D, Taylor, choices
from jaxshroud.scene.scene import without_given
from jaxshroud.signals.averages import Positions, averages, square_about_mean
from jaxshroud.signals.effects import mean_shift_text
from jaxshroud.verbs.gradient import differences

PRESSED = """
[blades]
m = 1.0
I = 1.0
k_x = 1e3
k_y = 1e3
k_T = 1.0
c_x = 5.0
c_y = 2.0
c_T = 0.0
[shroud]
alpha = "90 deg"
l_oa = 0.05
l_ab = 0.035
gap = "-1 mm"
[contact]
k = 5e3
[friction]
k_d = 1e4
mu = 50.0
[drive]
omega = 40.0
beta = "90 deg"
F_0 = 0.5
M_0 = 0.0
phase = ["0 deg", "180 deg"]
[parts]
motion = ["x", "y"]
[run]
periods = 8
transient = 200
"""  # pressed together by 1 mm, and driven along y only
SHORT = {"n_periods": 8, "transient": 200, "method": js.RungeKutta("dopri8", steps=100, locate="cubic")}


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "pressed.toml"
    path.write_text(PRESSED)
    return lambda *sets: js.load(path, list(sets)).scene


def stuck_reduction(scene) -> float:
    """P_d of the vibration of the stuck pair: x at rest, y a linear oscillator with k_d between the blades [%]."""
    b, omega, k_d = scene.blades, float(scene.drive.omega), float(scene.friction.k_d)
    k, m, c = (float(np.ravel(a)[0]) for a in (b.k_y, b.m, b.c_y))
    # opposite phases: both blades move against each other, and the spring k_d feels twice the displacement of one
    amplitude = float(scene.drive.F_0[0]) / np.hypot(k + 2 * k_d - m * omega**2, c * omega)
    free = float(scene.drive.F_0[0]) / np.hypot(k - m * omega**2, c * omega)
    return 100 * (1 - (amplitude / free) ** 2)


@pytest.mark.release
@pytest.mark.full
def test_a_mean_shift_is_no_vibration(pressed):
    # Stuck, the pair is linear: x rests at its static deflection, y vibrates with k_d as a spring. The transient leaves
    # exp(-c_x/2 200 T) of itself. P_d of Eq. (22) is 60 points lower, which the means within each period would not be.
    scene = pressed()
    run = js.sweep(scene, {"friction.mu": [50.0, 0.3]}, **SHORT)
    assert run.P_d_vibration[0] == pytest.approx(stuck_reduction(scene), abs=1e-6)
    assert_allclose(run.P_d, [39.2797, -46.3774], atol=1e-3)
    assert_allclose(run.P_d_vibration, [99.9026, 14.1846], atol=1e-3)
    assert np.all(run.P_d_vibration_ci < 1e-6)  # orbits of period 1
    final = js.power(scene, **SHORT).final
    assert_allclose([final["P_d"], final["P_d_vibration"]], [run.P_d[0], run.P_d_vibration[0]], rtol=1e-9)


def square_series(random: np.random.Generator) -> tuple[np.ndarray, Positions, np.ndarray]:
    """Mean squares and positions of 6 periods of 50 samples that wander, and the samples (3, 6, 50)."""
    samples = 0.1 * random.standard_normal((3, 6, 50)) + random.standard_normal((3, 6, 1)) + np.ones((3, 1, 1))
    (x, y, theta), J = samples, 0.3
    parts = [a.mean(axis=-1)[None, :, None] for a in (x, y, np.sin(theta), 1 - np.cos(theta))]
    square = (x**2 + y**2 + 2 * J * (1 - np.cos(theta))).mean(axis=-1)[None, :, None]
    return square, Positions(*parts, np.array([J])), samples


def test_means_are_over_all_periods_never_within_each():
    # <x^2> - <x>^2 and the rotation 2 J (1 - R) about the mean direction, in closed form from the samples; rounding.
    # Means within each period would call what wanders from period to period static: control, off by 30 % and more.
    square, positions, (x, y, theta) = square_series(np.random.default_rng(3))
    J = float(positions.gyration[0])
    of = lambda axis: x.var(axis=axis) + y.var(axis=axis) + 2 * J * (1 - np.abs(np.exp(1j * theta).mean(axis=axis)))
    found = float(square_about_mean(square, positions).mean())
    assert found == pytest.approx(float(of(None)), rel=1e-12)
    assert float(of(-1).mean()) < 0.7 * found


@pytest.mark.release(only=["method0", "method2"])
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(Taylor(), marks=pytest.mark.full),
        pytest.param(js.RungeKutta(steps=400), marks=pytest.mark.full),
        js.RungeKutta("tsit5", 400),
    ],
)
def test_the_mean_position_is_that_of_the_samples(method):
    # A rubbing pair with torsion over three periods from rest, against the mean of 2,000 samples a period by the
    # trapezoidal rule, whose error is below 1e-8. Sums over the ends of steps leave 3e-6 of the largest displacement.
    scene = js.load("table1", ["contact.gamma=5.5", "drive.M_0=20"]).scene
    scenes, steps = one_lane(without_given(scene)), 400 if isinstance(method, Taylor) else method.steps
    plan = Plan(0, 3, steps, 0.0, choices(method)._replace(vibration=True))
    means = run_lanes(scenes, initial_states(scenes), plan, lambda _: None).samples.means
    fine = js.RungeKutta("dopri8", steps=2000, locate="cubic")
    motion = js.simulate(scene, n_periods=3, every=1, method=fine).motion
    x, y, theta = (np.asarray(a)[:, 0] for a in (motion.x, motion.y, motion.theta))
    for found, exact in zip(means, (x, y, np.sin(theta), 1 - np.cos(theta)), strict=True):
        expected = (exact.sum() - (exact[0] + exact[-1]) / 2) / (len(exact) - 1)
        assert float(found[0].mean()) == pytest.approx(expected, abs=3e-6 * np.abs(exact).max())


@pytest.mark.full
def test_power_alone_is_unchanged():
    # What is kept beside the power changes no bit of the motion or of P_d.
    scenes = one_lane(without_given(js.load("table1").scene))
    runs = [
        run_lanes(scenes, initial_states(scenes), Plan(0, 3, 100, 0.0, one), lambda _: None) for one in (FAST, FOR_P_D)
    ]
    assert_array_equal(*(run.samples.power for run in runs))
    assert runs[0].samples.means is None
    assert np.isnan(averages(scenes, runs[0].samples)[1].P_d_vibration).all()


@pytest.mark.full
def test_interference_that_displaces_a_block_is_told(pressed):
    # By hand: N = 1 mm / (1/k + 2/k_x) and x = N / k_x; y moves freely by F_0 / |k_y - m omega^2|.
    # Control: 1 um of interference displaces the block by a thousandth of that, below a tenth of the free amplitude.
    told = lambda scene: [line for line in js.check(scene).doubts if "interference alone displaces" in line]
    (line,) = told(pressed())
    assert f"{1e3 * 1e-3 / (1 / 5e3 + 2 / 1e3) / 1e3:.3g} mm" in line
    assert not told(pressed("shroud.gap=-1um"))
    assert not told(pressed("shroud.gap=1mm"))


@pytest.mark.release
@pytest.mark.full
def test_the_derivative_of_the_vibration_is_exact(pressed):
    # On the orbit of the sliding pair, against fourth-order differences of orbits followed from scene to scene; the
    # method's order leaves 1e-6 of the derivative. Control: that of P_d, which the deflection changes, is another.
    scene, method = pressed("friction.mu=0.3"), js.RungeKutta("dopri8", steps=100)
    found = js.orbit(scene, method=method)
    keys = ["friction.mu", "contact.k", "shroud.gap"]
    exact = js.gradient(scene, keys, of="P_d_vibration", orbit=found)
    assert found.P_d_vibration == pytest.approx(exact.level, abs=1e-9)
    by_differences = differences(found, keys, 1e-3, of="P_d_vibration")
    for key in keys:
        assert exact.value[key] == pytest.approx(by_differences[key], rel=1e-5), key
    assert exact.level == pytest.approx(14.1846, abs=1e-3)
    of_P_d = js.gradient(scene, keys, orbit=found)
    assert of_P_d.level == pytest.approx(-46.3774, abs=1e-3)
    assert abs(of_P_d.value["shroud.gap"] / exact.value["shroud.gap"] - 1) > 0.1
    assert of_P_d.P_d_vibration == pytest.approx(exact.level, abs=1e-9)
    assert "--of P_d_vibration counts that" in of_P_d.mean_shift
    assert "P_d_vibration counted" in exact.mean_shift


NEAR = {"start": 0.49, "stop": 0.5, "most_points": 3}
TELLING = {
    "orbit": lambda scene, how: js.orbit(scene, method=how["method"]),
    "branch": lambda scene, how: js.branch(scene, "drive.F_0", **NEAR, method=how["method"]),
    "attractors": lambda scene, how: js.attractors(scene, 4, most_periods=256, method=how["method"]),
    "diagnose": lambda scene, how: js.diagnose(scene, transient=how["transient"], method=how["method"]),
    "scatter": lambda scene, how: js.scatter(scene, {"contact.k": 1.0}, draws=4, **how),
}


@pytest.mark.release(only=["attractors", "diagnose", "scatter"])
@pytest.mark.full
@pytest.mark.parametrize("verb", TELLING)
def test_who_tells_the_reduction_tells_that_of_the_vibration(pressed, verb):
    # Stuck, which is linear: the reduction does not depend on the force either.
    scene = pressed()
    found = TELLING[verb](scene, SHORT)
    told = np.ravel(found.P_d_vibration)
    assert_allclose(told, stuck_reduction(scene), atol=2e-6)
    assert np.all(np.abs(told - np.ravel(found.P_d)[-1]) > 50)


@pytest.mark.release
@pytest.mark.full
def test_the_vibration_can_be_tuned(pressed):
    # Exact slopes of the search are the differences of the judged designs; the best design tells both reductions.
    run = {"n_periods": 4, "transient": 40, "method": js.RungeKutta("dopri8", steps=100)}
    small = {"search": js.SearchOptions(4, 1, 1), "of": "P_d_vibration"}
    found = js.tune(pressed(), {"friction.mu": (0.2, 0.5)}, **small, **run)
    assert found.level == pytest.approx(found.best_P_d_vibration[0], abs=1e-9)
    assert "P_d_vibration counted" in found.mean_shift


def test_what_differs_is_told():
    said = mean_shift_text(39.3, 99.9, option="--of ")
    assert "39.3 % where vibration alone is reduced by 99.9 %; --of P_d_vibration counts that" in said
    assert "99.9 % (the largest difference, run 1); P_d" in mean_shift_text([1.0, 39.3], [1.5, 99.9])
    assert "-714.6 % where vibration alone grows by 708.0 %" in mean_shift_text(-714.6, -708.0)
    assert mean_shift_text(39.3, 39.9) == mean_shift_text(39.3, None) == mean_shift_text(np.nan, np.nan) == ""


PERIOD_7 = [
    "shroud.gap=2.33007955e-05",
    "contact.gamma=9.905025551416792",
    'contact.reading="printed"',
    "drive.F_0=11.767671079584618",
    "drive.M_0=0.6486800852674741",
    "blades.c_x=3.57",
    "blades.c_y=19.6",
]


@pytest.mark.release
@pytest.mark.full
def test_means_are_over_whole_orbits():
    # An orbit of period 7: means, maxima and shares of 9 orbits do not depend on the period that 64 have more. The run
    # is settled to 1e-9. Over all 64 the mean force would be 0.5 % and the impacts 0.4 % off.
    scene = js.load("table1", PERIOD_7).scene
    run = {"transient": 600, "method": "balanced", "forces": True}
    whole, more = (js.sweep(scene, {"drive.F_0": [float(scene.drive.F_0[0])]}, n_periods=n, **run) for n in (63, 64))
    assert whole.period_number[0] == more.period_number[0] == 7
    for name in ("N_mean", "N_max", "friction_work", "slip", "impacts", "time_apart", "time_slip", "P_d_vibration"):
        assert_allclose(getattr(more, name), getattr(whole, name), rtol=1e-7, err_msg=name)
    assert_allclose([more.N_mean[0], more.friction_work[0]], [42.3772, 0.103359], rtol=1e-5)
    assert 7 * more.impacts[0] == pytest.approx(23, rel=1e-12)
