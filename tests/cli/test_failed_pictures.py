"""A picture that cannot be drawn costs nothing else: it is one line at the very end, with exit status 1."""

import pytest
from command_line import run, status_of

TUNE = "--set parts.motion=[x] --periods 2 --transient 2 --steps-per-period 100"
TUNE += " --over contact.gamma=1:2 --scan 4 --starts 1 --updates 1"


@pytest.mark.parametrize(
    ("command", "words", "written"),
    [
        ("check", "", ["check.json", "check.nc"]),
        pytest.param("tune", TUNE, ["best.toml", "tune.json", "tune.nc"], marks=pytest.mark.full, id="tune"),
    ],
)
def test_a_picture_that_fails_is_told_at_the_end(command, words, written, tmp_path, monkeypatch, capsys):
    def save_figure(figure, *paths, dpi):
        raise ValueError("All-NaN slice encountered")

    monkeypatch.setattr("jaxshroud.plotting.style.save_figure", save_figure)
    out = tmp_path / "out"
    assert status_of(f"{command} table1 {words} --out {out}") == 1
    assert sorted(path.name for path in out.iterdir()) == written
    told = capsys.readouterr()
    *_, last = told.err.splitlines()
    assert last == f"{out / command}.png: cannot be drawn (All-NaN slice encountered)"
    assert "Traceback" not in told.err
    assert all(name in told.out for name in written)  # the table of the result is printed before
    run("scenes")  # the next command does not fail for it
