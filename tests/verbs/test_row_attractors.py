"""Coexisting motions of rows of blades, their shares and basins."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js

pytestmark = pytest.mark.full

STEPS = {"method": js.RungeKutta("dopri8", steps=60)}
# Four blades in anti-phase beyond the loss of their wave's stability: the broken motion and its copies.
BROKEN = ["row.blades=4", "drive.engine_order=2", 'parts.motion=["x"]', "drive.omega=923"]
SCENE = js.load("row_ring12", BROKEN).scene


@pytest.fixture(scope="module")
def found():
    return js.attractors(SCENE, 12, most_periods=256, **STEPS)


def marched_from(initial, periods):
    """The Poincaré points on which starts (n, blades) are after so many periods, by a plain march: (n, 4)."""
    starts = len(initial.x)
    nothing = np.zeros((starts, 4), np.int32)
    state = js.State(initial, np.zeros((starts, 4)), nothing, nothing)
    lanes = js.scenes_from({"drive.omega": np.full(starts, 923.0)}, SCENE)
    return js.sweep(lanes, state=state, transient=periods, n_periods=1, **STEPS).motion.x[:, -1]


def test_copies_of_a_broken_wave_are_motions_of_their_own(found):
    assert 2 <= len(found.names) <= 4
    assert found.undecided == 0
    assert found.residual.max() < 1e-9
    assert found.distance.min() > 0.1
    assert abs(found.multipliers[:, 0]).max() < 1  # all are stable
    assert_allclose(found.P_d, found.P_d[0], rtol=0, atol=1e-8)
    # Control: a copy that begins at another blade is none of the others' motions.
    assert min(np.abs(found.motion.x[0] - x).max() for x in found.motion.x[1:]) > 0.1 * np.abs(found.motion.x).max()


def test_shares_are_those_of_plain_marches(found):
    ends = marched_from(found.initial, 600)
    size = np.abs(found.motion.x).max()
    away = np.abs(ends[:, None] - found.motion.x).max(axis=-1) / size
    assert_array_equal(away.argmin(axis=1), found.label)
    assert away.min(axis=1).max() < 1e-5
    assert_array_equal(np.bincount(found.label), found.starts)


def test_a_ring_is_saved_and_drawn(found, reopened):
    again = reopened(found)
    assert repr(again) == repr(found)
    assert_array_equal(again.initial.v_x, found.initial.v_x)
    assert len(again.plot().axes) == 3


def test_basins_of_a_ring_are_what_their_starts_lead_to(found):
    plane = js.basins(SCENE, ("v_x[0]", "v_x[3]"), ranges=[(-0.4, 0.4), (-0.3, 0.5)], num=3, most_periods=512, **STEPS)
    v_0, v_3 = (plane.data[dim].to_numpy() for dim in plane.data["label"].dims)
    rates = np.zeros((3, 3, 4))
    rates[..., 0], rates[..., 3] = v_0[:, None], v_3
    still = np.zeros((9, 4))
    ends = marched_from(js.Motion(*[still] * 3, rates.reshape(9, 4), still, still), 600)
    away = np.abs(ends[:, None] - plane.motion.x).max(axis=-1) / np.abs(plane.motion.x).max()
    assert_array_equal(away.argmin(axis=1), plane.label.ravel())
    assert away.min(axis=1).max() < 1e-4


def test_what_rows_have_no_attractors_of():
    with pytest.raises(js.InputError, match="blade"):
        js.basins(SCENE, ("v_x[0]", "v_x[4]"), **STEPS)
    with pytest.raises(js.InputError, match="there is no theta"):
        js.basins(SCENE, ("v_x[0]", "theta[1]"), **STEPS)
