"""What is logged of rows within their steps, against the pair and against finer steps."""

import re
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes, initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.tableau import TaylorOptions, tableau
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


ORDERS = (1, 60.0, 1.0), (2, 20.0, 5.0)
CONFIGS = Path(js.__file__).parents[1] / "configs"


@pytest.mark.full
def test_what_is_logged_by_series_is_that_of_fine_steps(tmp_path):
    # Two orders of the drive with a mean load on mistuned blades that turn; extremes of fine steps are those of cubics.
    text = re.sub("(beta|F_0|M_0) = .*", "", (CONFIGS / "row_ring12.toml").read_text("utf-8"))
    orders = "".join(f"[[drive.harmonic]]\norder = {n}\nF = {F}\nbeta = 0.5\nM = {M}\n" for n, F, M in ORDERS)
    (tmp_path / "two.toml").write_text(text + orders, "utf-8")
    row = ["row.blades=3", "drive.engine_order=1", "blades.I=2.46e-3", "row.mistuning=[0.01, -0.02, 0.01]"]
    scene = js.load(tmp_path / "two.toml", [*row, "drive.F_x_mean=[5, 5, 5]"]).scene
    scenes = jax.tree.map(lambda a: np.asarray(a)[None], scene)
    recorded = dict(within=True, amplitudes=True, forces=True, vibration=True)
    methods = Choices(tableau("dopri8"), "cubic", **recorded), Choices(TaylorOptions(12, 1e-13), "series", **recorded)
    fine, got = (
        run_lanes(scenes, initial_states(scenes), Plan(0, 2, 3200, 0.0, one), lambda _: None) for one in methods
    )
    assert np.min(fine.log.counters.separation) > 1

    def close(a, b, rtol):
        a, b = np.asarray(a), np.asarray(b)
        assert_allclose(b, a, rtol=0, atol=rtol * np.max(np.abs(np.where(np.isfinite(a), a, 0))))

    # Means are summed over the ends of steps, and the magnitude of the drive's power by halves of trials; where trials
    # end, and in their middles, are the largest displacements that are logged without ranges.
    # Energy that jumps at a switch of the case changes with its instant, which steps locate to a tolerance.
    loosely = dict(means=1e-5, gross=1e-3, largest=1e-2, switched=1e-5)
    assert np.max(np.abs(got.samples.residual)) < 1e-12 * np.max(fine.samples.gross)
    for name, want in fine.samples._replace(residual=None)._asdict().items():
        jax.tree.map(
            partial(close, rtol=loosely.get(name, 1e-8)), want, getattr(got.samples._replace(residual=None), name)
        )
    jax.tree.map(partial(close, rtol=0), fine.log.counters, got.log.counters)
    for name in ("v_max", "slowest_onset"):
        close(getattr(fine.log.within, name), getattr(got.log.within, name), rtol=1e-7)


def test_what_is_not_requested_is_not_logged():
    scenes = scenes_at(js.load("row_ring12", CHAIN).scene, ["contact.gamma"], GAMMAS)
    log = begin_lanes(scenes, initial_states(scenes), FAST).accumulator.log
    assert (log.within, log.forces, log.impacts, log.extent) == (None,) * 4


def test_the_penetration_at_the_start_counts():
    # Pressed together by 2 mm at rest, the blades only part: no later penetration is as large.
    chain, pair = (
        logged(name, [*changes, "shroud.gap=-2mm"], 200) for name, changes in (("row_ring12", CHAIN), ("table1", PAIR))
    )
    assert_allclose(chain.log.v_max, pair.log.v_max, rtol=1e-12)
    at_start = 2e-3 * np.sin(js.load("table1").scene.shroud.alpha)
    assert_allclose(chain.log.v_max, at_start, rtol=1e-12)
    assert_allclose(chain.log.within.v_max, at_start, rtol=1e-12)
