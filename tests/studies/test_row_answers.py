"""A sample of the study of rows of blades."""

import pytest
import rows

pytestmark = pytest.mark.studies


def test_chains_of_two_are_the_pair():
    told = rows.pairs(48)
    assert told["all"]["alike statuses"]
    assert told["rows"] >= 20
    assert told["beyond"] == 0


def test_rows_of_more_blades_are_those_of_the_second_opinion():
    told = rows.opinions(range(2, 4))
    assert told["beyond"] == told["events counted otherwise"] == 0


@pytest.mark.release
def test_energy_of_random_rows():
    told = rows.energy(16, ((4, True),), periods=4)
    assert told["beyond"] == 0
