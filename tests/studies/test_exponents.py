"""A seeded sample of the study of exponents."""

import exponents
import pytest

pytestmark = pytest.mark.studies


def test_intervals_hold_the_floquet_exponent():
    rows = exponents.periodic(3, seed=2)
    assert sum(r["held"] for r in rows) >= 2
    assert all(r["ci"] < 0.1 for r in rows)
