"""Linear rows with patterns of mistuning under several harmonics: a dense reference, slopes, ties and marches."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar

import jaxshroud as js
from jaxshroud.scene.config import parse
from jaxshroud.scene.mistuning import random_patterns
from jaxshroud.signals.waves import largest_amplitudes
from jaxshroud.verbs.linear_rows import linear_problem
from jaxshroud.verbs.mistuned_rows import MistunedRow

N, M, K, C, B, K_C = 6, 0.08, 1e5, 8.0, 1.1, 2e4
LOADS = {1: (60.0, 30.0, 0.0), 2: (20.0, -20.0, 100.0), 4: (30.0, 60.0, 250.0)}  # N, degrees, degrees; by engine order
TEXT = f"""
[row]
blades = {N}
closed = true
[row.coupling]
k_x = {K_C}
[blades]
m = {M}
I = "block"
k_x = {K}
k_y = 3e6
k_T = 2000.0
c_x = {C}
c_y = 19.6
c_T = 0.506
B_x = {B}
[shroud]
alpha = "60 deg"
l_oa = 0.05
l_ab = 0.035
gap = 0.5
[contact]
k = 2.6e5
[friction]
k_d = 1e6
mu = 0.9
[run]
periods = 4
transient = 996
steps_per_period = 400
[drive]
speed = "500 rad/s"
F_x_mean = 20
"""
SPEEDS = np.linspace(350.0, 650.0, 31)  # order 2 meets the blades there, and order 1 beyond


def ring(*changes, orders=(1, 2, 4), motion='["x"]'):
    """A coupled ring under some engine orders and a mean load, whose stiffness grows with the speed."""
    rows = "".join(
        f'[[drive.harmonic]]\nengine_order = {n}\nF = {F}\nbeta = "{beta} deg"\nphase = "{psi} deg"\n'
        for n, (F, beta, psi) in LOADS.items()
        if n in orders
    )
    return parse(f"{TEXT}{rows}[parts]\nmotion = {motion}\n", "ring.toml", changes)


def waves(pattern, omega, orders=(1, 2, 4)):
    """The complex amplitudes of x (speeds, N) of the ring apart, by order, from matrices that are assembled here."""
    omega = np.atleast_1d(omega)[:, None, None]
    ring_of = 2 * np.eye(N) - np.roll(np.eye(N), 1, axis=0) - np.roll(np.eye(N), -1, axis=0)
    found = {}
    for n in orders:
        F, beta, psi = LOADS[n]
        own = K * (1 + pattern) + M * (B - n**2) * omega[..., 0] ** 2 + 1j * n * omega[..., 0] * C
        Z = own[:, :, None] * np.eye(N) + K_C * ring_of
        Q = F * np.cos(np.radians(beta)) * np.exp(1j * (2 * np.pi * n * np.arange(N) / N + np.radians(psi)))
        found[n] = np.linalg.solve(Z, np.broadcast_to(Q, (len(omega), N))[..., None])[..., 0]
    return found


def peaks(pattern, omega, orders=(1, 2, 4)):
    """The largest |x - mean| of each blade (speeds, N): of 2,048 phases, polished by Newton's method from the best."""
    of = waves(pattern, omega, orders)
    tau = np.linspace(0, 2 * np.pi, 2048, endpoint=False)
    course = sum((a[..., None] * np.exp(1j * n * tau)).imag for n, a in of.items())
    at = tau[np.abs(course).argmax(axis=-1)]
    for _ in range(4):
        rate = sum(n * (a * np.exp(1j * n * at)).real for n, a in of.items())
        at = at + rate / sum(n**2 * (a * np.exp(1j * n * at)).imag for n, a in of.items())
    return np.abs(sum((a * np.exp(1j * n * at)).imag for n, a in of.items()))


def largest(pattern, low, high):
    """The largest amplitude of any blade between two speeds, and the blade: of 200 speeds, polished about the best."""
    fine = np.linspace(low, high, 201)
    level = peaks(pattern, fine).max(axis=-1)
    k = int(np.clip(level.argmax(), 1, 199))
    found = minimize_scalar(
        lambda v: -peaks(pattern, v).max(), bounds=(fine[k - 1], fine[k + 1]), method="bounded", options={"xatol": 1e-9}
    )
    return max(-found.fun, level.max()), int(peaks(pattern, found.x)[0].argmax())


PATTERNS = 0.03 * random_patterns(8, N, 1)


def linear(of, orders=(1, 2, 4)):
    scene = js.vary(ring(orders=orders).scene, "row.mistuning", np.zeros(N))
    return linear_problem(MistunedRow(scene, "drive.speed", SPEEDS, of), "apart")


@pytest.fixture(scope="module")
def problem():
    return linear("x_peak")


@pytest.fixture(scope="module")
def found(problem):
    return problem.respond(PATTERNS)


