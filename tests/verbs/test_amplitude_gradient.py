"""Derivatives of amplitudes on orbits and in neighbourhoods, and amplitudes as what is tuned and scatters."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

import jaxshroud as js
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST
from jaxshroud.orbits import amplitude_slopes
from jaxshroud.orbits.batched_algorithms import stacked
from jaxshroud.orbits.gradient import smoothed_gradient, with_numbers
from jaxshroud.signals.amplitudes import free_level
from jaxshroud.verbs.design_problem import judge_designs, problem_of
from jaxshroud.verbs.gradient import differences
from jaxshroud.verbs.gradient_ascent import exact_slopes
from jaxshroud.verbs.tune import problem_from_result

pytestmark = pytest.mark.full

# The march finds extremes by cubics between steps, whose error falls as the fourth power of the step: it is small here.
FINE = js.RungeKutta(steps=1600)
SHORT = {"n_periods": 4, "transient": 16, "method": js.RungeKutta(steps=100)}
KEYS = ["shroud.gap", "contact.gamma", "drive.omega"]
MEASURES = ("x_mean", "x_rms", "x_peak")


def scene_at(*overrides):
    return js.load(
        "table1", ['parts.motion=["x"]', "blades.c_x=40", "contact.gamma=2.5", "drive.F_0=60", *overrides]
    ).scene


def quiet(_):
    pass


@pytest.fixture(scope="module")
def found():
    return js.orbit(scene_at(), method=FINE)


def slopes(found, of, keys=KEYS):
    return js.gradient(found.cycle().scene, keys, of=of, orbit=found)


def error(found, of, value):
    """The largest relative difference from differences of the march's own amplitudes on the orbits of nearby scenes."""
    quotient = differences(found, list(value), 1e-4, of)
    return max(abs(quotient[key] / slope - 1) for key, slope in value.items())


@pytest.mark.release
@pytest.mark.parametrize("of", MEASURES)
def test_derivatives_are_those_of_differences(found, of):
    exact = slopes(found, of)
    assert error(found, of, exact.value) < 1e-6
    assert (exact.kind, exact.flags) == ("periodic", ())
    assert exact.level == pytest.approx(
        float(getattr(js.orbit(scene_at(), method=FINE, amplitudes=True), of)[0]), rel=1e-7
    )


def test_the_mean_and_the_time_of_the_peak_count(found, monkeypatch):
    peak, mean = (slopes(found, of).value for of in ("x_peak", "x_mean"))
    # Controls: the derivative of the extreme alone, and the derivative a hundredth of a period after the extreme.
    for side in (1, -1):
        assert error(found, "x_peak", {key: peak[key] + side * mean[key] for key in KEYS}) > 0.1
    true_place = amplitude_slopes.turning_points
    late = lambda *args: [e._replace(turns=e.turns + 0.01) for e in true_place(*args)]
    monkeypatch.setattr(amplitude_slopes, "turning_points", late)
    monkeypatch.setattr(amplitude_slopes, "MAX_SECANTS", 0)
    assert error(found, "x_peak", slopes(found, "x_peak").value) > 1e-3


def test_where_the_search_for_a_peak_begins_does_not_count(found, monkeypatch):
    # A phase moves the motion in time before all: the rate's derivative is large beside that of the peak.
    true_place, exact = amplitude_slopes.turning_points, slopes(found, "x_peak", ["drive.phase[0]", *KEYS]).value
    for shift in (8e-10, -8e-10, 1e-6):
        moved = lambda *args, by=shift: [e._replace(turns=e.turns + by) for e in true_place(*args)]
        monkeypatch.setattr(amplitude_slopes, "turning_points", moved)
        assert slopes(found, "x_peak", list(exact)).value == pytest.approx(exact, rel=1e-10, abs=0)


def test_amplitudes_without_contact_are_proportional_to_the_load():
    # Of a sinusoid the peaks on both sides of the mean tie, but move as one: no flag.
    apart = js.orbit(scene_at("shroud.gap=1"), method=FINE)
    peak, rms = (slopes(apart, of, ["drive.F_0", "shroud.gap"]) for of in ("x_peak", "x_rms"))
    assert peak.flags == ()
    # RK4's amplitude at 1600 steps is off by 1e-11.
    assert peak.level == pytest.approx(np.sqrt(2) * rms.level, rel=1e-9)
    for found in (peak, rms):
        assert found.value["drive.F_0"] == pytest.approx(found.level / 60, rel=1e-9)
        assert found.value["shroud.gap"] == 0


