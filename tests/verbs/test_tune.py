"""Tuning: slopes, limits, and that the search finds what it should."""

import importlib

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud import load, power, tune, vary
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.march.tableau import tableau
from jaxshroud.model.prepared import initial_state
from jaxshroud.results.tuned import DesignJudgement
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.keys import Motion
from jaxshroud.verbs import gradient_ascent as ascent
from jaxshroud.verbs.design_problem import Problem, judge_designs
from jaxshroud.verbs.gradient_ascent import MAX_GROWTH, exact_slopes
from jaxshroud.verbs.tune import objective_map, problem_from_result

pytestmark = pytest.mark.full

tune_module = importlib.import_module("jaxshroud.verbs.tune")
OVER = {"shroud.gap": (5e-6, 2e-4), "contact.gamma": (0.1, 10.0)}
SEARCH = js.SearchOptions(scan=16, n_starts=2, updates=5)
SHORT = {"search": SEARCH, "n_periods": 16, "transient": 32, "method": js.RungeKutta(steps=100)}


def quiet(_):
    pass


@pytest.fixture(scope="module")
def scene():
    """Bending in x, so much damped that its motion is regular."""
    return load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene


@pytest.fixture(scope="module")
def tuned(scene):
    return tune(scene, OVER, conditions={"drive.F_0": [40.0, 60.0]}, **SHORT)


def problem_of(scene, conditions, goal="mean", **limits):
    bounds = {"most_penetration": np.inf, "most_force": np.inf, **limits}
    return Problem(scene, OVER, conditions, goal, bounds["most_penetration"], bounds["most_force"], PLAN)


PLAN = Plan(128, 16, 200, 0.0, FAST)


def test_paths_never_lose(tuned):
    assert tuned.points.shape == (6, 2, 2)
    assert np.all(np.diff(tuned.scores, axis=0) >= 0)
    assert tuned.objective >= tuned.scanned_scores.max()
    closer = np.concatenate([[tuned.scores[-1].max()], tuned.polished_scores])  # what follows the best path
    assert np.all(np.diff(closer) >= 0)
    assert closer[-1] == tuned.objective
    assert_array_equal(tuned.polished[-1], tuned.best)
    for (low, high), value in zip(OVER.values(), tuned.design.values(), strict=True):
        assert low <= value <= high
    assert tuned.periods <= 2 * (16 + 2 * 6 * 7 + 7 * 8 * 2) * 48


def test_the_objective_is_that_of_single_runs(scene, tuned):
    found = []
    for F_0 in (40.0, 60.0):
        one = vary(scene, "drive.F_0", F_0)
        for key, value in tuned.design.items():
            one = vary(one, key, value)
        found.append(power(one, n_periods=512, transient=128, method=js.RungeKutta(steps=400)).final["P_d"])
    assert tuned.checks["four times as long"].objective[0] == pytest.approx(np.mean(found), abs=0.2)


def test_exact_slopes_are_those_of_the_objective(scene):
    problem = problem_of(scene, {"drive.F_0": (60.0, 80.0)})
    u = np.array([[0.5, 0.3], [0.3, 0.5]])
    slope, growth = exact_slopes(problem, u, quiet)
    assert np.all(growth < MAX_GROWTH)
    for i in range(2):
        h = 1e-4 * np.eye(2)[i]
        up, down = (judge_designs(problem, problem.values(u + s * h), quiet).P_d for s in (1, -1))
        assert_allclose(slope[..., i], (up - down) / 2e-4, rtol=1e-4, atol=1e-3)


def test_chaos_is_noticed():
    # Control: a chaotic design pushes its state apart.
    scene = vary(load("table1", ["drive.M_0=100"]).scene, "contact.gamma", 5.5)
    problem = problem_of(scene, {"drive.F_0": (60.0,)})
    low, high = OVER["contact.gamma"]
    u = np.array([[0.4, np.log(5.5 / low) / np.log(high / low)]])
    assert exact_slopes(problem, u, quiet)[1].min() > MAX_GROWTH


