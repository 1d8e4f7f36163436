"""The scatter and the report of rows: patterns, forces at interfaces, and what a chain of two shares with the pair."""

import re
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from row_runs import CHAIN_OF_TWO, PAIR

import jaxshroud as js
from jaxshroud.march.method import FAST
from jaxshroud.model.linear import power_reduction
from jaxshroud.plotting.documents import TABLE_COLUMNS, Section, html_document, pdf_document, section_lines
from jaxshroud.verbs.arguments import plan_march, resolve_options
from jaxshroud.verbs.attractors import row_motions

METHOD = js.RungeKutta("dopri8", steps=100)
DAMPED = ['parts.motion=["x"]', "blades.c_x=40"]
RING = ["row.blades=3", "drive.engine_order=1", *DAMPED]
SHORT = {"n_periods": 2, "transient": 4, "method": METHOD}
UNLIKE = "blades.m=[0.08,0.09]"


def ring(*options):
    return js.load("row_ring12", [*RING, *options]).scene


@pytest.fixture(scope="module")
def scattered():
    scene = ring("contact.gamma=[2,4,8]")
    return scene, js.scatter(scene, {"row.mistuning": 0.04}, of="P_d_worst", at_least=50.0, draws=2, **SHORT)


def swept_draws(scene, found):
    """The sweep of the independent draws of a scatter."""
    return js.sweep(js.scenes_from({key: found.drawn[:, i] for i, key in enumerate(found.keys)}, scene), **SHORT)


@pytest.mark.full
def test_draws_of_the_mistuning_are_patterns(scattered):
    scene, found = scattered
    assert found.keys == tuple(f"row.mistuning[{i}]" for i in range(3))
    assert_array_equal(found.high - found.low, 0.08)
    assert_array_equal(found.level, swept_draws(scene, found).P_d_worst)  # the same lanes, bit for bit
    assert np.ptp(found.drawn, axis=1).min() > 0  # no draw moves all blades alike


@pytest.mark.full
def test_the_force_is_that_of_the_interface_where_it_is_largest(scattered):
    scene, found = scattered
    swept = swept_draws(scene, found)
    assert_array_equal(swept.interface_v_max.max(axis=-1), swept.v_max)
    forces = np.asarray(scene.k) * swept.interface_v_max
    assert found.N_max >= forces.max()  # of the mixed draws too
    # Control: the stiffest interface does not have the largest penetration, by far.
    assert (np.max(scene.k) * swept.v_max).min() > 1.2 * found.N_max


@pytest.mark.parametrize(
    ("ask", "told"),
    [
        (lambda: js.scatter(ring(), {"row.mistuning": 0.02}, of="x_mean", **SHORT), "its sign differs from blade to"),
        (lambda: js.scatter(ring(), {"row.mistuning": 2.0}, draws=2, **SHORT), "must be greater than -1"),
        (
            lambda: js.report(js.load("table1", DAMPED + PAIR).scene, of="P_d_worst", **SHORT),
            "the left one; take P_d",
        ),
        (lambda: js.report(ring("drive.F_0=0"), **SHORT), "no blade of the row vibrates, and there is no P_d"),
        (lambda: js.report(ring("drive.F_0[1]=0"), of="P_d_worst", **SHORT), "there is no P_d_worst"),
        (lambda: js.report(ring(), conditions={"shroud.gap[3]": [1e-5]}, **SHORT), r"interfaces, from [0] to [2]"),
        (lambda: js.report(ring("parts.contact=none"), **SHORT), "contact"),
    ],
)
def test_what_rows_cannot_be_asked_is_told(ask, told):
    with pytest.raises(js.InputError, match=re.escape(told)):
        ask()


def test_heads_of_wide_tables_are_folded_and_nothing_is_cut():
    head = ["a name of a column that is long"] * 6
    page = [Section("wide", (), [head, ["1"] * 6]), Section("narrow", (), [["name"] * 6, ["1"] * 6])]
    wide, narrow = map(section_lines, page)
    assert max(map(len, wide)) <= TABLE_COLUMNS
    assert " ".join(wide).split().count("long") == 6
    assert len(narrow) == 4  # heading, rule, head and row
    assert b"/Type /Page" in pdf_document("t", page)


