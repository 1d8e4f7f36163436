"""A sample of `misuse.py`."""

import misuse
import pytest

pytestmark = pytest.mark.studies


def test_wrong_types_are_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["True", "''", "[None]"]
    wrong = [
        one for one in misuse.outcomes(misuse.targets(), {word: misuse.WRONG[word] for word in words}) if one.fault
    ]
    wrong = [one for one in wrong if one.ended != "TypeCheckError"]  # the tests' own type checks come first
    assert not wrong
