"""A seeded sample of the study of coverage."""

import coverage
import pytest

pytestmark = pytest.mark.studies
SAMPLE, LEAST = 200, 0.93 - 2 * 0.015  # two standard deviations of so many replications


def test_intervals_of_given_length_hold_the_mean():
    for name, told in coverage.fixed_lengths(SAMPLE).items():
        if not name.endswith("n 64"):
            assert told["coverage"] >= LEAST, name
            assert told["half width over ideal"] <= 2, name
        else:
            assert told["coverage"] >= 0.9 or told["flagged as short"] >= 0.97, name


def test_stopped_runs_hold_the_mean():
    for name, told in coverage.stops(SAMPLE, 4096).items():
        assert told["coverage"] >= LEAST, name
        assert told["half width over ideal"] <= 2, name
        assert told["stable below 30 correlation times"] <= 0.05, name


def test_other_series_hold_the_mean():
    for name, told in coverage.others(SAMPLE, 4096).items():
        assert told["coverage"] >= LEAST, name
