"""Periodic orbits by shooting, and exact gradients on them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from quotients import on_orbit

import jaxshroud as js
from jaxshroud import load, value_of
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.tangents import direction, tangents
from jaxshroud.march import row_step
from jaxshroud.march.method import FAST
from jaxshroud.model import spring_contact
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State, initial_state
from jaxshroud.orbits.bifurcation import grazing_margins
from jaxshroud.orbits.orbit import ShootingState, describe_orbit
from jaxshroud.orbits.shooting import _shooting_step, moved_start
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.vary import vary
from jaxshroud.verbs.gradient import differences

STEPS = {"method": js.RungeKutta(steps=400)}
orbit, gradient, simulate = (partial(verb, **STEPS) for verb in (js.orbit, js.gradient, js.simulate))
PARAMETERS = (
    [
        "shroud.gap",
        "contact.gamma",
        "friction.k_d",
        "friction.mu",
        "drive.omega",
        "shroud.alpha",
        "shroud.l_oa",
        "shroud.l_ab",
    ]
    + [f"drive.{n}[{i}]" for n in ("F_0", "M_0", "beta", "phase") for i in (0, 1)]
    + [f"blades.{n}[{i}]" for n in ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T") for i in (0, 1)]
)
SIZE = 13  # of a state
UNLIKE = ("blades.m=[0.08, 0.085]", "drive.phase=[0, 2.9]")
PRINTED = ('contact.reading="printed"',)
# Overrides of Table 1 with F_0 = 60 N, the period number, and events that the orbit must have.
SCENES = {
    "slip onset": (("contact.gamma=1",), 1, ("onset_slip", "stick_slip", "slip_stick")),
    "stick onset": (("contact.gamma=7.5",), 1, ("onset_stick",)),
    "light contact": (("contact.gamma=0.3",), 1, ("switch_12", "switch_23", "switch_34")),
    "loaded switch 1-2": (("contact.gamma=16",), 2, ("switch_12", "onset_stick")),
    "loaded switch 1-4": (("contact.gamma=4.2",), 2, ("switch_14", "onset_stick")),
    "all switches": (("contact.gamma=6.6",), 2, ("switch_14", "switch_12", "switch_23", "switch_34")),
    "period 3": (("contact.gamma=5", "drive.omega=1535"), 3, ("onset_slip",)),
    "unlike blades": (("contact.gamma=6", *UNLIKE), 1, ("onset_stick", "switch_34")),
    "printed": (("contact.gamma=2.5", *PRINTED), 1, ("switch_12", "switch_23")),
    "printed, unlike blades": (("contact.gamma=1", *PRINTED, *UNLIKE), 1, ("onset_slip",)),
}


def scene_of(overrides):
    return load("table1", ["drive.F_0=60", *overrides]).scene


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES)
def case(request):
    """An orbit, its period number and its events."""
    overrides, q, events = request.param
    return orbit(scene_of(overrides)), q, events


@pytest.mark.release(only=["printed", "printed, unlike blades", "slip onset", "stick onset"])
@pytest.mark.full
def test_orbits_of_every_kind_are_found(case):
    found, q, events = case
    assert found.q == q
    assert found.flags == ()
    assert found.residual <= 1e-8
    run = simulate(found.scene, found.start, n_periods=found.q, method=found.method.replace(steps=400))
    for event in events:
        assert run.counters[event] > 0, event
    np.testing.assert_allclose(run.last.motion.x, found.start.motion.x, rtol=1e-6)


def scaled(values: dict, scene) -> np.ndarray:
    """Derivatives times the values of the parameters (or 1): changes of P_d for a relative change of each."""
    return np.array([slope * (abs(value_of(scene, key)) or 1) for key, slope in values.items()])


SLOW = ("loaded switch 1-2", "loaded switch 1-4", "period 3", "printed", "printed, unlike blades", "slip onset")


@pytest.mark.release(only=[*SLOW, "stick onset", "unlike blades"])
@pytest.mark.full
def test_exact_gradient_of_all_parameters(case):
    found, _, _ = case
    exact = scaled(on_orbit(found, PARAMETERS).value, found.scene)
    largest = np.abs(exact).max()
    for step in (3e-5, 1e-5, 3e-6):
        assert np.abs(scaled(differences(found, PARAMETERS, step), found.scene) - exact).max() <= 1e-6 * largest


def naive_miss(name, monkeypatch) -> float:
    """Largest error of a gradient that takes the events' instants for constants, over the largest component."""
    found = orbit(scene_of(SCENES[name][0]))
    right = scaled(on_orbit(found, PARAMETERS).value, found.scene)
    monkeypatch.setattr(row_step, "at_event", lambda quantities, *_: quantities)
    monkeypatch.setattr(spring_contact, "slide_at_onset", lambda crossing: crossing.at.u)
    method = found.march_choices._replace(tableau=found.method.tableau._replace(name="naive"))  # compiled anew
    steps = found.steps_per_period
    jacobian = tangents(found.scene, found.start, [], n=found.q, steps=steps, method=as_differentiable(method))
    naive = on_orbit(Orbit.of_cycles([replace(found.cycle(), method=method, jacobian=jacobian)]), PARAMETERS).value
    return np.abs(scaled(naive, found.scene) - right).max() / np.abs(right).max()


