"""A seeded sample of the study of identification."""

import identify
import numpy as np
import pytest

pytestmark = pytest.mark.studies


@pytest.mark.release
def test_intervals_hold_the_numbers_and_are_not_too_wide():
    # 18 numbers, each in its interval with 95 %: 14 or fewer in one sample of a hundred.
    found = identify.figures(3, 0, seed=1)
    names = "covered", "error", "half width"
    covered, error, half = (np.array([one[name] for one in found["each"]]) for name in names)
    assert covered.sum() >= 15
    assert 0.009 < min(found["noise, least and largest"]) <= max(found["noise, least and largest"]) < 0.011
    # Control: intervals of a tenth of the noise hold few.
    assert np.sum(np.abs(error) <= 0.1 * half) <= 9
