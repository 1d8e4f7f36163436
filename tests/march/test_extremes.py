"""Numerical stability at the extremes: correct, or a status that names the cause."""

import resource

import extremes
import jax
import numpy as np
import pytest
import reference
from numpy.testing import assert_allclose
from side_by_side import Choices, ends, relative_error, run, sizes, tableau, with_parts

import jaxshroud as js
from jaxshroud.batch.lanes import final_states, initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST, FAST_WITH_LEDGER
from jaxshroud.march.stability import largest_frequency, step_limits, steps_for
from jaxshroud.march.tableau import RK4
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StepTooLongError
from jaxshroud.scene.vary import vary


@pytest.fixture(scope="module")
def found(table1):
    return extremes.results(table1)


@pytest.mark.full
def test_every_case_ends_as_it_must(found):
    assert len(found) >= 200
    wrong = [f"{r.case}: {r.status}, not {r.case.expected}" for r in found if r.status != r.case.expected]
    assert not wrong


@pytest.mark.full
def test_every_case_that_is_ok_is_correct(found):
    assert {r.check for r in found if r.status == "OK"} == {"energy balance", "closed form"}
    assert not [f"{r.case}: {r.check} {r.error:.1e}" for r in found if not r.error <= extremes.TOLERANCE]


@pytest.mark.full
def test_the_table_in_the_documentation_is_this_one(found):
    written = [line.strip("| \n").split(" | ") for line in extremes.TABLE.read_text("utf-8").splitlines()]
    told = [tuple(cells[:4]) for cells in written if len(cells) == 5][1:]
    assert told == [row[:4] for row in extremes.rows(found)]


def parameters(scene) -> reference.Parameters:
    """The scene for the second opinion."""
    b, d, s = scene.blades, scene.drive, scene.shroud
    pair = lambda a: tuple(float(x) for x in a)
    blades = {name: pair(getattr(b, name)) for name in ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T")}
    drive = {name: pair(getattr(d, name)) for name in ("beta", "F_0", "M_0", "phase")}
    shroud = {name: float(getattr(s, name)) for name in ("alpha", "l_oa", "l_ab", "gap")}
    contact = {"k": float(scene.k), "k_d": float(scene.friction.k_d), "mu": float(scene.friction.mu)}
    return reference.Parameters(**blades, **drive, **shroud, **contact, m_y=pair(b.inertia_y), omega=float(d.omega))


@pytest.mark.release
@pytest.mark.full
def test_the_second_opinion_agrees_at_every_single_extreme(table1):
    # One period from rest. The second opinion knows no flat contact, turns of more than 1.2 rad, and no patience.
    method, compared = Choices(tableau("dopri8"), "cubic"), 0
    for case in extremes.cases():
        scene, steps = case.scene(table1), extremes.automatic_steps(case.scene(table1))
        if len(case.changes) > 1 or case.expected != "OK" or steps is None or steps > 70000:
            continue
        opinion = reference.simulate(parameters(scene), 1, rtol=1e-11)
        if opinion.status != "ok":
            continue
        got = run([scene], 1, steps, method)
        error = relative_error(ends(got), opinion.y[None], np.maximum(sizes(got), 1e-300))[0]
        assert error <= 1e-5, str(case)
        compared += 1
    assert compared >= 45


@pytest.mark.full
@pytest.mark.parametrize("gamma", [0.0, 2.5, 1e4])
def test_steps_just_below_and_above_the_limit(table1, gamma):
    scene = vary(table1, "contact.gamma", gamma)
    limit = float(largest_frequency(scene) * scene.drive.period) / step_limits(RK4)[0]
    below = js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=int(np.ceil(limit))))
    assert below.status == Status.OK
    assert np.abs(below.motion.theta).max() < 0.5
    with pytest.raises(StepTooLongError, match="unstable"):
        js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=int(limit)))


