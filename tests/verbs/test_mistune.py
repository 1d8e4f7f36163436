"""Mistuned rows: amplitudes of linear rings by an independent solution, statistics, searches, and marched rows."""

import jax
import numpy as np
import pytest
from command_line import read_json, refused, run, sets, status_of
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

import jaxshroud as js
from jaxshroud.cli import projection
from jaxshroud.model.modes import Status
from jaxshroud.scene.mistuning import design_pattern, random_patterns
from jaxshroud.signals.statistics import quantile_interval
from jaxshroud.signals.waves import RowResponses, largest_amplitudes
from jaxshroud.verbs.linear_rows import linear_problem
from jaxshroud.verbs.mistuned_rows import (
    MistunedRow,
    PatternProblem,
    PatternSlopes,
    SearchSize,
    search_worst_pattern,
)

pytestmark = pytest.mark.full

N, ORDER = 12, 3
LINEAR = js.load("row_ring12", ['parts.motion=["x", "y"]']).scene
SPEEDS = np.linspace(1000.0, 1400.0, 41)
ONE_MODE = ['parts.motion=["x"]', "contact.gamma=0.02", "friction.k_d=0", f"drive.engine_order={N // 2}"]
SMALL = ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1", "contact.gamma=2.6"]
SMALL_RING = js.load("row_ring12", SMALL).scene
HOW = {"n_periods": 4, "transient": 2, "method": js.RungeKutta("rk4", steps=200)}
ALONG = {"drive.omega": [500.0, 600.0]}


def solved(scene, mistuning, omega, k_d):
    """The amplitudes of x of a stuck ring, from matrices that are assembled here, blade by blade."""
    scene = jax.tree.map(np.asarray, scene)
    b, d, alpha = scene.blades, scene.drive, float(scene.shroud.alpha)
    n, t = np.array([np.sin(alpha), -np.cos(alpha)]), np.array([np.cos(alpha), np.sin(alpha)])
    spring = float(scene.contact.gamma[0] * b.k_x[0]) * np.outer(n, n) + k_d * np.outer(t, t)
    Z, Q = np.zeros((2 * N, 2 * N), complex), np.zeros(2 * N, complex)
    for i in range(N):
        own, right = slice(2 * i, 2 * i + 2), slice(2 * ((i + 1) % N), 2 * ((i + 1) % N) + 2)
        k = (1 + mistuning[i]) * np.array([b.k_x[i], b.k_y[i]])
        c = np.array([b.c_x[i], b.c_y[i]])
        Z[own, own] += np.diag(k + 1j * omega * c - omega**2 * b.m[i]) + spring
        Z[right, right] += spring
        Z[own, right] -= spring
        Z[right, own] -= spring
        direction = np.array([np.cos(d.beta[i]), np.sin(d.beta[i])])
        Q[own] = d.F_0[i] * direction * np.exp(2j * np.pi * ORDER * i / N)
    return np.abs(np.linalg.solve(Z, Q)[::2])


@pytest.fixture(scope="module")
def linear():
    return js.mistune(LINEAR, {"drive.omega": SPEEDS}, linear="stuck", sigmas=[0.01, 0.03], n_patterns=200, seed=1)


def test_a_linear_ring_is_that_of_a_direct_solution(linear):
    k_d = float(LINEAR.friction.k_d[0])
    amplitude = linear.amplitude[0, 1, :, 0]
    for p in range(200):
        at = [3, 17, 29]
        want = [solved(LINEAR, linear.mistuning[0, 1, p], SPEEDS[i], k_d).max() for i in at]
        # Both solve the same system; its condition number, some 1e3, leaves 1e-12.
        assert_allclose(amplitude[p, at], want, rtol=1e-8)
        tops = [
            solved(LINEAR, delta, w, k_d)
            for delta, w in (
                (linear.mistuning[0, 1, p], linear.worst_value[0, 1, p]),
                (np.zeros(N), linear.tuned_value),
            )
        ]
        assert_allclose(linear.amplification[0, 1, p], tops[0].max() / tops[1].max(), rtol=1e-8)
        assert tops[0].argmax() == linear.worst_blade[0, 1, p]
    # Without the springs of friction it is another ring.
    wrong = solved(LINEAR, linear.mistuning[0, 1, 0], SPEEDS[17], 0.0).max()
    assert abs(wrong / amplitude[0, 17] - 1) > 0.01


