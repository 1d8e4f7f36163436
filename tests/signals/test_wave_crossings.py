"""Special points between travelling waves: which multiplier of the reduced map passes the unit circle, and where."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxshroud.orbits.bifurcation import breaking_outside, crossings
from jaxshroud.orbits.branch import BranchPoint
from jaxshroud.orbits.travelling_wave import WAVE_RESIDUAL, TravellingWave, WaveSymmetry, wave_bifurcation

HELD = [0.5, 0.3 + 0.2j, 0.3 - 0.2j]  # multipliers that stay within


def point(blades, *reduced, residual=0.0):
    """A travelling wave with some multipliers of its reduced map, and its tangent along the parameter."""
    multipliers = np.array([*reduced, *HELD])
    cycle = SimpleNamespace(P=np.ones(blades), others=multipliers**blades)
    wave = TravellingWave(WaveSymmetry(blades, 1), residual, multipliers, multipliers)
    return BranchPoint(np.zeros(1), 0.0, cycle, (False,), np.ones(1), 0, wave=wave)  # pyright: ignore[reportArgumentType]


def kinds(blades, before, after, **of):
    here, there = (point(blades, *reduced, **of) for reduced in (before, after))
    return [kind for kind, _ in crossings(here, there)]


@pytest.mark.parametrize(
    ("blades", "before", "after", "found"),
    [
        (4, [-0.9], [-1.1], ["localisation"]),
        (3, [-0.9], [-1.1], ["flip"]),  # all blades stay alike in the wave of twice the period
        (4, [0.9], [1.1], ["branch point"]),  # which keeps the shift
        (4, [0.9j, -0.9j], [1.1j, -1.1j], ["localisation"]),
        (3, [0.9j, -0.9j], [1.1j, -1.1j], ["localisation"]),
        (4, [-0.9, 0.95j, -0.95j], [-1.1, 1.2j, -1.2j], ["localisation", "localisation"]),
        (4, [-0.8], [-0.9], []),
    ],
)
def test_what_breaks_the_shift_is_told_from_what_keeps_it(blades, before, after, found):
    assert kinds(blades, before, after) == found


def test_what_is_no_travelling_wave_has_the_kinds_of_the_period():
    # Control: to the fourth power -1 is 1, and i too, twice, where no determinant changes its sign.
    other = {"residual": 10 * WAVE_RESIDUAL}
    assert kinds(4, [-0.9], [-1.1], **other) == ["branch point"]
    assert "localisation" not in kinds(4, [0.9j, -0.9j], [1.1j, -1.1j], **other)


def test_crossings_of_several_multipliers_are_located_one_by_one():
    # By rank, whatever multiplier is nearest to the circle: the leading one is 10 %, the next 2 % outside.
    sizes = [breaking_outside(rank)(point(4, -1.1, 1.02j, -1.02j)) for rank in range(4)]
    np.testing.assert_allclose(sizes[:2], [0.1, 0.02], rtol=1e-12)
    assert sizes[3] == -1.0  # there is none


@pytest.mark.parametrize(
    ("blades", "lead", "kind"),
    [(4, 0.9, "fold"), (4, -0.9, "localisation"), (3, -0.9, "flip"), (3, 0.9j, "localisation")],
)
def test_an_orbit_tells_what_its_leading_multiplier_approaches(blades, lead, kind):
    found, distance = wave_bifurcation(np.array([lead, *HELD]), blades)
    assert found == kind
    assert distance == pytest.approx(0.1)
