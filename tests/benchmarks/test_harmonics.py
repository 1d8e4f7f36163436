"""Harmonic balance beside the march on four published peaks; no time counts."""

import json

import harmonics
import numpy as np
import pytest
from peers import pyharm_balance


@pytest.mark.benchmark
def test_harmonics_of_two_codes():
    # The same equations at the same instants, solved to 1e-8: pyHarm's peaks are those of the plain solver.
    harmonics.main([])
    found = json.loads(harmonics.RESULTS.read_text())["ways"]
    for number in () if pyharm_balance.missing() else (1, 8, 31):
        plain, other = (found[f"{name}, {number}"]["peaks"] for name in ("plain", pyharm_balance.NAME))
        np.testing.assert_allclose(other, plain, rtol=1e-6)


@pytest.mark.release
@pytest.mark.full
def test_a_small_run_of_harmonics_is_written_and_printed(tmp_path, capsys):
    harmonics.main(["--harmonics", "1", "--rounds", "1"], tmp_path / "harmonics.json")
    found = json.loads((tmp_path / "harmonics.json").read_text())
    assert {"orbit", "plain, 1"} <= set(found["ways"])
    assert found["ways"]["orbit"]["error"] < 1e-6 < 1e-3 < found["ways"]["plain, 1"]["error"]
    printed = capsys.readouterr().out
    assert all(name in printed for name in [*found["ways"], *found["absent"].values()])