@pytest.mark.full
@pytest.mark.parametrize("name", ["stick onset", "loaded switch 1-2", "loaded switch 1-4", "all switches"])
def test_naive_gradients_are_wrong(name, monkeypatch):
    # Control: by 6 to 107 % where contact begins in stick or a case changes under load.
    assert naive_miss(name, monkeypatch) > 0.01


@pytest.mark.full
def test_naive_gradients_can_hide(monkeypatch):
    # Where contact begins in slip and no case changes, nothing is lost: such an orbit alone would prove nothing.
    assert naive_miss("slip onset", monkeypatch) < 1e-4


def test_newtons_step_of_a_linear_map_is_to_its_fixed_point():
    rng = np.random.default_rng(3)
    M = 0.4 * rng.standard_normal((7, 7))
    shift = rng.standard_normal(7)
    start = rng.standard_normal(7)
    step = _shooting_step(M, M @ start + shift - start, np.array([False]))
    np.testing.assert_allclose(start + step, np.linalg.solve(np.eye(7) - M, shift), rtol=1e-11)
    # A free slider stays; the others go to where they return beside it.
    held = start + _shooting_step(M, M @ start + shift - start, np.array([True]))
    assert held[-1] == start[-1]
    np.testing.assert_allclose((M @ held + shift)[:-1], held[:-1], rtol=1e-11)


def test_permanent_stick_is_not_unique():
    # A Jacobian that leaves the slider where it starts, put together by hand: with this contact model blades that stay
    # pressed together still change case, which moves the slider.
    found = orbit(scene_of(("contact.gamma=2.5",)))
    M = found.jacobian.by_state.copy()
    M[-1], M[:-1, -1] = np.eye(SIZE)[-1], 0.1 * np.arange(1, SIZE)
    end = State(found.start.motion, found.start.u_s, np.int32(Mode.STICK), np.int32(1))
    shot = ShootingState(found.start, found.jacobian._replace(by_state=M, end=end), 0.0, 1)
    held = Orbit.of_cycles([describe_orbit(found.scene, shot, 1, 1e-11, 8, 400, FAST)])
    assert held.flags == ("not unique",)
    assert held.slider_is_free
    got = on_orbit(held, ["shroud.gap"])
    assert np.isfinite(got.value["shroud.gap"])
    assert got.conditioning < 10


STICKS = ("shroud.gap=-0.0004", "friction.mu=5", "drive.M_0=1", "drive.F_0=20")  # the blocks stay pressed together
FEW = ["shroud.gap", "contact.gamma", "friction.k_d", "drive.omega", "drive.M_0[0]"]


@pytest.mark.full
def test_permanent_stick_is_not_unique_through_case_switches():
    # Each switch rewrites the slider's place, which leaves a rounding in its row of the Jacobian.
    found = orbit(load("table1", STICKS).scene, method=js.RungeKutta(steps="auto"))
    assert (
        simulate(found.scene, found.start, n_periods=2, method=js.RungeKutta(steps="auto")).counters["switch_14"] == 4
    )
    assert found.flags == ("not unique",)
    assert np.abs(found.others).max() < 0.9
    assert found.bifurcation[1] > 0.1
    got = on_orbit(found, FEW)
    assert got.flags == ("not unique",)
    assert got.conditioning < 10
    assert got.value["shroud.gap"] == pytest.approx(643128.32, rel=1e-7)
    exact = scaled(got.value, found.scene)
    step = scaled(differences(found, FEW, 1e-5), found.scene)
    assert np.abs(step - exact).max() <= 1e-8 * np.abs(exact).max()
    # Control: a slider that is only held where its row is that of the unit matrix to the last bit is not held here.
    at = found.jacobian
    assert not np.array_equal(at.by_state[-1], np.eye(SIZE)[-1])
    by = tangents(found.scene, found.start, [direction(found.scene, "shroud.gap")], n=found.q, **how(found))
    free = np.linalg.solve(np.eye(SIZE) - at.by_state, by.by_parameter)
    held = moved_start(at.by_state, by.by_parameter, True)
    assert np.abs(free - held).max() > 0.01 * np.abs(held).max()


def how(found) -> dict:
    return {"steps": found.steps_per_period, "method": as_differentiable(found.march_choices)}


