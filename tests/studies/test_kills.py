"""A seeded sample of the study of killed sweeps."""

import kills
import numpy as np
import pytest

pytestmark = pytest.mark.studies


@pytest.mark.parametrize(("direction", "lanes"), [("independent", 2_000), ("both", 100)])
def test_a_killed_sweep_ends_with_the_same_bytes(tmp_path, direction, lanes):
    # 2,000 lanes are two blocks, 100 values in three directions six; of two kills one store at least is gone on with.
    found = kills.killed(lanes, 2, np.random.default_rng(3), tmp_path, direction)
    assert found["kills"] == 2
    for store in found["stores"]:
        assert store["identical"]
        assert store["computed_again"] == 0


@pytest.mark.parametrize("study", [kills.renamed, kills.at_once])
def test_kills_at_renames_and_second_processes_change_no_byte(tmp_path, study):
    found = study(50, 1, np.random.default_rng(3), tmp_path)
    assert [store["identical"] for store in found["stores"]] == [True]
