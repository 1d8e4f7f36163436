"""A sample of the study of what shipped scenes' accuracy changes."""

import pytest
import scene_accuracy

pytestmark = pytest.mark.studies


def test_what_an_accuracy_changes_is_a_motion_of_the_scene():
    # Every 16th lane of fig09_best: where RK4 at 400 steps ends on another orbit than "balanced", the latter is what
    # Dormand-Prince 8 at 6,400 steps reaches from rest in most of them; none shows what is not there.
    told = scene_accuracy.compared("fig09_best", 16)
    assert told["lanes"] == 32
    assert told["stopped"] == 0
    assert told["change"] >= 1  # else nothing is judged
    assert told["right"]["after"] > told["right"]["before"] + told["right"]["neither"]
    assert all(one["motions of the scene"]["after"] for one in told["each"])


def test_runs_agree_within_their_intervals_and_not_beyond():
    told = scene_accuracy.compared("fig10_best", 1)
    assert told["change"] == 0  # control below: period numbers and P_d of other stiffness ratios are no agreement
    file = scene_accuracy.js.load("fig10_best")
    lanes = scene_accuracy.lanes_of(file)
    found = scene_accuracy.marched(lanes, scene_accuracy.BEFORE, 300, 64)
    one, other = found.at(scene_accuracy.np.arange(3)), found.at(scene_accuracy.np.arange(1, 4))
    assert not scene_accuracy.agree(one, other).any()
