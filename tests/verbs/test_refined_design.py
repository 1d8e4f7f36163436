"""One tuned number: looked for between the best value and its neighbours, as far as intervals tell values apart."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.results.tuned import DesignJudgement
from jaxshroud.verbs import gradient_ascent
from jaxshroud.verbs.gradient_ascent import Looked, refine_design

KEY = "contact.gamma"
SHORT = {"n_periods": 8, "transient": 24, "method": js.RungeKutta(steps=100)}
SEARCH = js.SearchOptions(scan=8, n_starts=1, updates=0)


class Parabola:
    """A problem of one number whose score is largest at 0.37."""

    goal, runs = "mean", 1

    def __init__(self, ci):
        self.ci, self.asked = ci, []

    def values(self, u):
        return u

    def objective_ci(self, judged):
        return judged.ci[:, 0]

    def judge(self, _, designs, tick):
        self.asked.append(designs[:, 0])
        score = -((designs[:, 0] - 0.37) ** 2)
        numbers = {name: np.zeros(len(score)) for name in DesignJudgement._fields}
        return DesignJudgement(**numbers | {"score": score, "ci": np.full((len(score), 1), self.ci)})


def refined(ci, monkeypatch, u=(0.1, 0.3, 0.5, 0.7, 0.9)):
    problem, u = Parabola(ci), np.array(u)
    monkeypatch.setattr(gradient_ascent, "judge_designs", problem.judge)
    found = refine_design(problem, Looked(u, -((u - 0.37) ** 2), np.full(len(u), ci)), None)
    return found, problem


def test_a_number_without_scatter_is_found(monkeypatch):
    found, problem = refined(0.0, monkeypatch)
    assert found.points[-1, 0] == pytest.approx(0.37, abs=1e-4)
    assert np.all(np.diff(found.scores) >= 0)
    low, high = found.looked.place
    assert low < 0.37 < high
    assert high - low < 1e-3
    assert len(problem.asked) == gradient_ascent.REFINE_ROUNDS


def test_refinement_ends_where_intervals_tell_no_more(monkeypatch):
    found, problem = refined(5e-3, monkeypatch)
    low, high = found.looked.place
    apart = np.sqrt(np.hypot(5e-3, 5e-3))  # from the best, in u
    assert low < 0.37 - apart < 0.37 + apart < high
    assert high - low < 4 * apart
    assert len(problem.asked) < gradient_ascent.REFINE_ROUNDS
    assert np.min(np.diff(found.looked.u)) > apart / 4  # a control without intervals looks ever closer
    close, _ = refined(0.0, monkeypatch)
    assert np.min(np.diff(close.looked.u)) < apart / 100


@pytest.mark.parametrize("u", [(0.37, 0.5), (0.2, 0.3)])
def test_the_best_may_be_the_first_or_the_last(monkeypatch, u):
    found, _ = refined(0.0, monkeypatch, u)
    assert min(u) <= found.points[-1, 0] <= max(u)
    low, high = found.looked.place
    assert (low == 0.0) is (u[0] == 0.37)
    assert (high == 1.0) is (u[0] != 0.37)


def test_designs_that_stop_are_worse_and_none_that_runs_ends_the_search(monkeypatch):
    looked = Looked(np.array([0.1, 0.5, 0.9]), np.array([-np.inf, 1.0, -np.inf]), np.full(3, np.nan))
    assert looked.worse.tolist() == [True, False, True]
    assert looked.place == (0.1, 0.9)
    nothing = looked._replace(score=np.full(3, -np.inf))
    assert not nothing.worse.any()


def test_tune_tells_where_the_best_is(reopened):
    scene = js.load("table1", ['parts.motion=["x"]', "drive.F_0=60"]).scene
    found = js.tune(scene, {KEY: (1.0, 4.0)}, search=SEARCH, **SHORT)
    low, high = found.best_between[KEY]
    assert 1.0 <= low <= found.design[KEY] <= high <= 4.0
    values = np.geomspace(1.0, 4.0, 200)
    dense = js.sweep(scene, {KEY: values}, **SHORT).P_d
    assert found.objective >= np.nanmax(dense) - 0.2
    again = reopened(found)
    assert again.best_between == found.best_between
    assert found.summary()["best_between"] == {KEY: [low, high]}
    two = js.tune(scene, {KEY: (1.0, 4.0), "shroud.gap": (1e-5, 2e-5)}, search=SEARCH, **SHORT)
    assert two.best_between == {}
