"""Cost of reduced models against the full one, in one run: pytest --benchmark tests/benchmarks/test_models.py -s."""

import json
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxshroud import load
from jaxshroud.batch.closed_form import closed_form_runs
from jaxshroud.batch.lanes import begin_lanes, initial_states
from jaxshroud.batch.operation_count import size_of_trial
from jaxshroud.batch.periods import PERIODS_PER_CALL, at_start_of_period, one_call, run_block
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march.method import FAST
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene

pytestmark = pytest.mark.benchmark
RESULT = Path(__file__).parent / "results" / "models.json"
GAMMA, PERIODS, STEPS, REPEATS = np.linspace(0.1, 8.0, 64), 32, 200, 9
MODELS = {
    "full": {},
    "x, y": {"motion": ("x", "y")},
    "x": {"motion": ("x",)},
    "no friction": {"friction": "none"},
    "rigid neighbour": {"neighbour": "rigid"},
    "x, no friction, rigid neighbour": {"motion": ("x",), "friction": "none", "neighbour": "rigid"},
    "smooth": {"contact": "smooth"},
}


def model_of(scene: Scene, parts: dict) -> Scene:
    """The scene with another model."""
    width = 5e-5 if parts.get("contact") == "smooth" else None
    return with_parts(scene, Parts(**parts), width)


def test_cost_of_models():
    table1 = load("table1").scene
    runs = {}
    for name, parts in MODELS.items():
        scenes = grid_of_scenes(model_of(table1, parts), {"contact.gamma": GAMMA})
        plan = Plan(0, PERIODS, STEPS, 0.0, FAST)
        begin = at_start_of_period(begin_lanes(scenes, initial_states(scenes), FAST))
        options = FAST, PERIODS_PER_CALL, best_mapping()
        runs[name] = lambda scenes=scenes, begin=begin, plan=plan, options=options: jax.block_until_ready(
            run_block(scenes, begin, plan.clock, one_call(PERIODS), *options)
        )
        runs[name]()
    free = grid_of_scenes(model_of(table1, {"contact": "none"}), {"contact.gamma": GAMMA})
    whole_run = Plan(0, PERIODS, STEPS, 0.0, FAST)
    fresh = np.zeros(len(GAMMA), bool)
    runs["closed form"] = lambda: closed_form_runs(free, initial_states(free), whole_run, lambda _: None, fresh)
    runs["closed form"]()
    seconds = {name: [] for name in runs}
    for _ in range(REPEATS):
        for name, run in runs.items():
            began = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - began)
    operations_of = lambda name: size_of_trial(model_of(table1, MODELS[name]), FAST).operations
    whole = operations_of("full")
    rows = {
        name: {
            "ratio": float(np.median(np.divide(times, seconds["full"]))),
            "us per lane and period": float(np.median(times)) / len(GAMMA) / PERIODS * 1e6,
            "operations": None if name == "closed form" else operations_of(name) / whole,
        }
        for name, times in seconds.items()
    }
    for name, row in rows.items():
        print(f"{name:<34}", *(f"{key} {value:.3g}" for key, value in row.items() if value is not None), sep="  ")
    RESULT.write_text(json.dumps({"steps": STEPS, "lanes": len(GAMMA), "models": rows}, indent=1) + "\n", "utf-8")
