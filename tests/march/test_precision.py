"""What is computed in which precision: never in another one than was asked for."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud import sweep as sweep_verb
from jaxshroud.batch import sampling, stepped_runs, tangents
from jaxshroud.model.prepared import initial_state
from jaxshroud.orbits.shooting import CLOSING_TOLERANCE

SINGLE = js.RungeKutta(precision="float32")
STEPS = {"method": SINGLE.replace(steps=100)}


@pytest.fixture(scope="module")
def scene():
    """One coordinate, with contact; forgets a push within some ten periods."""
    return js.load("table1", ['parts.motion=["x"]', "contact.gamma=2.5", "blades.c_x=10"]).scene


@pytest.fixture
def computed(monkeypatch):
    """The types of the scenes that compiled functions are called with."""
    seen = set()

    def watched(run):
        def call(scenes, states, *args, **options):
            numbers = jax.tree.leaves((scenes, states))
            seen.update(str(a.dtype) for a in numbers if jnp.issubdtype(a.dtype, jnp.floating))
            return run(scenes, states, *args, **options)

        return call

    monkeypatch.setattr(tangents, "flow_with_tangents", watched(tangents.flow_with_tangents))
    monkeypatch.setattr(stepped_runs, "run_block", watched(stepped_runs.run_block))
    monkeypatch.setattr(sampling, "_block_of_samples", watched(sampling._block_of_samples))
    return seen


VERBS = {
    "simulate": lambda s: js.simulate(s, n_periods=1, **STEPS),
    "sweep": lambda s: sweep_verb(s, {"contact.gamma": [1.0, 2.0]}, n_periods=1, **STEPS),
    "power": lambda s: js.power(s, n_periods=4, **STEPS),
    "orbit": lambda s: js.orbit(s, most_periods=64, **STEPS),
    "orbit from a state": lambda s: js.orbit(s, state=initial_state(s.initial), most_periods=8, **STEPS),
    "lyapunov": lambda s: js.lyapunov(s, n_periods=1, transient=1, **STEPS),
    "smoothed gradient": lambda s: js.gradient(
        s, ["shroud.gap"], most_periods=1, pairs=4, n_periods=2, transient=0, **STEPS
    ),
}


def in_short(result):
    """Whether a result is told in one paragraph."""
    told = repr(result)
    return told.startswith(type(result).__name__) and len(told) < 400 and "array" not in told


@pytest.mark.full(but=["simulate"])
@pytest.mark.parametrize("verb", VERBS)
def test_float32_is_what_is_computed(scene, computed, verb):
    result = VERBS[verb](scene)
    assert computed == {"float32"}
    assert in_short(result)


@pytest.mark.full
def test_a_sweep_is_told_by_its_axes(scene):
    swept = sweep_verb(scene, {"contact.gamma": [1.0, 2.0], "drive.F_0": [40.0, 60.0]}, n_periods=1, **STEPS)
    told = "SweepResult along contact.gamma (2: 1 to 2) x drive.F_0 (2: 40 to 60): 1 period kept of each lane; 4 OK; "
    assert repr(swept).startswith(told)


@pytest.mark.full
def test_a_design_is_sought_in_float32_and_checked_in_float64(scene, computed):
    small = dict(search=js.SearchOptions(2, 1, 1), n_periods=2, transient=2)
    tuned = js.tune(scene, {"shroud.gap": (2e-5, 4e-5)}, **small, **STEPS)
    assert tuned.problem.plan.method.precision == "float32"
    assert computed == {"float32", "float64"}  # the reference method of one of the checks
    assert in_short(tuned)
    computed.clear()
    single = jax.tree.map(lambda a: a.astype("float32"), scene)
    js.tune(single, {"shroud.gap": (2e-5, 4e-5)}, **small, **STEPS)
    assert computed == {"float32"}


def test_a_map_of_periods_is_in_the_precision_of_its_method(scene):
    flow = jax.eval_shape(lambda: js.period_map(scene, initial_state(scene.initial), **STEPS))  # traced, not compiled
    assert flow.power.dtype == flow.state.motion.x.dtype == jnp.float32


@pytest.mark.parametrize(
    "verb",
    [
        lambda s: js.period_map(s, initial_state(s.initial)),
        lambda s: js.orbit(s),
        lambda s: js.gradient(s, ["shroud.gap"]),
        lambda s: js.tune(s, {"shroud.gap": (2e-5, 4e-5)}),
        lambda s: js.lyapunov(s, n_periods=1),
    ],
)
def test_float64_is_refused_where_there_are_no_such_digits(scene, verb):
    single = jax.tree.map(lambda a: a.astype("float32"), scene)
    with pytest.raises(ValueError, match="Float64 is requested"):
        verb(single)


@pytest.mark.full
def test_power_series_run_where_jax_has_no_float64():
    """13! does not fit into the integers that it has."""
    code = """import jaxshroud as js
run = js.simulate(js.load("table1").scene, n_periods=1, method=js.Taylor(tolerance=1e-5, steps=50, precision="float32"))
print(run.motion.x.dtype, int(run.status))"""
    given = os.environ | {"JAX_ENABLE_X64": "0"}
    done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True)
    assert done.stdout == "float32 0\n", done.stderr


@pytest.mark.full
def test_an_orbit_in_float32_closes(scene):
    single, double = (js.orbit(scene, method=m.replace(steps=200)) for m in (SINGLE, js.RungeKutta()))
    assert single.flags == double.flags == ()
    assert single.start.motion.x.dtype == np.float32
    # Rounding, some 1e-7 a step, is forgotten within ten periods of 200 steps.
    assert single.residual < 1e3 * CLOSING_TOLERANCE["float32"]
    assert single.P_d == pytest.approx(double.P_d, abs=1e-3)
    # Control: the tolerance of float64 is out of reach.
    assert (
        "not converged"
        in js.orbit(scene, method=js.RungeKutta(steps=200, precision="float32"), most_periods=32, tolerance=1e-11).flags
    )


@pytest.mark.full
def test_threads_compute_in_the_precision_of_their_caller(scene):
    run = lambda: sweep_verb(scene, {"contact.gamma": [1.0, 2.0]}, n_periods=2, method=js.RungeKutta(steps=100)).motion
    expected = run()
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            got = run()
    finally:
        jax.config.update("jax_enable_x64", True)
    jax.tree.map(np.testing.assert_array_equal, got, expected)
