"""Blades by modes in the verbs that close, follow and differentiate orbits, and in those that tell motions apart.

Lumped blades written as modes answer as the lumped ones; derivatives by what modes have are those of sweeps.
"""

import dataclasses
import functools

import jax
import modal_reference
import numpy as np
import pytest
import row_reference
from numpy.testing import assert_allclose, assert_array_less

import jaxshroud as js
from jaxshroud.io.restart import stored_end
from jaxshroud.march import taylor_trial
from jaxshroud.model.blade import ModalMotion
from jaxshroud.orbits.gradient import scenes_around
from jaxshroud.scene.text import text_of
from jaxshroud.scene.vary import level_of

METHOD = js.RungeKutta(steps=100)
SHORT = {"method": METHOD, "n_periods": 8, "transient": 24}
SPEEDS = ("drive.omega", 525.0, 545.0)
ALONG_X = ['parts.motion=["x"]', "blades.c_x=40"]
WHOLE = ["drive.M_0=1", "blades.c_x=40"]


@functools.cache
def two_modes():
    """A blade of two modes along x, and one that does not move the shroud, beside a wall."""
    blades = js.modal_blades([160.0, 420.0, 300.0], 0.1, [[3.0, 1.5, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(js.load("table1", [*ALONG_X, 'parts.neighbour="rigid"']).scene, blades=blades)


@functools.cache
def orbit_of_two():
    return js.orbit(two_modes(), method=METHOD)


def test_an_orbit_has_the_coordinates_of_its_modes(tmp_path):
    found = orbit_of_two()
    assert (found.q, found.flags) == (1, ())
    assert found.multipliers.shape == (2 * 2 * 3 + 1,)
    assert np.sum(np.abs(found.multipliers) < 1e-12) >= 2 * 3  # of the wall
    # The third mode, which does not move the shroud, decays by itself.
    k, c = (2 * np.pi * 300) ** 2, 2 * 0.1 * 2 * np.pi * 300
    own = np.exp(np.roots([1, c, k]) * float(two_modes().drive.period))
    assert all(np.abs(found.multipliers - one).min() < 2e-3 * abs(one) for one in own)
    # A run from its start returns to it; read from a file, too.
    found.save(tmp_path / "orbit.nc")
    for start in (found.start, js.open(tmp_path / "orbit.nc").start):
        assert isinstance(start.motion, ModalMotion)
        run = js.simulate(two_modes(), state=start, n_periods=1, method=METHOD)
        for name in ("x", "v_x"):
            there = getattr(run.motion, name)
            assert_allclose(there[-1], there[0], rtol=0, atol=1e-9 * np.abs(there).max())
            assert_allclose(there[0], getattr(found.motion, name), rtol=1e-12)
    # Control: from x and v_x alone, which leave the modes undetermined, it does not.
    run = js.simulate(two_modes(), state=dataclasses.replace(start, motion=found.motion), n_periods=1, method=METHOD)
    assert np.abs(run.motion.x[-1] - run.motion.x[0]).max() > 1e-4 * np.abs(run.motion.x).max()


@pytest.mark.full
def test_exponents_are_the_multipliers():
    found, orbit = js.lyapunov(two_modes(), **{**SHORT, "n_periods": 32}), orbit_of_two()
    moving = np.log(np.abs(orbit.multipliers[:6]))
    assert found.exponents.shape == (6 + 1,)
    assert_allclose(found.exponents[:6].sum(), moving.sum(), rtol=1e-2)
    assert_allclose(found.exponents[0], moving[0], rtol=0.05)
    assert isinstance(found.last.motion, ModalMotion)


@pytest.mark.full
def test_a_branch_and_a_response_pass_the_orbit():
    found, orbit = js.branch(two_modes(), *SPEEDS, most_points=4, method=METHOD), orbit_of_two()
    at = np.argmin(np.abs(found.value - 536))
    assert found.value[at] == pytest.approx(536, rel=1e-12)
    assert found.P_d[at] == pytest.approx(orbit.P_d, rel=1e-9)
    there = js.orbit(js.vary(two_modes(), "drive.omega", found.value[0]), state=found.start(0), q=1, method=METHOD)
    assert there.P_d == pytest.approx(found.P_d[0], rel=1e-9)
    assert there.updates <= 1
    response = js.response(two_modes(), *SPEEDS, num=2, most_points=2, **SHORT)
    assert not np.any(response.status)


SETTLED = [(3, 2, 0, 1), (3, 2, 0, 3), (4, 2, 0, 1), (4, 2, 0, 3), (5, 2, 0, 8), (6, 2, 0, 8), (3, 2, 2, 3)]
RINGS = [(3, 3, 2, 1), (3, 3, 2, 8), (4, 3, 2, 4)]
FINE = js.RungeKutta(steps=3200)


def settled_scene(n, blades, points, seed):
    """A random pair or ring of blades of n modes, damped so that it settles soon."""
    rng = np.random.default_rng(seed)
    p = row_reference.random_row(rng, blades, closed=blades > 2)
    gap = tuple(abs(one) / 4 + 2e-6 for one in p.gap)
    p = dataclasses.replace(p, mistuning=(0.0,) * blades, initial=(0.0,) * (6 * blades), gap=gap)
    modes = modal_reference.random_modes(rng, n, p)
    modes = modes._replace(zeta=rng.uniform(0.05, 0.1, modes.zeta.shape))
    return modal_reference.scene_of(p, modes, points)


def with_stress(scene):
    """The scene with a stress of each mode."""
    sigma = np.random.default_rng(1).uniform(1e9, 9e9, (scene.coordinates, 1)) * np.ones(scene.layout.blades)
    own = [dataclasses.replace(mode, sigma=a) for mode, a in zip(scene.blades.modes, sigma, strict=True)]
    return dataclasses.replace(scene, blades=js.ModalBlades(tuple(own)))


def swept_slopes(scene, keys, orbit):
    """The derivatives of P_d and sigma_a of settled sweeps, each times its number, and the errors of both, (2, keys).

    They are central differences of order 4 with steps h, and their errors a fifteenth of what steps of 2 h change. The
    sweeps are by power series: by cubics between the steps of a Runge-Kutta method the extremes of the stress err by
    1e-7 at 800 steps, and their differences, as an extreme passes steps, by up to 4e-5.
    """
    levels = np.array([level_of(scene, key) for key in keys])
    h = 1e-4
    offsets = np.array([[-4], [-2], [-1], [1], [2], [4]])
    parts = [scenes_around(scene, [key], v * (1 + h * offsets)) for key, v in zip(keys, levels, strict=True)]
    scenes = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    method = js.Taylor(14, 1e-13, 200)
    swept = js.sweep(scenes, n_periods=2 * orbit.q, transient=512, method=method, amplitudes=True)
    numbers = swept.P_d, swept.sigma_a[:, scene.layout.counting].max(axis=1)
    values = np.stack(numbers).reshape(2, len(keys), 6)
    of_order_4 = np.array([1, -8, 8, -1]) / (12 * h)
    fine, coarse = values[..., 1:5] @ of_order_4, values[..., [0, 1, 4, 5]] @ of_order_4 / 2
    return fine, abs(coarse - fine) / 15


@pytest.mark.full
@pytest.mark.parametrize(("n", "blades", "points", "seed"), SETTLED + RINGS)
def test_derivatives_are_those_of_settled_sweeps(n, blades, points, seed):
    scene = with_stress(settled_scene(n, blades, points, seed))
    orbit = js.orbit(scene, most_periods=192, method=FINE)
    keys = ["blades.modes[0].f", "blades.modes[0].zeta", "blades.modes[1].phi_x", f"blades.modes[{n - 1}].phi_theta"]
    keys += ["blades.modes[2].f[0]", "shroud.gap", "friction.mu"]
    of_stress = [f"blades.modes[{j}].sigma" for j in range(n)]
    power, stress = (
        js.gradient(scene, [*keys, *more], of=of, orbit=orbit, method=FINE)
        for of, more in (("P_d", ()), ("sigma_a", of_stress))
    )
    assert power.flags == stress.flags == ()
    wanted, errors = swept_slopes(scene, keys, orbit)
    slopes = np.array([[found.value[key] * level_of(scene, key) for key in keys] for found in (power, stress)])
    sizes = np.max(np.abs(wanted), axis=1, keepdims=True)
    # With 3200 steps the times of events, by cubics, leave 5e-8, with 800 up to 1e-5; rounding 1e-9 of the largest.
    allowed = 1e-6 * np.abs(wanted) + 1e-8 * sizes
    assert_array_less(errors, allowed / 10)
    assert_array_less(np.abs(slopes - wanted), allowed)
    # Half the range is linear in the stress of all modes.
    assert sum(stress.value[key] * level_of(scene, key) for key in of_stress) == pytest.approx(stress.level, rel=1e-9)
    # Control: with the damper held instead of the damping ratio, the derivative by f is another one.
    held = slopes[:, 0] - slopes[:, 1]
    assert np.all(np.abs(held - wanted[:, 0]) > 1e-5 * sizes[:, 0])


def scaled_slopes(case, method):
    """The derivatives of P_d of a settled scene, each times the number itself."""
    scene = settled_scene(*case)
    keys = ["blades.modes[0].f", "blades.modes[1].phi_x", "blades.modes[2].zeta", "shroud.gap", "friction.mu"]
    found = js.gradient(scene, keys, method=method).value
    return np.array([found[key] * level_of(scene, key) for key in keys])


EXACT = js.RungeKutta("dopri8", 400, locate="bisection")


@pytest.mark.full
@pytest.mark.parametrize("case", [SETTLED[2], SETTLED[-1], RINGS[0]])
def test_derivatives_by_series_are_those_of_runge_kutta(case):
    wanted, found = scaled_slopes(case, EXACT), scaled_slopes(case, js.Taylor(14, 1e-13, 400))
    assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.max(np.abs(wanted)))


@pytest.mark.full
def test_naive_derivatives_by_series_are_wrong(monkeypatch):
    # Control: events whose instants have no derivative; another order is compiled anew.
    monkeypatch.setattr(taylor_trial, "at_event", lambda quantity, *_: quantity)
    wanted, naive = scaled_slopes(SETTLED[2], EXACT), scaled_slopes(SETTLED[2], js.Taylor(13, 1e-13, 400))
    assert np.max(np.abs(naive - wanted)) > 1e-5 * np.max(np.abs(wanted))


@pytest.mark.full
def test_a_design_by_series_is_that_of_runge_kutta():
    how = {"search": js.SearchOptions(2, 1, 1), "motions": 2, "n_periods": 8, "transient": 24}
    best, exact = (
        js.tune(two_modes(), {"shroud.gap": (1e-5, 4e-5)}, method=method, **how).best
        for method in (js.Taylor(14, 1e-13, 200), js.RungeKutta("dopri8", 200, locate="bisection"))
    )
    assert_close(best, exact)


def by_modes(scene):
    """Lumped blades by modes, of which there are as many as coordinates."""
    modes, kept = modal_reference.modes_of_lumped(scene.blades), len(scene.parts.motion)
    blades = js.modal_blades(modes.f[:kept], modes.zeta[:kept], modes.shapes[:, :kept], blades=scene.layout.blades)
    return dataclasses.replace(scene, blades=blades)


def assert_close(found, wanted):
    """The same numbers to 1e-9 of the largest; what is not finite in the same places."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    size = np.max(np.abs(wanted), where=np.isfinite(wanted), initial=0.0)
    assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * size)


MEASURED = {"t [s]": np.array([0.002, 0.004, 0.006]), "x_left [m]": np.array([1e-5, 3e-5, -2e-5])}
ANSWERS = {  # numbers of each verb
    "orbit": lambda s: [
        (one := js.orbit(s, method=METHOD)).P,
        one.motion.x,
        one.conditioning,
        np.sort_complex(
            one.multipliers[np.abs(one.multipliers) > 1e-9].round(12)
        ),  # not of coordinates that are absent
    ],
    "lyapunov": lambda s: [(one := js.lyapunov(s, **SHORT)).exponents, one.motion.x],
    "branch": lambda s: [(one := js.branch(s, *SPEEDS, most_points=3, method=METHOD)).value, one.P_d, one.motion.v_x],
    "response": lambda s: [
        (one := js.response(s, *SPEEDS, num=2, most_points=2, **SHORT)).data["P_d"],
        one.data["x_peak"],
    ],
    "diagnose": lambda s: [js.diagnose(s, transient=16, method=METHOD).exponents],
    "attractors": lambda s: [(one := js.attractors(s, 2, method=METHOD)).label, one.initial.v_x, one.motion.x],
    "basins": lambda s: [(one := js.basins(s, num=2, method=METHOD)).label, one.P_d],
    "gradient": lambda s: [*js.gradient(s, ["shroud.gap", "friction.mu"], **SHORT).value.values()],
    "tune": lambda s: [
        js.tune(s, {"shroud.gap": (1e-5, 4e-5)}, search=js.SearchOptions(2, 1, 1), motions=2, **SHORT).best
    ],
    "fit": lambda s: [js.fit(s, MEASURED, {"shroud.gap": (1e-5, 4e-5)}, scan=2, starts=1, method=METHOD).chi2],
    "sweep": lambda s: [js.sweep(s, {"shroud.gap": [1e-5, 2e-5]}, direction="both", **SHORT).P_d],
}
STATES = {
    "impacts": [],
    "nothing touches": ["shroud.gap=5 mm"],
    "all sticks": ["shroud.gap=-0.4 mm", "friction.mu=5", "drive.F_0=20"],
    "nothing driven": ["drive.F_0=0", "drive.M_0=0"],
}


def answer(verb, scene):
    """The numbers of a verb, or its line."""
    try:
        return ANSWERS[verb](scene)
    except js.Error as error:
        return str(error)


def assert_answers_alike(verb, options):
    scene = js.load("table1", options).scene
    wanted, found = (answer(verb, one) for one in (scene, by_modes(scene)))
    if isinstance(wanted, str):
        assert found == wanted
        return
    for one, other in zip(found, wanted, strict=True):
        assert_close(one, other)


@pytest.mark.full
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("verb", ANSWERS)
def test_a_verb_answers_as_for_the_lumped_blades(verb, state):
    assert_answers_alike(verb, [*ALONG_X, *STATES[state]])


@pytest.mark.full
@pytest.mark.parametrize("verb", ["orbit", "lyapunov", "branch", "response", "gradient"])
def test_blades_that_turn_answer_as_the_lumped_ones(verb):
    assert_answers_alike(verb, WHOLE)


@pytest.mark.full
def test_a_known_frequency_is_found_again():
    run = js.simulate(two_modes(), n_periods=1, method=METHOD)
    table = {"t [s]": run.t[5::10], "x_left [m]": run.motion.x[5::10, 0]}
    over = {"blades.modes[0].f": (150.0, 175.0)}
    found = js.fit(two_modes(), table, over, scan=4, starts=1, method=METHOD)
    assert found.best[0] == pytest.approx(160, rel=1e-4)


def test_a_stored_run_goes_on_with_the_coordinates_of_its_modes(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(text_of(two_modes(), {"periods": 1}), "utf-8")
    both = js.simulate(two_modes(), n_periods=2, method=METHOD)
    one = js.simulate(js.load(file), n_periods=1, method=METHOD)
    one.save(tmp_path / "run.nc")
    for state in (one.last, stored_end(tmp_path / "run.nc", js.load(file)).state):
        run = js.simulate(two_modes(), state=state, n_periods=1, method=METHOD)
        assert_allclose(run.motion.x, both.motion.x[100:], rtol=0, atol=1e-12 * np.abs(run.motion.x).max())
    lumped = js.simulate(js.load("table1", ALONG_X), n_periods=1, method=METHOD)
    lumped.save(tmp_path / "lumped.nc")
    with pytest.raises(js.Error, match="coordinates of 3 modes"):
        stored_end(tmp_path / "lumped.nc", js.load(file, ['parts.neighbour="blade"']))


@pytest.mark.full
def test_the_map_of_a_period_goes_on_with_the_coordinates_of_its_modes():
    start = js.simulate(two_modes(), n_periods=2, method=METHOD).last
    once = js.period_map(two_modes(), start, method=METHOD)
    twice = js.period_map(two_modes(), once.state, method=METHOD)
    at_once = js.period_map(two_modes(), start, n_periods=2, method=METHOD)
    for one, other in zip(jax.tree.leaves(twice.state.motion), jax.tree.leaves(at_once.state.motion), strict=True):
        assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())
