"""Forces, friction's work and wear of runs and sweeps: both sides of events, and what the march has tallied."""

from typing import NamedTuple

import numpy as np
import pytest
import reference
from numpy.testing import assert_allclose, assert_array_equal
from side_by_side import scene_of

import jaxshroud as js
from jaxshroud.model.modes import Mode
from jaxshroud.orbits.bifurcation import grazing_margins
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.grids import stack_scenes
from jaxshroud.verbs.simulate import simulate
from jaxshroud.verbs.sweep import sweep

pytestmark = pytest.mark.full

SCENES = {
    "table1": reference.table1(),
    "realistic": reference.table1(I=2.46e-5, M_0=0.5),
    "printed": reference.table1(gamma=0.3, reading=reference.PRINTED),
}
PERIODS, STEPS, EVERY = 3, 1600, 4  # 400 samples a period
MOTION = ("x", "y", "theta", "v_x", "v_y", "v_theta")


SERIES = js.Taylor(order=8, tolerance=1e-10)
OTHERWISE = {
    "table1, series": ("table1", SERIES),
    "realistic, series": ("realistic", SERIES),
    "realistic, dopri8": ("realistic", js.RungeKutta("dopri8")),  # of whose stages there are too many at once
}


LONG = pytest.mark.release(only=["table1, series", "realistic, dopri8"])


@pytest.fixture(scope="module", params=[*SCENES, *OTHERWISE])
def marched(request):
    """A run with its events, and a sweep of the same scene alone, step by step the same."""
    name, method = OTHERWISE.get(request.param, (request.param, js.RungeKutta(locate="bisection")))
    p, how = SCENES[name], {"n_periods": PERIODS, "method": method.replace(steps=STEPS)}
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


def loop_areas(t: np.ndarray, i: np.ndarray, y: tuple, x: tuple) -> np.ndarray:
    """The integrals of y dx between the states `i` and those after them, each given with its rate.

    Between two states y and x are cubics through their values and rates, of which the integral is exact.
    """
    h = t[i + 1] - t[i]
    nodes, weights = np.polynomial.legendre.leggauss(3)  # exact for the product, of degree 5
    area = np.zeros(len(i))
    for s, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        values = 1 - 3 * s**2 + 2 * s**3, 3 * s**2 - 2 * s**3, s - 2 * s**2 + s**3, s**3 - s**2
        slopes = 6 * s**2 - 6 * s, 6 * s - 6 * s**2, 1 - 4 * s + 3 * s**2, 3 * s**2 - 2 * s
        at = lambda b, y, y_rate: b[0] * y[i] + b[1] * y[i + 1] + h * (b[2] * y_rate[i] + b[3] * y_rate[i + 1])
        area += weight * at(values, *y) * at(slopes, *x)
    return area


def slip_signs(mode: np.ndarray) -> np.ndarray:
    """The signs sigma of slip, 0 in stick and apart."""
    return np.select([mode == Mode.SLIP_PLUS, mode == Mode.SLIP_MINUS], [1.0, -1.0], 0.0)


def enclosed(p: reference.Parameters, ds) -> tuple[float, float]:
    """The integral of F du over all stretches between events, and what it has put into the friction spring."""
    t, F, u, mode = (ds[n].to_numpy() for n in ("time", "F", "u", "mode"))
    u_rate, v_rate = rates(p, ds).T
    F_rate = np.where(mode == Mode.STICK, p.k_d * u_rate, slip_signs(mode) * p.mu * p.k * v_rate)
    i = np.flatnonzero((np.diff(t) > 0) & (mode[:-1] != Mode.APART))  # an event takes no time
    area = loop_areas(t, i, (F, F_rate), (u, u_rate))
    return float(area.sum()), float(((F[i + 1] ** 2 - F[i] ** 2) / (2 * p.k_d)).sum())


