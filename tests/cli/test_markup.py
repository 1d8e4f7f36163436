"""What comes from outside is shown as it is: neither markup nor anything that a terminal obeys."""

import pytest

from jaxshroud.cli.terminal import files_written, one_line, print_table
from jaxshroud.io import files


@pytest.mark.parametrize("text", ["a [/b] c", "disp [mm]", "[bold]no[/bold]"])
def test_a_table_shows_titles_and_values_as_they_are(text, capsys):
    print_table(text, {text: text})
    assert capsys.readouterr().out.count(text) == 3


def test_what_a_terminal_obeys_is_not_passed_on(capsys):
    print_table("a\x1b[2Jb", {"k": "\x1b]0;title\x07"})
    assert "\x1b" not in capsys.readouterr().out
    assert "\x1b" not in one_line(ValueError("unknown flag --\x1b[31mred"))


def test_numbers_of_a_table_have_no_sixteen_digits(capsys):
    print_table("t", {"a": 0.1 + 0.2, "b": {"c": 1 / 3}, "d": [2 / 3, 1], "e": [], "n": 123456789})
    words = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[1:]]
    assert [(name, value.strip()) for name, value in words] == [
        ("a", "0.3"),
        ("b", "c: 0.333333"),
        ("d", "0.666667, 1"),
        ("e", "none"),
        ("n", "123456789"),
    ]


def test_written_names_the_files(tmp_path):
    with files.results_together():
        for name in ("sweep.nc", "summary.json"):
            files.write(tmp_path / name, b"a")
        assert files_written() == f"sweep.nc, summary.json in {tmp_path}"
