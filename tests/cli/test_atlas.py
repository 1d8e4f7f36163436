"""The commands `branch`, `attractors` and `basins`, and sweeps in both directions."""

import json

import pytest

from jaxshroud.cli import commands as cli

SCENE = ["table1", "--set", 'parts.motion=["x"]', "--set", "blades.c_x=5", "--steps-per-period", "100"]
RANGE = ["--along", "contact.gamma", "--start", "2", "--stop", "2.6"]


@pytest.mark.release(only=["branch-branch.nc"])  # the command is on its page, which tests/test_docs.py runs
@pytest.mark.full
@pytest.mark.parametrize(
    ("words", "files"),
    [
        (["branch", *SCENE, *RANGE, "--num", "4", "--periods", "8"], ["branch.nc", "branch.png", "sweep.nc"]),
        (["attractors", *SCENE, "--starts", "8"], ["attractors.nc", "attractors.png"]),
        (["basins", *SCENE, "--num", "2", "--start=-1mm,-0.5", "--stop=1mm,0.5"], ["basins.nc", "basins.png"]),
        (["sweep", *SCENE, *RANGE, "--num", "4", "--periods", "16", "--direction", "both"], ["sweep.nc", "sweep.png"]),
    ],
    ids=lambda words: words[0],
)
def test_a_command_writes_its_files_and_they_can_be_drawn_again(words, files, tmp_path, capsys):
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["scene"] == "table1.toml"
    for name in files:
        assert (tmp_path / "out" / name).stat().st_size > 0
    assert cli.main(["plot", str(tmp_path / "out"), "--out", str(tmp_path / "again.pdf")]) == 0
    assert (tmp_path / "again.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["branch", *SCENE, "--along", "contact.gamma"], "give --start and --stop"),
        (["branch", *SCENE, *RANGE, "--at", "9"], "outside of its range"),
        (["basins", *SCENE, "--plane", "x[0]"], "two numbers"),
        (["basins", *SCENE, "--start=-1mm"], "a value for each"),
    ],
)
def test_wrong_words_are_told_in_one_line(words, told, tmp_path, capsys):
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert told in error
    assert "\n" not in error