class Wear(NamedTuple):
    """What wears the faces in a run."""

    archard: float  # integral of N abs(u_s') [J]
    slip: float  # path of the slider [m]
    impulse: float  # of the normal force [N s]
    ended: np.ndarray  # that of each contact that ends [N s]
    speeds: np.ndarray  # closing speed at each onset [m/s]


def wear(p: reference.Parameters, ds) -> Wear:
    """The wear of the faces from the states on both sides of events."""
    t, N, u, v, mode = (ds[n].to_numpy() for n in ("time", "N", "u", "v", "mode"))
    (u_rate, v_rate), lag = rates(p, ds).T, slip_signs(mode) * p.mu * p.k / p.k_d
    slider, moves = (u - lag * v, u_rate - lag * v_rate), np.diff(t) > 0
    i, pressed = np.flatnonzero(moves & (lag[:-1] != 0)), np.flatnonzero(moves & (mode[:-1] != Mode.APART))
    ends = (N[1:] + N[:-1]) / 2 * np.diff(t) + np.diff(t) ** 2 / 12 * p.k * (v_rate[:-1] - v_rate[1:])
    onsets = np.flatnonzero((mode[:-1] == Mode.APART) & (mode[1:] != Mode.APART)) + 1
    worn = np.abs(loop_areas(t, i, (N, p.k * v_rate), slider)).sum()
    path = np.abs(slider[0][i + 1] - slider[0][i]).sum()
    separations = np.cumsum((mode[:-1] != Mode.APART) & (mode[1:] == Mode.APART))
    contact = np.append(0, separations)[pressed]  # the number of the contact of each interval
    ended = np.bincount(contact, ends[pressed], separations[-1] + 1)[: separations[-1]]
    return Wear(float(worn), float(path), float(ends[pressed].sum()), ended, v_rate[onsets])


@pytest.mark.release
@LONG
def test_the_wear_of_the_faces_is_that_of_the_run(marched):
    p, run, swept = marched
    own, whole = wear(p, run.with_events()), run.with_events()
    # As for the friction loop: cubics through 400 samples a period, and the march's own quadrature.
    assert float(swept.archard[0]) * PERIODS == pytest.approx(own.archard, rel=1e-6)
    assert float(swept.friction_work[0]) * PERIODS == pytest.approx(p.mu * own.archard, rel=1e-6)
    assert float(swept.slip[0]) * PERIODS == pytest.approx(own.slip, rel=1e-6)
    period = 2 * np.pi / p.omega
    assert float(swept.N_mean[0]) * period * PERIODS == pytest.approx(own.impulse, rel=1e-6)
    assert float(swept.impacts[0]) * PERIODS == len(own.speeds)
    assert float(swept.approach_max[0]) == pytest.approx(own.speeds.max(), rel=1e-6)
    assert float(swept.approach_mean[0]) == pytest.approx(own.speeds.mean(), rel=1e-6)
    # Of the contacts that end: one that has begun counts in neither, whatever its impulse is so far.
    assert float(swept.impulse_mean[0]) == pytest.approx(own.ended.mean(), rel=1e-6)
    assert float(swept.impulse_max[0]) == pytest.approx(own.ended.max(), rel=1e-6)
    assert float(swept.impulse_mean[0]) < float(swept.impulse_max[0]) <= own.impulse
    # Controls: without the events a part of the slip is missed; the re-setting of the slider is no slip.
    assert abs(wear(p, run.data).slip / own.slip - 1) > 1e-4
    assert float(np.nansum(np.abs(np.diff(whole["u_s"].to_numpy())))) > 0


