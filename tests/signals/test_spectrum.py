"""Amplitude spectra against closed forms; names of lines."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxshroud.signals.spectrum import amplitude_spectrum, label_lines, line_label, repeats_after, whole_periods

EXACT = 1e-13  # an FFT of 1e4 terms of order 1 is good to about log2(1e4) rounding errors of 1e-16


def tau(n_periods, samples_per_period=64):
    """Drive angle at each sample, both ends of the run included."""
    n = round(n_periods * samples_per_period)
    return 2 * np.pi * np.arange(n + 1) / samples_per_period


def names(*args, **kwargs):
    return [label for _, label in label_lines(*args, **kwargs)]


@pytest.mark.parametrize("window", ["rectangular", "hann"])
def test_a_sine_on_a_bin_has_its_own_amplitude(window):
    # Both windows are normalised by their sum, so a line on a bin is exact at any phase.
    t = tau(12)
    frequency, amplitude = amplitude_spectrum(3 * np.sin(2 * t + 0.4) + 0.5 * np.cos(t / 3) - 7, 64, window)
    at = {f: amplitude[round(12 * f)] for f in (0, 1 / 3, 1, 2)}
    assert_allclose(list(at.values()), [7, 0.5, 0, 3], rtol=0, atol=10 * EXACT)
    assert_allclose(frequency, np.arange(12 * 32 + 1) / 12, rtol=1e-15)


def test_only_the_last_whole_periods_count():
    # A spectrum over 5 periods ignores a start-up that lies before them.
    t = tau(5.4)
    signal = np.sin(t)
    signal[: signal.size - 5 * 64] = 1e9
    _, amplitude = amplitude_spectrum(signal, 64)
    assert_allclose(np.delete(amplitude, 5), 0, atol=EXACT)
    assert_allclose(amplitude[5], 1, atol=EXACT)


def test_parseval():
    # Mean square = mean^2 + half the sum of squared amplitudes; the mean and the highest bin count in full.
    signal = np.random.default_rng(1).normal(size=640)
    _, a = amplitude_spectrum(signal, 64)
    power = a[0] ** 2 + (a[1:-1] ** 2).sum() / 2 + a[-1] ** 2
    assert_allclose(power, np.mean(signal**2), rtol=10 * EXACT)


@pytest.mark.parametrize(("window", "peak"), [("rectangular", 2 / np.pi), ("hann", 8 / (3 * np.pi))])
def test_leakage_of_a_line_between_two_bins(window, peak):
    # The windows' transforms half a bin off centre. The mirror line, 2 x 100 bins away, adds 1/200 at most.
    t = tau(100)
    frequency, amplitude = amplitude_spectrum(np.sin(t * 1.005), 64, window)
    assert_allclose(amplitude[[100, 101]], peak, rtol=0.006)
    far = amplitude[frequency > 3].max()
    # Tails at 200 bins: 1/(pi 200) = 1.6e-3 against 200^-3 / pi = 4e-8, mirror line included.
    assert far < 1e-6 if window == "hann" else far > 1e-4


def test_samples_that_miss_the_ends_of_periods():
    # 400 steps, every third stored: 3 periods are 400 samples, so 7 periods are cut to 6.
    rate = Fraction(400, 3)
    t = 2 * np.pi * np.arange(int(7 * rate) + 1) / float(rate)
    frequency, amplitude = amplitude_spectrum(2 * np.sin(t), rate)
    assert whole_periods(t.size, rate) == 6
    assert_allclose([frequency[6], amplitude[6]], [1, 2], atol=10 * EXACT)
    assert repeats_after(np.sin(t), rate) == 3


@pytest.mark.parametrize(
    ("signal", "rate", "window", "message"),
    [
        ([], 64, "hann", "at least one in each series, but is"),
        (np.zeros(63), 64, "hann", "must have 64 samples .*, but has 63"),
        (np.zeros((64, 2)), 64, "hann", r"one dimension, but has shape \(64, 2\)"),
        (np.zeros(64), 0, "hann", "`samples_per_period` must be at least 2, but is 0"),
        (np.zeros(64), 64, "flat", "`window` must be 'rectangular' or 'hann', but is 'flat'"),
    ],
)
def test_bad_arguments(signal, rate, window, message):
    with pytest.raises(ValueError, match=message):
        amplitude_spectrum(signal, rate, window)


@pytest.mark.parametrize("q", [1, 2, 3, 7, 16])
def test_a_signal_repeats_after_its_period_number(q):
    t = tau(2 * q)
    assert repeats_after(np.sin(t) + 0.01 * np.cos(t / q), 64) == q


def test_a_signal_that_does_not_repeat():
    t = tau(40)
    assert repeats_after(np.sin(t) + 0.1 * np.sin(t / np.sqrt(2)), 64) == 0
    assert repeats_after(np.sin(t) + 0.1 * np.sin(t / 17), 64) == 0  # 16 is the largest number tried
    assert repeats_after(np.sin(t[:100]), 64) == 0  # 1.6 periods cannot show a repeat
    assert repeats_after(np.where(t > 9, np.nan, t), 64) == 0
    assert repeats_after([], 64) == 0


@pytest.mark.parametrize(
    ("line", "label"),
    [("1", "f_e"), ("2", "2f_e"), ("1/2", "f_e/2"), ("3/2", "3f_e/2"), ("6/4", "3f_e/2"), ("4/3", "4f_e/3")],
)
def test_label(line, label):
    assert line_label(Fraction(line)) == label


def test_lines_of_a_known_period_number():
    # Covering q periods only, each bin is a line: a small one beside a larger one is named all the same.
    t = tau(2)
    spectrum = amplitude_spectrum(np.sin(t) + 0.3 * np.sin(t / 2) + 0.2 * np.sin(1.5 * t) + 0.1 * np.sin(3 * t), 64)
    assert label_lines(*spectrum, 2) == [(0.5, "f_e/2"), (1.0, "f_e"), (1.5, "3f_e/2"), (3.0, "3f_e")]
    assert names(*spectrum, 1) == ["f_e", "3f_e"]
    assert names(*spectrum, 2, threshold=0.25) == ["f_e/2", "f_e"]


def test_lines_of_an_unknown_period_number():
    t = tau(240)
    spectrum = amplitude_spectrum(np.sin(t) + 0.1 * np.sin(t / 3) + 0.1 * np.sin(1.25 * t) + 5, 64)
    assert names(*spectrum) == ["f_e/3", "f_e", "5f_e/4"]
    assert names(*spectrum, max_denominator=3) == ["f_e/3", "f_e"]


def test_broadband_noise_has_no_names():
    # White noise of standard deviation 0.3 over 7,681 bins: few stand out, and none sits on a fraction.
    noise = 0.3 * np.random.default_rng(2).normal(size=240 * 64)
    assert names(*amplitude_spectrum(np.sin(tau(240)[1:]) + noise, 64, "hann")) == ["f_e"]


def test_a_short_spectrum_names_harmonics_only():
    t = tau(4)
    spectrum = amplitude_spectrum(np.sin(t) + 0.3 * np.sin(t / 2) + 0.2 * np.sin(2 * t), 64)
    assert names(*spectrum) == ["f_e", "2f_e"]


def test_nothing_to_name():
    assert label_lines([], []) == []
    assert label_lines([0.0], [1.0]) == []
    assert names(*amplitude_spectrum(np.zeros(64 * 20), 64)) == []
    assert names(*amplitude_spectrum(np.full(64 * 20, np.nan), 64)) == []
