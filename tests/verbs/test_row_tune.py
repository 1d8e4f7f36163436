"""Tuning rows of blades: slopes of all objectives, patterns of mistuning as scatter, and a whole search."""

import json

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.plan import Plan
from jaxshroud.march.method import choices
from jaxshroud.plotting.style import quantity
from jaxshroud.verbs.design_problem import judge_designs, problem_of, scenes_of
from jaxshroud.verbs.gradient_ascent import MAX_GROWTH, exact_slopes
from jaxshroud.verbs.scattering import scattering_of

METHOD = js.RungeKutta("dopri8", steps=100)
RING = ["row.blades=3", "drive.engine_order=1", 'parts.motion=["x"]', "blades.c_x=40"]
OVER = {"shroud.gap": (5e-6, 1e-4)}
SHORT = {"n_periods": 8, "transient": 24, "method": METHOD}


def quiet(_):
    pass


def ring(*options):
    return js.load("row_ring12", [*RING, *options]).scene


MISTUNED = ring("row.mistuning=[0,0.04,-0.03]")


def problem(of, over=OVER, scattering=None):
    method = choices(METHOD, ledger=False)._replace(amplitudes=of == "x_rms")
    return problem_of(MISTUNED, over, {"drive.F_0": (60.0, 80.0)}, scattering, of)._replace(
        plan=Plan(24, 8, 100, 0.0, method)
    )


def slope_error(of, over, other=None):
    """The largest error of the slopes, relative to the largest; of another quantity for a control."""
    made, u = problem(of, over), np.full((1, len(over)), 0.4)
    slope, growth = exact_slopes(problem(other or of, over), u, quiet)
    assert np.all(growth < MAX_GROWTH)
    h = 1e-4
    ends = [np.vstack([u + side * h * e for e in np.eye(len(over))]) for side in (1, -1)]
    up, down = (judge_designs(made, made.values(end), quiet).P_d for end in ends)
    difference = (up - down).T / (2 * h)
    return np.abs(slope[0] - difference).max() / np.abs(difference).max()


@pytest.mark.full
def test_slopes_are_those_of_the_worst_blade():
    # Differences of second order err by about h^2 = 1e-8 in the unit cube.
    over = {"row.mistuning[1]": (-0.05, 0.05)}
    assert slope_error("P_d_worst", over) < 1e-6
    assert slope_error("P_d_worst", over, "P_d") > 0.1  # control: that of all blades


@pytest.mark.full
@pytest.mark.parametrize("of", ["P", "x_rms"])
def test_slopes_are_those_of_the_objective(of):
    over = {**OVER, "friction.mu": (0.1, 0.9), "row.mistuning[1]": (-0.05, 0.05)}
    assert slope_error(of, over) < 1e-6
    assert slope_error(of, over, "P_d_worst") > 1e-3


def test_a_scatter_of_the_mistuning_draws_patterns():
    scattering = scattering_of({"row.mistuning": 0.02}, 4, 0, MISTUNED.layout)
    assert scattering is not None
    assert scattering.keys == tuple(f"row.mistuning[{i}]" for i in range(3))
    found = scenes_of(problem("P_d", scattering=scattering), np.array([[2e-5]])).row.mistuning
    deviation = np.asarray(found)[:4] - [0, 0.04, -0.03]  # about the scene's own pattern
    np.testing.assert_allclose(deviation, 0.02 * scattering.places, rtol=0, atol=1e-15)
    assert np.ptp(deviation, axis=1).min() > 0  # no draw moves all blades alike


def test_requests_that_rows_do_not_know_are_told():
    with pytest.raises(
        ValueError, match="'x_mean' is of the pair alone: its sign differs from blade to blade of a row"
    ):
        js.tune(MISTUNED, OVER, of="x_mean", **SHORT)
    with pytest.raises(KeyError, match=r"the scene has 3 interfaces, from \[0\] to \[2\]"):
        js.tune(MISTUNED, {"shroud.gap[3]": (5e-6, 1e-4)}, **SHORT)


def test_labels_number_the_blades_of_a_row():
    assert quantity("row.mistuning[0]", names=MISTUNED.layout.names)[0].startswith("mistuning, blade 0")


@pytest.mark.release
@pytest.mark.full
def test_a_ring_is_tuned_for_its_worst_blade(reopened):
    found = js.tune(MISTUNED, OVER, of="P_d_worst", goal="worst", conditions={"drive.F_0": [60.0, 80.0]},
                    search=js.SearchOptions(3, 1, 2), **SHORT)  # fmt: skip
    assert found.exact.all()
    assert np.all(np.diff(found.scores, axis=0) >= 0)
    assert found.objective > found.scanned_scores.max()  # better than where it started
    assert found.feasible
    assert found.confirmed
    assert found.level == found.objective
    single = js.sweep(js.vary(MISTUNED, "shroud.gap", found.design["shroud.gap"]), {"drive.F_0": [60.0, 80.0]}, **SHORT)
    assert found.objective == pytest.approx(single.P_d_worst.min(), rel=1e-9)
    again = reopened(found)
    assert again.summary() == found.summary()
    assert json.loads(json.dumps(again.summary()))["blades"] == list(MISTUNED.layout.names)


@pytest.mark.release
@pytest.mark.full
def test_a_design_is_judged_over_patterns():
    small = {"search": js.SearchOptions(2, 1, 1), "n_periods": 4, "transient": 8, "method": METHOD}
    robust = {"scatters": {"row.mistuning": 0.03}, "draws": 2, "check_draws": 16, "at_least": 50.0}
    found = js.tune(ring(), OVER, of="P_d_worst", **robust, **small)
    assert tuple(found.scatters) == tuple(f"row.mistuning[{i}]" for i in range(3))
    assert found.motions is None
    assert np.ptp(found.sampled_P_d) > 0
    assert found.sampled_P_d.min() < found.nominal_P_d[0]  # patterns make some blade worse
    labels = {panel.get_label(): panel.get_xlabel() for panel in found.plot().axes}
    assert labels["row.mistuning[0]"].startswith("mistuning, blade 0")
