"""A sample of the study of loads, and that it can fail."""

import load_cases
import numpy as np
import pytest

pytestmark = pytest.mark.studies


@pytest.mark.parametrize(("seed", "is_row"), [(1001, False), (1002, False), (2001, True)])
def test_marches_are_those_of_the_plain_integrator(seed, is_row):
    found = load_cases.kept_references()[f"{'rows' if is_row else 'pairs'}{seed}"]
    told = load_cases.compared(seed, is_row, found)
    assert told["counts equal"]
    assert told["events"] > 5
    assert told["error"] < load_cases.AGREES


@pytest.mark.parametrize("name", ["harmonics", "mean", "B", "gap_at"])
def test_a_load_that_is_left_out_is_seen(name, monkeypatch):
    # Control: the same references, but a march without the last order, mean loads, growth or untwist.
    p, of = load_cases.drawn(1001, False)
    less = {
        "harmonics": of.harmonics[:-1],
        "mean": 0 * of.mean,
        "B": 0 * of.B,
        "gap_at": np.array(p.gap),
    }
    monkeypatch.setattr(load_cases, "drawn", lambda *_: (p, of._replace(**{name: less[name]})))
    told = load_cases.compared(1001, False, load_cases.kept_references()["pairs1001"])
    assert told["error"] > 1e-4


def test_references_are_found_again():
    kept, again = load_cases.kept_references()["pairs1003"], load_cases.by_reference(1003, False)
    np.testing.assert_allclose(again["states"], kept["states"], rtol=0, atol=1e-9 * np.abs(kept["states"]).max())
    assert again["counts"].tolist() == kept["counts"].tolist()
