"""A sample of the study of closed forms, and that it can fail."""

import linear_answers
import numpy as np
import pytest

pytestmark = pytest.mark.studies


@pytest.mark.parametrize(("layout", "state"), [("pairs", "stuck"), ("chains", "apart")])
def test_marches_settle_to_the_closed_form(layout, state):
    told = linear_answers.compared(layout, state, 12, 6)
    assert told["claimed"] > 0
    assert told["claimed and left"] == 0
    assert told["difference"] < linear_answers.AGREES


def test_other_loads_are_seen(monkeypatch):
    # Control: the closed form of loads that are larger by a millionth.
    scenes = linear_answers.drawn("pairs", "stuck", np.random.default_rng(11))
    own = linear_answers.some(scenes, np.flatnonzero(linear_answers.claimed(scenes, "stuck"))[:3])
    in_state = linear_answers.in_state
    more = linear_answers.at_level(own, np.full(3, 1 + 1e-6))
    monkeypatch.setattr(linear_answers, "in_state", lambda _, state: in_state(more, state))
    assert max(linear_answers.differences(own, "stuck").values()) > 1e-7
