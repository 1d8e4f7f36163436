"""A seeded sample of the reading study, and its verdict on labels that are known."""

import json

import numpy as np
import pytest
import reading
import reading_friction
import reading_scenes
import reading_verdict
from reading_friction import CLAIMS, GAPS, PLACES, Times
from reading_report import PLAUSIBLE
from reading_scenes import FIG10, FIG12, FIG14, POINTS, columns
from reading_verdict import LABELS, Found

from jaxshroud import load
from jaxshroud.scene.text import numbers_of

pytestmark = pytest.mark.studies


def test_some_readings_give_what_is_stored():
    # Other machines round otherwise, which chaos and slow transients show: few labels may differ, and P_d by little.
    rows, rng = reading_scenes.readings(), np.random.default_rng(5)
    alike = [i for i, row in enumerate(rows) if (row.formulas, row.angles) == ("consistent", "as drawn")]
    some, at = rng.choice(alike, 24, replace=False), columns([*FIG10, *FIG14])
    got, kept = reading.simulated([rows[i] for i in some], [POINTS[i] for i in at]), reading.stored()
    assert np.mean(got.period == kept.period[some][:, at]) > 0.9
    assert np.nanmedian(np.abs(got.P_d - kept.P_d[some][:, at])) < 0.1


def test_the_default_reading_is_table_1_but_for_its_moment():
    row = reading_scenes.Reading(M_0=100.0)
    got = numbers_of(reading_scenes.scenes([row], [reading_scenes.Point(gamma=2.5)]))
    for key, want in numbers_of(load("fig10b").scene).items():
        np.testing.assert_allclose(got[key][0], want, rtol=1e-14, err_msg=key)


def test_eq21_is_among_the_readings():
    row = reading_scenes.Reading(equation=reading_scenes.LITERAL, M_0=5.0)
    got = numbers_of(reading_scenes.scenes([row], [reading_scenes.Point(gamma=2.5)]))
    for key, want in numbers_of(load("eq21").scene).items():
        np.testing.assert_allclose(got[key][0], want, rtol=2e-5, err_msg=key)  # that file's five digits


def drawn(readings: int) -> Found:
    """Period numbers at random, more often 1 or chaos than not, as in the study."""
    shape = readings, len(POINTS)
    period = np.random.default_rng(1).choice([0, 1, 2, 3, 4], p=[0.35, 0.35, 0.2, 0.05, 0.05], size=shape)
    return Found(period, np.zeros(shape), np.zeros(shape))


def test_random_readings_are_no_evidence():
    said = reading_verdict.verdict(drawn(2000), draws=500)
    assert said.word == "undetermined"
    assert said.choice.observed >= 5  # the best of many meets most labels all the same
    assert said.choice.p > 0.2


def test_a_planted_reading_is_found():
    found = drawn(300)
    for points, name in ((FIG10, "Fig. 10"), (FIG14, "Fig. 14"), (FIG12[3], "Fig. 12")):
        found.period[7, columns(points)] = LABELS[name]
    said = reading_verdict.verdict(found, draws=2000)
    assert said.chosen.tolist() == [7]
    assert max(said.choice.p, said.judged.p, said.all_labels.p) < 0.06  # 1 order of 24 meets all labels of a figure


def shares(stick, slip):
    """One reading with these shares of the time at all places, and a P_d that is largest at gamma = 2.5."""
    whole = np.ones((1, len(PLACES)))
    P_d = np.where(np.arange(len(PLACES)) == 3, 50.0, 40.0)[None]
    return Times(P_d, (1 - stick - slip) * whole, stick * whole, slip * whole)


def borne_out(found):
    """The claims that one reading bears out altogether."""
    return {name for name, shown in reading_friction.claims(found).items() if shown.all()}


def test_claims_on_friction_are_told_apart():
    assert set(reading_friction.claims(shares(0.1, 0.1))) == set(CLAIMS)
    mixed = shares(0.2, 0.3)
    assert borne_out(mixed) == {"3.3.1, best", "3.3.2, no pure stick"}
    mixed.stick[:, [8, 9, 16, 17]] = 0.4  # gamma = 15 and 30, F_0 = 90 and 200 N
    mixed.apart[:, GAPS[:, -1]] = 1.0
    assert borne_out(mixed) == set(CLAIMS)
    assert borne_out(shares(0.3, 0.0)) == set()  # pure stick
    assert borne_out(shares(0.0, 0.0)) == {"3.3.2, no pure stick", "3.3.2, apart"}  # no contact is no stick


def test_friction_of_the_plausible_reading_is_what_is_stored():
    # Shares in chaos are those of other trajectories on other machines; the article's claims are not.
    kept = json.loads(reading.HERE.with_suffix(".json").read_text("utf-8"))["friction"]
    got = reading_friction.times([PLAUSIBLE])
    assert borne_out(got) == set(kept["plausible"]["borne out"])
    stored = [row["stick in contact"] for row in kept["plausible"]["over gamma"]]
    np.testing.assert_allclose(got.stick_in_contact[0, : len(stored)], stored, atol=0.03)