def test_amplitudes_are_those_of_the_sum_of_harmonics(found):
    for pattern, of_blades in zip(PATTERNS, found.amplitude[:, 0], strict=True):
        # Both solve the same system to some 1e-12 and are polished.
        assert_allclose(of_blades, peaks(pattern, SPEEDS), rtol=1e-9)
    added = sum(np.abs(a) for a in waves(PATTERNS[0], SPEEDS).values())  # the control: magnitudes
    assert np.median(added / found.amplitude[0, 0]) > 1.02


def test_the_worst_blade_is_that_of_the_largest_peak_between_values(found):
    top = largest_amplitudes(found, SPEEDS)
    for p, pattern in enumerate(PATTERNS):
        k = int(found.amplitude[p, 0].max(axis=-1).argmax())
        level, blade = largest(pattern, SPEEDS[max(k - 1, 0)], SPEEDS[min(k + 1, len(SPEEDS) - 1)])
        assert top.amplitude[p] == pytest.approx(level, rel=1e-9)
        assert top.blade[p] == blade


@pytest.mark.full
def test_root_mean_squares_are_closed_forms():
    found = js.mistune(ring(), {"drive.speed": SPEEDS}, linear="apart", of="x_rms", n_patterns=3)
    for p in range(3):
        square = sum(np.abs(a) ** 2 / 2 for a in waves(found.mistuning[0, 0, p], SPEEDS).values())
        assert_allclose(found.amplitude[0, 0, p, 0], np.sqrt(square).max(axis=-1), rtol=1e-9)


@pytest.mark.parametrize("of", ["x_peak", pytest.param("x_rms", marks=pytest.mark.full)])
def test_slopes_hold_the_instant(of, problem):
    problem, pattern = problem if of == "x_peak" else linear(of), PATTERNS[:2]
    top = problem.largest(pattern)
    slopes = problem.slopes(pattern, top)
    assert slopes.ties == 0
    h = 1e-5
    for p in range(2):

        def level(change):
            moved = pattern[p] + change  # noqa: B023
            if of == "x_peak":
                return peaks(moved, top.value[p])[0, top.blade[p]]  # noqa: B023
            square = sum(np.abs(a) ** 2 / 2 for a in waves(moved, top.value[p]).values())  # noqa: B023
            return np.sqrt(square)[0, top.blade[p]]  # noqa: B023

        want = [(level(h * e) - level(-h * e)) / (2 * h) for e in np.eye(N)]
        # Central differences of a peak whose width is some 0.02: (1e-5 / 0.02)^2, 3e-7.
        assert_allclose(slopes.by_mistuning[p], want, rtol=1e-5, atol=1e-5 * np.abs(want).max())


def test_ties_are_counted(problem):
    # All blades of a tuned ring are equally large and move differently; a random pattern has one worst blade.
    both = np.stack([np.zeros(N), PATTERNS[0]])
    assert problem.slopes(both, problem.largest(both)).ties == 1


@pytest.mark.full
def test_two_instants_that_move_alike_are_no_tie():
    # Under odd harmonics a displacement is its own negative half a period later.
    problem = linear("x_peak", orders=(1,))
    assert problem.slopes(PATTERNS[:1], problem.largest(PATTERNS[:1])).ties == 0


@pytest.mark.full
def test_a_search_tells_its_ties(reopened):
    options = {"linear": "apart", "n_patterns": 2, "scan": 4, "starts": 2, "updates": 4}
    found = js.mistune(ring(), {"drive.speed": SPEEDS}, **options)
    assert found.search_amplification[-1] >= found.search_amplification[0]
    assert found.summary()["search"]["slopes at ties"] == found.search_ties >= 0
    assert reopened(found).search_ties == found.search_ties


STUCK = ("shroud.gap=-0.4 mm", "drive.level=0.02", "drive.F_x_mean=0", 'initial.start="static"')


@pytest.mark.full
@pytest.mark.parametrize(("state", "changes"), [("apart", ()), ("stuck", STUCK)])
def test_a_march_of_a_thousand_periods_ends_there(state, changes):
    file = ring(*changes, motion='["x", "y"]')
    found = {
        of: js.mistune(file, {"drive.speed": [480.0, 500.0]}, linear=state, of=of, sigmas=[0.02], n_patterns=1)
        for of in ("x_peak", "x_rms")
    }
    scene = js.vary(file.scene, "row.mistuning", found["x_peak"].mistuning[0, 0, 0])
    marched = js.power(scene, n_periods=4, transient=996, method=js.RungeKutta("dopri8", steps=400), amplitudes=True)
    for of, one in found.items():
        # Between steps, cubics miss (2 pi 4 / 400)^4 / 384 of order 4, 4e-8.
        assert one.amplitude[0, 0, 0, 0, 1] == pytest.approx(getattr(marched, of).max(), rel=1e-6)