STIFFNESS = np.concatenate([[0.0, 1e-8, 1e-4, 1e-2], np.geomspace(0.1, 1e4, 16)])


def errors_over_gamma(table1, product: float | None, periods: int = 3) -> np.ndarray:
    """State error over the whole state's largest number at each gamma, from rest; product None: automatic steps."""
    errors = []
    for gamma in STIFFNESS:
        scene = vary(table1, "contact.gamma", gamma)
        turn = float(largest_frequency(scene) * scene.drive.period)
        steps = steps_for(scene, 0, "auto", RK4) if product is None else int(np.ceil(turn / product))
        got, exact = (
            ends(run([scene], periods, n, m))[0]
            for n, m in ((steps, FAST_WITH_LEDGER), (int(turn / 0.1) + 64, Choices(tableau("dopri8"), "cubic")))
        )
        errors.append(np.abs(got - exact).max() / np.abs(exact).max())
    return np.array(errors)


@pytest.mark.full
def test_the_error_at_the_limit_of_accuracy_and_at_automatic_steps(table1):
    coarse, auto = errors_over_gamma(table1, 0.5), errors_over_gamma(table1, None)
    assert np.median(coarse) <= 1e-3
    assert np.all(coarse[STIFFNESS <= 30] <= 1e-3)  # beyond, three periods hold so many impacts that errors have grown
    assert np.median(auto) <= 1e-6
    assert np.mean(auto <= 1e-5) >= 0.9
    # Control: twice the step of the limit of accuracy misses it.
    assert np.median(errors_over_gamma(table1, 1.5)) > 1e-3


@pytest.mark.release
def test_a_million_periods(table1):
    # The clock is an integer, so that no phase is lost, and nothing grows: neither the orbit's error nor the memory.
    scene = with_parts(vary(table1, "contact.gamma", 0.3), motion=("x",), neighbour="rigid")
    alone = jax.tree.map(lambda a: a[None], scene)
    state, ends_at, memory = initial_states(alone), [], []
    for periods in (5_000, 995_000):
        runs = run_lanes(alone, state, Plan(periods - 1, 1, 16, 0.0, FAST), lambda _: None)
        state = final_states(runs.last.state)
        assert runs.last.status == Status.OK
        ends_at.append(ends(runs)[0])
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert_allclose(ends_at[1], ends_at[0], rtol=1e-9)
    assert np.count_nonzero(ends_at[1]) == 2  # the left block's x and its rate
    assert memory[1] - memory[0] < 64 * 1024  # kB


@pytest.mark.full
def test_float32_at_late_times(table1):
    # Single precision stays on the orbit: its clock does not wear out.
    scene = vary(table1, "contact.gamma", 0.3)
    single = js.RungeKutta(steps=100, precision="float32")
    late = js.sweep(scene, {"drive.F_0": [60.0]}, n_periods=4, transient=20_000, method=single)
    exact = js.sweep(scene, {"drive.F_0": [60.0]}, n_periods=4, transient=400, method=js.RungeKutta(steps=100))
    assert late.status[0] == Status.OK
    assert_allclose(late.motion.theta, exact.motion.theta, rtol=1e-3)
    assert_allclose(late.P_d, exact.P_d, rtol=1e-3)


@pytest.mark.release
def test_a_hundred_thousand_lanes_are_as_many_single_ones(table1):
    lanes = 100_000
    F_0 = np.linspace(1.0, 90.0, lanes)
    many = js.sweep(table1, {"drive.F_0": F_0}, n_periods=1, method=js.RungeKutta(steps=40), transient=0)
    assert np.all(many.status == Status.OK)
    for lane in (0, 31_415, lanes - 1):
        one = js.sweep(
            table1, {"drive.F_0": F_0[lane : lane + 1]}, n_periods=1, method=js.RungeKutta(steps=40), transient=0
        )
        assert_allclose(one.motion.x[0], many.motion.x[lane], rtol=1e-9, atol=1e-16)
