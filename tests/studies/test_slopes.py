"""A seeded sample of the study of tangents against differences."""

import numpy as np
import pytest
import slopes

pytestmark = pytest.mark.studies


@pytest.mark.parametrize("name", ["bending in x", "four cases"])
def test_tangents_are_the_differences_that_are_known(name):
    found = slopes.figures(slopes.CASES[name], np.random.default_rng(6).uniform(1.0, 15.0, 8))
    assert found["known"] >= 0.9 * found["derivatives"], found["off"]
    assert found["largest error of those known"] < 1e-6