def excess(omega):
    """How much farther from the mean the largest x of an orbit is than the smallest, over their distance."""
    cycle = js.orbit(scene_at(f"drive.omega={omega!r}"), method=FINE).cycle()
    plan = Plan(0, 1, 1600, 0.0, FAST._replace(amplitudes=True))
    samples = run_lanes(*stacked([(cycle.scene, cycle.start)]), plan, quiet).samples
    mean = samples.moments.first[0][0, 0, 0] * omega / (2 * np.pi)
    high, low = (end[0][0, 0, 0] for end in (samples.extent.highest, samples.extent.lowest))
    return (high + low - 2 * mean) / (high - low)


def test_a_tie_of_two_peaks_is_flagged():
    tied = float(brentq(excess, 820, 870, xtol=1e-6))  # pyright: ignore[reportArgumentType]
    near = [
        slopes(js.orbit(scene_at(f"drive.omega={w!r}"), method=FINE), "x_peak", KEYS[2:])
        for w in (tied - 0.01, tied, tied + 0.01)
    ]
    assert [one.flags for one in near] == [(), ("two peaks",), ()]
    below, at, above = (one.value["drive.omega"] for one in near)
    assert abs(below / above - 1) > 0.1  # a kink
    assert min(abs(at / below - 1), abs(at / above - 1)) < 1e-3  # the slope of one side, 0.01 rad/s away
    assert any(np.diff([a.level, b.level]) == pytest.approx(0.01 * at, rel=1e-3) for a, b in pairwise(near))


def test_many_scenes_are_each_alone():
    gaps = [1e-5, 3e-5]
    together = js.gradient(js.scenes_from({"shroud.gap": gaps}, scene_at()), KEYS, of="x_peak", method=FINE)
    for i, gap in enumerate(gaps):
        alone = js.gradient(scene_at(f"shroud.gap={gap}"), KEYS, of="x_peak", method=FINE)
        for key in KEYS:
            assert together.value[key][i] == pytest.approx(alone.value[key], rel=1e-9)


def test_the_smoothed_gradient_of_an_amplitude_tends_to_the_exact_one(found):
    scene, keys = with_numbers(scene_at(), KEYS[:1]), KEYS[:1]
    plan = Plan(64, 4, 1600, 0.0, FAST)
    for of in ("x_rms", "x_peak"):
        exact = slopes(found, of, keys).value["shroud.gap"]
        got = smoothed_gradient(scene, keys, of, found.cycle(), 1e-4, 8, plan, 0)
        assert got.value[0] == pytest.approx(exact, rel=1e-5)  # curvature across the neighbourhood


@pytest.mark.parametrize("of", ["x_rms", "x_mean", "P"])
def test_exact_slopes_of_a_tuning_are_those_of_its_objective(of):
    plan = Plan(64, 4, 400, 0.0, FAST._replace(amplitudes=of != "P"))
    problem = problem_of(scene_at(), {"shroud.gap": (1e-5, 4e-5)}, {"drive.F_0": (40.0, 60.0)}, of=of)._replace(
        plan=plan
    )
    u, h = np.array([[0.4]]), 1e-4
    ahead, behind = (judge_designs(problem, problem.values(u + s), quiet).P_d[0] for s in (h, -h))
    slope, growth = exact_slopes(problem, u, quiet)
    # Second-order differences across 1e-4 of the cube.
    np.testing.assert_allclose(slope[0, :, 0], (ahead - behind) / (2 * h), rtol=1e-4)
    assert growth.max() < 1


