"""The march by power series: its recurrences are the right-hand side, and it keeps every law of the march."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import opinions
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pair_views import contact_of, rates_in
from side_by_side import counts, ends, energy_residual, relative_error, run, scene_of, sizes, with_parts

import jaxshroud as js
from jaxshroud import Status, load, vary
from jaxshroud.batch.lanes import carried_state, initial_states
from jaxshroud.batch.runs import trajectories
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.march.carry import Fixed, time_grid
from jaxshroud.march.events import EVENTS
from jaxshroud.march.extremes import _polynomial_maximum
from jaxshroud.march.method import Choices, method_as_json, method_from_json
from jaxshroud.march.row_events import row_guards
from jaxshroud.march.stepper import POWER_SERIES
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.march.taylor_events import first_event, return_length
from jaxshroud.march.taylor_expansion import per_radian, seconds_per_radian, taylor_expansion, wave_at
from jaxshroud.march.taylor_integrals import TrialSpan, read_off
from jaxshroud.march.taylor_trial import face_guards
from jaxshroud.model.arithmetic import Unrolled, is_zero
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import alone, at_only_interface, clusters_of, prepared_row, row_rhs
from jaxshroud.model.series import Series, polynomial_value, polynomial_value_and_rate
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Contact

FINE = Choices(tableau("dopri8"))
COARSE = Choices(TaylorOptions(8, 1e-7), "series")
SERIES = {"8": COARSE, "16": Choices(TaylorOptions(16, 1e-14), "series")}
MISPRINTS = ("gap_sign", "friction_components", "M_N2_case1", "M_N1_case2", "M_N1_case4", "levers")
DOUBTS = ("corner_angles", "M_N1_sign")
READINGS = [(), *((name,) for name in (*MISPRINTS, *DOUBTS)), MISPRINTS]
HELD = [(Mode.APART, 0), *itertools.product((Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS), (1, 2, 3, 4, FLAT))]
ORDER, SHORT = 12, 0.02  # [rad], within which what is left out is below rounding


def held(rng: np.random.Generator) -> State:
    """One random state in each mode and case; what is flat turns as one."""
    size = dict(x=1e-4, y=1e-5, theta=1e-2, v_x=0.05, v_y=0.01, v_theta=2.0)
    z = Motion(*(rng.normal(size=(len(HELD), 2)) * size[name] for name in Motion._fields))
    mode, case = (np.array(column, np.int32) for column in zip(*HELD, strict=True))
    flat = (case == FLAT)[:, None]
    one = lambda a: np.where(flat, a[:, :1], a)
    z = z._replace(theta=one(z.theta), v_theta=one(z.v_theta))
    pairs = Motion(*((jnp.asarray(a[:, 0]), jnp.asarray(a[:, 1])) for a in z))
    return State(pairs, jnp.asarray(rng.normal(size=len(HELD)) * 1e-5), jnp.asarray(mode), jnp.asarray(case))


def expanded(state: State, scene) -> dict:
    """Numbers by the series `SHORT` after a state, and the same by the right-hand side and the guards there."""
    row = prepared_row(scene)
    now = carried_state(state, row)
    lane = eqx.tree_at(lambda lane: lane.state, POWER_SERIES.begin(now, row, COARSE, alone), now)
    start, period = jnp.asarray(0.13), scene.drive.period
    fixed = Fixed(row, time_grid(start, jnp.asarray(100.0), period), jnp.int32(100))
    way = taylor_expansion(lane, fixed, ORDER, alone)
    unit, s = seconds_per_radian(fixed), jnp.asarray(SHORT)
    at = lambda number: polynomial_value_and_rate(number, s)
    ends = [list(map(at, zip(*a, strict=True))) for a in way.blades.own]
    x, y, theta = (Unrolled(*(value for value, _ in pair)) for pair in ends)
    v_x, v_y, v_theta = (Unrolled(*(rate for _, rate in pair)) for pair in ends)
    case = way.faces.case
    there = wave_at(jnp.int32(0), s / (math.tau * fixed.grid.turn), fixed.grid, alone)
    now = State(Motion(x, y, theta, v_x, v_y, v_theta), now.u_s, now.mode, case)
    scaled = per_radian(row, unit)
    slope, rates = row_rhs(there, now, clusters_of(now, scaled), scaled, Recorded(ledger=True), alone)
    curved = [
        [jax.jvp(lambda s, a=a: at_rate(a, s), (s,), (1.0,))[1] for a in zip(*b, strict=True)] for b in way.blades.own
    ]
    faces, contact = at_only_interface(way.faces), State(None, state.u_s, state.mode, state.case)
    guards = [polynomial_value(guard, s) for _, guard in face_guards(faces, contact, contact_of(scaled))]
    seen = row_guards(now, there, scaled, alone, EVENTS).value
    wave = wave_at(jnp.int32(0), jnp.asarray(0.0), fixed.grid, alone)

    def gained(s):
        contact = State(None, now.u_s, now.mode, now.case)
        method = Choices(TaylorOptions(ORDER, 1e-7), "series", derivative=True)
        return read_off(TrialSpan(s, unit, wave), way.blades, way.faces, contact, (None, None), row, method).gain

    _, rate = jax.jvp(gained, (s,), (jnp.ones(()),))
    works, exact = rate.ledger, rates.ledger
    return {
        "accelerations": ([a for pair in curved for a in pair], jax.tree.leaves(slope.acceleration)),
        "power": ([a / unit for a in rate.power], list(rates.power)),
        "works": (
            [a * unit**2 for a in (works.drive, works.viscous, works.friction)],
            [exact.drive, exact.viscous, exact.friction],
        ),
        "guards": ([*guards[:3], jnp.maximum(*guards[3:])], [a[0] for a in seen if not is_zero(a)]),
    }


def at_rate(a, s):
    """The rate of a polynomial."""
    return polynomial_value_and_rate(a, s)[1]


@pytest.mark.release(
    only=["M_N1_case2", "M_N1_case4", "M_N1_sign", "M_N2_case1", "friction_components", "gap_sign", "levers"]
)
@pytest.mark.full(but=["consistent"])
@pytest.mark.parametrize("reading", READINGS, ids=["consistent", *MISPRINTS, *DOUBTS, "printed"])
def test_series_obey_the_right_hand_side_in_every_mode_and_case(table1, reading):
    # Coefficients that satisfy x'' = f(x, x', t) and begin with the state are those of the motion. 0.02 rad on, terms
    # beyond order 12 are below rounding.
    scene = js.vary(table1, "drive.M_0", 10.0)
    scene = js.Scene(scene.blades, scene.shroud, Contact(None, 2.5, frozenset(reading)), scene.friction, scene.drive)
    found = jax.vmap(expanded, in_axes=(0, None))(held(np.random.default_rng(4)), scene)
    apart = np.array([mode == Mode.APART for mode, _ in HELD])
    for name, (series, numbers) in found.items():
        for k, (got, right) in enumerate(zip(series, numbers, strict=True)):
            got, right = np.asarray(got), np.asarray(right)
            keep = ~apart if name == "guards" and EVENTS[min(k, 3)].switches_case else np.full_like(apart, True)
            scale = np.abs(right[keep]).max()
            assert_allclose(got[keep], right[keep], rtol=0, atol=1e-12 * scale, err_msg=f"{name} {k}")


@pytest.mark.full
def test_a_series_of_one_reading_does_not_obey_another(table1):
    # Control: each misprint alone changes the accelerations by far more than the tolerance above.
    state, numbers = held(np.random.default_rng(4)), {}
    accelerated = jax.vmap(rates_in, in_axes=(0, None))
    for reading in READINGS:
        contact = Contact(None, 2.5, frozenset(reading))
        scene = js.Scene(table1.blades, table1.shroud, contact, table1.friction, table1.drive)
        numbers[reading] = np.array(jax.tree.leaves(accelerated(state, prepared_row(scene)).acceleration))
    scale = np.abs(numbers[()]).max()
    assert all(np.abs(numbers[r] - numbers[()]).max() > 1e-6 * scale for r in READINGS[1:])


def test_products_quotients_and_angles_of_series_are_those_of_their_functions():
    # exp(s): a_n = 1/n!; its square has 2^n/n!, and the quotient of both is exp(-s).
    grows = Series(lambda n: 1 / math.factorial(n))
    square = grows * grows
    for n in range(8):
        assert (grows**2)[n] == pytest.approx(2**n / math.factorial(n), rel=1e-14)
        assert (grows / square)[n] == pytest.approx((-1) ** n / math.factorial(n), abs=1e-14)
        assert grows.rate[n] == pytest.approx(grows[n], rel=1e-14)


def polynomial(roots, sign=1.0):
    """Coefficients, in rising powers, of a polynomial with these roots."""
    return np.polynomial.polynomial.polyfromroots(roots) * sign


# Guards on [0, 1] as polynomials, the one that fires and where: None for none.
COURSES = {
    "rises once": ([polynomial([0.3])], 0, 0.3),
    "rises and falls back in one part": ([polynomial([0.1, 0.25], -1)], 0, 0.1),
    "rises, falls, and is above zero at the end": ([polynomial([0.62, 1.4], -1)], 0, 0.62),
    "falls first": ([polynomial([0.2, 0.7])], 0, 0.7),
    "only falls": ([polynomial([0.4], -1)], None, None),
    "begins at zero and falls before it rises": ([polynomial([0.0, 0.04])], 0, 0.04),
    "falls, rises and falls again in one part": ([polynomial([0.0, 0.12, 0.3], -1)], 0, 0.12),
    "dips and has a hump in one part": ([polynomial([-0.05, 0.12, 0.4], -1)], 0, 0.12),
    "of two, that which is first": ([polynomial([0.45]), polynomial([0.44, 3.0, 5.0])], 1, 0.44),
    "of two in different parts": ([polynomial([0.6]), polynomial([0.4])], 1, 0.4),
    "straight lines tell the wrong one": ([polynomial([0.45]), polynomial([0.4] * 5)], 1, 0.4),
    "a hump before a crossing": ([polynomial([0.5]), polynomial([0.1, 0.3], -1)], 1, 0.1),
    "falls, comes back and falls again": ([polynomial([0.0, 0.1, 0.45], -1)], 0, 0.1),
    "the same, and is above zero at the end": ([polynomial([0.0, 0.56, 0.8, 0.97])], 0, 0.56),
    "none": ([polynomial([2.0]), polynomial([1.5])], None, None),
}


@pytest.mark.parametrize("name", COURSES)
def test_the_first_rise_of_polynomials(name):
    guards, which, root = COURSES[name]
    guards = [tuple(jnp.asarray(c) for c in guard) for guard in guards]
    h, tries, at = jnp.asarray(1.0), 0, None
    for _ in range(12):
        met = first_event(guards, h, jnp.asarray(False), jnp.int32(tries))
        if not met.reject:
            break
        h, tries = met.end, tries + 1
    at = float(met.end) if met.fire else None
    if root is None:
        assert at is None
        assert float(met.end) == float(h)
    elif name == "straight lines tell the wrong one":  # a five-fold root is flat: known to the fifth root of rounding
        assert (int(met.which), at) == (1, pytest.approx(0.4, abs=2e-3)) or not met.fire
    else:
        assert int(met.which) == which
        assert at == pytest.approx(root, abs=1e-9)


def all_numbers(scene):
    return vary(vary(scene, "contact.k", scene.k), "blades.m_y", scene.blades.inertia_y)


@pytest.fixture(scope="module")
def scenes(table1):
    return [all_numbers(vary(table1, "contact.gamma", gamma)) for gamma in (0.3, 2.5, 4.2, 7.5)]


@pytest.fixture(scope="module")
def fine(scenes):
    return run(scenes, 3, 2000, FINE)


@pytest.mark.full
@pytest.mark.release(only=["16"])
@pytest.mark.parametrize("method", SERIES.values(), ids=SERIES)
def test_motion_events_and_energy_are_those_of_the_fine_march(scenes, fine, method):
    got = run(scenes, 3, 2000, method)
    error = relative_error(ends(got), ends(fine), sizes(fine))
    # Impacts multiply what a step errs by, its tolerance at most, some tens of times in three periods.
    assert np.all(error <= max(100 * method.taylor.tolerance, 1e-11))
    for name in vars(fine.log.counters):
        if name != "grazing":
            assert_array_equal(counts(got, name), counts(fine, name), name)
    residual = np.abs(got.samples.residual.sum(-1)) / got.samples.gross.sum(-1)
    assert np.all(residual <= max(method.taylor.tolerance, 1e-12))
    near = max(100 * method.taylor.tolerance, 1e-11)
    assert_allclose(got.samples.power[..., 0], fine.samples.power[..., 0], rtol=near)
    for mine, theirs in zip(got.last.accumulator.log.times, fine.last.accumulator.log.times, strict=True):
        assert_allclose(mine[0], theirs[0], atol=1e-5 * float(scenes[0].drive.period))
    # The reference looks at the ends of its steps only, of which it has 2,000 a period.
    assert_allclose(got.log.v_max, fine.log.v_max, rtol=1e-4)


def test_a_trial_does_not_outlast_a_quick_return():
    # A guard that starts at its limit, dips for a thousandth of the trial and later falls for good: seen at its ends
    # alone it never rises. The trial ends beyond the return; a guard that bends down does not shorten it.
    quick, falling = ([tuple(jnp.asarray(c) for c in polynomial(at, -1))] for at in ([0.0, 1e-3, 0.2], [-0.5, 0.4]))
    one = jnp.asarray(1.0)
    assert 1e-3 < float(return_length(quick, one)) < 3e-3
    assert float(return_length(falling, one)) == 1.0
    met = first_event(quick, return_length(quick, one), jnp.asarray(False), jnp.int32(0))
    assert bool(met.fire)
    assert float(met.end) == pytest.approx(1e-3, abs=1e-12)


def test_a_guard_above_zero_is_the_one_that_is_met_in_a_trial_of_no_length():
    # Once a rejected trial has ended where it began, the next one has no length.
    guards = [(jnp.asarray(-1.0), jnp.asarray(1.0)), (jnp.asarray(1e-6), jnp.asarray(-1e-7))]
    met = first_event(guards, jnp.asarray(0.0), jnp.asarray(False), jnp.int32(4))
    assert (bool(met.fire), int(met.which)) == (True, 1)


@pytest.mark.release
@pytest.mark.full
def test_rocking_of_light_blades_is_that_of_the_fine_march(table1):
    # Thousands of switches in three periods between nearly parallel faces, with equal steps, by which flat contact is
    # told. 1e-8 in all but one lane of sixteen: where two neighbouring events decide what follows, 1e-4 remains.
    scenes = []
    for gamma in np.linspace(0.5, 8.0, 16):
        scene = table1
        for key, number in {"blades.I": 2.46e-5, "drive.M_0": 0.5, "contact.gamma": gamma}.items():
            scene = vary(scene, key, number)
        scenes.append(all_numbers(scene))
    fine, got = (run(scenes, 3, 2000, method) for method in (FINE, Choices(TaylorOptions(14, 1e-10), "series")))
    assert np.min(counts(fine, "switch_23") + counts(fine, "switch_14")) > 1000
    error = relative_error(ends(got), ends(fine), sizes(fine))
    assert np.sum(error < 1e-8) >= 15, error
    assert np.all(error < 1e-4), error


@pytest.mark.release  # studies/series.py
@pytest.mark.full
def test_second_opinion():
    parameters, told = opinions.scenes("consistent"), opinions.kept("consistent")
    runs = run([scene_of(p) for p in parameters], opinions.PERIODS, 3000, SERIES["16"])
    comparable = (told.status == "ok") & (runs.last.status != Status.ANGLE_OUT_OF_RANGE)
    size = np.repeat(np.abs(told.samples).reshape(-1, 3, 6, 2).max(axis=(1, 3)), 2, axis=-1)
    error = relative_error(ends(runs), told.samples[:, -1], size)
    suspects = comparable & (error > 1e-8)
    # As for the Runge-Kutta methods: there the reference itself moves between tolerances of 1e-12 and 1e-11.
    assert np.all(told.moved[suspects] > 1e-9), f"lanes {np.flatnonzero(suspects)}"
    assert np.mean(comparable & ~suspects) >= 0.6
    assert np.all(runs.last.status[comparable] == Status.OK)


@pytest.mark.full
def test_samples_are_read_off_and_cost_no_trial(table1):
    # Wherever samples are, the trials are the same: bit by bit the same end and the same works. What a march that stops
    # at an instant errs by otherwise there is its tolerance, times what impacts make of it.
    by = dict(method=js.Taylor(order=8, tolerance=1e-13, steps=400))
    many, few = (js.simulate(table1, n_periods=2, every=n, **by) for n in (1, 400))
    for name in Motion._fields:
        assert_array_equal(getattr(many.motion, name)[::400], getattr(few.motion, name))
    assert float(many.work_drive) == float(few.work_drive)
    assert abs(many.energy_residual) <= 1e-12
    scenes, method = js.stack_scenes([table1]), Choices(TaylorOptions(8, 1e-13), "series")
    for stop in (277, 391):  # a march that ends there, within the period
        grid = SampleGrid(0.0, 400, stop, stop)
        there = trajectories(scenes, initial_states(scenes), grid, method, lambda _: None)
        for name in Motion._fields:
            read, size = (
                np.asarray(getattr(many.motion, name)),
                np.asarray(getattr(there.samples["motion"], name))[0, -1],
            )
            assert_allclose(read[stop], size, rtol=0, atol=1e-10 * np.abs(read).max())
    assert np.any(np.diff(np.asarray(many.mode)[250:400]) != 0)  # events are among them


@pytest.mark.release
@pytest.mark.full
def test_lanes_are_read_off_each_at_its_own_pace(table1):
    # Side by side each lane makes its own trials, and has the samples that it has alone.
    scenes = [vary(table1, "contact.gamma", gamma) for gamma in (0.3, 7.5)]
    by = dict(n_periods=1, method=js.Taylor(order=8, tolerance=1e-6, steps=400), every=40)
    both, *alone = (js.simulate(s, **by) for s in (js.stack_scenes(scenes), *scenes))
    for lane, one in enumerate(alone):
        got = np.asarray(both.motion.x)[lane]
        assert_allclose(got, one.motion.x, rtol=0, atol=1e-9 * np.abs(got).max())
        assert_array_equal(np.asarray(both.mode)[lane], one.mode)


def test_crests_of_polynomials():
    # Of a random polynomial, the largest value within [0, 1] against that at a thousand points and both ends.
    rng, s = np.random.default_rng(8), np.linspace(0, 1, 1001)
    for _ in range(20):
        c = rng.normal(size=5) / [1, 1, 2, 6, 24]  # as smooth as a trial is
        seen = np.polynomial.polynomial.polyval(s, c).max()
        found = float(_polynomial_maximum(tuple(map(jnp.asarray, c)), jnp.asarray(1.0)))
        assert seen - 1e-12 <= found <= seen + 1e-6


@pytest.mark.full
def test_without_torque_from_rest(table1):
    # M_0 = 0: theta_1 = theta_2 for ever, and every contact is flat from its first instant.
    scene = all_numbers(vary(table1, "drive.M_0", 0.0))
    got = run([scene] * 4, 3, 2000, COARSE)
    truth = run([scene] * 4, 3, 2000, FINE)
    assert np.all(counts(got, "flat") >= counts(got, "onset_slip") + counts(got, "onset_stick"))
    assert relative_error(ends(got), ends(truth), sizes(truth))[0] <= 1e-5
    assert_array_equal(*np.moveaxis(got.samples.motion.theta, -1, 0))
    assert np.all(np.abs(energy_residual(got)) < 1e-7)


def test_the_name_of_the_method_is_its_choice():
    method = js.Taylor(order=14, tolerance=1e-10)
    assert str(method) == "taylor 14 1e-10, events by series, float64"
    assert method_from_json(method_as_json(method)).tolerance == 1e-10
    assert method.replace(tolerance=1e-9) == js.Taylor(order=14, tolerance=1e-9)
    assert str(method.replace(steps=50)) == "taylor 14 1e-10, events by series, float64, 50 steps a period"


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (lambda: js.Taylor(order=3), "`order` must be a whole number from 4 to 24"),
        (lambda: js.Taylor(tolerance=0.5), "`tolerance` must be a number from"),
        (lambda: js.RungeKutta(locate="series"), "`locate` cannot be 'series'"),
        (lambda: js.RungeKutta("taylor"), "`tableau` cannot be 'taylor'"),
    ],
)
def test_what_methods_refuse(method, message):
    with pytest.raises((js.InputError, TypeError), match=message):
        method()


def test_smooth_contact_by_series_is_refused(table1):
    smooth = with_parts(table1, 1e-7, contact="smooth")
    with pytest.raises(js.InputError, match=r"not smooth contact; take a Runge-Kutta method\.$"):
        js.simulate(smooth, n_periods=1, method=js.Taylor(steps=100))


def test_an_absent_number_stays_absent_beside_series():
    series = Series(lambda n: jnp.asarray(float(n)))
    absent = load("table1", ['parts.motion=["x"]']).scene
    ready = prepared_model(absent)
    assert is_zero(series * ready.mobility.inverse.theta[0])
    assert (series + ready.mobility.inverse.theta[0]) is series


@pytest.mark.release  # studies/missed_events.py
@pytest.mark.full
def test_faces_rock_to_the_last_return():
    """As contact ends what pushes rocking faces back fades: by series none of the last returns is missed."""
    scene = load("table1").scene
    for key, number in ROCKING.items():
        scene = vary(scene, key, number)
    switches = []
    for method in (js.RungeKutta("dopri8", locate="bisection"), js.Taylor(order=14, tolerance=1e-11)):
        marched = js.simulate(scene, n_periods=2, method=method.replace(steps=2000), every=1000)
        switches.append(marched.counters["switch_23"])
        assert marched.status == Status.OK
    assert switches[0] > 700  # an unchecked march by series misses four of them, and errs by 4e-4
    assert switches[1] == switches[0]


ROCKING = {
    "blades.m": 0.0701,
    "blades.I": 1.9512e-5,
    "blades.k_x": [181968.8, 70114.9],
    "blades.k_y": [1530557.9, 1714527.3],
    "blades.k_T": [2103.27, 3665.14],
    "blades.c_x": [2.786, 4.988],
    "blades.c_y": 58.77,
    "blades.c_T": [0.02026, 0.5883],
    "shroud.alpha": 0.6739,
    "shroud.gap": 0.0,
    "shroud.l_oa": 0.07525,
    "shroud.l_ab": 0.03275,
    "contact.gamma": 0.20919,
    "friction.mu": 0.06061,
    "friction.k_d": 678271.9,
    "drive.omega": 1173.17,
    "drive.beta": [1.0037, 0.60796],
    "drive.F_0": [41.186, 12.59],
    "drive.M_0": [0.58252, 0.31275],
    "drive.phase": [0.0, 4.923],
}


def test_a_guard_that_rises_twice_between_two_looks_is_not_passed_over():
    # Value and rate are -0.001 and 0 at 0, 1/2 and 1, so that no cubic tells of the two humps of 0.2 in between.
    double_root = np.polynomial.Polynomial.fromroots([0, 0, 0.5, 0.5, 1, 1])
    guard = 100 * double_root - 1e-3
    first = min(r.real for r in guard.roots() if abs(r.imag) < 1e-12 and r.real > 0)
    no, length = jnp.zeros((), bool), jnp.asarray(1.0)
    for tries in range(8):
        met = first_event([tuple(jnp.asarray(c) for c in guard.coef)], length, no, jnp.int32(tries))
        if not met.reject:
            break
        assert met.end < length
        length = met.end
    assert met.fire
    assert_allclose(met.end, first, rtol=1e-12)


@pytest.mark.release  # studies/missed_events.py
@pytest.mark.full
def test_a_double_crossing_inside_a_long_trial_is_met():
    # The faces switch forth and back within a trial of order 16: passed over, the state is 3.4e-4 off after two
    # periods, at any number of steps and with an energy residual of 1e-14. Dormand-Prince 8 and order 12 agree to 2e-9.
    overrides = {
        "blades.I": 2.6160521216069342e-05,
        "shroud.alpha": 0.9887105657862301,
        "shroud.gap": 1.0320996052560072e-06,
        "contact.k": 538404.5346056379,
        "drive.omega": 502.7957762247744,
        "drive.beta": 0.49427427276293934,
        "drive.F_0": 5.828297860798546,
        "drive.M_0": 0.10977218231319973,
        "drive.phase": [0.028875763527480905, 3.170468417117274],
    }
    scene = js.load("table1", [f"{key}={value}" for key, value in overrides.items()]).scene
    by_series, fine = (
        run([scene], 2, 1600, method) for method in (SERIES["16"], Choices(tableau("dopri8"), "cubic", False))
    )
    assert counts(by_series, "switch_23") == counts(fine, "switch_23")
    assert relative_error(ends(by_series), ends(fine), sizes(fine)) < 1e-8


def test_a_rigid_neighbour_has_no_coordinates_of_its_own():
    scene = js.load("table1", ['parts.neighbour="rigid"', 'parts.motion=["x"]']).scene
    by_series = js.simulate(scene, n_periods=2, method=js.Taylor(steps=200)).last.motion.x
    plain = js.simulate(scene, n_periods=2, method=js.RungeKutta("dopri8", 400)).last.motion.x
    assert_allclose(by_series, plain, rtol=0, atol=1e-8 * np.abs(plain).max())