@pytest.mark.release(only=["taylor 8 1e-10, events by series, float64"])
@pytest.mark.parametrize("method", [js.RungeKutta(steps=400), js.Taylor(order=8, tolerance=1e-10)], ids=str)
def test_blocks_that_start_pressed_together_do_not_collide(table1, method):
    got = sweep(table1, {"shroud.gap": [-2e-4]}, n_periods=1, transient=0, forces=True, method=method)
    begun = {name: int(got.counters[name][0]) for name in ("onset_slip", "onset_stick")}
    assert begun == {"onset_slip": 2, "onset_stick": 1}  # the start sticks
    assert got.impacts == 2
    # Control: with the start, at rest, the mean closing speed would be a third less.
    assert got.approach_mean > 0.8 * got.approach_max


@pytest.mark.release(only=["realistic", "realistic, series"])
@LONG
def test_the_friction_loop_encloses_the_tallied_work(marched):
    p, run, swept = marched
    area, sprung = enclosed(p, run.with_events())
    work = float(swept.friction_work[0]) * PERIODS
    # Cubics through 400 samples a period miss some 1e-8 of it, the march's own quadrature as much.
    assert area - sprung == pytest.approx(work, rel=1e-6)
    # Control: without the events the loop has no corners.
    assert abs(np.subtract(*enclosed(p, run.data)) / work - 1) > 1e-5


@LONG
def test_samples_are_those_of_a_run_without_events(marched):
    p, run, _ = marched
    plain = simulate(
        scene_of(p),
        n_periods=PERIODS,
        method=run.march,
        every=EVERY,
    )
    # The same trials; programs that are compiled apart may round differently.
    assert_allclose(run.motion.x, plain.motion.x, rtol=0, atol=1e-9 * np.abs(plain.motion.x).max())
    assert run.counters == plain.counters
    assert len(run.events.t) == 2 * (sum(run.counters.values()) - run.counters["grazing"])


@LONG
def test_events_change_the_state_and_not_the_place(marched):
    _, run, _ = marched
    before, after = (run.events.data.isel(time=slice(side, None, 2)) for side in (0, 1))
    assert_array_equal(before["time"], after["time"])
    assert_allclose(before["x"], after["x"], rtol=1e-12, atol=1e-18)
    changed = (before["mode"].to_numpy() != after["mode"].to_numpy()) | (before["case"].to_numpy() != after["case"])
    assert changed.all()
    whole = run.with_events()
    assert np.all(np.diff(whole["time"]) >= 0)
    # Each state stands where its neighbour has its mode: nothing changes but at events.
    moved = np.diff(whole["time"]) > 0
    assert np.all((np.diff(whole["mode"]) == 0)[moved])


@LONG
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
    scene, how = (
        scene_of(SCENES["table1"]),
        {"n_periods": 1, "transient": 0, "forces": True},
    )
    steps = (200, 400, 3200)
    methods = [js.RungeKutta(steps=n, locate="bisection") for n in steps]
    N = [float(sweep(scene, {"contact.k": [2.5e5]}, method=m, **how).N_max[0]) for m in methods]
    miss = [abs(of / N[-1] - 1) for of in N[:-1]]
    assert miss[1] < 2e-5
    assert miss[0] > 8 * miss[1]


MARCHES = (js.RungeKutta(steps=1600, locate="bisection"), js.Taylor(order=12, tolerance=1e-9, steps=1600))
OF_THE_MARCH = {"method", "scene", "energy_residual", "slider_jumps"}  # what says how it went, not what was found
BENDING = ['parts.motion=["x"]', "blades.c_x=40"]


def numbers_shown(result):
    """All that a result shows, by name: arrays, and attributes that are numbers."""
    told = {name: np.asarray(a) for name, a in {**result.data.variables, **result.data.attrs}.items()}
    return {name: a for name, a in told.items() if a.dtype.kind in "iufb" and name not in OF_THE_MARCH}


