"""Period numbers of orbits whose period is known."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from jaxshroud import load, sweep
from jaxshroud.march.method import RungeKutta
from jaxshroud.signals.period import (
    LARGEST_PERIOD,
    NOT_SETTLED,
    PERIOD_TOLERANCE,
    SETTLED,
    UNKNOWN_IF_SETTLED,
    periodicity,
    repetition,
    series_settling,
    settling,
)

RNG = np.random.default_rng(11)


def orbit(q: int, n: int = 96) -> np.ndarray:
    """A random orbit of q different points, repeated."""
    return np.resize(np.random.default_rng(q).uniform(-1, 1, q), n)


@pytest.mark.parametrize("q", range(1, LARGEST_PERIOD + 1))
def test_a_repeated_orbit_has_its_length_as_period(q):
    found = periodicity(orbit(q))
    assert (int(found.number), bool(found.settled)) == (q, True)
    assert int(periodicity(1e-9 * orbit(q)).number) == q  # metres or micrometres: the tolerance is relative


@pytest.mark.parametrize(("q", "n", "number"), [(17, 96, 17), (24, 72, 24), (24, 71, 0), (32, 96, 32), (64, 192, 64)])
def test_longer_orbits_are_found_where_they_are_kept_three_times(q, n, number):
    assert int(periodicity(orbit(q, n)).number) == number


def test_what_returns_after_more_periods_than_are_found_is_aperiodic():
    found = periodicity(orbit(65, 260))
    assert (int(found.number), bool(found.settled)) == (0, True)  # neither periodic nor on its way there


@pytest.mark.parametrize("q", [1, 3, 12])
@pytest.mark.parametrize("since", [-60.0, 0.0, 60.0])
def test_what_passes_by_an_orbit_slowly_is_not_settled(q, since):
    # Beside a fold x' = a + x^2 has no orbit, but passes by with steps of 5e-9: x = sqrt(a) tan(sqrt(a) t).
    a, t = 5e-9, since + np.arange(128 // q + 1)
    drift = np.repeat(np.sqrt(a) * np.tan(np.sqrt(a) * t), q)[:128]
    passing = periodicity(orbit(q, 128) + drift)
    assert (int(passing.number), bool(passing.settled)) == (q, False)
    power = series_settling(30 + orbit(q, 128)[None] + drift, q, 0.01)
    assert power.verdict[0] == UNKNOWN_IF_SETTLED
    noise = 1e-13 * np.random.default_rng(q).standard_normal(128)
    assert bool(periodicity(orbit(q, 128) + noise).settled)  # control: an orbit that rounding moves


@pytest.mark.parametrize("q", [1, 2, 5, 16])
def test_noise_counts_from_the_tolerance_on(q):
    x = orbit(q)
    scale = np.abs(x).max()
    for factor, number in ((0.99, q), (1.01, 0)):
        noisy = x.copy()
        middle = np.flatnonzero(np.abs(x) < scale)[20] if q > 1 else 48  # not the point that sets the scale
        noisy[middle] -= np.sign(x[middle]) * factor * PERIOD_TOLERANCE * scale
        assert int(periodicity(noisy).number) == number
        assert int(periodicity(noisy, period_tol=2 * PERIOD_TOLERANCE).number) == q


def test_a_chaotic_orbit_is_aperiodic_and_settled():
    x = np.empty(400)
    x[0] = 0.3
    for i in range(399):
        x[i + 1] = 3.9 * x[i] * (1 - x[i])  # logistic map, no period window
    found = periodicity(x)
    assert (int(found.number), bool(found.settled)) == (0, True)


@pytest.mark.parametrize("q", [1, 2, 3])
def test_a_dying_transient_is_not_settled(q):
    decay = np.exp(-np.arange(200) / 60)  # return errors fall to a fifth from half to half
    found = periodicity(orbit(q, 200) + decay * RNG.uniform(0.9, 1.0, 200))
    assert (int(found.number), bool(found.settled)) == (0, False)
    later = orbit(q, 200) + np.exp(-10) * decay
    assert (int(periodicity(later).number), bool(periodicity(later).settled)) == (q, True)


def test_noise_whose_returns_shrink_is_not_settled():
    # A burst early on widens the intervals of all means, so that no drift is seen in them; the returns are seen to die.
    noise = np.random.default_rng(5).standard_normal(400)
    assert bool(periodicity(noise).settled)  # control: without the burst
    noise[50] = 30.0
    found = periodicity(noise)
    assert (int(found.number), bool(found.settled)) == (0, False)


def test_lanes_keep_their_shape_and_do_not_disturb_each_other():
    lanes = np.stack([orbit(q) for q in (3, 16, 1, 17, 2, 8)]).reshape(2, 3, 96)
    lanes[1, 0] = np.nan
    found = periodicity(lanes)
    assert found.number.dtype == np.int32
    assert_array_equal(found.number, [[3, 16, 1], [0, 2, 8]])
    assert_array_equal(found.settled, [[True, True, True], [False, True, True]])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_bad_sample_leaves_no_period(bad):
    x = orbit(2)
    x[50] = bad
    assert (int(periodicity(x).number), bool(periodicity(x).settled)) == (0, False)


def test_too_few_samples_show_no_period():
    assert int(periodicity(np.array([0.3])).number) == 0  # nothing to compare with
    assert periodicity(np.array([[0.3], [0.4]])).number.shape == (2,)
    assert int(periodicity(np.array([0.3, 0.3])).number) == 1


def test_a_blade_at_rest_has_period_1():
    found = periodicity(np.zeros(40))
    assert (int(found.number), bool(found.settled)) == (1, True)


LEVER = 0.037  # m, half the diagonal of Table 1's blocks
SIZES = np.array([8e-4, 7e-4, 2e-4, 2e-4, 1e-2, 1e-2])  # of x, y [m] and theta [rad]


def number_of(samples, sizes=SIZES, precision=np.float64):
    return int(repetition(samples, sizes, np.asarray(LEVER), PERIOD_TOLERANCE, precision).number)


def motion(numbers, n=96, sizes=SIZES):
    """Displacements (n, 6) that repeat after given numbers of periods; each as large as its size at most."""
    return np.stack([orbit(q, n) for q in numbers], axis=1) * sizes


@pytest.mark.parametrize("numbers", [(1, 1, 1, 1, 2, 1), (3, 3, 1, 1, 1, 1), (2, 1, 3, 1, 1, 1)])
def test_every_displacement_counts(numbers):
    assert number_of(motion(numbers)) == np.lcm.reduce(numbers)


def test_a_displacement_counts_by_its_own_size():
    samples = motion([1] * 6)
    samples[::2, 3] += 2e-3 * SIZES[3]  # two thousandths of the right blade's y, half a thousandth of x
    assert number_of(samples) == 2
    samples[::2, 3] -= 1.2e-3 * SIZES[3]
    assert number_of(samples) == 1


def test_what_the_model_leaves_out_does_not_count():
    for kept in ([0], [0, 2], [0, 1], [0, 1, 2, 3]):  # rigid neighbour, no torsion
        sizes = np.where(np.isin(np.arange(6), kept), SIZES, 0.0)
        assert number_of(motion([5] * 6, sizes=sizes), sizes) == 5


@pytest.mark.parametrize(("precision", "noise"), [(np.float64, 1e-14), (np.float32, 5e-6)])
def test_rounding_does_not_count(precision, noise):
    # M_0 = 0: theta is what rounding leaves of moments that cancel.
    samples, sizes = motion([2] * 6), SIZES.copy()
    samples[:, 4:] = RNG.uniform(-1, 1, (96, 2)) * noise * SIZES[0] / LEVER
    sizes[4:] = np.abs(samples[:, 4:]).max(axis=0)
    assert number_of(samples, sizes, precision) == 2
    assert number_of(samples, np.where(sizes < 1e-6, 0.0, sizes), precision) == 2  # exact zero at ends of steps
    samples[:, 4:] *= 1e4 if precision is np.float64 else 10  # control: so much is no rounding
    assert number_of(samples, np.abs(samples).max(axis=0), precision) == (2 if precision is np.float64 else 0)
    samples[:, 4:] *= 1e5
    assert number_of(samples, np.abs(samples).max(axis=0), precision) == 0


@pytest.mark.parametrize("q", [1, 2, 3, 6])
def test_the_number_of_an_orbit_is_the_same_at_every_phase(q):
    # Orbits with harmonics that all but vanish at some phases, still settling by a hundredth of the tolerance.
    rng = np.random.default_rng(q)
    harmonics = rng.standard_normal((6, 3 * q)) + 1j * rng.standard_normal((6, 3 * q))
    harmonics[:, 1:q:2] += 1.0  # subharmonics are there
    t = np.arange(64 * 96)[:, None] / 96
    course = sum((harmonics[:, k] * np.exp(2j * np.pi * (k + 1) / q * t)).imag for k in range(3 * q)) * SIZES
    course = course * (1 + 1e-5 * np.exp(-t / 20))
    sizes = np.abs(course).max(axis=0)
    assert {number_of(course[phase::96], sizes) for phase in range(96)} == {q}


@pytest.mark.full
def test_the_number_of_a_run_is_the_same_at_every_phase():
    # x_1 passes through 0 at the strobe at 1.35; at others some hundredths of its size are left of it.
    scene = load("table1", ["drive.M_0=10"]).scene
    found = [
        sweep(scene, {"contact.gamma": [2.5]}, n_periods=32, transient=40, phase=p, method=RungeKutta(steps=400))
        for p in PHASES
    ]
    assert [int(got.period_number[0]) for got in found] == [1] * len(PHASES)
    assert np.ptp([got.P_d[0] for got in found]) < 1e-5


PHASES = (0.0, 1.35, 1.94, 2.60, 3.16, 6.26)


def decaying(q: int, decay: float, n: int, begun: int = 0) -> np.ndarray:
    """Displacements (n, 6) on their way to an orbit, a tenth of their size off at first."""
    t = begun + np.arange(n)[:, None]
    return np.stack([np.resize(np.roll(orbit(q, q), -begun), n) + 0.1 * np.exp(-t[:, 0] / decay)] * 6, axis=1) * SIZES


@pytest.mark.parametrize(("q", "decay"), [(1, 680), (1, 200), (2, 680), (4, 2000)])
def test_a_slow_approach_is_not_settled_though_it_nearly_repeats(q, decay):
    # c_x = 0.02: from period to period nothing changes by the tolerance, but in 680 periods it does.
    near = PERIOD_TOLERANCE * SIZES[None]
    for begun in range(0, 3 * decay, decay):
        samples = decaying(q, decay, 64, begun)
        found = repetition(samples, SIZES, np.asarray(LEVER), PERIOD_TOLERANCE, np.float64)
        assert (int(found.number), int(found.settling.verdict)) in (
            (q, NOT_SETTLED),
            (0, UNKNOWN_IF_SETTLED),
            (0, NOT_SETTLED),
        )
        if found.number == 0:
            continue
        more = int(found.settling.periods_more)
        needed = decay * np.log(0.1 / PERIOD_TOLERANCE) - begun  # until a thousandth is left
        assert needed / 2 < more < 2 * needed + 4 * 64
        later = settling(decaying(q, decay, 64, begun + more)[None], near, q)
        assert (int(later.verdict[0]), float(later.periods_more[0])) == (SETTLED, 0.0)


@pytest.mark.full
def test_yes_is_never_wrong_without_contact():
    # In closed form: P_d is 0 in the end. With c_x = 0.02 that takes some thousand periods.
    scene = load("table1", ['parts.contact="none"', "blades.c_x=0.02", "drive.M_0=10"]).scene

    def run(transient):
        return sweep(
            scene,
            {"drive.omega": [536.0, 700.0, 1110.0]},
            n_periods=64,
            transient=transient,
            method=RungeKutta(steps=400),
        )

    end, verdicts = run(30000), set()
    size = np.hypot(end.motion.x, end.motion.v_x / end.axes["drive.omega"][:, None, None]).max(axis=(1, 2))
    assert np.all(end.settling == SETTLED)
    assert np.all(end.P_d_settling == SETTLED)
    for transient in (0, 10, 100, 1000, 2000, 4000, 8000, 16000):
        got = run(transient)
        far = np.abs(got.motion.x - end.motion.x).max(axis=(1, 2)) / size
        assert not np.any((np.abs(got.P_d) > 0.02) & (got.P_d_settling == SETTLED)), transient
        assert not np.any((far > 5e-3) & (got.settling == SETTLED)), transient
        assert_array_equal(got.settled, got.settling == SETTLED)
        assert_array_equal(got.P_d_settled, got.P_d_settling == SETTLED)
        verdicts |= set(got.settling.tolist())
    assert {SETTLED, UNKNOWN_IF_SETTLED} <= verdicts


@pytest.mark.parametrize("n", [1, 2, 8, 15])
def test_few_periods_are_no_evidence(n):
    found = periodicity(np.full(n, 0.3))
    assert (int(found.number), bool(found.settled)) == (int(n > 1), False)


def wandering(n, rho=0.7, lanes=200):
    """AR(1) series (lanes, n, 1), of (1 + rho) / (1 - rho) samples to a correlation time."""
    noise = np.random.default_rng(5).normal(size=(n, lanes))
    for i in range(1, n):
        noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * noise[i]
    return noise.T[..., None]


def test_how_many_periods_an_aperiodic_motion_must_keep_is_told():
    near, needed = np.full((200, 1), 1e-6), 30 * 1.7 / 0.3  # samples for 30 correlation times
    short, long = settling(wandering(96), near, 0), settling(wandering(600), near, 0)
    asked = short.to_keep[np.isfinite(short.to_keep) & (short.to_keep > 0)]
    assert len(asked) > 100
    assert 0.5 < np.median(asked) / needed < 1.5
    assert np.all(asked > 96)
    assert np.mean(long.verdict == SETTLED) > 0.7
    assert np.all(long.to_keep[long.verdict == SETTLED] == 0)
    few = settling(wandering(32), near, 0)
    assert np.all(few.to_keep[few.verdict == UNKNOWN_IF_SETTLED] >= 64)
    # A torus is regular however long it is: more periods do not help.
    turns = np.sqrt(2) * np.arange(96) + np.arange(200)[:, None]
    torus = settling(np.sin(turns)[..., None], near, 0)
    assert np.all(torus.verdict != SETTLED)
    assert np.all(np.isnan(torus.to_keep))


def test_an_orbit_is_not_told_to_keep_more():
    assert settling(orbit(3)[None, :, None], np.full((1, 1), 1e-6), 3).to_keep.tolist() == [0.0]