def test_the_worst_blade_is_set_as_a_symbol():
    assert b"<i>P</i><sub><i>d</i>,worst</sub> of" in html_document("t", [Section("h", ["P_d_worst of it"])])


@pytest.mark.full
def test_motions_of_a_row_are_told_apart_by_their_copies():
    # Four blades in anti-phase beyond the loss of their wave's stability: the broken motion and its copies.
    scene = js.load("row_ring12", ["row.blades=4", "drive.engine_order=2", 'parts.motion=["x"]', "drive.omega=923"])
    resolved = resolve_options(scene, method=js.RungeKutta("dopri8", steps=60))
    march = plan_march(resolved, resolved.lanes, FAST)
    found = row_motions(scene.scene, 10, 0, march, 64, 32)
    assert 2 <= len(found.share) <= 4
    assert found.starts.sum() == np.sum(found.label >= 0) >= 8
    assert np.all(np.diff(found.starts) <= 0)
    assert_allclose(found.P_d, found.P_d[0], rtol=0, atol=1e-3)  # copies have one power, once settled
    assert found.distance.min() > 0.1
    assert np.ptp(found.x_peak, axis=1).min() > 0.1 * found.x_peak.mean()  # control: no motion is the wave


@pytest.fixture
def small(monkeypatch):
    """A report with few values over gap and frequency."""
    monkeypatch.setattr(sys.modules["jaxshroud.verbs.report"], "GAPS", 3)
    monkeypatch.setattr(sys.modules["jaxshroud.verbs.response"], "VALUES", 3)


@pytest.mark.release
@pytest.mark.full
def test_a_report_of_a_chain_of_two_has_the_numbers_of_the_pair(small, tmp_path):
    chain, how = (
        js.load("row_ring12", [*DAMPED, *CHAIN_OF_TWO, UNLIKE]),
        {"n_periods": 4, "transient": 32, "method": METHOD},
    )
    pair = js.sweep(
        js.load("table1", [*DAMPED, *PAIR, UNLIKE]).scene, {"drive.F_0": [60.0]}, forces=True, amplitudes=True, **how
    )
    reductions, of_all = power_reduction(pair.P, pair.P_0)[0], power_reduction(pair.P.sum(), pair.P_0.sum())
    required = (reductions.min() + of_all) / 2
    asked = {"scatters": {"row.mistuning": 0.02}, "at_least": required, "of": "P_d_worst", "most_force": 1e-3}
    found = js.report(chain, draws=2, starts=2, **asked, **how)
    # Rounding alone: sums are taken in another order.
    assert float(found.run.P_d_worst) == pytest.approx(reductions.min(), rel=1e-9)
    assert_allclose(found.run.x_peak, pair.x_peak[0], rtol=1e-9)
    run = found.diagnosis
    periods = (run.t.size - 1) / run.steps_per_period
    for got, want in ((run.slip[0], pair.slip), (run.loss_friction[0] / periods, pair.friction_work)):
        assert got == pytest.approx(float(want[0]), rel=1e-6)  # of other periods of a settled motion
    assert run.N.max() == pytest.approx(float(pair.N_max[0]), rel=1e-2)  # at the steps, and within them
    # What is asked of the worst blade fails where all blades together would do.
    assert found.verdict == "fails"
    assert any(reason.startswith("P_d_worst is") for reason in found.reasons)
    assert float(found.run.P_d) > required
    assert any(reason.startswith("the normal force reaches") for reason in found.reasons)
    told = {section.heading: section for section in found.sections}
    assert {"Natural modes", "Waves and localisation", "Blades", "Loads at the interfaces", "Scatter"} <= {*told}
    assert told["Blades"].table[1][0] == str(int(reductions.argmin()))
    assert len(told["Loads at the interfaces"].table) == 2
    for name in ("report.html", "report.pdf"):
        found.save(tmp_path / name)
    assert found.summary()["diagnosis"]["verdict"] == run.verdict
