"""Whether two motions are one."""

import numpy as np
import pytest

from jaxshroud.signals.orbit_distance import (
    SweptMotion,
    containing_set,
    fill_one_set,
    motions_differ,
    number_motions,
    set_distance,
    steep_steps,
)


def henon(n, seed, shift=0.0):
    """Points (n, 2) of the Henon attractor from a random start."""
    x, y = np.random.default_rng(seed).uniform(-0.1, 0.1, 2)
    points = []
    for i in range(n + 100):
        x, y = 1 - 1.4 * x * x + y, 0.3 * x
        if i >= 100:
            points.append((x + shift, y))
    return np.array(points)


def circle(n, radius, turn=0.0):
    """Points (n, 2) of a quasi-periodic motion."""
    angle = 2 * np.pi * (np.arange(n) * (np.sqrt(5) - 1) / 2 + turn)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def test_an_orbit_is_itself_whenever_it_is_looked_at():
    orbit = np.random.default_rng(0).standard_normal((4, 12))
    assert set_distance(orbit, np.roll(orbit, 1, axis=0)) == 0
    assert set_distance(orbit, np.concatenate([orbit, orbit])) == 0
    assert set_distance(orbit, orbit[:2]) > 0.1  # control: half of an orbit is another motion


@pytest.mark.parametrize("other", range(1, 9))
def test_aperiodic_motions_on_one_set_are_one(other):
    # 512 points: distances to the nearest of 256 scatter by far less than the half that is allowed.
    assert fill_one_set(henon(512, 0), henon(512, other)) is True
    assert fill_one_set(circle(512, 1.0), circle(512, 1.0, 0.1 * other)) is True


def test_aperiodic_motions_on_other_sets_are_others():
    assert fill_one_set(henon(512, 0), henon(512, 1, shift=1.0)) is False
    assert fill_one_set(henon(512, 0), henon(512, 1, shift=0.2)) is None  # these cross; two attractors do not
    assert fill_one_set(circle(512, 1.0), circle(512, 1.1)) is False
    assert (
        fill_one_set(henon(512, 0), np.repeat(henon(512, 1)[:1], 512, axis=0)) is False
    )  # a fixed point within the set
    assert containing_set([henon(512, 0), circle(512, 2.0)], henon(64, 5)) == 0
    assert containing_set([henon(512, 0), circle(512, 2.0)], circle(64, 3.0)) is None


def lane(x, number=1):
    return SweptMotion(
        np.broadcast_to(np.atleast_1d(x)[:, None], (8, 1)) if np.ndim(x) == 0 else np.resize(x, (8, 1)), number, True
    )


def test_steep_steps_are_not_slopes():
    values = np.linspace(0, 1, 30)
    smooth = [lane(v) for v in np.sqrt(values) + 0.1]  # as steep as an orbit is beyond a flip
    assert not steep_steps(smooth[1:]).any()
    broken = [lane(v + (0.4 if i >= 12 else 0)) for i, v in enumerate(0.3 * values)]
    assert np.flatnonzero(steep_steps(broken)).tolist() == [11]


def test_motions_of_equal_period_number_differ_by_their_distance():
    assert motions_differ(lane(0.3), lane(0.4))
    assert not motions_differ(lane(0.3), lane(0.3 + 1e-4))
    assert motions_differ(lane([0.3, 0.5], 2), lane(0.3))
    assert not motions_differ(lane([0.3, 0.5], 2), lane([0.5, 0.3], 2))


def test_motions_are_numbered_as_they_are_met():
    unsettled = lane(0.3)._replace(settled=False)
    lanes = [unsettled, lane(0.3), lane(0.5), lane(0.3 + 1e-4), lane([0.3, 0.5], 2), lane(np.nan), lane(0.5)]
    assert number_motions(lanes).tolist() == [-1, 0, 1, 0, 2, -1, 1]
