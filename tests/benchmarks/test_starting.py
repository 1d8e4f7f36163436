"""How long commands take to start."""

import json

import pytest
import start


@pytest.mark.benchmark
def test_start():
    start.main(["--all"])


@pytest.mark.full
@pytest.mark.parametrize("cold", [False, True], ids=["warm", "cold"])
def test_the_table_has_every_command_of_both_checkouts(cold, tmp_path, capsys):
    words = ["--help", "scenes"]
    for name in words:
        assert name in start.CASES
    start.main(["--rounds", "1", "--against", str(start.HERE), *(["--cold"] if cold else []), "scenes"], tmp_path / "a")
    found = json.loads((tmp_path / "a").read_text())["cold" if cold else "warm"]
    for label in ("here", "against"):
        assert set(found[label]) == {start.BASE, "scenes"}
        assert all(times["processor"] > 0 for times in found[label].values())
    assert "scenes" in capsys.readouterr().out


@pytest.mark.full
def test_a_command_that_fails_gives_no_figures(tmp_path):
    (tmp_path / "jaxshroud.py").write_text("raise SystemExit('broken')")
    with pytest.raises(RuntimeError, match=r"scenes of .* ended with 1: broken"):
        start.main(["--rounds", "1", "--against", str(tmp_path), "scenes"], tmp_path / "a")


def test_a_budget_is_held_against_the_ratio_that_it_is_of():
    case = start.Case("", 3.0, cold=0.7)
    assert start.budget_text(case, False, [2.9]) == "3"
    assert start.budget_text(case, False, [3.1, 0.5]) == "3 (over)"
    assert start.budget_text(case, True, [9.0, 0.6]) == "0.7"
    assert start.budget_text(case, True, [9.0, 0.8]) == "0.7 (over)"
    assert start.budget_text(case, True, [9.0]) == start.budget_text(start.Case(""), False, [9.0]) == ""
