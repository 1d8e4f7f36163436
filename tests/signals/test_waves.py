"""The distance of a row's motion from a travelling wave, on motions whose distance is known."""

import numpy as np
import pytest

from jaxshroud.signals.waves import row_wave

STEPS, BLADES, EO = 40, 4, 2
RATE = float(STEPS)  # samples in a drive period
ROUNDING = 1e-24  # of a share: squares of 1e-16 of the amplitude, summed over some hundred samples


def wave(harmonics, blades=BLADES, order=EO, periods=8):
    """A travelling wave of an engine order, (time, blades), of harmonics n with their amplitudes."""
    t, i = 2 * np.pi * np.arange(STEPS * periods + 1)[:, None] / STEPS, np.arange(blades)
    phase = t + 2 * np.pi * order * i / blades
    return sum(a * np.cos(n * phase + n) for n, a in harmonics.items())


def share(x, order=EO):
    return row_wave({"x": x}, RATE, order).distance.share


OWN = wave({1: 1e-4, 2: 2e-5, 3: 1e-5})
SQUARE = (1e-8 + 4e-10 + 1e-10) / 2  # its mean square


def test_a_wave_of_the_drive_has_no_distance():
    assert share(OWN) < ROUNDING
    assert share(OWN, EO + BLADES) < ROUNDING  # engine orders are alike modulo N
    assert share(OWN + 3e-3) == pytest.approx(
        share(OWN), abs=1e-20
    )  # a deflection of all blades alike: rounding of 3 mm


def test_a_wave_of_another_order_is_outside_altogether():
    # Its largest nodal diameters are one of each harmonic too, but not those of the drive.
    other = wave({1: 1e-4, 3: 1e-5}, order=1)
    assert share(other) == pytest.approx(1.0, abs=1e-12)


def test_means_that_differ_are_outside():
    offset = 4.4e-6 * (-1.0) ** np.arange(BLADES)
    assert share(OWN + offset) == pytest.approx(4.4e-6**2 / (4.4e-6**2 + SQUARE), rel=1e-9)


def test_a_harmonic_at_another_diameter_is_outside():
    # One nodal diameter for each harmonic, but 2 for the second where the drive's wave has 0.
    i, t = np.arange(BLADES), 2 * np.pi * np.arange(8 * STEPS + 1)[:, None] / STEPS
    mixed = wave({1: 1e-4}) + 5e-5 * np.cos(2 * t + 2 * np.pi * 2 * i / BLADES)
    assert share(mixed) == pytest.approx(0.25 / 1.25, rel=1e-9)


def test_a_subharmonic_of_one_blade_is_outside():
    # A half of the drive's frequency on one blade alone is at all nodal diameters alike; a wave of two periods explains
    # one of them.
    half = np.zeros_like(OWN)
    half[:, 0] = 2e-5 * np.cos(np.pi * np.arange(len(OWN)) / STEPS)
    square = 4e-10 / 2 / BLADES
    found = row_wave({"x": OWN + half}, RATE, EO)
    assert found.periods == 2
    assert found.distance.share == pytest.approx(square * (1 - 1 / BLADES) / (SQUARE + square), rel=1e-9)


def test_a_wave_of_two_periods_is_one_by_the_shift_that_closes_the_row():
    # Three blades under engine order 1: a shift of 4 T / 3 closes after 4 T, two whole orbits.
    double = wave({1: 1e-4}, blades=3, order=1) + wave({0.5: 3e-5, 1.5: 1e-5}, blades=3, order=4)
    found = row_wave({"x": double}, RATE, 1)
    assert (found.periods, found.distance.shift) == (2, 4)
    assert found.distance.share < ROUNDING
    assert "2 periods (each blade ahead of its neighbour by 4 T/N)" in found.words
    # Four blades under engine order 1: neither 1 nor 5 is even, so that no wave of two periods exists.
    halves = wave({1: 1e-4}, order=1) + wave({0.5: 3e-5}, order=1)
    none = row_wave({"x": halves}, RATE, 1)
    assert none.distance.shift is None
    assert none.distance.share == pytest.approx(9e-10 / (1e-8 + 9e-10), rel=1e-9)
    assert "no wave fits the row" in none.words


def test_the_displacement_that_is_furthest_counts():
    moves = {"x": OWN, "y": 0.1 * OWN + 1e-6 * (-1.0) ** np.arange(BLADES), "theta": 1e-19 * wave({1: 1.0}, order=1)}
    found = row_wave(moves, RATE, EO)
    assert found.name == "y"  # theta, which is rounding, does not count
    assert found.distance.share == pytest.approx(1e-12 / (1e-12 + 0.01 * SQUARE), rel=1e-9)


def test_a_motion_that_never_repeats_is_no_wave():
    golden = (1 + np.sqrt(5)) / 2
    found = row_wave({"x": OWN + wave({golden: 5e-5})}, RATE, EO)
    assert not found.repeats
    assert found.distance.share == pytest.approx(0.25 / 1.25, rel=0.3)  # frequencies of four periods leak
    assert "does not repeat" in found.words


@pytest.mark.parametrize(
    ("x", "order", "reason"),
    [
        (OWN, None, "no engine order"),
        (np.where(np.arange(len(OWN))[:, None] > 200, np.nan, OWN), EO, "has stopped"),
        (np.full_like(OWN, 1e-3), EO, "nothing moves"),
        (OWN[:STEPS], EO, "one period"),
    ],
)
def test_without_a_wave_there_is_a_reason(x, order, reason):
    found = row_wave({"x": x}, RATE, order)
    assert np.isnan(found.distance.share)
    assert reason in found.words
