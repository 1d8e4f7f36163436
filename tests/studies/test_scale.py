"""A small sample of the study of projections: it runs, and has every number. No time counts."""

import math

import projection
import pytest

pytestmark = pytest.mark.studies


def numbers(found) -> list[float]:
    """All of them."""
    if isinstance(found, dict):
        found = list(found.values())
    return [n for each in found for n in numbers(each)] if isinstance(found, list) else [float(found)]


@pytest.mark.release
def test_projections_are_compared_with_runs():
    found = projection.measured(66, 64, 8, 1)
    assert set(found) == {"memory", "time"}
    assert found["memory"]["lanes done"] >= 64
    assert found["memory"]["of"] == 66**2
    assert len(found["time"]["ratios"]) == len(found["time"]["runs"]) == 1
    assert all(n > 0 and math.isfinite(n) for n in numbers(found))
