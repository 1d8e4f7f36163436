"""A seeded sample of the study of accuracies by points and in rows."""

import promises_points
import pytest

pytestmark = pytest.mark.studies


def test_light_faces_of_two_points_keep_a_promised_accuracy():
    pairs = promises_points.pairs(3, 5)
    found = promises_points.told([promises_points.by_points(pair) for pair in pairs], [1e-6])["1e-06"]
    assert found["promised and judged"] == found["kept of these"] == 3, found


def test_rows_keep_a_promised_accuracy():
    found = promises_points.told(promises_points.rows(4, 6, light=False), [1e-6])["1e-06"]
    assert found["promised and judged"] == found["kept of these"] >= 3, found
