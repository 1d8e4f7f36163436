"""A sample of `fuzz.py`."""

import fuzz
import pytest

pytestmark = pytest.mark.studies


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of the damage done
def test_hostile_inputs_are_refused_in_one_line(tmp_path):
    (tmp_path / "made").mkdir()
    (tmp_path / "here").mkdir()
    of = fuzz.stored(tmp_path / "made")
    for one in fuzz.inputs(90, 7, of):
        got = fuzz.outcome(one, tmp_path / "here")
        assert got.fault is None, (one.kind, one.words, got)
