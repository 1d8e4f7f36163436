"""A seeded sample of the study of branches."""

import branches
import pytest

pytestmark = pytest.mark.studies


def test_folds_and_flips_are_where_sweeps_change():
    found = branches.studied([one for one in branches.drawn(20, branches.SEED) if one.model == branches.X_RIGID[0]][:4])
    assert sum(found["compared"].values()) >= 1
    assert found["agree"] == found["compared"]
    assert found["largest closing error of unstable orbits"] <= 1e-9
