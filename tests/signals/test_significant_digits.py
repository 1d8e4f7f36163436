"""Numbers have as many digits as their intervals leave."""

import math

import pytest

from jaxshroud.signals.effects import between, with_interval


@pytest.mark.parametrize(
    ("value", "half", "unit", "told"),
    [
        (51.18443210987654, 0.0011023, "%", "51.1844 % +- 0.0011 percentage points"),
        (51.18443210987654, 0.0996, "", "51.18 +- 0.10"),
        (51.18443210987654, 12.6, "", "51 +- 13"),
        (-51234.5, 234.0, "%", "-51230 % +- 230 percentage points"),
        (0.02, 140.0, "", "0 +- 140"),
        (5.02345e-12, 3e-14, "m^4", "5.023e-12 +- 0.030e-12 m^4"),
        (5.02345e9, 3e7, "", "5.023e+09 +- 0.030e+09"),
        (51.18443210987654, 0.0, "%", "51.1844 %"),  # on an orbit
        (51.18443210987654, 1e-9, "%", "51.1844 %"),  # rounding
        (51.18443210987654, math.nan, "%", "51.1844 % (interval unknown)"),
        (-math.inf, math.nan, "", "-inf"),
        (0.0, 0.0, "", "0"),
        (0.0, 3e-9, "", "0.0e-09 +- 3.0e-09"),
    ],
)
def test_a_number_has_the_digits_that_its_interval_leaves(value, half, unit, told):
    assert with_interval(value, half, unit) == told


@pytest.mark.parametrize(
    ("value", "low", "high", "told"),
    [
        (0.51234567, 0.43712, 0.58745, "0.512 (0.437 to 0.587)"),
        (1.0, 0.9716, 1.0, "1.000 (0.972 to 1.000)"),
        (0.5, 0.5, 0.5, "0.5 (0.5 to 0.5)"),
        (math.nan, math.nan, math.nan, "nan (nan to nan)"),
    ],
)
def test_ends_of_an_interval_have_the_same_digits(value, low, high, told):
    assert between(value, low, high) == told
