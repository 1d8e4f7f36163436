"""A seeded sample of the study of verdicts."""

import pytest
import verdicts

pytestmark = pytest.mark.studies


@pytest.mark.release
def test_verdicts_are_those_of_long_runs(monkeypatch):
    monkeypatch.setattr(verdicts, "LONGER", 5)
    monkeypatch.setattr(verdicts, "CHAOS", 200)
    rows = verdicts.compared("table1", verdicts.family_of("table1", 5, 77))
    known = [row for row in rows if row["truth"] != "neither"]
    assert len(known) >= 4
    assert sum(row["judged"] == "wrong" for row in known) == 0
    assert sum(row["judged"] == "undecided" for row in known) <= 1
    assert {verdicts.class_of(row["truth"]) for row in known} >= {"period 1", "chaotic"}
