"""The commands `branch`, `attractors` and `basins`, and sweeps in both directions."""

import pytest
from command_line import read_json, run

SCENE = "table1 --set parts.motion=[x] --set blades.c_x=5 --steps-per-period 100"
RANGE = "--along contact.gamma --start 2 --stop 2.6"


@pytest.mark.release(only=["branch-branch.nc"])  # the command is on its page, which tests/test_docs.py runs
@pytest.mark.full
@pytest.mark.parametrize(
    ("words", "files"),
    [
        (f"branch {SCENE} {RANGE} --num 4 --periods 8", "branch.nc branch.png sweep.nc"),
        (f"attractors {SCENE} --starts 8", "attractors.nc attractors.png"),
        (f"basins {SCENE} --num 2 --start=-1mm,-0.5 --stop=1mm,0.5", "basins.nc basins.png"),
        (f"sweep {SCENE} {RANGE} --num 4 --periods 16 --direction both", "sweep.nc sweep.png"),
    ],
    ids=lambda words: words.split()[0],
)
def test_a_command_writes_its_files_and_they_can_be_drawn_again(words, files, tmp_path, capsys):
    run(f"{words} --out {tmp_path}/out")
    summary = read_json(tmp_path / "out" / "summary.json")
    assert summary["scene"] == "table1.toml"
    for name in files.split():
        assert (tmp_path / "out" / name).stat().st_size > 0
    run(f"plot {tmp_path}/out --out {tmp_path}/again.pdf")
    assert (tmp_path / "again.pdf").read_bytes().startswith(b"%PDF")
