"""Forces and friction's work of runs and sweeps: both sides of events, and what the march has tallied."""

import numpy as np
import pytest
import reference
from side_by_side import scene_of

from jaxshroud.march.method import Method, named_choices
from jaxshroud.model.modes import Mode
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.grids import stack_scenes
from jaxshroud.verbs.simulate import simulate
from jaxshroud.verbs.sweep import sweep

SCENES = {
    "table1": reference.table1(),
    "realistic": reference.table1(I=2.46e-5, M_0=0.5),
    "printed": reference.table1(gamma=0.3, reading=reference.PRINTED),
}
PERIODS, STEPS, EVERY = 3, 1600, 4  # 400 samples a period
MOTION = ("x", "y", "theta", "v_x", "v_y", "v_theta")


SERIES = Method("taylor", order=8, tolerance=1e-10)
OTHERWISE = {
    "table1, series": ("table1", SERIES),
    "realistic, series": ("realistic", SERIES),
    "realistic, dopri8": ("realistic", Method("dopri8", locate="cubic")),  # of whose stages there are too many at once
}


@pytest.fixture(scope="module", params=[*SCENES, *OTHERWISE])
def marched(request):
    """A run with its events, and a sweep of the same scene alone, step by step the same."""
    name, method = OTHERWISE.get(request.param, (request.param, Method()))
    p, how = SCENES[name], {"n_periods": PERIODS, "steps_per_period": STEPS, "method": method}
    run = simulate(scene_of(p), **how, every=EVERY, events=True)
    return p, run, sweep(scene_of(p), {"contact.k": [p.k]}, **how, transient=0, forces=True)


def rates(p: reference.Parameters, ds) -> np.ndarray:
    """u' and v' at every state in contact, by the second opinion; flat contact has those of case 4."""
    q, rate = (np.concatenate([ds[n].to_numpy() for n in names], axis=1) for names in (MOTION[:3], MOTION[3:]))
    found = np.zeros((len(q), 2))
    for i in np.flatnonzero(ds["mode"].to_numpy() != Mode.APART):
        r = reference.relative(p, min(int(ds["case"][i]), 4), q[i].tolist(), rate[i].tolist())
        found[i] = r.u_rate, r.v_rate
    return found


def enclosed(p: reference.Parameters, ds) -> tuple[float, float]:
    """The integral of F du over all stretches between events, and what it has put into the friction spring.

    Between two states F and u are cubics through their values and rates, of which the integral is exact.
    """
    t, F, u, mode = (ds[n].to_numpy() for n in ("time", "F", "u", "mode"))
    u_rate, v_rate = rates(p, ds).T
    sigma = np.select([mode == Mode.SLIP_PLUS, mode == Mode.SLIP_MINUS], [1.0, -1.0], 0.0)
    F_rate = np.where(mode == Mode.STICK, p.k_d * u_rate, sigma * p.mu * p.k * v_rate)
    i = np.flatnonzero((np.diff(t) > 0) & (mode[:-1] != Mode.APART))  # an event takes no time
    h = t[i + 1] - t[i]
    nodes, weights = np.polynomial.legendre.leggauss(3)  # exact for the product, of degree 5
    area = np.zeros(len(i))
    for s, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        values = 1 - 3 * s**2 + 2 * s**3, 3 * s**2 - 2 * s**3, s - 2 * s**2 + s**3, s**3 - s**2
        slopes = 6 * s**2 - 6 * s, 6 * s - 6 * s**2, 1 - 4 * s + 3 * s**2, 3 * s**2 - 2 * s
        at = lambda b, y, y_rate: b[0] * y[i] + b[1] * y[i + 1] + h * (b[2] * y_rate[i] + b[3] * y_rate[i + 1])  # noqa: E731
        area += weight * at(values, F, F_rate) * at(slopes, u, u_rate)
    return float(area.sum()), float(((F[i + 1] ** 2 - F[i] ** 2) / (2 * p.k_d)).sum())


