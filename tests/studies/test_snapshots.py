"""A sample of the study of stored texts and programs, and controls."""

import pytest
import snapshot_commands
import snapshot_programs
import snapshots

pytestmark = pytest.mark.studies
COMMANDS = ("scenes", "sweep pair", "refused, trade of a row")
PROGRAMS = ("lowered/pair, x alone, rk4", "lowered/row, x alone, dopri8, bisection")


@pytest.fixture(scope="module")
def then():
    """What is stored, by versions as they are here."""
    if others := snapshots.other_versions():
        pytest.skip(f"stored by others: {others}")
    return snapshots.stored()


@pytest.fixture(autouse=True)
def terminal(monkeypatch):
    """One that is as wide as it was."""
    for name, value in snapshots.TERMINAL.items():
        monkeypatch.setenv(name, value)


def test_help_is_as_it_was(then):
    names = {name for name in then if name.startswith("help/")}
    assert names == snapshot_commands.helps().keys()
    for name, make in snapshot_commands.helps().items():
        assert not snapshots.difference(name, make(), then[name])


def test_commands_say_and_write_what_they_did(then, tmp_path):
    commands = snapshot_commands.Commands(tmp_path)
    for case in (case for case in snapshot_commands.CASES if case.name in COMMANDS):
        said, written = commands.run(case)
        assert not snapshots.difference(case.name, said, then[f"command/{case.name}"])
        assert not snapshots.difference(case.name, written, then.get(f"variables/{case.name}"))


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_are_lowered_as_they_were(name, then):
    assert not snapshots.difference(name, snapshot_programs.programs()[name](), then[name])


def test_a_changed_entry_is_told(monkeypatch):
    lines = ["exit status 0", "P_d 30.1 %"]
    program = {"sha256": "a", "operations": 3, "by name": {"stablehlo.add": 3}}
    assert not snapshots.difference("a", lines, list(lines))
    assert "+P_d 30.2 %" in snapshots.difference("a", ["exit status 0", "P_d 30.2 %"], lines)
    more = {**program, "sha256": "b", "operations": 4, "by name": {"stablehlo.add": 4}}
    assert '+  "stablehlo.add": 4' in snapshots.difference("a", more, program)
    monkeypatch.setattr(snapshots, "stored", lambda: {"command/a": lines, "command/gone": lines})
    monkeypatch.setattr(snapshots, "entries", lambda only: iter([("command/a", lines), ("command/new", lines)]))
    assert snapshots.compare().keys() == {"command/gone", "command/new"}


def test_names_of_functions_do_not_count():
    text = "func.func public @main(%a: f64) { call @{}(%a) }\nfunc.func private @{}(%a: f64)"
    first, second = (snapshot_programs.without_names(text.replace("@{}", name)) for name in ("@_where", "@chosen"))
    assert first == second
    assert first != snapshot_programs.without_names(text.replace("@{}", "@main"))