def test_limits_are_kept(scene, tuned):
    force = 0.5 * tuned.checks["four times as long"].force[0]
    held = tune(scene, OVER, conditions={"drive.F_0": [40.0, 60.0]}, most_force=force, **SHORT)
    assert held.feasible
    assert held.checks["four times as long"].force[0] <= 1.001 * force
    assert held.objective < tuned.objective


def test_the_worst_condition_counts(scene):
    conditions = {"drive.F_0": (40.0, 60.0), "friction.mu": (0.3, 0.5, 0.7)}
    worst, mean = (problem_of(scene, conditions, goal) for goal in ("worst", "mean"))
    design = np.array([[5e-5, 1.0]])
    a, b = judge_designs(worst, design, quiet), judge_designs(mean, design, quiet)
    assert a.P_d.shape == (1, 6)
    assert_array_equal(a.P_d, b.P_d)
    assert a.objective[0] == a.P_d.min() < b.objective[0]


def test_map_has_the_objective(tuned):
    drawn = objective_map(tuned, 3)
    assert drawn["objective"].shape == (3, 3)
    corner = np.array([[drawn["first"][2], drawn["second"][0]]])
    assert judge_designs(tuned.problem, corner, quiet).objective[0] == pytest.approx(drawn["objective"][2, 0], rel=1e-9)


def test_scaled_variables():
    problem = problem_of(load("table1").scene, {})._replace(
        over={"shroud.gap": (1e-6, 1e-4), "friction.mu": (0.0, 1.0)}
    )
    assert_allclose(problem.values(np.array([[0.5, 0.5]])), [[1e-5, 0.5]])
    u, h = np.array([[0.3, 0.7]]), 1e-6
    slope = (problem.values(u + h) - problem.values(u - h)) / (2 * h)
    assert_allclose(problem.rates(u), slope, rtol=1e-8)


def test_three_numbers_need_no_power_of_two(scene):
    over = {**OVER, "friction.mu": (0.1, 0.9)}
    small = {**SHORT, "search": SEARCH._replace(scan=6, updates=1), "n_periods": 2, "transient": 2}
    assert tune(scene, over, **small).scanned.shape == (6, 3)


@pytest.mark.parametrize(
    ("over", "more", "told"),
    [
        ({}, {}, "at least one"),
        ({"shroud.gap": (1e-6, np.inf)}, {}, "finite and in order"),
        (OVER, {"conditions": {"shroud.gap": [1e-4]}}, "both tuned and an operating condition"),
        *((OVER, {"most_force": wrong}, "`most_force` must be positive") for wrong in (0.0, -1.0, np.nan)),
        *((OVER, {"most_penetration": wrong}, "`most_penetration` must be positive") for wrong in (0.0, -1.0, np.nan)),
    ],
)
def test_wrong_requests_are_told(scene, over, more, told):
    with pytest.raises(ValueError, match=told):
        tune(scene, over, **more)


TINY_SEARCH = js.SearchOptions(scan=8, n_starts=1, updates=1)
TINY = {"search": TINY_SEARCH, "n_periods": 4, "transient": 4, "method": js.RungeKutta(steps=100)}


def test_designs_that_stop_do_not_spoil_the_search(scene):
    # Most starts are so far out that the squares of the numbers overflow.
    coarse = js.RungeKutta(steps=100, precision="float32")
    search = {**TINY, "search": js.SearchOptions(16, 8, 2), "method": coarse}
    found = tune(scene, {"initial.x[0]": (1e-6, 1e30)}, **search)
    assert np.isneginf(found.scanned_scores).any()
    assert np.all(np.isfinite(found.points))
    assert not np.isnan(found.scores).any()
    assert np.isfinite(found.objective)
    assert found.objective >= found.scanned_scores.max()