@pytest.mark.full(but=["table1", "realistic"])
def test_the_friction_loop_encloses_the_tallied_work(marched):
    p, run, swept = marched
    area, sprung = enclosed(p, run.with_events())
    work = float(swept.friction_work[0]) * PERIODS
    # Cubics through 400 samples a period miss some 1e-8 of it, the march's own quadrature as much.
    assert area - sprung == pytest.approx(work, rel=1e-6)
    # Control: without the events the loop has no corners.
    assert abs(np.subtract(*enclosed(p, run.data)) / work - 1) > 1e-5


@pytest.mark.full(but=["table1", "realistic"])
def test_samples_are_those_of_a_run_without_events(marched):
    p, run, _ = marched
    plain = simulate(
        scene_of(p),
        n_periods=PERIODS,
        steps_per_period=STEPS,
        every=EVERY,
        method=named_choices(run.method)._replace(ledger=True),
    )
    # The same trials; programs that are compiled apart may round differently.
    np.testing.assert_allclose(run.motion.x, plain.motion.x, rtol=0, atol=1e-9 * np.abs(plain.motion.x).max())
    assert run.counters == plain.counters
    assert len(run.events.t) == 2 * (sum(run.counters.values()) - run.counters["grazing"])


@pytest.mark.full(but=["table1", "realistic"])
def test_events_change_the_state_and_not_the_place(marched):
    _, run, _ = marched
    before, after = (run.events.data.isel(time=slice(side, None, 2)) for side in (0, 1))
    np.testing.assert_array_equal(before["time"], after["time"])
    np.testing.assert_allclose(before["x"], after["x"], rtol=1e-12, atol=1e-18)
    changed = (before["mode"].to_numpy() != after["mode"].to_numpy()) | (before["case"].to_numpy() != after["case"])
    assert changed.all()
    whole = run.with_events()
    assert np.all(np.diff(whole["time"]) >= 0)
    # Each state stands where its neighbour has its mode: nothing changes but at events.
    moved = np.diff(whole["time"]) > 0
    assert np.all((np.diff(whole["mode"]) == 0)[moved])


@pytest.mark.full(but=["table1", "realistic"])
def test_the_largest_forces_are_no_less_than_any_state_shows(marched):
    p, run, swept = marched
    states = run.with_events()
    for name in ("N", "F"):
        largest, seen = float(getattr(swept, f"{name}_max")[0]), float(np.abs(states[name]).max())
        # Between samples a force is a part (omega h)^2 / 8 larger, 2e-3 at the frequency of contact.
        assert seen <= largest * (1 + 1e-12)
        assert largest < seen * (1 + 2e-3)
    assert float(swept.F_max[0]) <= p.mu * float(swept.N_max[0]) * (1 + 1e-6)


def test_the_largest_force_converges_as_its_cubics():
    # By the fourth power of the step; ends of steps and events alone miss by the second.
    scene, how = scene_of(SCENES["table1"]), {"n_periods": 1, "transient": 0, "method": Method(), "forces": True}
    steps = (200, 400, 3200)
    N = [float(sweep(scene, {"contact.k": [2.5e5]}, steps_per_period=n, **how).N_max[0]) for n in steps]
    miss = [abs(of / N[-1] - 1) for of in N[:-1]]
    assert miss[1] < 2e-5
    assert miss[0] > 8 * miss[1]


def test_events_are_of_one_scene_that_has_them(table1):
    with pytest.raises(InputError, match="one scene with located contact"):
        simulate(stack_scenes([table1, table1]), n_periods=1, steps_per_period=200, events=True)


@pytest.mark.full
def test_events_of_a_long_method():
    """Its trials are several kernels; as one, with what is kept of events, the compiler takes minutes."""
    how = {"n_periods": 1, "steps_per_period": 400, "every": 100}
    scene = scene_of(SCENES["table1"])
    got, fine = (simulate(scene, **how, method=m, events=True).events for m in (Method("dop853"), Method("rk4")))
    np.testing.assert_array_equal(got.mode, fine.mode)
    # Both locate events to 1e-6 of a step and better; RK4 errs by some 1e-7 at 400 steps.
    np.testing.assert_allclose(got.t, fine.t, rtol=1e-5)
