"""What comes from outside is shown as it is: neither markup nor anything that a terminal obeys."""

import pytest

from jaxshroud.cli.terminal import one_line, print_table


@pytest.mark.parametrize("text", ["a [/b] c", "disp [mm]", "[bold]no[/bold]"])
def test_a_table_shows_titles_and_values_as_they_are(text, capsys):
    print_table(text, {text: text})
    assert capsys.readouterr().out.count(text) == 3


def test_what_a_terminal_obeys_is_not_passed_on(capsys):
    print_table("a\x1b[2Jb", {"k": "\x1b]0;title\x07"})
    assert "\x1b" not in capsys.readouterr().out
    assert "\x1b" not in one_line(ValueError("unknown flag --\x1b[31mred"))
