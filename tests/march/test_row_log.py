"""What is logged of rows within their steps, against the pair and against finer steps."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import initial_states
from jaxshroud.march.method import FAST
from jaxshroud.scene.grids import scenes_at

IN_X = 'parts.motion=["x"]'
CHAIN = ["row.blades=2", "row.closed=false", "drive.engine_order=1", IN_X]
PAIR = [IN_X, "drive.F_0=60", "drive.M_0=0.3", 'drive.phase=["0 deg", "180 deg"]']
GAMMAS = np.linspace(0.5, 5, 8)[:, None]
WITHIN = FAST._replace(within=True, amplitudes=True)


def logged(name, changes, steps):
    """The runs of one period from rest, with eight stiffnesses of contact."""
    scenes = scenes_at(js.load(name, changes).scene, ["contact.gamma"], GAMMAS)
    return run_lanes(scenes, initial_states(scenes), Plan(0, 1, steps, 0.0, WITHIN), lambda _: None)


@pytest.mark.full
def test_extremes_of_a_chain_of_two_are_those_of_the_pair():
    chain, pair = logged("row_ring12", CHAIN, 200), logged("table1", PAIR, 200)
    for name, want in pair.log.within._asdict().items():
        np.testing.assert_allclose(getattr(chain.log.within, name), want, rtol=1e-10, err_msg=name)
    assert np.all(np.isfinite(chain.log.within.slowest_onset))
    for got, want in zip(chain.samples.extent, pair.samples.extent, strict=True):
        np.testing.assert_allclose(got[0], want[0], rtol=1e-10)


def test_extremes_are_those_within_steps():
    # By cubics within steps: an error of fourth order. Those at the ends of steps, the control, miss a thousandth. The
    # faces stick: slip would end, in an event, where blades that move along x are closest.
    coarse, finer, true = (logged("row_ring12", [*CHAIN, "friction.mu=50"], steps) for steps in (200, 400, 12800))
    missed = lambda got, want: np.abs(got / want - 1).max()
    inside = [missed(run.log.within.v_max, true.log.v_max) for run in (coarse, finer)]
    assert inside[0] < 1e-4 < 1e-3 < missed(coarse.log.v_max, true.log.v_max)
    assert inside[1] < inside[0] / 12
    swing = lambda run: np.maximum(run.samples.extent.highest[0], -run.samples.extent.lowest[0])
    # The motion itself errs by some 2e-5 in RK4 steps of that length.
    assert missed(swing(coarse), swing(true)) < 3e-5 < 1e-4 < missed(coarse.samples.largest[0], swing(true))


def test_what_is_not_requested_is_not_logged():
    scenes = scenes_at(js.load("row_ring12", CHAIN).scene, ["contact.gamma"], GAMMAS)
    log = begin_lanes(scenes, initial_states(scenes), FAST).accumulator.log
    assert (log.within, log.forces, log.impacts, log.extent) == (None,) * 4


def test_the_penetration_at_the_start_counts():
    # Pressed together by 2 mm at rest, the blades only part: no later penetration is as large.
    chain, pair = (
        logged(name, [*changes, "shroud.gap=-2mm"], 200) for name, changes in (("row_ring12", CHAIN), ("table1", PAIR))
    )
    np.testing.assert_allclose(chain.log.v_max, pair.log.v_max, rtol=1e-12)
    at_start = 2e-3 * np.sin(js.load("table1").scene.shroud.alpha)
    np.testing.assert_allclose(chain.log.v_max, at_start, rtol=1e-12)
    np.testing.assert_allclose(chain.log.within.v_max, at_start, rtol=1e-12)
