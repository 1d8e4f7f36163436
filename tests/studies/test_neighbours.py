"""A sample of the study of values and their neighbours."""

import neighbours
import pytest

pytestmark = pytest.mark.studies


def test_by_one_method_a_value_does_not_depend_on_its_neighbours():
    found = neighbours.study_of("x alone", 6)
    for size in (2, 17):
        assert found[f"method, {size}"] == {"bits": 0, "moved": 0, "settled": 0}
    assert found["method, 1"]["settled"] == 0