@pytest.mark.release
def test_an_amplitude_is_tuned(reopened):
    scene, conditions, over = scene_at(), {"drive.F_0": [40.0, 60.0]}, {"shroud.gap": (5e-6, 2e-4)}
    search = js.SearchOptions(scan=4, n_starts=1, updates=2)
    tuned = js.tune(scene, over, conditions=conditions, of="x_peak", search=search, loss=2.0, **SHORT)
    best = js.vary(scene, "shroud.gap", tuned.design["shroud.gap"])
    swept = js.sweep(best, conditions, amplitudes=True, **SHORT)
    # The quantity of the design, by another verb; rounding in 100 (1 - level / free).
    assert tuned.level == pytest.approx(swept.x_peak[:, 0].mean(), rel=1e-9)
    assert tuned.level <= tuned.levels(tuned.scanned_scores).min()
    assert tuned.motions is None
    again = reopened(tuned)
    assert repr(again) == repr(tuned)
    assert (again.summary()["of"], again.summary()["level"]) == ("x_peak", tuned.level)
    problem = problem_from_result(again)  # rebuilt from the file, it judges alike
    assert judge_designs(problem, tuned.best[None], quiet).objective[0] == tuned.objective
    assert tuned.plot() is not None
    assert tuned.plot(panel="robust") is not None


def test_turning_without_a_torque_is_compared_with_what_the_forces_move():
    # Without a torque the blade would not turn at all; its corners move by half the longer diagonal per radian.
    turning = js.load("table1", ["drive.M_0=0"]).scene
    a, b, alpha = (float(getattr(turning.shroud, name)) for name in ("l_oa", "l_ab", "alpha"))
    diagonal = np.sqrt(a**2 + b**2 + 2 * a * b * abs(np.cos(alpha)))
    of_block = np.hypot(free_level("x_rms", turning), free_level("y_rms", turning))
    assert of_block / free_level("theta_rms", turning) == pytest.approx(diagonal / 2)


def test_draws_of_an_amplitude_are_the_sweep_of_their_numbers(reopened):
    over = {"shroud.gap": (1e-5, 3e-5), "friction.mu": (0.2, 0.4)}
    conditions = {"drive.F_0": [30.0, 60.0]}
    found = js.scatter(scene_at(), over, of="x_peak", conditions=conditions, draws=4, **SHORT)
    numbers = {key: found.drawn[:, i] for i, key in enumerate(found.keys)}
    alone = [js.sweep(js.scenes_from(numbers, scene_at(f"drive.F_0={F}")), amplitudes=True, **SHORT) for F in (30, 60)]
    np.testing.assert_array_equal(found.level, np.maximum(*(one.x_peak[:, 0] for one in alone)))
    np.testing.assert_array_equal(found.P_d, np.minimum(*(one.P_d for one in alone)))
    assert found.median == np.median(found.level)
    assert repr(reopened(found)) == repr(found)
    assert " m, nine in ten" in repr(found)
    assert found.summary()["of"] == "x_peak"
    assert found.plot().axes[0].get_xlabel() == r"$x_\mathrm{peak}$ [mm]"


@pytest.mark.parametrize("verb", [js.scatter, js.tune])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"of": "y_peak"}, "do not move in y"),
        ({"of": "x_peek"}, "Argument `of`"),
        ({"of": "x_peak", "at_least": 3.0}, "`at_least` is a P_d"),
    ],
)
def test_wrong_quantities_are_told(verb, options, words):
    with pytest.raises(ValueError, match=words):
        verb(scene_at(), {"shroud.gap": (5e-6, 2e-4)}, **options)
    if "at_least" not in options:
        with pytest.raises(ValueError, match=words):
            js.gradient(scene_at(), ["shroud.gap"], **options)


def test_of_levels_that_tie_the_one_counts_that_rises_most():
    # The largest of a + 2 d, a - 3 d rises by 3 on the left side of d = 0; to the right of it by 2 only.
    found = amplitude_slopes.largest_level(
        [(1.0, np.array([2.0, 1.0])), (1.0, np.array([-3.0, 4.0])), (0.5, np.array([9.0, 9.0]))], "tie"
    )
    assert found.slope.tolist() == [-3.0, 4.0]
    assert found.flags == ("tie",)
    alike = amplitude_slopes.largest_level([(1.0, np.array([2.0])), (1.0, np.array([2.0]))], "tie")
    assert (alike.slope.tolist(), alike.flags) == ([2.0], ())
