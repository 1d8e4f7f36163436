"""What the pure functions cost beside the verbs, and how long they take to compile beside `period_map`."""

import json
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_peers import RESULTS, one_core  # noqa: F401

import jaxshroud as js
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import initial_states
from jaxshroud.march.method import FAST

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("default")]
KEYS = ("shroud.gap", "contact.gamma", "friction.mu")
STEPS = 400


def record(name: str, found: dict) -> None:
    """Print a finding and keep it."""
    path = RESULTS / "developers.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(known | {name: found}, indent=1) + "\n")
    print(f"\n{name}: {json.dumps(found)}")


def busy(run) -> float:
    """Seconds of the processor that a run takes."""
    begin = time.process_time()
    run()
    return time.process_time() - begin


def scene_of(motion: str):
    return js.load("table1", ["contact.gamma=2.5", "drive.F_0=60", f"parts.motion={motion}"]).scene


@pytest.fixture
def no_cache():
    """Nothing is compiled beforehand."""
    jax.config.update("jax_enable_compilation_cache", False)
    yield
    jax.config.update("jax_enable_compilation_cache", True)


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("motion", ['["x"]', '["x", "y", "theta"]'])
def test_cost_of_a_sweep_function(motion):
    # The same 256 lanes for 32 periods, chunk after chunk: by the verb's runner and in one program. Time of the
    # processor, as both keep one core busy: others that share it do not count.
    base, n, transient = scene_of(motion), 24, 8
    scenes = jax.vmap(lambda g: js.vary(base, "contact.gamma", g))(jnp.linspace(0.5, 8.0, 256))
    f = js.sweep_function(n, transient, js.RungeKutta(steps=STEPS))
    plan = Plan(transient, n, STEPS, 0.0, FAST)
    runs = {
        "verb": lambda: run_lanes(scenes, initial_states(scenes), plan, lambda _: None),
        "function": lambda: jax.block_until_ready(f(scenes)),
    }
    taken = {name: float(np.median([busy(run) for _ in range(9)][1:])) for name, run in runs.items()}
    record(f"seconds, sweep of {motion}", taken | {"ratio": taken["function"] / taken["verb"]})


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize("motion", ['["x"]', '["x", "y", "theta"]'])
def test_compiling_a_rollout(motion):
    # Derivatives of one period's power by three numbers, forward: traced, lowered and compiled, without any cache.
    base = scene_of(motion)

    def moved(p):
        scene = base
        for key, value in zip(KEYS, p, strict=True):
            scene = js.vary(scene, key, value)
        return scene

    start = js.State(base.initial, jnp.zeros(()), jnp.int32(0), jnp.int32(0))
    ways = {
        "rollout": lambda p: js.rollout(moved(p), start, 1, method=js.RungeKutta(steps=STEPS)).power,
        "period_map": lambda p: jnp.stack(js.period_map(moved(p), start, method=js.RungeKutta(steps=STEPS)).power),
    }
    p, taken = jnp.asarray([float(js.value_of(base, key)) for key in KEYS]), {}
    for name, way in ways.items():
        begin = time.perf_counter()
        jax.jit(jax.jacfwd(way)).lower(p).compile()
        taken[name] = time.perf_counter() - begin
    record(f"seconds to compile, {motion}", taken | {"ratio": taken["rollout"] / taken["period_map"]})
