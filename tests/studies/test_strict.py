"""Every public function, with the arguments of `misuse`, under the settings with which JAX traps careless programs."""

import inspect

import jax
import jax.numpy as jnp
import misuse
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.model.linear import free_power
from jaxshroud.model.prepared import initial_state

QUICK = ("largest_frequency", "check", "explain", "method_for", "most_trials", "check_laws")
USUAL = ("simulate", "sweep", "power", "orbit", "lyapunov", "gradient", "rollout", "period_map", "sweep_function()")
LONG = ("attractors", "basins", "branch", "diagnose", "fit", "mistune", "report", "response", "scatter")
LONG += ("table", "tune")
# Without JAX, or of files; `trade` and the map of a search, which is a sweep, take minutes.
OTHERS = {"amplitude_spectrum", "cache_compilations", "load", "open", "periodicity", "scenes_from"}
OTHERS |= {
    "modal_blades",
    "reduce",
    "reduce_shapes",
    "shipped",
    "stack_scenes",
    "sweep_function",
    "tableau",
    "trade",
    "value_of",
    "vary",
    "with_contact_law",
}
METHOD = js.RungeKutta(steps=100)


def run_strictly(name):
    """Ranks and types are never promoted, and NaN is trapped where it arises."""
    with jax.numpy_rank_promotion("raise"), jax.debug_nans(True):
        target = {**misuse.functions(), **misuse.made()}[name]
        target.call(**target.right)


@pytest.mark.studies
@pytest.mark.full
@pytest.mark.parametrize("name", [*QUICK, *USUAL])
def test_a_public_function_passes_the_strictest_settings(name):
    with jax.checking_leaks():  # no tracer outlives its function
        run_strictly(name)


@pytest.mark.studies
@pytest.mark.full
@pytest.mark.parametrize("name", LONG)
def test_a_long_public_function_passes_strict_settings(name):
    # Looking for leaks, JAX traces anew at every call: minutes for each of these, which call what the others call.
    run_strictly(name)


def ring(*sets):
    return js.load("row_ring12", ["row.blades=3", "drive.engine_order=1", *sets]).scene


IN_X, BRIEF = 'parts.motion=["x"]', {"n_periods": 2, "transient": 1, "method": METHOD}
OF_ROWS = {
    "simulate": lambda: js.simulate(ring(IN_X), n_periods=1, method=METHOD),
    "sweep": lambda: js.sweep(ring(), {"contact.gamma": [1.0, 2.0]}, amplitudes=True, **BRIEF),
    "power": lambda: js.power(ring(), **BRIEF),
    "rollout": lambda: js.rollout(ring(IN_X), None, 1, method=METHOD),
    "sweep_function": lambda: js.sweep_function(1, 0, METHOD)(jax.tree.map(lambda a: jnp.asarray(a)[None], ring(IN_X))),
    "orbit": lambda: js.orbit(ring(IN_X), most_periods=32, method=METHOD),
    "gradient": lambda: js.gradient(ring(IN_X), ["shroud.gap"], **BRIEF),
    "diagnose": lambda: js.diagnose(ring(IN_X), transient=8, method=METHOD),
    "branch": lambda: js.branch(ring(IN_X), "drive.omega", start=530.0, stop=540.0, most_points=3, method=METHOD),
    "mistune": lambda: js.mistune(
        ring(IN_X), along={"drive.omega": [900.0, 905.0]}, sigmas=[0.01], n_patterns=2, updates=0, **BRIEF
    ),
}


@pytest.mark.studies
@pytest.mark.full
@pytest.mark.parametrize("name", OF_ROWS)
def test_rows_pass_strict_settings(name):
    with jax.numpy_rank_promotion("raise"), jax.debug_nans(True):
        OF_ROWS[name]()


def test_every_public_function_is_tried_or_named():
    public = {name for name in js.__all__ if inspect.isfunction(getattr(js, name))}
    assert public == {*QUICK, *USUAL, *LONG, *OTHERS} - {"sweep_function()"}


def test_the_check_of_a_step_promotes_no_ranks():
    scene = js.load("table1").scene
    with jax.numpy_rank_promotion("raise"), jax.debug_nans(True):
        assert js.largest_frequency(scene) > 0
        assert np.all(free_power(scene) > 0)


@pytest.fixture(scope="module")
def pure():
    """Compiled pure functions, each with its argument on the device."""
    pair = js.load("table1", ['parts.motion=["x"]']).scene
    ring = js.load("row_ring12", ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1"]).scene
    begin = initial_state(pair.initial)
    slope = jax.grad(lambda gap: js.rollout(js.vary(pair, "shroud.gap", gap), None, 1, method=METHOD).power.sum())
    found = {
        "rollout": (lambda scene: js.rollout(scene, None, 1, method=METHOD), pair),
        "rollout of a row": (lambda scene: js.rollout(scene, None, 1, method=METHOD), ring),
        "slope": (slope, jnp.asarray(22e-6)),
        "period_map": (lambda scene: js.period_map(scene, begin, method=METHOD), pair),
        "sweep_function": (js.sweep_function(1, 0, METHOD), jax.tree.map(lambda a: a[None], pair)),
    }
    return {name: (jax.jit(f), jax.device_put(argument)) for name, (f, argument) in found.items()}


@pytest.mark.release(only=["slope"])
@pytest.mark.studies(only=["rollout of a row", "period_map"])
@pytest.mark.full
@pytest.mark.parametrize("name", ["rollout", "rollout of a row", "slope", "period_map", "sweep_function"])
def test_a_compiled_pure_function_transfers_nothing(pure, name):
    f, argument = pure[name]
    with jax.transfer_guard("disallow"):
        jax.block_until_ready(f(argument))