def test_the_peak_between_values_is_at_least_that_of_the_values(linear):
    assert_array_less(linear.amplitude.max(axis=(3, 4)) * (1 - 1e-12), linear.amplification * linear.tuned_largest)
    fine = js.mistune(LINEAR, {"drive.omega": np.linspace(1000, 1400, 4001)}, linear="stuck", n_patterns=3, seed=1)
    # From values 10 rad/s apart, a sixth of the width of the peaks, their heights are known to far less than 1e-4.
    assert_allclose(linear.amplification[0, 1, :3], fine.amplification[0, 0], rtol=1e-4)


def test_patterns_are_those_of_scenes_and_the_same_for_all_sigmas(linear):
    own = js.load("row_ring12", ["row.mistuning={sigma = 0.03, seed = 1}"]).scene.row.mistuning
    assert_allclose(linear.mistuning[0, 1, 0], own, rtol=1e-14)
    assert_allclose(linear.mistuning[0, 0] * 3, linear.mistuning[0, 1], rtol=1e-12)


def test_the_tuned_ring_amplifies_by_one_and_patterns_of_sigma_zero_are_designs(linear):
    assert linear.design_amplification == pytest.approx([1.0], rel=1e-14)
    assert linear.whitehead == pytest.approx((1 + np.sqrt(N)) / 2)
    both = js.mistune(
        LINEAR, {"drive.omega": SPEEDS}, linear="stuck", sigmas=[1e-9], n_patterns=2, designs=["none", "alternate:0.02"]
    )
    # A deviation of 1e-9 moves a peak whose relative width is 0.04 by some 1e-8 of its width.
    assert_allclose(both.amplification[:, 0, 0], both.design_amplification, rtol=1e-7)
    assert both.design_amplification[1] > 1.0001


def test_intentional_patterns_are_what_they_are_called():
    size = LINEAR.layout
    assert_array_equal(design_pattern("alternate:0.02", size), np.tile([0.02, -0.02], 6))
    assert_allclose(design_pattern("harmonic:6:0.02", size), design_pattern("alternate:0.02", size), atol=1e-16)
    waves = np.abs(np.fft.rfft(design_pattern("harmonic:4:0.03", size)))
    assert waves.argmax() == 4


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"designs": ["alternate"]}, "There is no pattern 'alternate'"),
        ({"designs": ["harmonic:7:0.1"]}, "a whole number from 0 to 6"),
        ({"designs": ["none", "none"]}, "each once"),
        ({"sigmas": [0.03, 0.01]}, "that increase"),
        ({"sigmas": [0.8], "n_patterns": 200}, "the mistuning of a blade"),
        ({"along": {"drive.omega": [2.0, 1.0]}}, "values that increase"),
        ({"of": "theta_peak"}, "move in x, y"),
        ({"linear": None, "updates": 2, "direction": "forward"}, "A search runs from rest"),
    ],
)
def test_what_cannot_be_is_refused(arguments, told):
    usual = {"along": {"drive.omega": SPEEDS}, "linear": "stuck", "n_patterns": 2}
    with pytest.raises(js.InputError, match=told):
        js.mistune(LINEAR, **usual | arguments)


def test_a_pair_is_refused():
    with pytest.raises(js.InputError, match=r"add a table \[row\]"):
        js.mistune(js.load("table1"), {"drive.omega": SPEEDS})


