"""A seeded sample of the reading study, and its verdict on labels that are known."""

import numpy as np
import pytest
import reading
import reading_scenes
import reading_verdict
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
