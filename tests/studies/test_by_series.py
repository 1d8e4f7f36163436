"""A seeded sample of the study of the march by power series."""

import numpy as np
import pytest
import series

pytestmark = pytest.mark.studies


def test_series_agree_with_the_second_opinion():
    # The kept opinions themselves move by up to 1e-9 between tolerances; the sample is formed by the code at hand.
    seeds = list(range(0, 1000, 8))
    opinion = series.Opinions(*(a[seeds] for a in series.kept()))
    runs = series.marched(seeds)
    difference, known = series.differences(runs, opinion.end, opinion.size), opinion.status == "ok"
    np.testing.assert_array_equal(np.isfinite(difference), known)
    suspects = known & (difference > series.NEAR)
    assert np.all(opinion.moved[suspects] > series.NEAR / 10)
    assert np.mean(suspects) < 0.02
    # The second opinion keeps no such balance: this is the march's own, to 1e-12 of the gross work.
    assert np.max(series.residuals(runs)[known]) <= 1e-12


def test_kept_opinions_are_those_of_the_second_opinion():
    seeds = [5, 500, 950]
    fresh, kept = series.told(seeds), series.Opinions(*(a[seeds] for a in series.kept()))
    np.testing.assert_array_equal(fresh.status, kept.status)
    # Plain Python rounds alike everywhere but in its libraries; impacts multiply that by some thousands.
    np.testing.assert_allclose(fresh.end / fresh.size, kept.end / kept.size, rtol=0, atol=1e-9)