def test_slopes_of_a_linear_ring_are_its_differences():
    row = MistunedRow(js.vary(LINEAR, "row.mistuning", np.zeros(N)), "drive.omega", SPEEDS, "x_rms")
    problem = linear_problem(row, "stuck")
    pattern = 0.02 * random_patterns(1, N, 5)
    top = problem.largest(pattern)
    slope = problem.slopes(pattern, top).by_mistuning[0]
    step = 1e-5
    for i in (0, 7):
        sides = [solved(LINEAR, pattern[0] + s * step * np.eye(N)[i], top.value[0], 1e6)[top.blade[0]] for s in (1, -1)]
        # Central differences of a peak whose width is 0.04: their error is some (1e-5 / 0.04)^2, 1e-7.
        assert slope[i] == pytest.approx(
            (sides[0] - sides[1]) / (2 * step) * np.sqrt(0.5), rel=1e-5, abs=1e-5 * max(abs(slope))
        )


@pytest.mark.published
def test_a_gradient_comes_near_whiteheads_bound_in_its_own_case(published):
    zeta, k, m = 1e-4, 1e5, 0.08
    ring = js.load("row_ring12", [*ONE_MODE, f"blades.c_x={2 * zeta * np.sqrt(k * m)}"]).scene
    omega = np.linspace(1100.0, 1170.0, 600)
    found = js.mistune(ring, {"drive.omega": omega}, linear="stuck", sigmas=[0.02], n_patterns=2, starts=4, updates=40)
    assert 2.0 <= found.search_amplification[-1] <= found.whitehead * (1 + 1e-6)
    published("Whitehead's bound", [found.search_amplification[-1]])
    assert found.search_amplification[-1] > found.random_amplification[-1]
    assert np.sqrt(np.mean(found.searched_mistuning**2)) <= 0.02 * (1 + 1e-12)


def responses(amplitude, status=None):
    """Responses of patterns with amplitudes (n, directions, values, blades)."""
    amplitude = np.asarray(amplitude, float)
    status = np.zeros(amplitude.shape[:3], int) if status is None else status
    return RowResponses(amplitude, status, np.ones(amplitude.shape[:3], bool))


def test_a_search_finds_the_maximum_of_a_plane_however_slopes_are_found():
    a = np.array([1.0, -2.0, 0.5, 0.25])
    respond = lambda patterns: responses(np.stack([1 + patterns @ a] * 3, axis=1)[:, None, :, None])
    slopes = lambda patterns, top: PatternSlopes(np.tile(a, (len(patterns), 1)))
    problem = PatternProblem(values=np.arange(3.0), respond=respond, slopes=slopes, cost=3, slope_cost=1)
    found = search_worst_pattern(problem, 4, 0.1, SearchSize(8, 2, 20), 0)
    best = 0.1 * 2 * a / np.linalg.norm(a)  # on the ball of radius sigma sqrt(N)
    assert_allclose(found.mistuning, best, atol=1e-3)
    assert found.by_gradient[-1] == pytest.approx(1 + best @ a, rel=1e-4)
    assert found.by_chance[-1] < found.by_gradient[-1]
    # The scan, the first slopes, then responses to both paths and slopes of those that rose.
    assert found.cost[0] == 8 * 3 + 2
    assert np.all(np.diff(found.cost) <= 2 * (3 + 1))
    assert np.all(np.diff(found.cost) >= 2 * 3)


def test_patterns_with_narrow_peaks_are_named(reopened):
    # Lightly damped blades over few values. Where even the largest of all blades falls below half power at both
    # neighbours of a peak, the blade that has it does so all the more.
    scene = js.load("row_ring12", [*ONE_MODE, "row.blades=3", "drive.engine_order=1", "blades.c_x=0.16"]).scene
    values = np.linspace(1100.0, 1130.0, 16)
    found = js.mistune(scene, {"drive.omega": values}, linear="apart", sigmas=[0.01], n_patterns=12, seed=3)
    of_all = found.amplitude[0, 0, :, 0]  # (patterns, values)
    for k, level in enumerate(of_all):
        i = level.argmax()
        beside = max(level[j] for j in (i - 1, i + 1) if 0 <= j < len(values))
        assert found.narrow[0, 0, k] >= (beside < level[i] / np.sqrt(2))
    assert 0 < found.narrow.sum() < found.narrow.size
    names = [f"sigma 0.01, pattern {k}" for k in np.flatnonzero(found.narrow[0, 0])]
    assert [name for name in found.coarse_patterns if "pattern" in name] == names
    assert found.coarse == len(found.coarse_patterns)
    (line,) = (line for line in found.messages if "narrower" in line)
    assert found.coarse_patterns[0] in line
    assert reopened(found).messages == found.messages


