"""The faults that guard the tests can still be planted, and of each it is known what catches it."""

import json

import pytest
from planted_faults import FAULTS, ROOT, STORED


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_fault_can_be_planted(fault):
    source = (ROOT / "jaxshroud" / fault.file).read_text()
    assert source.count(fault.right) == 1


def test_every_fault_has_a_record():
    assert json.loads(STORED.read_text()).keys() == FAULTS.keys()