@pytest.mark.release
@pytest.mark.full
def test_permanent_flat_contact_has_one_angle():
    # A difference of the angles does not exist there. Taken for a motion of its own it would stay for ever: a second
    # multiplier of 1, and derivatives off by up to twenty times.
    found = orbit(load("table1", ["shroud.gap=-0.0005", "friction.mu=5", "drive.M_0=0.05", "drive.F_0=5"]).scene)
    run = simulate(found.scene, found.start, n_periods=1, method=js.RungeKutta(steps=400))
    assert set(run.case.tolist()) == {5}
    assert found.flags == ("not unique",)
    assert np.abs(found.others).max() < 0.9
    assert np.sum(np.abs(found.multipliers) < 1e-9) == 2
    exact = scaled(on_orbit(found, FEW).value, found.scene)
    step = scaled(differences(found, FEW, 1e-5), found.scene)
    assert np.abs(step - exact).max() <= 1e-8 * np.abs(exact).max()


def orbit_near_resonance(c_x):
    """An orbit without contact that the more a push moves, the less damping there is; in closed form."""
    scene = load("table1", ["shroud.gap=1", f"blades.c_x={c_x}", f"drive.F_0={c_x}", "drive.M_0=0"]).scene
    scene = vary(scene, "drive.omega", float(np.sqrt(scene.blades.k_x[0] / scene.blades.m[0])))
    swing = steady_amplitudes(scene)[1]
    place, speed = [a.imag for a in swing], [scene.drive.omega * a.real for a in swing]
    return orbit(scene, state=initial_state(Motion(*place, *speed)), q=1, method=js.RungeKutta(steps=20000))


@pytest.mark.full
def test_ill_conditions_are_told():
    damped, nearly_free = orbit_near_resonance(1.0), orbit_near_resonance(1e-7)
    assert damped.flags == ()
    assert damped.conditioning == pytest.approx(28.7, rel=0.01)
    assert nearly_free.flags == ("ill conditioned",)
    assert nearly_free.doubt > 1e-6 > damped.doubt
    assert on_orbit(nearly_free, ["drive.omega"]).flags == ("ill conditioned",)
    assert nearly_free.conditioning == pytest.approx(1e7 * damped.conditioning, rel=0.05)


def test_chaos_has_no_orbit():
    found = orbit(scene_of(("contact.gamma=5.5",)), most_periods=200)
    assert not found.found
    assert found.flags == ("aperiodic",)
    assert np.isnan(found.P_d)


def test_a_known_period_number_needs_a_state(table1):
    with pytest.raises(ValueError, match="needs a `state`"):
        orbit(table1, q=2)


@pytest.mark.full
def test_margins_of_grazing():
    found = orbit(scene_of(("contact.gamma=2.5",)))
    margins = grazing_margins(found.cycle())
    assert 0 < margins.slowest_onset <= 1
    assert margins.counters["onset_slip"] == 4
    none = grazing_margins(orbit(load("table1", ['shroud.gap="5 mm"', "drive.F_0=60"]).scene).cycle())
    assert np.isnan(none.slowest_onset)
    assert none.nearest_miss > 0


@pytest.mark.release
@pytest.mark.full
def test_margins_see_grazes_and_misses_within_steps():
    # Bending alone, in closed form until the blocks touch. With 37 steps a period the corners pass their least distance
    # between two ends of steps, and a graze begins and ends there.
    free = load("table1", ['shroud.gap="5 mm"', "drive.F_0=60", "drive.M_0=0", "contact.gamma=2.5"]).scene
    found = orbit(free, method=js.RungeKutta(steps=37))
    missed = grazing_margins(found.cycle()).nearest_miss
    swing, alpha, deep = steady_amplitudes(free)[1], float(free.shroud.alpha), 1e-8
    d_x, d_y = (complex(a[0] - a[1]) for a in (swing.x, swing.y))
    size = abs(d_x * np.sin(alpha) - d_y * np.cos(alpha))
    exact = 5e-3 * np.sin(alpha) - size
    assert missed == pytest.approx(exact, rel=2e-5)  # RK4's own error of the motion with such steps
    run = simulate(free, found.start, n_periods=1, method=found.method.replace(steps=37))
    x, y = (np.asarray(a) @ [1, -1] for a in (run.motion.x, run.motion.y))
    ends = (5e-3 - x) * np.sin(alpha) + y * np.cos(alpha)
    assert ends.min() > exact * (1 + 5e-4)  # control: at the ends of steps it is further away
    grazing = replace(found.cycle(), scene=vary(free, "shroud.gap", 5e-3 - (missed + deep) / np.sin(alpha)))
    margins = grazing_margins(grazing)
    assert margins.counters["grazing"] == 1
    assert margins.slowest_onset == pytest.approx(np.sqrt(2 * deep / size), rel=0.2)
