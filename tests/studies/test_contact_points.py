"""Seeded samples of the studies of faces with several points."""

import sys
from pathlib import Path

import point_derivatives
import point_energy
import pytest

pytestmark = [pytest.mark.studies, pytest.mark.full]


def test_derivatives_are_those_of_differences():
    found = point_derivatives.figures("light pair, two points", 1, 7)
    assert found["within 1e-6"] == found["derivatives"], found["scenes"]


def test_energy_balances():
    found = point_energy.figures("pairs", 8)
    assert found["balanced"] == found["scenes"], found["residuals"]
    # Control: with few steps it does not.
    coarse = point_energy.residuals(point_energy.random_scenes(*point_energy.STRUCTURES["pairs"][0], 4, 0), 60)[0]
    assert coarse.max() > 100 * point_energy.BALANCES


@pytest.mark.parametrize("method", ["RUNGE_KUTTA", "SERIES"])
def test_marches_agree_with_independent_ones(method):
    import points

    sys.path.append(str(Path(__file__).parent.parent / "march"))
    found = points.compared(points.random_scene(100, False), getattr(points, method))
    assert found["error"] < points.AGREES or found["error"] < 100 * found["nudged"], found
    assert found["counts equal"]