def test_the_largest_amplitude_is_over_blades_values_and_directions():
    amplitude = np.ones((2, 2, 4, 3))
    amplitude[0, 1, 2, 0], amplitude[1, 0, 3, 2] = 5.0, 7.0
    amplitude[1, 1, 0] = np.nan
    status = np.zeros((2, 2, 4), int)
    status[1, 1, 0] = Status.NOT_FINITE
    top = largest_amplitudes(responses(amplitude, status), np.array([10.0, 20.0, 30.0, 40.0]))
    assert_array_equal(top.amplitude, [5.0, 7.0])
    assert_array_equal(top.value, [30.0, 40.0])
    assert_array_equal([top.direction, top.blade], [[1, 0], [0, 2]])
    assert_array_equal([top.whole, top.at_end, top.coarse], [[True, False], [False, True], [True, True]])
    assert top.participation_ratio[0] == pytest.approx((25 + 2) ** 2 / (3 * (625 + 2)))


def test_intervals_of_quantiles_cover_them():
    random = np.random.default_rng(0)
    for share, truth in ((0.5, np.log(2)), (0.95, np.log(20))):
        hits = []
        for _ in range(400):
            found = quantile_interval(random.exponential(size=100), share)
            hits.append(found.low <= truth <= found.high)
        # At least 95 of 100; of 400 trials fewer than 0.92 come by chance once in 200.
        assert 0.92 <= np.mean(hits) <= 0.99
    assert np.isnan(quantile_interval(np.arange(10.0), 0.95).high)  # no value of ten is above it surely
    assert quantile_interval(np.arange(1001.0), 0.5).value == 500


@pytest.fixture(scope="module")
def marched(tmp_path_factory):
    store = tmp_path_factory.mktemp("mistuned") / "a.zarr"
    scene = SMALL_RING
    return store, js.mistune(scene, ALONG, sigmas=[0.02], n_patterns=3, store=store, **HOW)


def test_a_marched_row_is_that_of_a_sweep(marched):
    _, found = marched
    scene = js.vary(SMALL_RING, "row.mistuning", found.mistuning[0, 0, 1])
    swept = js.sweep(scene, ALONG, amplitudes=True, **HOW)
    # The same lanes beside others; rounding alone.
    assert_allclose(found.amplitude[0, 0, 1, 0], swept.x_peak.max(axis=-1), rtol=1e-9)
    level = found.amplitude[0, 0, :, 0].max(axis=-1) / found.tuned_amplitude.max()
    assert_allclose(found.amplification[0, 0], level, rtol=1e-14)


def test_a_stored_run_goes_on_without_computing_again(marched, written):
    store, found = marched
    again = js.mistune(SMALL_RING, ALONG, sigmas=[0.02], n_patterns=3, store=store, resume=True, **HOW)
    assert not written
    assert_array_equal(again.amplification, found.amplification)
    with pytest.raises(js.StoreError, match=r"sigma|scenes|another"):
        js.mistune(SMALL_RING, ALONG, sigmas=[0.03], n_patterns=3, store=store, resume=True, **HOW)


def test_rows_are_run_up_and_down_the_speeds_and_searched(marched):
    scene, told = SMALL_RING, []
    both = js.mistune(scene, ALONG, sigmas=[0.02], n_patterns=3, direction="both", **HOW)
    assert both.amplitude.shape == (1, 1, 3, 3, 2)
    assert_allclose(both.amplitude[0, 0, :, 0], marched[1].amplitude[0, 0, :, 0], rtol=1e-9)
    assert np.all(both.amplitude[0, 0, :, 1, 0] == both.amplitude[0, 0, :, 0, 0])  # up from rest at the first value
    searched = js.mistune(
        scene,
        ALONG,
        sigmas=[0.02],
        n_patterns=1,
        scan=2,
        starts=1,
        updates=1,
        progress=lambda done, total: told.append((done, total)),
        **HOW,
    )
    periods = HOW["n_periods"] + HOW["transient"]
    assert searched.search_cost[0] == periods * (2 * 2 + 3)
    assert searched.search_amplification[-1] >= searched.search_amplification[0]
    assert all(done <= total for done, total in told)


