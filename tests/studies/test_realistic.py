"""Seeded samples of the studies of realistic blades and of flat contact."""

import faces
import numpy as np
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


def test_flat_contact_is_the_limit_of_a_spring_between_the_faces():
    scenes, exact = faces.flat_scenes(60, 12, periods=1)
    slow = 1  # scene of these, which rocks against stiff springs for a minute of plain Python
    found = np.array([faces.differences(*one, periods=1) for one in zip(scenes[slow:], exact[slow:], strict=True)])
    known = found[np.isfinite(found).all(axis=1)]
    assert len(known) > 1
    assert np.median(known[:, 0] / known[:, -1]) > 10  # over two decades
    assert np.median(known[:, -1]) < 1e-2
