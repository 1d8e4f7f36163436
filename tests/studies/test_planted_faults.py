"""The faults that guard the tests can still be planted, and each was caught where the record says so."""

import json

import pytest
from planted_faults import FAULTS, ROOT, STORED


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_fault_can_be_planted(fault):
    source = (ROOT / "jaxshroud" / fault.file).read_text()
    assert source.count(fault.right) == 1


def test_every_fault_is_caught():
    assert {name: one["by"] for name, one in json.loads(STORED.read_text()).items()}.keys() == FAULTS.keys()