def test_a_pattern_with_a_lane_that_stopped_is_left_out(monkeypatch):
    from jaxshroud.verbs import mistuned_rows as verb

    def stopping(*arguments, **named):
        found, chatter = swept_responses(*arguments, **named)
        amplitude, status = found.amplitude.copy(), np.array(found.status)
        amplitude[3, 0, 1], status[3, 0, 1] = np.nan, Status.TOO_MANY_EVENTS
        unjudged = np.arange(status.size).reshape(status.shape) < 5  # aperiodic lanes
        settled = found.settled.astype(bool) & ~unjudged
        to_keep = np.where(unjudged, 90.0, 0.0)
        return found._replace(amplitude=amplitude, status=status, settled=settled, to_keep=to_keep), chatter

    swept_responses = verb.swept_responses
    monkeypatch.setattr(verb, "swept_responses", stopping)
    found = js.mistune(SMALL_RING, ALONG, sigmas=[0.02], n_patterns=3, **HOW)
    assert np.isnan(found.amplification[0, 0]).tolist() == [False, True, False]
    assert found.left_out == found.failed == 1
    assert found.quantile[0, 0, 1] == pytest.approx(np.nanmedian(found.amplification))
    assert any("left out" in line for line in found.messages)
    assert found.unjudged == 5
    advice = "5 runs: too few periods to judge an aperiodic motion; keep at least 96 (--periods 96)"
    assert advice in found.messages
    drifting = f"the transient of {found.unsettled - 5} runs is perhaps not over: give a longer --transient"
    assert (drifting in found.messages) is (found.unsettled > 5)


def test_the_command_writes_what_the_verb_finds_and_says_what_is_wrong(tmp_path, capsys):
    along = "--along drive.omega --start 1000 --stop 1400 --num 21"
    words = f"mistune row_ring12 --set parts.motion=[x] {along} --n-patterns 20 --linear stuck --out {tmp_path}/out"
    run(f"{words} --pattern none --pattern alternate:0.02 --updates 2")
    out = capsys.readouterr().out
    assert "Whitehead (linear, one mode per blade)" in out
    assert "worst by gradient" in out
    found = js.open(tmp_path / "out" / "mistune.nc")
    assert isinstance(found, js.Mistuned)
    assert found.designs == ("none", "alternate:0.02")
    summary = read_json(tmp_path / "out" / "summary.json")
    assert summary["amplification"]["none"]["0.03"]["0.5"][0] == pytest.approx(found.quantile[0, 0, 1])
    for panel in ("amplification", "amplitude", "pattern"):
        found.plot(panel=panel)
    assert "has no store" in refused(capsys, f"{words} --force --resume")


@pytest.mark.parametrize("direction", ["independent", "forward"])
def test_a_long_march_is_projected_and_kept_in_a_store(direction, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(projection, "LONG_ROW_STEPS", 0)
    along = f"--along drive.omega --start 500 --stop 600 --num 2 --n-patterns 3 --direction {direction}"
    how = "--tableau rk4 --steps-per-period 200 --periods 4 --transient 2"
    words = f"mistune row_ring12 {sets(*SMALL)} {along} {how} --out {tmp_path}/out"
    run(words)
    (told,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("10 runs: about ")]
    assert "mistune.zarr" in told
    assert (tmp_path / "out" / "mistune.zarr").is_dir()
    assert status_of(words) == 2
    assert "give --resume to go on with it" in capsys.readouterr().err.splitlines()[-1]
    run(f"{words} --resume --force")
