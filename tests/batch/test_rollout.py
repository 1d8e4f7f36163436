"""`rollout` and `sweep_function`: derivatives against differences, batches against loops, samples against the verbs."""

import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from quotients import quotients
from side_by_side import with_parts

import jaxshroud as js
from jaxshroud.batch.xla import FOR_SERIES
from jaxshroud.march import row_step
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import initial_state, prepared_model

KEYS = ("shroud.gap", "contact.gamma", "friction.mu", "drive.F_0")
STEPS = 200
PLAIN = js.RungeKutta()
FULL = ["drive.F_0=60"]
NARROW = ['blades.I="block"', 'drive.M_0="0.5 N m"', "drive.F_0=60"]  # nearly parallel faces: flat contact


def along_x(*changes):
    """Table 1 where blades move along x alone."""
    return js.load("table1", ['parts.motion=["x"]', *changes]).scene


def at(scene, numbers):
    for key, value in zip(KEYS, numbers, strict=True):
        scene = js.vary(scene, key, value)
    return scene


def numbers_of(scene):
    return jnp.stack([jnp.ravel(jnp.asarray(js.value_of(scene, key)))[0] for key in KEYS])


def observed(scene, numbers, n_periods=2, steps=STEPS, method=PLAIN):
    """Contact forces, displacements and power, each over its size."""
    save = lambda m: (m.N / 100, m.F / 100, m.state.motion.x / 1e-4, m.state.motion.y / 1e-4)
    how = {"every": steps // 4, "method": method.replace(steps=steps)}
    run = js.rollout(at(scene, numbers), None, n_periods, save=save, **how)
    return jnp.concatenate([jnp.ravel(a) for a in (*run.saved, run.power / 1e-8)])


def slopes_of(scene, numbers, periods, steps, method=PLAIN):
    """Quotients of what is observed, and its tangents."""
    f = lambda p: observed(scene, p, periods, steps, method)
    tangents = np.asarray(jax.jit(jax.vmap(jax.jacfwd(f)))(numbers))
    assert np.all(np.isfinite(tangents))
    return quotients(jax.jit(jax.vmap(f)), numbers), tangents


@pytest.mark.release(only=["flat", "cases"])  # studies/slopes.py
@pytest.mark.full
@pytest.mark.parametrize(
    ("options", "motion", "periods", "steps", "kinds"),
    [
        (FULL, ("x",), 1, STEPS, {"onset_slip", "onset_stick", "separation", "stick_slip", "slip_stick"}),
        (FULL, ("x", "y", "theta"), 2, 400, {"switch_14", "switch_23", "switch_12", "switch_34"}),
        (NARROW, ("x", "y", "theta"), 1, 800, {"flat", "flat_corner"}),
    ],
    ids=["x", "cases", "flat"],
)
def test_tangents_are_differences_through_all_events(options, motion, periods, steps, kinds):
    # 1e-6 over the largest slope of each number, wherever differences know it to 1e-7. Between nearly parallel faces
    # they do not everywhere, by kinks where an event falls on the end of a step (tests/studies/slopes.py).
    scene = with_parts(js.load("table1", ["contact.gamma=2.5", *options]).scene, motion=motion)
    gamma = np.linspace(1.0, 15.0, 8)
    met = js.sweep(scene, {"contact.gamma": gamma}, n_periods=periods, transient=0, method=js.RungeKutta(steps=steps))
    assert kinds <= {name for name, count in met.counters.items() if np.any(count)}
    numbers = jnp.tile(numbers_of(scene), (8, 1)).at[:, 1].set(gamma)
    differences, tangents = slopes_of(scene, numbers, periods, steps)
    error, known = differences.error(tangents), differences.doubt < 1e-7
    assert "flat" in kinds or np.all(known), differences.doubt
    assert np.all(error[known] < 1e-6), error
    lanes = np.max(error, axis=1)
    assert np.sum(lanes < 1e-6) >= 6, lanes
    assert np.all(lanes < 1e-4), lanes


@pytest.mark.release
@pytest.mark.full
def test_naive_tangents_of_a_rollout_are_wrong(monkeypatch):
    # Control: without the derivative of the events' instants every lane misses the tolerance tenfold, some by far more.
    monkeypatch.setattr(row_step, "at_event", lambda quantities, *_: quantities)
    naive = js.RungeKutta(PLAIN.tableau._replace(name="naive"))  # another name: compiled anew
    scene = along_x("contact.gamma=2.5", *FULL)
    numbers = jnp.tile(numbers_of(scene), (8, 1)).at[:, 1].set(np.linspace(1.0, 15.0, 8))
    differences, tangents = slopes_of(scene, numbers, 1, STEPS, naive)
    error = np.max(differences.error(tangents), axis=1)
    assert np.all(error > 1e-5), error
    assert np.max(error) > 0.1, error


@pytest.mark.release
@pytest.mark.full
@pytest.mark.parametrize("method", [js.RungeKutta("dopri8"), js.Taylor()], ids=str)
def test_what_is_told_of_events_is_what_samples_show(method):
    # Between samples 1/4000 of a period apart speeds change by up to 0.6 %, of the gentlest onset here.
    scene = js.load("table1", ["contact.gamma=3", *FULL]).scene
    save = lambda at: (at.v, at.state.motion.theta, at.state.case)
    run = js.rollout(scene, None, 2, every=1, method=method.replace(steps=4000), save=save)
    v, theta, case = map(np.asarray, run.saved)
    h = scene.drive.period / 4000
    touches = (v[:-1] <= 0) & (v[1:] > 0)
    turned = (case[:-1] != case[1:]) & (case[:-1] > 0) & (case[1:] > 0)
    turn = theta[:, 0] - theta[:, 1]
    lever = prepared_model(scene).block.a_x
    crossed = turned & (turn[:-1] * turn[1:] < 0)
    assert touches.sum() > 3
    assert crossed.sum() == turned.sum() > 0  # by the turn alone, here
    assert_allclose(run.slowest_onset, np.diff(v)[touches].min() / h, rtol=1e-2)
    assert_allclose(run.slowest_switch, np.abs(np.diff(turn))[crossed].min() / h * lever, rtol=1e-2)


def test_bounds_and_samples_that_cannot_be_are_refused():
    scene, method = along_x(), js.RungeKutta(steps=STEPS)
    with pytest.raises(js.InputError, match=r"outside jax\.jit"):
        jax.jit(lambda s: js.most_trials(s, 1, method=method))(scene)
    with pytest.raises(js.InputError, match="must divide"):
        js.rollout(scene, every=7, method=method)
    with pytest.raises(js.InputError, match="one leading axis"):
        js.sweep_function(4, 3, method)(scene)


@pytest.mark.full
def test_a_sweep_function_tells_the_vibration_alone():
    # Interference holds the blades apart, which P_d counts as vibration. Against means of the verb's samples.
    scene = along_x("shroud.gap=-20um", "drive.F_0=20", *FULL)
    method = js.RungeKutta(steps=STEPS)
    found = js.sweep_function(2, 8, method)(jax.tree.map(lambda a: jnp.asarray(a)[None], scene))
    run = js.simulate(scene, n_periods=10, every=1, method=method)
    x = run.motion.x[-2 * STEPS :, 0]
    of_vibration, of_all = np.var(x), np.mean(x**2)
    share = (100 - found.P_d_vibration[0]) / (100 - found.P_d[0])
    assert_allclose(share, of_vibration / of_all, rtol=1e-5)
    assert share < 0.9


SHARDED = """
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)
import jax.numpy as jnp, numpy as np, jaxshroud as js
from jax.sharding import PartitionSpec
scene = js.load("table1", ['parts.motion=["x"]', "contact.gamma=2.5", "drive.F_0=60"]).scene
scenes = jax.vmap(lambda g: js.vary(scene, "contact.gamma", g))(jnp.linspace(0.5, 8.0, 128))
f, lanes = js.sweep_function(2, 1, js.RungeKutta(steps=200)), PartitionSpec("lanes")
mesh = jax.make_mesh((2,), ("lanes",), axis_types=(jax.sharding.AxisType.Auto,))
shared = jax.jit(jax.shard_map(f, mesh=mesh, in_specs=(lanes,), out_specs=lanes, check_vma=False))(scenes)
assert len(shared.P.devices()) == 2
assert_allclose(shared.motion.x, f(scenes).motion.x, rtol=1e-9)
"""


@pytest.mark.release
@pytest.mark.full
def test_a_sweep_function_runs_on_many_devices():
    # In a process of its own: the number of devices is fixed once JAX has started. With LAPACK in it, it may never end.
    command, how = [sys.executable, "-c", SHARDED], {"capture_output": True, "text": True, "timeout": 300}
    done = subprocess.run(command, env=os.environ, check=False, **how)
    assert done.returncode == 0, done.stderr


@pytest.mark.release
@pytest.mark.full
def test_a_rollout_by_power_series_is_differentiated(table1):
    """Outside of `jax.jit` too, where what it compiles for series is its own choice: otherwise it takes minutes."""
    method = js.Taylor(order=8, tolerance=1e-9)

    def power(gap):
        return js.rollout(js.vary(table1, "shroud.gap", gap), None, 2, method=method.replace(steps=100)).power[0]

    gap, h = 22e-6, 1e-8
    _, slope = jax.jvp(power, (gap,), (1.0,))
    # The difference errs by the tolerance times the power over h, 2e-7 of a slope of 5e-4, and by h^2.
    assert float(slope) == pytest.approx(float(power(gap + h) - power(gap - h)) / (2 * h), rel=5e-3)
    inside = jax.jit(lambda gap: jax.jvp(power, (gap,), (1.0,))[1], compiler_options=FOR_SERIES)
    assert float(inside(gap)) == pytest.approx(float(slope), rel=1e-9)


@pytest.mark.release(only=["rk4, events by bisection, float64"])
@pytest.mark.full
@pytest.mark.parametrize("method", [js.RungeKutta(locate="bisection"), js.Taylor(order=8, tolerance=1e-7)], ids=str)
def test_a_start_in_overlap_sticks_whatever_the_rates(method):
    # The element starts unstretched under N > 0. By the rates it would slip, as k_d |u'| > mu k v' here, with mu N at
    # once: 12 N, where a step of stick stretches it by 0.4 N at most, and the forces would jump where v' = u' = 0.
    scene = along_x()
    places = lambda s: (s.initial.x, s.initial.v_x)
    scene = eqx.tree_at(places, scene, (jnp.array([1.2e-4, 0.0]), jnp.array([0.01, 0.0])))
    found = js.rollout(scene, every=1, method=method.replace(steps=400), save=lambda at: (at.N, at.F, at.state.mode))
    N, F, mode = (np.asarray(a)[0] for a in found.saved)
    assert mode == 1  # stick
    assert abs(F) < 0.05 * 0.5 * N


@pytest.mark.release
@pytest.mark.full
@pytest.mark.parametrize("contact", ["spring", "smooth", "none"])
def test_numbers_out_of_their_ranges_are_told_where_nothing_can_be_raised(contact):
    width = ["contact.width=1e-4"] if contact == "smooth" else []
    scene = js.load("table1", ['parts.motion=["x"]', f'parts.contact="{contact}"', *width]).scene
    ran = jax.jit(lambda c: js.rollout(js.vary(scene, "blades.c_x", c), n_periods=1, method=js.RungeKutta(steps=800)))
    bad, good = ran(-3.0), ran(3.0)
    assert (bad.status, good.status) == (Status.BAD_INPUT, Status.OK)
    assert np.isnan(bad.state.motion.x).all()
    assert np.isfinite(good.state.motion.x).all()
    mapped = jax.jit(
        lambda c: js.period_map(
            js.vary(scene, "blades.c_x", c), initial_state(scene.initial), method=js.RungeKutta(steps=100)
        )
    )
    assert mapped(-3.0).status == Status.BAD_INPUT
    assert mapped(3.0).status == Status.OK


@pytest.mark.parametrize("name", ["rollout", "period_map", "sweep_function", "explain"])
def test_power_series_refuse_smooth_contact(name):
    scene = js.load("table1", ["parts.contact=smooth", "contact.width=50 um", 'parts.motion=["x"]']).scene
    method, state = js.Taylor(8, 1e-7, 50), initial_state(scene.initial)
    run = {
        "rollout": lambda: js.rollout(scene, method=method),
        "period_map": lambda: js.period_map(scene, state, method=method),
        "sweep_function": lambda: js.sweep_function(1, 0, method)(jax.tree.map(lambda a: a[None], scene)),
        "explain": lambda: js.explain(scene, method),
    }
    with pytest.raises(js.InputError, match="taylor knows located contact, not smooth contact"):
        run[name]()


@pytest.mark.release
@pytest.mark.full
def test_a_start_that_is_not_finite_is_bad_input():
    scene = along_x()
    begin = initial_state(scene.initial)
    begin = eqx.tree_at(lambda begin: begin.motion.v_x, begin, np.array([np.nan, 0.0]))
    assert js.rollout(scene, begin, n_periods=1, method=js.RungeKutta(steps=100)).status == Status.BAD_INPUT


@pytest.mark.parametrize("verb", ["sweep", "orbit", "gradient", "branch", "check", "explain", "tune", "trade"])
def test_verbs_inside_a_transformation_name_what_runs_there(verb):
    scene = along_x()
    more = {"sweep": [{"shroud.gap": [1e-5]}], "gradient": [["shroud.gap"]], "branch": ["contact.gamma", 1.0, 3.0]}
    more["tune"] = [{"shroud.gap": (1e-5, 1e-4)}]
    with pytest.raises(js.InputError, match=r"use js\.rollout, js\.sweep_function or js\.period_map there"):
        jax.jit(lambda gamma: getattr(js, verb)(js.vary(scene, "contact.gamma", gamma), *more.get(verb, [])))(2.0)


def test_values_of_a_sweep_are_no_tracers():
    scene = along_x()
    with pytest.raises(js.InputError, match=r"js\.sweep_function"):
        jax.jit(lambda gap: js.sweep(scene, {"shroud.gap": gap[None]}, n_periods=1, transient=0).P_d)(jnp.asarray(1e-5))


def test_scenes_with_leading_axes_are_mapped_over():
    scene = along_x()
    many = jax.vmap(lambda gap: js.vary(scene, "shroud.gap", gap))(np.array([1e-5, 2e-5]))
    for function, arguments in (
        (js.rollout, ()),
        (js.period_map, (initial_state(scene.initial),)),
        (js.most_trials, ()),
    ):
        with pytest.raises(js.InputError, match=rf"jax\.vmap\(js\.{function.__name__}\)"):
            function(many, *arguments)
