"""A seeded sample of the study of killed sweeps."""

import kills
import numpy as np
import pytest

pytestmark = [
    pytest.mark.studies,
    # Other tests of this process have used JAX, which warns of any fork; these processes run a command at once.
    pytest.mark.filterwarnings(r"ignore:os.fork\(\) was called:RuntimeWarning"),
]


@pytest.mark.release
def test_a_killed_sweep_ends_with_the_same_bytes(tmp_path):
    # 2,000 lanes are two blocks; of two kills one store at least is gone on with. All directions are killed below.
    found = kills.killed(2_000, 2, np.random.default_rng(3), tmp_path)
    assert found["kills"] == 2
    for store in found["stores"]:
        assert store["identical"]
        assert store["computed_again"] == 0


@pytest.mark.release
@pytest.mark.full(but=["at_once"])
@pytest.mark.parametrize("study", [kills.renamed, kills.at_once])
def test_kills_at_renames_and_second_processes_change_no_byte(tmp_path, study):
    found = study(12, 1, np.random.default_rng(3), tmp_path)
    assert [store["identical"] for store in found["stores"]] == [True]
