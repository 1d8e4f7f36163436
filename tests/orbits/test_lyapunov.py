"""Lyapunov exponents of what has known ones: textbook maps, and blades that never touch."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud import load
from jaxshroud.batch.lanes import initial_states
from jaxshroud.march.method import FAST
from jaxshroud.model.prepared import State
from jaxshroud.orbits.lyapunov import first_frames, largest_exponents, mean_exponents, next_frames
from jaxshroud.scene.grids import scenes_at

pytestmark = pytest.mark.full


def henon(z):
    return np.array([1 - 1.4 * z[0] ** 2 + z[1], 0.3 * z[0]]), np.array([[-2.8 * z[0], 1.0], [0.3, 0.0]])


def logistic(z):
    return 4 * z * (1 - z), np.array([4 - 8 * z])


def cat(z):
    M = np.array([[2.0, 1.0], [1.0, 1.0]])
    return M @ z % 1.0, M


def exponents_of(step, z, n):
    frames, growth = first_frames(len(z)), []
    for _ in range(n):
        z, M = step(z)
        frames, grown = next_frames(frames, M)
        growth += grown
    return mean_exponents(np.array(growth))[:2]


@pytest.mark.parametrize(
    ("step", "start", "known"),
    [
        (logistic, [0.3], [np.log(2)]),
        (henon, [0.1, 0.1], [0.41922, -1.62319]),
        (cat, [0.1, 0.4], np.log((3 + np.sqrt(5)) / 2) * np.array([1, -1])),
    ],
)
def test_textbook_maps(step, start, known):
    # Published values lie within 1.5 half widths of 95 % intervals (once in 300 they do not, by chance), where frames
    # that are still turning when the average begins leave up to 1e-4.
    mean, ci = exponents_of(step, np.array(start), 3000)
    assert np.all(ci < 0.02)
    assert np.all(np.abs(mean - known) <= 1.5 * ci + 1e-4)
    # The sum is the mean logarithm of the determinant, whatever the frames do: exact.
    if step is not logistic:
        assert_allclose(mean.sum(), np.log(0.3) if step is henon else 0.0, atol=1e-12)


def test_blades_that_never_touch_forget_with_their_dampers():
    # Each lane's x_1 decays as exp(-c t / 2 m); a push that is measured in energy does not swing by more than zeta.
    base = load("table1", ['parts.motion=["x"]', 'shroud.gap="5 mm"']).scene
    damping = np.array([2.0, 4.0, 8.0])
    scenes = scenes_at(base, ["blades.c_x"], damping[:, None])
    found = largest_exponents(scenes, initial_states(scenes), 32, 100, FAST)
    exact = -damping / (2 * 0.08) * np.asarray(scenes.drive.period)
    # RK4 at omega h = 0.13 damps by (omega h)^5 / 144 a step more: 3e-5 of a period's 0.15 at least.
    assert_allclose(found.exponent, exact, rtol=0.02)
    assert np.all(np.abs(found.exponent - exact) <= found.ci + 2e-4)


STEPS = {"method": js.RungeKutta(steps=100)}
NEVER = ('shroud.gap="1 m"',)
PRESSED = ('shroud.gap="-1 mm"', "drive.F_0=1")


@pytest.mark.parametrize(
    ("overrides", "moving", "slider"),
    [
        (NEVER, 4, [-np.inf]),
        (PRESSED, 4, [0.0]),
        pytest.param((*NEVER, 'parts.contact="none"'), 4, [], marks=pytest.mark.full),
        pytest.param((*PRESSED, 'parts.friction="none"'), 4, [], marks=pytest.mark.full),
        pytest.param((*NEVER, 'parts.neighbour="rigid"'), 2, [-np.inf], marks=pytest.mark.full),
    ],
    ids=["never touching", "stuck", "no contact", "no friction", "one blade"],
)
def test_there_are_as_many_exponents_as_states(overrides, moving, slider):
    # Two of each coordinate that moves, one of the slider; those of the motion sum up to the dampers' (Liouville).
    scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", *overrides]).scene
    found = js.lyapunov(scene, n_periods=8, transient=4, **STEPS)
    special = found.exponents[np.isin(found.exponents, [0.0, -np.inf])]
    assert special.tolist() == slider
    assert np.isnan(found.ci[np.isneginf(found.exponents)]).all()
    motion = found.exponents[~np.isin(found.exponents, [0.0, -np.inf])]
    assert len(motion) == moving
    exact = -moving / 2 * 40 / 0.08 * float(scene.drive.period)
    assert_allclose(motion.sum(), exact, rtol=1e-3)  # RK4 damps by (omega h)^5 / 144 a step more
    assert found.stuck == (slider == [0.0])
    assert ("slider in permanent stick" in repr(found)) == found.stuck


def test_a_slider_that_slips_has_lost_its_memory():
    # Griffin's oscillator, three states: x, its rate, and a slider that each slip sets anew.
    unit = [f"blades.{name}=1" for name in ("m", "I", "k_x", "k_y", "k_T")]
    dry = [f"blades.{name}=0" for name in ("c_x", "c_y", "c_T")]
    press = ["shroud.alpha=1e-4", "shroud.gap=-1e5", "contact.gamma=0.1", "friction.k_d=1", "friction.mu=1"]
    drive = ["drive.omega=1.079", "drive.beta=0", "drive.F_0=1", "drive.M_0=0"]
    parts = ['parts.motion=["x"]', 'parts.neighbour="rigid"']
    scene = js.load("table1", [*unit, *dry, *press, *drive, *parts]).scene
    found = js.lyapunov(scene, n_periods=16, transient=60, **STEPS)
    exact = np.log(np.abs(js.orbit(scene, q=1, state=found.last, **STEPS).multipliers[:2]))
    # Frames of two directions turn for 16 periods, over which their growth parts by exp(0.47) each: 5e-4 at most.
    assert_allclose(found.exponents[:2], exact, atol=5e-4)
    assert found.exponents[2:].tolist() == [-np.inf]
    assert np.isnan(found.ci[2])


def test_growth_below_rounding_is_not_resolved():
    # A factor of 1e-13 of the largest is told from rounding by nobody, of 1e-9 it is; an exact 0 is forgotten.
    for factor, is_known in ((1e-9, True), (1e-13, False)):
        frames, growth = first_frames(2), []
        for _ in range(40):
            frames, grown = next_frames(frames, np.diag([1.0, factor]))
            growth += grown
        mean = mean_exponents(np.array(growth))[0]
        assert np.isfinite(mean).tolist() == [True, is_known]
    mean, ci, _ = mean_exponents(np.array([[-1.0, np.nan, -2.0], [-1.0, -5.0, -np.inf]]))
    assert_array_equal(mean, [-1.0, np.nan, -np.inf])
    assert np.isnan(ci[1:]).all()


def test_the_largest_exponent_of_a_ring_is_that_of_a_nearby_run():
    # By plain marches, brought back to one distance after each period; multipliers are complex, so that growth turns.
    ring = load("row_ring12", ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1", "contact.gamma=6"]).scene
    method, omega = js.RungeKutta(steps=200), float(ring.drive.omega)
    here = js.simulate(ring, n_periods=100, method=method).last
    found = js.lyapunov(ring, state=here, n_periods=32, transient=0, method=method)
    apart = 1e-7 * np.abs(here.motion.x).max()
    x, v = np.random.default_rng(0).standard_normal((2, 3)) * apart
    growth = []
    for _ in range(60):
        near = here.motion._replace(x=here.motion.x + x, v_x=here.motion.v_x + omega * v)
        there = State(near, here.u_s, here.mode, here.case)
        here, there = (js.simulate(ring, start, n_periods=1, method=method).last for start in (here, there))
        x, v = there.motion.x - here.motion.x, (there.motion.v_x - here.motion.v_x) / omega
        size = np.linalg.norm([x, v])
        growth.append(np.log(size / apart))
        x, v = x * apart / size, v * apart / size
    assert found.exponents[0] < -0.2
    assert np.mean(growth[12:]) == pytest.approx(found.exponents[0], abs=0.02)
    assert np.isneginf(found.exponents[6:]).all()  # the sliders, which slip sets anew
