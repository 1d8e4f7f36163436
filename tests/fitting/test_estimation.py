"""Least squares, intervals and findings on curves whose answers are known; nothing is marched."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.stats import chi2, norm, t

import jaxshroud as js
from jaxshroud.fitting.identifiability import findings, profiles
from jaxshroud.fitting.least_squares import (
    Data,
    Minimum,
    Misfit,
    estimate,
    estimate_at,
)
from jaxshroud.fitting.noise import is_contradicted, noise_of_neighbours
from jaxshroud.fitting.searches import estimate_of_history, lengthened

TIMES = np.linspace(0, 1, 40)
STARTS = np.random.default_rng(0).random((8, 2))


def line(points):
    """Values and slopes of u_0 + u_1 t."""
    values = points[:, :1] + points[:, 1:] * TIMES
    slopes = np.broadcast_to(np.stack([np.ones_like(TIMES), TIMES], -1), (*values.shape, 2))
    return values[..., None], slopes[:, :, None]


def decay(points):
    """Values and slopes of u_0 exp(-4 u_1 t)."""
    shape = np.exp(-4 * points[:, 1:] * TIMES)
    values = points[:, :1] * shape
    return values[..., None], np.stack([shape, -4 * TIMES * values], -1)[:, :, None]


def product(points):
    """Values and slopes of u_0 u_1 t, of which only the product is known."""
    values = points[:, :1] * points[:, 1:] * TIMES
    slopes = np.stack([points[:, 1:] * TIMES, points[:, :1] * TIMES], -1)
    return values[..., None], slopes[:, :, None]


def measured(predict, truth, noise, seed, *, known=False):
    """Noisy data of a model, whose noise is known or not; of a seed, or of a generator that goes on."""
    exact, rng = predict(np.array([truth]))[0][0], np.random.default_rng(seed)
    return Data(exact + noise * rng.standard_normal(exact.shape), np.full(exact.shape, noise if known else 1.0), known)


def misfit_of(predict, data):
    """The misfit of a model that computes all of its values at once."""
    return Misfit(lambda points, rows: predict(points), data)


def found_in(predict, data):
    """The fit to a response, its intervals, and what is said."""
    found = estimate(misfit_of(predict, data), STARTS, 2)
    return found, *told_of(found, is_history=False)


def told_of(found, *, is_history):
    numbers = profiles(found)
    told = findings(found, ("a", "b"), numbers, lambda u: u, is_history)
    return [number.interval for number in numbers], told


def says(told, words):
    """Whether one of the notes has these words."""
    return any(words in note for note in told.notes)


@pytest.mark.parametrize("known", [True, False])
def test_intervals_of_a_line_are_those_of_linear_regression(known):
    data = measured(line, (0.4, 0.5), 0.02, 1, known=known)
    found, ends, told = found_in(line, data)
    design = np.stack([np.ones_like(TIMES), TIMES], -1)
    exact, rest, *_ = np.linalg.lstsq(design, data.values[:, 0])
    variance = 0.02**2 if known else rest[0] / (len(TIMES) - 2)
    half = (norm if known else t(len(TIMES) - 2)).ppf(0.975) * np.sqrt(
        variance * np.diag(np.linalg.inv(design.T @ design))
    )
    assert_allclose(found.u, exact, rtol=1e-7)  # the descent's tolerance
    assert_allclose([e.high - e.low for e in ends], 2 * half, rtol=1e-6)
    assert {e.by for e in ends} == {"jacobian"}
    assert told.notes == []
    assert told.determined == [True, True]


@pytest.mark.full
def test_intervals_hold_the_truth_as_often_as_they_say():
    # 2 x 150 intervals of 95 %: below 0.91 and above 0.99 less than once in a thousand times.
    rng, held, narrow = np.random.default_rng(2), [], []
    for _ in range(150):
        found, ends, _ = found_in(decay, measured(decay, (0.6, 0.5), 0.02, rng))
        held += [e.low <= u <= e.high for e, u in zip(ends, (0.6, 0.5), strict=True)]
        half = [(e.high - e.low) / 6 for e in ends]
        narrow += [abs(found.u[i] - u) <= half[i] for i, u in enumerate((0.6, 0.5))]
    assert 0.91 < np.mean(held) < 0.99
    assert np.mean(narrow) < 0.7  # control: a third of the width holds some half of them


def test_a_profile_ends_where_chi2_says():
    # Of one wide number; the other is eliminated in closed form, as values are linear in it.
    data = measured(decay, (0.5, 0.5), 0.15, 3, known=True)
    found, ends, _ = found_in(decay, data)
    assert ends[1].by == "profile"

    def chi2(rate):
        shape, y = np.exp(-4 * rate * TIMES), data.values[:, 0]
        return np.sum((y - np.clip(y @ shape / (shape @ shape), 0, 1) * shape) ** 2) / 0.15**2

    excess = lambda rate: chi2(rate) - found.chi2 - norm.ppf(0.975) ** 2
    exact = brentq(excess, 0, found.u[1]), brentq(excess, found.u[1], 1)
    assert_allclose((ends[1].low, ends[1].high), exact, atol=2e-3)  # of the root, over the range
    linear = found.u[1] + found.quantile * np.sqrt(found.covariance[1, 1]) * np.array([-1, 1])
    assert np.max(np.abs(linear - exact)) > 2e-2  # control: the linear interval is ten times that off


def test_numbers_of_which_only_the_product_is_known_are_named():
    _, ends, told = found_in(product, measured(product, (0.5, 0.6), 0.01, 4))
    assert told.determined == [False, False]
    assert says(told, "a cannot be told from b here (correlation -1.0")
    assert all(e.by == "profile" for e in ends)
    for end in ends:  # either may be anything from 0.3, where the other is 1, to 1
        assert_allclose((end.low, end.high), (0.3, 1.0), atol=0.02)
        assert end.open == (False, True)


def test_a_number_without_influence_is_named():
    still = lambda points: (line(points)[0] * 0 + points[:, :1, None], line(points)[1] * np.array([1.0, 0.0]))
    _, ends, told = found_in(still, measured(still, (0.5, 0.5), 0.01, 5))
    assert told.notes == ["the data do not depend on b here"]
    assert told.determined == [True, False]
    assert (ends[1].low, ends[1].high) == (0, 1)


def test_a_truth_outside_the_bounds_is_named():
    _, _, told = found_in(line, measured(line, (0.5, 1.5), 0.01, 6))
    assert says(told, "b ends at its bound")
    assert says(told, "neighbouring residuals are alike")  # of a line that does not fit


def test_noise_that_is_stated_too_small_is_named():
    data = measured(line, (0.4, 0.5), 0.02, 7)
    _, _, told = found_in(line, data._replace(sigma=np.full(data.values.shape, 0.004), sigma_is_known=True))
    assert any(note.startswith("the residuals are 5") or note.startswith("the residuals are 4.") for note in told.notes)


def test_derivatives_that_grow_along_a_record_are_named():
    def grows(points):
        """Values and slopes of u_0 + 1e-6 u_1 exp(20 t)."""
        rise = np.broadcast_to(1e-6 * np.exp(20 * TIMES), (len(points), len(TIMES)))
        values, slopes = points[:, :1] + points[:, 1:] * rise, np.stack([np.full_like(rise, 1e-6), rise], -1)
        return values[..., None], slopes[:, :, None]

    found, *_ = found_in(grows, measured(grows, (0.5, 0.5), 0.01, 10, known=True))
    _, told = told_of(found, is_history=True)
    assert says(told, "as in chaos")


def test_each_channel_has_its_own_noise():
    both = lambda points: tuple(np.concatenate([a, a * 1e-3], axis=2) for a in line(points))
    rng, exact = np.random.default_rng(8), both(np.array([(0.4, 0.5)]))[0][0]
    noise = np.array([0.02, 1e-6])
    data = Data(exact + noise * rng.standard_normal(exact.shape), np.ones(exact.shape), False)
    found, ends, _ = found_in(both, data)
    assert_allclose(found.misfit.data.sigma[0], noise, rtol=0.3)  # four deviations of 40 values
    assert all(abs(found.u - (0.4, 0.5)) < 5e-3)  # the second channel counts: the first alone leaves 6e-3
    assert all(e.high - e.low < 5e-3 for e in ends)


def test_where_the_model_says_nothing_a_descent_turns_back():
    half = lambda points: tuple(np.where(points[:, 1] < 0.7, a.T, np.nan).T for a in line(points))
    found, _, told = found_in(half, measured(line, (0.4, 0.5), 0.02, 9))
    assert abs(found.u[1] - 0.5) < 0.05
    assert told.notes == []
    assert told.determined == [True, True]
    later = lambda points: (np.where(TIMES[:, None] < 0.9, line(points)[0], np.nan), line(points)[1])
    _, _, told = found_in(later, measured(line, (0.4, 0.5), 0.02, 9))
    assert "of 4 of 40 values the fitted scene says nothing: it stops, or finds no orbit there" in told.notes
    nowhere = lambda points: tuple(a * np.nan for a in line(points))
    with pytest.raises(js.NumericalError, match="says nothing of the data"):
        estimate(misfit_of(nowhere, measured(line, (0.4, 0.5), 0.02, 9)), STARTS, 2)


def test_residuals_and_slopes_are_computed_once_for_each_point():
    misfit = misfit_of(line, measured(line, (0.4, 0.5), 0.02, 1))
    misfit.at(np.array([0.1, 0.2]))
    misfit.at(np.array([0.1, 0.2]))
    assert misfit.evaluations == 1


LONG = np.linspace(0, 1, 200)


def chirp(points):
    """Values and slopes of u_0 sin(400 u_1 t), whose sum of squares has some hundred valleys along u_1."""
    phase = 400 * points[:, 1:] * LONG
    values, slopes = points[:, :1] * np.sin(phase), [np.sin(phase), 400 * LONG * points[:, :1] * np.cos(phase)]
    return values[..., None], np.stack(slopes, -1)[:, :, None]


def history_of(truth, seed, *, known, predict=chirp):
    return measured(predict, truth, 0.02, seed, known=known)


def search(data, seed, predict=chirp):
    rng = np.random.default_rng(seed)
    draws = [rng.random((16, 2)) for _ in range(4)]
    return estimate_of_history(misfit_of(predict, data), LONG, draws, 4, rng)


@pytest.mark.parametrize("known", [True, False])
def test_a_record_is_lengthened_into_its_valley(known):
    truth, found_by_starts = (0.6, 0.37), []
    for seed in range(5):
        data = history_of(truth, seed, known=known)
        found = search(data, seed)
        ends, told = told_of(found, is_history=True)
        assert told == ([True, True], [])
        assert all(e.low <= u <= e.high for e, u in zip(ends, found.u, strict=True))
        assert_allclose(found.u, truth, rtol=0, atol=5 * 0.02 / np.sqrt(200))
        assert_allclose(np.mean(found.misfit.data.sigma), 0.02, rtol=0.25)
        by_starts = estimate(misfit_of(chirp, data), np.random.default_rng(seed).random((64, 2)), 4)
        found_by_starts.append(abs(by_starts.u[1] - truth[1]) < 1e-3)
    assert not all(found_by_starts)  # control: descents over the whole record miss it


def two_valleys(points):
    """Values and slopes that have two valleys along u_1, at 0.3 and 0.7, which the first 0.6 of a record do not tell.

    Noise alone decides which of them is deeper there; the rest shows that 0.7 is right.
    """
    u, late = points[:, 1:], LONG > 0.6
    wave = 0.01 * np.sin(40 * LONG)
    values = points[:, :1] + 10 * (u - 0.3) * (u - 0.7) + u * wave + np.where(late, 0.4 * (u - 0.7), 0.0)
    slope = 20 * (u - 0.5) + wave + np.where(late, 0.4, 0.0)
    return values[..., None], np.stack([np.ones_like(slope), slope], -1)[:, :, None]


def test_the_deeper_valley_of_a_part_does_not_crowd_out_others():
    # u_0 is all but known: its prior is a datum of the record's beginning, with a hundredth of the noise.
    def pinned(points):
        values, slopes = two_valleys(points)
        values[:, 0, 0], slopes[:, 0, 0] = 100 * points[:, 0], (100.0, 0.0)
        return values, slopes

    for seed in range(8):
        data = history_of((0.5, 0.7), seed, known=True, predict=pinned)
        found = lengthened(
            misfit_of(pinned, data), np.random.default_rng(seed).random((32, 2)), np.random.default_rng(seed)
        )
        assert abs(found.u[0, 1] - 0.7) < 0.01  # ten deviations; the other valley is 0.4 away


@pytest.mark.parametrize("known", [True, False])
def test_a_fit_that_the_noise_contradicts_claims_nothing(known):
    # chi^2 is what noise exceeds once in 200 times, far below four of its standard deviations.
    exact = line(np.array([(0.4, 0.5)]))[0][0]
    noise = np.random.default_rng(12).standard_normal(exact.shape)
    data = Data(exact + 0.02 * noise, np.full(exact.shape, 0.02), True)
    found = estimate(misfit_of(line, data), STARTS, 2)
    for probability, claims in ((0.005, False), (0.02, True)):
        sigma = 0.02 * np.sqrt(found.chi2 / chi2.isf(probability, found.freedom))
        scaled = data._replace(sigma=np.full(exact.shape, sigma), sigma_is_known=known)
        again = estimate_at(misfit_of(line, scaled), [Minimum(found.u, float(found.chi2 * (0.02 / sigma) ** 2))])
        told = findings(again, ("a", "b"), profiles(again), lambda u: u, is_history=True)
        assert told.determined == [claims, claims]
        assert says(told, "times the noise that") == (not claims)


def test_chi2_over_the_noise_of_neighbours_is_as_large_as_over_known_noise():
    # Once in a hundred times it is contradicted: of 4,000 fits of 400 values 25 to 60, four deviations.
    rng, at = np.random.default_rng(13), np.arange(400.0)
    residuals = rng.standard_normal((4000, 400))
    contradicted = [
        is_contradicted(float(np.sum((one / noise_of_neighbours(one[:, None], at)) ** 2)), 400) for one in residuals
    ]
    assert 20 <= sum(contradicted) <= 60


def test_searches_go_on_where_the_noise_contradicts_what_they_found():
    # No number fits data whose noise is stated too small: all searches are made, though all end alike.
    data = history_of((0.6, 0.37), 0, known=True)
    assert search(data, 0).searches == 2
    small = search(data._replace(sigma=data.sigma / 1.2), 0)
    assert (small.searches, small.alike) == (4, 4)
    _, told = told_of(small, is_history=True)
    assert told.determined == [False, False]


def test_an_error_of_the_march_as_large_as_an_interval_is_named():
    data = measured(line, (0.4, 0.5), 0.02, 1, known=True)
    found, _, told = found_in(line, data)
    assert told.determined == [True, True]
    residuals = found.misfit.at(found.u)
    shift = np.array([0.5, -0.25]) * found.half_widths
    moved = residuals._replace(values=residuals.values + residuals.jacobian @ shift)
    assert_allclose(found.moved_by(moved), 0.5, rtol=1e-9)  # of a line
    told = findings(found, ("a", "b"), profiles(found), lambda u: u, is_history=True, march_error=0.5)
    assert told.determined == [False, False]
    assert says(told, "the march's own error moves numbers by 0.5 ")


def test_a_wrong_valley_has_no_interval():
    # The fit is held in a neighbouring valley, as where a search missed the right one.
    data = history_of((0.6, 0.37), 0, known=False)
    near = lambda points: chirp(np.stack([points[:, 0], 0.39 + 0.02 * points[:, 1]], -1))
    scaled = lambda points: (near(points)[0], near(points)[1] * np.array([1.0, 0.02]))
    _, told = told_of(search(data, 0, scaled), is_history=True)
    assert told.determined == [False, False]
    assert says(told, "times the noise that neighbours have")
    assert says(told, "neighbouring residuals are alike")


def test_two_valleys_that_fit_as_well_are_both_told():
    folded = lambda points: chirp(np.stack([points[:, 0], np.abs(points[:, 1] - 0.5)], -1))
    signs = lambda points: np.stack([np.ones(len(points)), np.sign(points[:, 1] - 0.5)], -1)[:, None, None]
    both = lambda points: (folded(points)[0], folded(points)[1] * signs(points))
    data = history_of((0.6, 0.1), 1, known=True, predict=both)
    _, told = told_of(search(data, 1, both), is_history=True)
    assert told.determined == [True, False]
    assert says(told, "1 of the starts end elsewhere and fit as well")


def test_noise_is_what_neighbours_differ_by():
    rng, at = np.random.default_rng(3), np.sort(np.random.default_rng(4).random(2000))
    noise = 0.01 * rng.standard_normal((2000, 2)) * [1.0, 2.0]
    smooth = np.sin(20 * at)[:, None] * [1.0, -1.0]
    assert_allclose(noise_of_neighbours(noise + smooth, at), [0.01, 0.02], rtol=0.1)
    assert np.std(noise + smooth, axis=0).min() > 0.5  # control: what is smooth is large
