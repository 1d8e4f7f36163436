"""A sample of `foreign_files.py`."""

import foreign_files
import pytest

pytestmark = pytest.mark.studies


def test_nothing_foreign_is_lost_altered_or_waited_for():
    assert not [(kind, fault) for kind, fault, _ in foreign_files.outcomes(20, 40, seed=2) if fault]
