"""A seeded sample of the study of the derivatives of rows."""

import pytest
import row_derivatives

pytestmark = [pytest.mark.studies, pytest.mark.full]


def test_derivatives_of_rows_are_those_of_differences():
    found = row_derivatives.figures(row_derivatives.STRUCTURES["ring of 3, x and y"], 1, 7)
    assert found["within 1e-6"] == found["derivatives"], found["rows"]
