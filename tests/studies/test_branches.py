"""A seeded sample of the study of branches."""

import branches
import pytest

pytestmark = [pytest.mark.studies, pytest.mark.filterwarnings("ignore::jaxshroud.AccuracyWarning")]  # by 100 steps


@pytest.mark.release
def test_folds_and_flips_are_where_sweeps_change():
    scenes = branches.drawn(8, branches.SEED, [branches.X_RIGID])
    *_, found = branches.studied(scenes, 1)
    assert sum(found["compared"].values()) >= 1
    assert found["agree"] == found["compared"]
    assert found["largest closing error of unstable orbits"] <= 1e-9
