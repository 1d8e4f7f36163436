"""Algorithms of one lane, run for many together."""

import numpy as np
import pytest

from jaxshroud import load
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.tangents import TangentProblem
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import FAST
from jaxshroud.model.prepared import initial_state
from jaxshroud.orbits import batched_algorithms as module
from jaxshroud.orbits.batched_algorithms import Derivatives, Periods, StagedProgress, run_alone, run_together
from jaxshroud.scene.checks import NumericalError

SCENE = load("table1", ['parts.motion=["x"]', "drive.F_0=60"]).scene
STATE = initial_state(SCENE.initial)


def periods(n):
    return Periods(SCENE, STATE, Plan(0, n, 50, 0.0, FAST))


def asking(*wanted, error=None):
    """An algorithm that asks for some things in turn, and returns the answers' types."""
    told = []
    for one in wanted:
        told.append(type((yield one)).__name__)
    if error is not None:
        raise error
    return told


@pytest.fixture
def batches(monkeypatch):
    """What is computed at once."""
    seen = []
    for kind in (Periods, Derivatives):
        answers = kind.answers
        spy = lambda wanted, answers=answers: seen.append(len(wanted)) or answers(wanted)
        monkeypatch.setattr(kind, "answers", staticmethod(spy))
    return seen


@pytest.mark.full
def test_what_lanes_want_alike_is_computed_at_once(batches):
    tangents = Derivatives(TangentProblem(SCENE, STATE), 1, 50, FAST)
    found = run_together([asking(periods(1)), asking(periods(2)), asking(periods(1), tangents), asking(tangents)])
    assert found == [["Runs"], ["Runs"], ["Runs", "Tangents"], ["Tangents"]]
    assert sorted(batches) == [1, 2, 2]  # periods alike, others, and both tangents: a lane waits for the larger batch


@pytest.mark.parametrize("error", [NumericalError("no"), np.linalg.LinAlgError("singular")])
def test_a_lane_that_fails_does_not_stop_the_others(error):
    found = run_together([asking(periods(1), error=error), asking(periods(1), periods(1))])
    assert found == [error, ["Runs", "Runs"]]
    with pytest.raises(type(error)):
        run_alone(asking(error=error))
    with pytest.raises(ZeroDivisionError):  # control: a fault of the program is none of a lane
        run_together([asking(error=ZeroDivisionError()), asking(periods(1))])


def test_progress_ends_with_all_that_was_to_do():
    told = []
    run_together([asking(periods(1)), asking(periods(1), periods(3))], lambda *now: told.append(now), 8)
    assert told[:2] == [(0, 16), (9, 16)]  # the first lane has ended
    assert told[-1] == (16, 16)


def test_an_interruption_keeps_what_was_found(monkeypatch):
    def stop(wanted):
        raise Interrupted([None])

    monkeypatch.setattr(module.Derivatives, "answers", staticmethod(stop))
    tangents = Derivatives(TangentProblem(SCENE, STATE), 1, 50, FAST)
    with pytest.raises(Interrupted) as stopped:
        run_together([asking(periods(1)), asking(tangents), asking(periods(1))])
    assert stopped.value.done == [["Runs"], None, ["Runs"]]
    with pytest.raises(Interrupted) as stopped:
        run_together([asking(tangents)])
    assert stopped.value.done is None


def test_stages_add_to_what_is_to_be_done():
    told = []
    progress = StagedProgress(lambda done, total: told.append((done, total)))
    for periods in (10, 30):
        stage = progress.stage()
        for done in (0, periods):
            stage(done, periods)
    assert told == [(0, 10), (10, 10), (10, 40), (40, 40)]
