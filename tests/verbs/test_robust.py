"""Robust tuning: draws that count like conditions, how far numbers may go, and the probability of a wanted P_d."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.plan import Plan
from jaxshroud.march.method import FAST
from jaxshroud.results.tuned import DesignJudgement
from jaxshroud.verbs import robust as robustness
from jaxshroud.verbs.design_problem import judge_designs, problem_of, scenes_of
from jaxshroud.verbs.gradient_ascent import MAX_GROWTH, exact_slopes
from jaxshroud.verbs.robust import robustness_request
from jaxshroud.verbs.scattering import scattering_of
from jaxshroud.verbs.tune import problem_from_result

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
OVER = {"shroud.gap": (5e-6, 5e-5)}
HOW = {"n_periods": 4, "transient": 16, "method": js.RungeKutta(steps=100)}
SMALL = {"search": js.SearchOptions(scan=4, n_starts=1, updates=1), **HOW}
PLAN = Plan(16, 4, 100, 0.0, FAST)
SCATTERS = {"shroud.gap": 5e-6, "blades.m[1]": "5%", "drive.F_0": "20%"}


def quiet(_):
    pass


def scattering(places=None):
    made = scattering_of(SCATTERS, 4, 0)
    return made if places is None else made._replace(places=np.array(places))


def problem(**more):
    made = problem_of(SCENE, OVER, {"drive.F_0": (40.0, 60.0)}, scattering(**more))
    return made._replace(plan=PLAN)


@pytest.fixture(scope="module")
def robust():
    return js.tune(
        SCENE, OVER, conditions={"drive.F_0": [40.0, 60.0]}, scatters=SCATTERS, draws=4, at_least=51.0,
        check_draws=64, motions=4, **SMALL,
    )  # fmt: skip


def test_numbers_scatter_about_design_condition_and_scene():
    many = scenes_of(problem(places=[[1.0, -1.0, 0.5], [-1.0, 0.0, 1.0]]), np.array([[2e-5]]))
    assert_allclose(many.shroud.gap, [2.5e-5, 1.5e-5] * 2, rtol=1e-12)
    assert_allclose(many.blades.m[:, 1], [0.076, 0.08] * 2, rtol=1e-12)
    assert_array_equal(many.blades.m[:, 0], 0.08)
    assert_allclose(many.drive.F_0, [[44.0] * 2, [48.0] * 2, [66.0] * 2, [72.0] * 2], rtol=1e-12)


@pytest.mark.full
def test_draws_count_like_conditions():
    # The same runs, given as a list of scenes: equal to rounding.
    found = judge_designs(problem(), np.array([[2e-5]]), quiet)
    runs = js.sweep(scenes_of(problem(), np.array([[2e-5]])), **HOW)
    assert found.P_d.shape == (1, 8)
    assert_allclose(found.P_d[0], runs.P_d, rtol=1e-9)
    assert found.objective[0] == pytest.approx(np.mean(runs.P_d), rel=1e-9)
    assert judge_designs(problem()._replace(goal="worst"), np.array([[2e-5]]), quiet).objective[0] == found.P_d.min()


@pytest.mark.full
def test_slopes_are_averaged_over_draws():
    # A share of the gap itself: its derivative is stretched with it. Differences err by the square of their step.
    made = problem_of(SCENE, OVER, {}, scattering_of({"shroud.gap": "30%", "friction.mu": "20%"}, 4, 0))
    made, u, h = made._replace(plan=PLAN), np.array([[0.6]]), 1e-4
    slope, growth = exact_slopes(made, u, quiet)
    assert np.all(growth < MAX_GROWTH)
    up, down = (judge_designs(made, made.values(u + s), quiet).P_d for s in (h, -h))
    assert_allclose(slope[..., 0], (up - down) / (2 * h), rtol=1e-3, atol=1e-3)
    # Control: without the stretch it would be another.
    assert np.abs(slope[0, :, 0] / made.stretch[:, 0] / ((up - down)[0] / (2 * h)) - 1).max() > 0.05


@pytest.mark.full
def test_intervals_end_where_too_much_is_lost(robust):
    assert list(robust.intervals) == ["shroud.gap", "blades.m[1]"]
    within = robust.intervals["shroud.gap"]
    assert within.low <= robust.design["shroud.gap"] <= within.high
    assert within.ended_by == ("bound", "loss")
    gaps = np.array([*np.linspace(within.low, within.high, 40), within.beyond[1]])
    P_d = np.array(
        [js.sweep(js.vary(SCENE, "drive.F_0", F_0), {"shroud.gap": gaps}, **HOW).P_d for F_0 in (40.0, 60.0)]
    )
    loss = (robust.nominal_P_d[:, None] - P_d).max(axis=0)
    assert np.all(loss[:-1] <= robust.loss)
    assert loss[-1] > robust.loss
    assert within.beyond[1] - within.high < 1e-3 * (within.high - within.low)


def known(loss, limit=np.inf, at=0.4, most=1.0, monkeypatch=None):
    """An interval of a number from 0 to 1 whose loss is known, and a force of its own size against a limit."""
    made = problem_of(SCENE, {"friction.mu": (0.0, 1.0)}, {})._replace(most_force=limit)

    def judge(_, designs, tick):
        mu = designs[:, 0]
        P_d, n = -loss(mu)[:, None], len(mu)
        score = P_d[:, 0] - np.maximum(mu / limit - 1, 0)
        return DesignJudgement(score, P_d[:, 0], P_d, np.zeros((n, 1)), np.zeros(n), mu, np.ones((n, 1)))

    monkeypatch.setattr(robustness, "judge_designs", judge)
    design = np.array([at])
    return robustness.interval_of(made, design, 0, judge(made, design[None], quiet), most, quiet)


def test_intervals_of_a_known_loss(monkeypatch):
    # A parabola that loses 1 at 0.4 +- 0.01: an interval narrower than the first look's spacing.
    found = known(lambda mu: ((mu - 0.4) / 0.01) ** 2, monkeypatch=monkeypatch)
    assert_allclose(found.ends, [0.39, 0.41], atol=1e-5)
    assert np.all(found.ended_by == robustness.ALLOWED_LOSS)
    assert found.beyond[0] < 0.39 < found.ends[0] < found.ends[1] < 0.41 < found.beyond[1]
    inside = (found.probes >= found.ends[0]) & (found.probes <= found.ends[1])
    assert inside.sum() >= robustness.SEARCH_POINTS // 2


def test_intervals_end_at_islands_limits_and_bounds(monkeypatch):
    flat = lambda mu: 0.0 * mu
    assert known(flat, monkeypatch=monkeypatch).ends.tolist() == [0.0, 1.0]
    assert known(flat, monkeypatch=monkeypatch).ended_by.tolist() == [robustness.BOUND] * 2
    held = known(flat, limit=0.7, monkeypatch=monkeypatch)
    assert held.ended_by.tolist() == [robustness.BOUND, robustness.LIMIT]
    assert held.ends[1] <= 0.7 < held.beyond[1] < held.ends[1] + 1e-4
    island = lambda mu: np.where(abs(mu - 0.6) < 0.01, 2.0, 0.0)
    assert known(island, monkeypatch=monkeypatch).ends[1] == pytest.approx(0.59, abs=1e-4)
    wrong = known(flat, limit=0.3, monkeypatch=monkeypatch)
    assert wrong.ends.tolist() == [0.4, 0.4]
    assert wrong.ended_by.tolist() == [robustness.LIMIT] * 2


def test_what_comes_near_is_looked_at_closer(monkeypatch):
    # Waves 0.2 off that lose 1.001 at most, more than 1 in 3 % of each: a first look meets no such place for long.
    waves = lambda mu: np.where(abs(mu - 0.4) < 0.2, 0.0, 0.7 + 0.301 * np.sin(2 * np.pi * 57.3 * mu))
    wrong = lambda found: np.mean(waves(np.linspace(*found.ends, 20_000)) > 1)
    assert wrong(known(waves, monkeypatch=monkeypatch)) == 0
    # Control: a first look alone.
    monkeypatch.setattr(robustness, "REFINEMENTS", 0)
    monkeypatch.setattr(robustness, "MAX_AUDITS", 0)
    assert wrong(known(waves, monkeypatch=monkeypatch)) > 0.005


@pytest.mark.full
def test_probability_is_that_of_the_draws(robust):
    assert robust.probability == np.mean(robust.sampled_P_d >= 51.0)
    assert 0 < robust.probability < 1
    assert robust.probability_low < robust.probability < robust.probability_high
    made = problem_from_result(robust)
    again = made._replace(scattering=made.scattering._replace(places=robust.sampled))
    P_d = judge_designs(again, robust.best[None], quiet).P_d.reshape(2, -1).min(axis=0)
    assert_array_equal(P_d, robust.sampled_P_d)


@pytest.mark.full
def test_motions_of_the_best_design_are_counted(robust):
    # Strongly damped: one motion at either load, and its P_d is the design's own.
    assert robust.motions.tolist() == [1, 1]
    assert_allclose(robust.motions_worst, robust.nominal_P_d, atol=0.01)


@pytest.mark.full
def test_a_robust_tuning_comes_back_from_its_file(robust, reopened):
    back = reopened(robust)
    assert repr(back) == repr(robust)
    assert back.scatters == robust.scatters == {"shroud.gap": (5e-6, False), "blades.m[1]": (0.05, True), "drive.F_0": (0.2, True)}  # fmt: skip  # noqa: E501
    assert str(back.robust) == str(robust.robust)
    again, was = (judge_designs(problem_from_result(one), robust.best[None], quiet).P_d for one in (back, robust))
    assert_array_equal(again, was)
    assert len(back.plot().axes) == 1 + 2 + 1  # the values of the tuned number, two numbers, and the scatter
    assert robust.conditions == {"drive.F_0": [40.0, 60.0]}


def test_a_tuning_without_scatter_has_nothing_of_it():
    assert robustness_request(False, None, None, 1024, 32) is None
    assert scattering_of({}, 16, 0) is None


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"scatters": {"shroud.gap": "2000%"}}, "below 100 %"),
        ({"scatters": {"shroud.gap": "wide"}}, "not 'wide'"),
        ({"scatters": {"shroud.gap": (1e-6, 2e-6)}}, "`scatters` must be"),
        ({"scatters": {"shroud.gap": 0.0}}, "positive half width"),
        ({"scatters": {"friction.mu": 0.6}}, "at an end of its scatter"),
        ({"scatters": {"shroud.gap[0]": "10%"}}, "gap"),
        ({"scatters": {"drive.M_0": "10%"}}, "a share of 0 does not scatter"),
        ({"scatters": {"blades.m": 0.01, "blades.m[1]": "10%"}}, "partly the same number"),
        ({"at_least": 30.0}, "say what scatters"),
        ({"loss": 0.0}, "`loss` must be positive"),
        ({"loss": 1.0, "check_draws": 1}, "check_draws"),
        ({"scatters": {"shroud.gap": 1e-6}, "draws": 0}, "draws"),
    ],
)
def test_wrong_requests_are_told(asked, told):
    with pytest.raises(js.Error, match=told):
        js.tune(js.vary(SCENE, "drive.M_0", 0.0), OVER, **asked, **SMALL)
