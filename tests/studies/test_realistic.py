"""A seeded sample of the study of realistic blades."""

import pytest
import realistic

from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau
from jaxshroud.model.modes import Status

pytestmark = pytest.mark.studies
DOPRI8 = Choices(tableau("dopri8"), "cubic")


@pytest.mark.parametrize("steps", realistic.STEPS)
def test_realistic_blades_end_well(steps):
    found = realistic.figures(realistic.drawn(120, 12), 15, steps, DOPRI8)
    assert found["status"] == {Status.OK.name: found["scenes"]}
    assert found["in flat contact"] > 2
    assert found["dropped"]["1.0"] < 1e-6
    if steps == max(realistic.STEPS):
        assert found["residual"]["1.0"] < 1e-8
