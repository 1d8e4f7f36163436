"""Intervals of root mean squares about the mean, by the batches of P_d."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.periods import Sample
from jaxshroud.signals.amplitudes import amplitude_intervals
from jaxshroud.signals.statistics import confidence_interval

OMEGA = 50.0
LANES, RHO, MEAN, VARIANCE = 600, 0.5, 3.0, 2.0


def intervals(mean, square, q=0):
    """The half widths (lanes, blades) of one displacement with means (lanes, periods, blades)."""
    lanes, period = len(mean), 2 * np.pi / OMEGA
    scenes = js.scenes_from({"drive.omega": np.full(lanes, OMEGA)}, js.load("table1").scene)
    samples = Sample(*[None] * len(Sample._fields))
    still = np.zeros_like(mean)
    moments = (mean * period, still, still), (square * period, still, still)
    found = amplitude_intervals(scenes, samples._replace(moments=moments), np.full(lanes, q))
    assert np.nanmax(found["y_rms_ci"], initial=0.0) == 0  # of what does not move
    return found["x_rms_ci"]


def wandering(n, seed):
    """AR(1) series (LANES, n) of mean 0 and variance 1."""
    noise = np.random.default_rng(seed).normal(size=(n, LANES))
    for i in range(1, n):
        noise[i] = RHO * noise[i - 1] + np.sqrt(1 - RHO**2) * noise[i]
    return noise.T[..., None]


def test_the_interval_covers_the_root_mean_square_about_the_mean():
    # In each period the mean wanders by 0.1, and the variance within it by 0.3.
    n = 400
    mean = MEAN + 0.1 * wandering(n, 1)
    square = mean**2 + VARIANCE + 0.3 * wandering(n, 2)
    true = np.sqrt(VARIANCE + 0.1**2)
    rms = np.sqrt(square.mean(axis=1) - mean.mean(axis=1) ** 2)
    half = intervals(mean, square)
    assert 0.93 < np.mean(np.abs(rms - true) < half) < 0.995
    correlated = np.sqrt((1 + RHO) / (1 - RHO) / n)
    assert np.median(half) < 1.4 * 1.96 * 0.3 * correlated / (2 * true)
    # Control: the squares alone, without the mean that moves with them, have twice the interval.
    alone = confidence_interval(np.moveaxis(square, 1, -1)) / (2 * rms)
    assert np.median(alone) > 1.9 * np.median(half)


@pytest.mark.parametrize("q", [1, 3])
def test_of_an_orbit_only_rounding_is_left(q):
    cycle = np.random.default_rng(q).uniform(1.0, 2.0, q)
    mean = np.resize(cycle, (2, 13))[..., None].repeat(2, axis=-1)
    np.testing.assert_allclose(intervals(mean, mean**2 + 1.0, q), 0.0, atol=1e-14)


def test_fewer_than_two_orbits_have_no_interval():
    mean = np.ones((1, 5, 2))
    assert np.isnan(intervals(mean, mean + 1, 3)).all()