def assert_alike(results):
    """RK4 at 1,600 steps errs by some 1e-9, series by less; half widths of intervals show some hundred times that.

    RK4 looks at penetration where steps end: between them it is larger by (omega h)^2 / 8 at most, with omega that of
    contact, 6.5 times the drive's.
    """
    one, other = map(numbers_shown, results)
    assert one.keys() == other.keys()
    for name, a in one.items():
        size = np.nanmax(np.abs(a), initial=0) if a.dtype.kind == "f" else 0
        near = {"v_max": 1e-4}.get(name, 1e-6) * size + 1e-12  # rounding of what is zero
        assert_allclose(other[name], a, rtol=0, atol=near, err_msg=name)


@pytest.mark.release
def test_a_sweep_shows_the_same_whatever_the_march():
    # Pressed together from the start, where contact is deepest, and touching now and then.
    scene, gaps = js.load("table1", BENDING).scene, {"shroud.gap": [-4e-4, 2e-5]}
    runs = [sweep(scene, gaps, n_periods=2, transient=1, forces=True, method=m) for m in MARCHES]
    assert runs[0].v_max[0] == pytest.approx(4e-4 * np.sin(float(scene.shroud.alpha)), rel=1e-12)
    assert_alike(runs)


def test_a_run_shows_the_same_whatever_the_march():
    scene = js.load("table1", BENDING).scene
    runs = [simulate(scene, n_periods=1, every=100, events=True, method=m) for m in MARCHES]
    assert_alike(runs)
    assert_alike([run.events for run in runs])


@pytest.mark.release(only=["more0"])
@pytest.mark.parametrize("more", [[], ["friction.mu=0"], ["shroud.gap=20mm"]])
def test_margins_are_the_same_whatever_the_march(more):
    scene = js.load("table1", BENDING + more).scene
    one, other = (grazing_margins(js.orbit(scene, method=m).cycle()) for m in MARCHES)
    assert one.counters == other.counters
    # The largest speed is that of a cubic's slope, of which a step of 1/1600 misses some 1e-7; of ends alone 1e-6.
    assert_allclose(other[1:], one[1:], rtol=2e-7)


def test_without_contact_series_close_the_same_orbit():
    scene = js.load("table1", [*BENDING, "parts.contact=none"]).scene
    one, other = (js.orbit(scene, method=m) for m in MARCHES)
    assert other.P_d == pytest.approx(one.P_d, abs=1e-7)
    assert_allclose(np.abs(other.multipliers), np.abs(one.multipliers), rtol=0, atol=1e-8)


def test_events_are_of_one_scene_that_has_them(table1):
    with pytest.raises(InputError, match="one scene with located contact"):
        simulate(stack_scenes([table1, table1]), n_periods=1, method=js.RungeKutta(steps=200), events=True)


@pytest.mark.release
def test_events_of_a_long_method():
    """Its trials are several kernels; as one, with what is kept of events, the compiler takes minutes."""
    how = {"n_periods": 1, "every": 100}
    scene = scene_of(SCENES["table1"])
    got, fine = (
        simulate(scene, **how, method=m, events=True).events
        for m in (js.RungeKutta(name, steps=400, locate="bisection") for name in ("dopri8", "rk4"))
    )
    assert_array_equal(got.mode, fine.mode)
    # Both locate events to 1e-6 of a step and better; RK4 errs by some 1e-7 at 400 steps.
    assert_allclose(got.t, fine.t, rtol=1e-5)


def test_a_contact_that_has_not_ended_counts_in_no_impulse():
    # The blades meet within the only period, whose end is within their contact: half an oscillation on its spring is
    # 1.1 ms, the period 0.3 ms. The longest and the mean impulse are both of no contact yet.
    meet = ['parts.motion=["x"]', "initial.v_x=[1,-1]", "drive.omega=20000"]
    how = dict(n_periods=1, transient=0, forces=True, method=js.RungeKutta(steps=100))
    swept = sweep(js.load("table1", meet).scene, {"drive.F_0": [60.0]}, **how)
    assert swept.impacts[0] == 1
    assert swept.N_max[0] > 0
    assert swept.impulse_max[0] == 0
    assert np.isnan(swept.impulse_mean[0])
