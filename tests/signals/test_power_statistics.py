"""P_d by the article's rule for n, and the confidence interval of its mean."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.signals.averages import reduction
from jaxshroud.signals.period import SETTLED
from jaxshroud.signals.statistics import confidence_interval
from jaxshroud.verbs.power import FIRST_PERIODS, is_converged

SEEDS = 1000


def as_power(percent: np.ndarray, P_0: float = 2.0) -> np.ndarray:
    """Power of both blades (..., n, 2) whose left one is reduced by `percent`; the right one is twice the left."""
    P = P_0 * (1 - percent / 100)
    return np.stack([P, 2 * P], axis=-1)


def autoregressive(rho: float, n: int, seed: int) -> np.ndarray:
    """SEEDS stationary AR(1) series of mean 0 and variance 1."""
    noise = np.random.default_rng(seed).normal(size=(n, SEEDS))
    x = np.empty_like(noise)
    x[0] = noise[0]
    for i in range(1, n):
        x[i] = rho * x[i - 1] + np.sqrt(1 - rho**2) * noise[i]
    return x.T


@pytest.mark.parametrize(("rho", "n"), [(0.0, 64), (0.0, 512), (0.5, 512), (0.8, 512), (0.9, 512), (0.9, 2000)])
def test_the_interval_covers_the_mean_and_is_not_much_too_wide(rho, n):
    x = autoregressive(rho, n, seed=13)
    covered = np.mean(np.abs(x.mean(axis=1)) < confidence_interval(x))
    assert 0.93 < covered < 0.995  # binomial scatter of 1,000 runs: 0.006
    assert np.median(confidence_interval(x)) < 1.4 * 1.96 * np.sqrt((1 + rho) / (1 - rho) / n)
    # Control: taking the samples for independent ones covers far less where they are not.
    naive = 1.96 * x.std(axis=1, ddof=1) / np.sqrt(n)
    assert rho == 0 or np.mean(np.abs(x.mean(axis=1)) < naive) < 0.85


def test_an_interval_of_too_few_correlation_times_is_flagged():
    # 64 samples of rho = 0.9 are 3.4 correlation times: the interval covers in four of five runs, and says so.
    x = autoregressive(0.9, 64, seed=17)
    short = reduction(as_power(x), np.full((SEEDS, 2), 2.0), np.zeros(SEEDS, np.int32)).ci_short
    assert np.mean(np.abs(x.mean(axis=1)) < confidence_interval(x)) < 0.85
    assert short.mean() > 0.97
    assert not reduction(
        as_power(autoregressive(0.5, 512, 18)), np.full((SEEDS, 2), 2.0), np.zeros(SEEDS, np.int32)
    ).ci_short.any()


@pytest.mark.parametrize("q", [1, 3])
def test_a_settled_orbit_is_never_short(q):
    cycle = np.random.default_rng(q).uniform(size=q)
    found = reduction(as_power(np.resize(cycle, 48)[None]), np.full((1, 2), 2.0), np.array([q], np.int32))
    assert (bool(found.ci_short[0]), int(found.settling[0]), float(found.periods_more[0])) == (False, SETTLED, 0.0)


def test_stopping_when_the_interval_is_short_enough_still_covers():
    # The rule and the looks of `power`: 64, 128, ... periods. Stopping at the first short interval covers less.
    x, n, tolerance = autoregressive(0.9, 4096, seed=19), FIRST_PERIODS, 1.96 / np.sqrt(24)
    held, hasty, close = np.zeros(SEEDS, bool), np.full(SEEDS, np.nan), np.zeros(SEEDS, bool)
    running = np.arange(SEEDS)
    while len(running):
        now = reduction(as_power(x[running, :n]), np.full((len(running), 2), 2.0), np.zeros(len(running), np.int32))
        enough = is_converged(now, np.abs(x[running, : n // 2].mean(axis=1) - now.P_d), tolerance)
        held[running] = np.abs(now.P_d) <= now.ci
        first = np.isnan(hasty[running]) & (now.ci <= tolerance)
        hasty[running[first]] = held[running[first]]
        goes_on = ~(enough & close[running]) & (n < x.shape[1])
        close[running], n = enough, 2 * n
        running = running[goes_on]
    assert 0.93 < held.mean() <= 0.99
    assert np.nanmean(hasty) < 0.92


def test_a_sine_that_never_repeats_is_covered():
    turns = np.random.default_rng(20).uniform(size=(SEEDS, 1))
    for n in (64, 500):
        x = np.sin(2 * np.pi * ((np.sqrt(5) - 1) / 2 * np.arange(n) + turns))
        assert np.all(np.abs(x.mean(axis=1)) <= confidence_interval(x))


@pytest.mark.parametrize("q", [1, 2, 3, 7])
def test_a_periodic_run_has_no_uncertainty(q):
    cycle = np.random.default_rng(q).uniform(size=q)
    series = np.resize(cycle, 60)  # batches of whole orbits all have the same mean
    assert confidence_interval(series[None], q)[0] < 1e-15
    if q > 1:  # control: batches that cut orbits do not
        assert confidence_interval(np.resize(cycle, 10 * (q + 1))[None])[0] > 1e-4


def test_fewer_than_six_orbits_are_the_batches_themselves():
    # Student's t for 3 - 1 degrees of freedom: 4.303.
    series = np.array([[1.0, 3.0, 2.0, 5.0, 4.0, 3.0]])  # three orbits of two periods: means 2, 3.5, 3.5
    by_hand = 4.302653 * np.std([2.0, 3.5, 3.5], ddof=1) / np.sqrt(3)
    assert_allclose(confidence_interval(series, 2), by_hand, rtol=1e-6)
    assert np.isnan(confidence_interval(series, 6)[0])  # one orbit: nothing to tell from


@pytest.mark.parametrize(("q", "n"), [(0, 25), (1, 25), (2, 24), (3, 24), (7, 21), (16, 16)])
def test_n_is_the_largest_multiple_of_the_period_number(q, n):
    percent = np.random.default_rng(q).uniform(10, 20, (1, 25))
    found = reduction(as_power(percent), np.array([[2.0, 4.0]]), np.array([q], np.int32))
    assert found.n.tolist() == [n]
    assert_allclose(found.P_d, percent[:, 25 - n :].mean(axis=1), rtol=1e-12)  # the latest n periods
    assert_allclose(found.P, as_power(percent)[:, 25 - n :].mean(axis=1), rtol=1e-12)
    assert_array_equal(np.isnan(found.ci), [q == 16])


def test_P_d_is_the_left_blades():
    power = np.broadcast_to([1.5, 0.1], (1, 30, 2))
    found = reduction(power, np.array([[2.0, 0.2]]), np.array([1], np.int32))
    assert_allclose(found.P_d, 25.0, rtol=1e-14)  # Eq. (24), not the right blade's 50 %
    assert (float(found.ci[0]), bool(found.settled[0])) == (0.0, True)


def test_no_drive_has_no_reduction():
    power = np.ones((2, 30, 2))
    found = reduction(power, np.array([[0.0, 0.0], [2.0, 2.0]]), np.array([1, 1], np.int32))
    assert_array_equal(np.isnan(found.P_d), [True, False])
    assert_array_equal(np.isnan(found.ci), [True, False])
    assert_array_equal(found.settled, [False, True])
    assert_array_equal(found.P, 1.0)


DRIFTS = {
    "ramp": np.linspace(0, 1, 60),
    "step between the halves": np.repeat([0.0, 1.0], 30),
    "transient of ten periods": np.exp(-np.arange(60) / 10),
}


@pytest.mark.parametrize("drift", DRIFTS.values(), ids=DRIFTS)
def test_drift_is_not_settled(drift):
    def settled(percent):
        return bool(reduction(as_power(percent[None]), np.full((1, 2), 2.0), np.array([1], np.int32)).settled[0])

    assert not settled(10 + drift)
    # A hundredth of a percentage point does not count, unless it goes on and on: where a ramp ends, nobody knows.
    assert settled(10 + 0.009 * drift) == (drift[-2] == drift[-1] or drift[0] > drift[-1])


def test_stationary_noise_is_settled():
    # The halves of white noise differ by sqrt(2) times the standard error of the whole, twice; 2 ci is 4.5 of them.
    percent = 10 + np.random.default_rng(14).normal(size=(SEEDS, 100))
    found = reduction(as_power(percent), np.full((SEEDS, 2), 2.0), np.zeros(SEEDS, np.int32))
    assert found.settled.mean() > 0.97


def test_mixed_period_numbers_keep_the_order_of_lanes():
    number = np.array([[3, 1, 0], [16, 2, 3]], np.int32)
    rng = np.random.default_rng(15)
    power, P_0 = rng.uniform(1, 2, (2, 3, 50, 2)), rng.uniform(2, 3, (2, 3, 2))
    found = reduction(power, P_0, number)
    assert_array_equal(found.n, [[48, 50, 50], [48, 50, 48]])
    for lane in np.ndindex(2, 3):
        alone = reduction(power[lane][None], P_0[lane][None], number[lane][None])
        for got, want in zip(found, alone, strict=True):
            assert_array_equal(got[lane], want[0])


def test_a_single_lane_has_no_lane_dimension():
    percent = np.random.default_rng(16).uniform(10, 20, 40)
    found = reduction(as_power(percent), np.array([2.0, 4.0]), np.array(2, np.int32))
    assert [value.shape for value in found] == [(2,), *[()] * 9]
    assert_allclose(found.P_d, percent.mean(), rtol=1e-12)


def test_a_stopped_lane_is_nan_alone():
    power = np.ones((2, 30, 2))
    power[0, 10:] = np.nan
    found = reduction(power, np.full((2, 2), 2.0), np.array([0, 1], np.int32))
    assert_array_equal(np.isnan(found.P_d), [True, False])
    assert_array_equal(found.settled, [False, True])


@pytest.mark.release
@pytest.mark.full
def test_intervals_in_float32_hold_the_reductions_in_float64():
    # Settled orbits, on which P_d of both precisions differs by up to 7 units of rounding of 100 % - P_d.
    scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
    rough, fine = (
        js.sweep(scene, {"contact.gamma": np.linspace(0.3, 3.0, 5)}, n_periods=16, transient=128, method=method)
        for method in (js.RungeKutta(steps=100, precision="float32"), js.RungeKutta(steps=100))
    )
    apart = np.abs(rough.P_d - fine.P_d)
    assert np.all(apart <= rough.P_d_ci)
    assert np.all(rough.P_d_ci < 1e-3)
    assert np.all(fine.P_d_ci < apart.max() / 1e3)  # control: of float64 they are as narrow as they were
