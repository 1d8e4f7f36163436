"""A sample of the study of what shipped scenes' accuracy changes."""

import numpy as np
import pytest
import scene_accuracy
from scene_accuracy import BEFORE, FINE, agree, compared, lanes_of, marched

import jaxshroud as js

pytestmark = pytest.mark.studies


@pytest.mark.release
def test_what_an_accuracy_changes_is_a_motion_of_the_scene(monkeypatch):
    # Every 16th lane of fig09_best: RK4 at 400 steps ends on another orbit than "balanced" in four lanes, in which
    # motions coexist. What Dormand-Prince 8 reaches from rest, whatever the roundings, is the latter's.
    monkeypatch.setattr(scene_accuracy, "FINE", FINE.replace(steps=1600))
    told = compared("fig09_best", 16)
    assert told["lanes"] == 32
    assert told["stopped"] == 0
    assert told["right"]["after"] >= 1
    assert told["right"]["before"] + told["right"]["neither"] == 0


def test_runs_agree_within_their_intervals_and_not_beyond():
    assert compared("fig10_best")["change"] == 0
    found = marched(lanes_of(js.load("fig10_best")), BEFORE, 300, 64)
    assert agree(found, found).all()
    others = np.roll(np.arange(4), 1)  # control: other stiffness ratios
    assert not agree(found, found.at(others)).any()
