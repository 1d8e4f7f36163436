"""Branches of periodic orbits: what is solved for holds, and what is found does not depend on how it is followed."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.flows import flow_with_tangents
from jaxshroud.orbits.branch import BranchPoint
from jaxshroud.orbits.branch_continuation import Arc, joined_arcs
from jaxshroud.results.branch import BIFURCATION_KINDS

KEY, STEPS = "contact.gamma", {"method": js.RungeKutta(steps=100)}
# Bending in x alone, lightly damped: along gamma one orbit folds twice, and its upper part flips.
SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=5", "contact.gamma=3"]).scene
FOLDS, FLIP = (2.0205136, 2.4617387), 3.6139405  # of this march, by steps of the continuation twice as short and long


@pytest.fixture(scope="module")
def found():
    """The branch through the orbit at gamma = 3, and that of twice its period."""
    with pytest.warns(js.AccuracyWarning, match=r"flip at contact\.gamma = 3\.61394: a finer march places it"):
        return js.branch(SCENE, KEY, 1.5, 3.7, most_points=80, **STEPS)


def special(found, kind):
    return [one for one in found.special if one.kind == kind]


@pytest.mark.full
def test_multipliers_are_on_the_unit_circle_where_they_pass_it(found):
    # The equation is solved to 1e-8 of the multiplier.
    assert sorted(one.value for one in special(found, "fold")) == pytest.approx(FOLDS, rel=1e-6)
    assert [one.value for one in special(found, "flip")] == pytest.approx([FLIP], rel=1e-6)
    for kind, at in (("fold", 1.0), ("flip", -1.0)):
        for one in special(found, kind):
            assert abs(one.multiplier - at) < 1e-7


@pytest.mark.full
def test_every_located_value_is_told_with_the_error_of_the_march(found):
    # 100 steps a period: the equation is solved to ten digits, the march errs in the fifth or sixth. The truth is a
    # march of eight times the steps, whose own errors it tells as well.
    fine = js.branch(SCENE, KEY, 1.5, 3.7, most_points=80, method=js.RungeKutta(steps=800))
    for kind in ("fold", "flip"):
        coarse, true = (sorted(special(one, kind), key=lambda s: s.value) for one in (found, fine))
        assert len(coarse) == len(true) > 0
        for one, exact in zip(coarse, true, strict=True):
            off = abs(one.value - exact.value)
            assert one.error / 3 < off < 3 * one.error
            assert exact.error < one.error / 8
    assert np.isnan(found.value_error[found.kind == 0]).all()


@pytest.mark.full
def test_stability_changes_at_special_points_only(found):
    for i in np.flatnonzero(np.diff(found.stable.astype(int)) * (np.diff(found.branch) == 0)):
        assert {BIFURCATION_KINDS[found.kind[i]], BIFURCATION_KINDS[found.kind[i + 1]]} & {"fold", "flip"}
    assert (~found.stable).sum() >= 5


@pytest.mark.full
def test_a_fold_is_where_the_branch_turns(found):
    for one in special(found, "fold"):
        before, after = found.value[one.point - 1] - one.value, found.value[one.point + 1] - one.value
        assert before * after > 0  # orbits on one side only


@pytest.mark.full
def test_unstable_orbits_close_as_simulated(found):
    # Shooting closes them to 1e-11; the march without tangents locates events with one trial less, 1e-9 of the motion.
    unstable = np.flatnonzero(~found.stable & (found.q == 1))
    assert len(unstable) >= 3
    for i in unstable[:: len(unstable) // 3]:
        scene = js.vary(SCENE, KEY, float(found.value[i]))
        run = js.simulate(scene, found.start(int(i)), n_periods=1, **STEPS)
        size = np.abs(run.motion.x).max()
        np.testing.assert_allclose(run.last.motion.x, found.start(int(i)).motion.x, rtol=0, atol=1e-8 * size)
        assert found.residual[i] <= 1e-9


@pytest.mark.full
def test_the_doubled_branch_begins_in_the_flip(found):
    first = np.flatnonzero(found.branch == 1)[0]
    assert found.q[first] == 2
    assert found.ends[1][0] == "flip"
    assert abs(found.value[first] - FLIP) < 1e-3
    # Of period two in truth: control, for an orbit of period one all differences vanish.
    assert np.abs(np.diff(found.samples[first, :, 0])) > 1e-3 * np.abs(found.samples[first, :, 0]).max()


@pytest.mark.full
def test_grazing_is_at_zero_closing_speed(found):
    grazing = special(found, "grazing")
    assert grazing
    for one in grazing:
        onset, others = found.slowest_onset[one.point], found.slowest_onset[found.kind == 0]
        speed = onset if found.onsets[one.point] == found.onsets.max() else 0.0
        gap_left = min(found.nearest_miss[one.point], 1.0) if speed == 0.0 else 0.0
        assert speed < 1e-2 * np.median(others)
        assert gap_left < 1e-5 * np.abs(found.motion.x).max()


@pytest.mark.full
def test_no_point_compiles_anything(found):
    before = len(flow_with_tangents.widest.programs)
    js.branch(SCENE, KEY, 2.9, 3.2, **STEPS)
    assert len(flow_with_tangents.widest.programs) == before


@pytest.mark.full
def test_what_is_saved_is_what_is_opened(found, reopened):
    again = reopened(found)
    assert isinstance(again, js.Branch)
    assert again.special == found.special
    assert again.messages == found.messages
    assert len(again.plot().axes) == 3


@pytest.mark.parametrize(
    ("arguments", "q", "told"),
    [
        (("contact.gamma", 5.0, 6.0), None, "outside of its range"),
        (("contact.gamma", 3.0, 3.0), None, "is empty"),
        (("contact.gamma",), None, "is not known"),
        (("contact.gama", 1.0, 2.0), None, "did you mean"),
        ((KEY, 1.5, 3.7), 2, "`q` needs a `state`"),
        ((KEY, 1.5, 3.7), 0, "`q` must be positive"),
    ],
)
def test_wrong_arguments_are_told(arguments, q, told):
    with pytest.raises(js.InputError, match=told):
        js.branch(SCENE, *arguments, q=q, **STEPS)


def points_called(letters):
    """Points of a branch that are known by their kinds."""
    return [BranchPoint(np.zeros(1), 0.0, None, (), np.zeros(1), 0, kind=letter) for letter in letters]


@pytest.mark.parametrize("lost", [0, 1, None])
def test_a_closed_branch_is_told_once(lost):
    # Both ways around the same points: the first one, two folds, and the first one again.
    ways = [Arc(points_called("aFbGa"), "closed"), Arc(points_called("aGbFa"), "closed")]
    arcs = [Arc(points_called("a"), "lost") if i == lost else way for i, way in enumerate(ways)]
    points, ends = joined_arcs(*arcs)
    assert ends == ("closed", "closed")
    assert sorted(point.kind for point in points) == sorted("aFbGa")
    open_points, ends = joined_arcs(Arc(points_called("abc"), "stop"), Arc(points_called("ade"), "lost"))
    assert "".join(point.kind for point in open_points) == "edabc"
    assert ends == ("lost", "stop")