def test_an_optimum_at_its_bound_is_told(scene):
    # The stiffer a soft contact, the more vibration it takes out.
    found = tune(scene, {"contact.gamma": (0.01, 0.02)}, **{**TINY, "search": TINY_SEARCH._replace(scan=64)})
    assert found.at_bounds == {"contact.gamma": "upper"}
    assert found.design["contact.gamma"] == pytest.approx(0.02, rel=1e-3)
    assert tune_module._bound(0.5) == 0


@pytest.mark.parametrize("name", TABLEAUS)
def test_no_check_is_coarser_than_the_search(scene, name, monkeypatch):
    plans, nothing = [], DesignJudgement(*[np.zeros(1)] * 7)
    monkeypatch.setattr(ascent, "judge_designs", lambda problem, *_: plans.append(problem.plan) or nothing)
    search = Plan(8, 4, 40, 0.0, FAST._replace(tableau=tableau(name), precision="float32"))
    ascent.verify_design(problem_of(scene, {})._replace(plan=search), np.array([5e-5, 1.0]), 0, quiet)
    assert plans[0].steps_per_period == 80
    assert plans[0].method.precision == "float64"
    assert plans[0].method.flat_return == search.method.flat_return / 4
    assert all(plan.method.tableau.order >= search.method.tableau.order for plan in plans)
    assert all(plan.steps_per_period >= search.steps_per_period for plan in plans)


def test_penetration_within_steps():
    # Between the ends of steps by the cubic through v and v' there: an error of fourth order. At their ends alone, the
    # control, it is of second order at best.
    scenes = scenes_at(load("table1").scene, ["contact.gamma"], np.linspace(0.5, 5, 8)[:, None])
    log = lambda n, method: run_lanes(scenes, initial_states(scenes), Plan(0, 1, n, 0.0, method), quiet).log
    true = log(12800, FAST).v_max
    missed = lambda v: np.abs(v / true - 1).max()
    inside = [missed(log(n, FAST._replace(within=True)).within.v_max) for n in (200, 400)]
    ends = [missed(log(n, FAST).v_max) for n in (200, 400)]
    assert inside[0] < 1e-4 < 1e-3 < ends[0]
    assert inside[1] < inside[0] / 12
    assert ends[1] > ends[0] / 8


def test_a_tuning_comes_back_from_its_file(scene, reopened):
    over = {"shroud.gap": (2e-5, 4e-5), "contact.gamma": (1.0, 2.0)}
    found = tune(scene, over, conditions={"drive.F_0": [40.0, 60.0]}, **TINY)
    back = reopened(found)
    assert repr(back) == repr(found)
    for name in ("design", "over", "conditions", "at_bounds", "confirmed", "feasible", "goal", "periods", "most_force"):
        assert getattr(back, name) == getattr(found, name), name
    assert_array_equal(back.points, found.points)
    assert list(back.checks) == list(found.checks)
    for name, judged in found.checks.items():
        for a, b in zip(back.checks[name], judged, strict=True):
            assert_array_equal(a, b)
    assert len(found.plot().axes) == 2
    assert len(back.plot(drawn=objective_map(found, 2)).axes) == 3  # and a colour bar
    again, was = (objective_map(one, 2)["objective"] for one in (back, found))
    assert_array_equal(again, was)  # the file holds all that was simulated


def test_a_tuning_starts_where_it_is_told(scene, reopened):
    # 1 mm apart at first, and no transient: the first periods count.
    over, rest = {"shroud.gap": (2e-5, 4e-5)}, Motion(*np.zeros((6, 2)))
    far = initial_state(rest._replace(x=np.array([-1e-3, 0.0])))
    small = TINY | {"n_periods": 2, "transient": 0}
    own, given = (tune(scene, over, state=state, **small) for state in (None, far))
    assert abs(own.objective - given.objective) > 1.0
    with pytest.raises(ValueError, match="does not hold the `state`"):
        problem_from_result(reopened(given))


def test_an_infeasible_tuning_is_an_error_if_asked(scene):
    over = {"shroud.gap": (2e-5, 4e-5)}
    with pytest.raises(js.NumericalError, match="does not keep the limits"):
        tune(scene, over, most_penetration=1e-12, throw=True, **TINY)
