"""A seeded sample of the study of settling."""

import pytest
import settling

pytestmark = pytest.mark.studies


def test_yes_is_right_and_unknown_is_rare():
    rows = [settling.judged(run) for run in settling.runs(100, 1.0, settling.HEAVIEST, 64)]
    for told in settling.figures(rows).values():
        assert told["yes"] >= 20
        assert told["yes, but wrong"] <= 1
        assert told["share of unknown among these"] <= 0.15
