"""A seeded sample of the study of accuracies by the corner and by points."""

import promises_points
import pytest

pytestmark = pytest.mark.studies


def test_light_faces_of_two_points_keep_an_accuracy_without_trials():
    found = promises_points.told(promises_points.by_points(promises_points.drawn(3, 5)), 1e-6)
    assert found["promised"] == 0
    assert found["kept"] == 3, found
