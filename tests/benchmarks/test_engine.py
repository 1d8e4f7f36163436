"""What the engine costs at other sizes, and its observed orders."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import engine
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from peers import scalar_c
from problem import PERIODS, Problem, errors, problem
from test_peers import RESULTS, one_core  # noqa: F401

from jaxshroud.batch.lanes import begin_lanes, initial_states, lane_models
from jaxshroud.batch.periods import LANES_PER_CALL, Clock, at_start_of_period, one_call, run_block
from jaxshroud.batch.xla import fused
from jaxshroud.march.carry import Fixed
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.march.tableau import tableau

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("default")]
SWEEP = """
import time; begin = time.perf_counter()
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", {cache!r})
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
import numpy as np, jaxshroud as js
js.sweep(js.load("table1").scene, {{"contact.gamma": np.linspace(0.1, 8, 64)}}, n_periods=10)
print(time.perf_counter() - begin)
"""
MANY = """
import os, sys, time
os.sched_setaffinity(0, {cores})
sys.path.insert(0, {folder!r})
import jax
jax.config.update("jax_enable_x64", True)
from engine import scenes_of
from problem import problem
from jaxshroud.march.method import FAST
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.lanes import initial_states
scenes = scenes_of(problem(512))
run = lambda: run_lanes(scenes, initial_states(scenes), Plan(0, 32, 500, 0.0, FAST), lambda _: None)
run()
begin = time.perf_counter()
run()
print(time.perf_counter() - begin)
"""


def record(name: str, found: dict) -> None:
    """Print a finding and keep it."""
    path = RESULTS / "engine.json"
    RESULTS.mkdir(exist_ok=True)
    kept = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(kept | {name: found}, indent=1, sort_keys=True))
    print(f"\n{name}: {json.dumps(found)}")


def alternately(rounds: int, **runs) -> dict[str, float]:
    """Median seconds of each run, taken in turn, after one that is not counted."""
    taken = {name: [] for name in runs}
    for i in range(rounds + 1):
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            if i:
                taken[name].append(time.perf_counter() - start)
    return {name: float(np.median(t)) for name, t in taken.items()}


@pytest.mark.usefixtures("one_core")
def test_many_lanes():
    few, many, steps = engine.prepare(problem(1024), FAST), engine.prepare(problem(65536), FAST), 100
    taken = alternately(1, few=lambda: few(steps), many=lambda: many(steps))
    few_us, many_us = (taken[k] / n / PERIODS * 1e6 for k, n in (("few", 1024), ("many", 65536)))
    record("us per lane and period", {"1024 lanes": few_us, "65536 lanes": many_us, "ratio": many_us / few_us})


@pytest.mark.usefixtures("one_core")
def test_general_parameters():
    # The same chunk with every number of the scene in the lanes, or all but gamma as constants of the program.
    part, steps = problem(LANES_PER_CALL), 500
    clock = Clock.of_steps(steps)
    scenes = engine.scenes_of(part)
    lanes = begin_lanes(scenes, initial_states(scenes), FAST)
    numbers = jax.tree.map(lambda a: float(a[0]), lane_models(scenes)[0])

    def constant(f, lanes, fixed):
        def with_constants(lane, k, lag, grid, stop):
            known = jax.tree.map(lambda a: jnp.full((), a), numbers)
            varied = eqx.tree_at(lambda m: (m.law.k, m.law.lag), known, (k, lag))
            return f(lane, Fixed(varied, grid, stop))

        law = fixed.model.law
        return fused(with_constants, lanes, law.k, law.lag, fixed.grid, fixed.stop)

    def march(each):
        begin, limits = at_start_of_period(lanes), one_call(PERIODS)
        return lambda: jax.block_until_ready(run_block(scenes, begin, clock, limits, FAST, PERIODS, each))

    taken = alternately(15, general=march(fused), constant=march(constant))
    record("seconds, parameters in the lanes and constant", taken | {"ratio": taken["general"] / taken["constant"]})


@pytest.mark.usefixtures("one_core")
@pytest.mark.skipif(scalar_c.missing() is not None, reason="needs a C compiler")
def test_one_lane():
    # 3 periods, and 60: the first hundred microseconds to milliseconds of a call are the same for any length.
    part, long = Problem(np.array([2.5])), 60
    c = scalar_c.prepare(part)
    runs = {
        f"{how}, {n} periods": engine.prepare(part, FAST._replace(locate=how), chunk=1, periods=n)
        for how in ("cubic", "bisection")
        for n in (PERIODS, long)
    }
    taken = alternately(15, c=lambda: c(500), **{name: lambda run=run: run(500) for name, run in runs.items()})
    ratio = taken[f"cubic, {long} periods"] / taken["c"] * PERIODS / long
    record("seconds, one lane", taken | {"cubic over C, per period of the long run": ratio})


def test_two_cores():
    # In processes of their own: XLA's threads stay on the cores that they were born with.
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        pytest.skip("needs two cores")
    taken = {"one": [], "two": []}
    for _ in range(3):
        for name, some in (("one", {cores[0]}), ("two", set(cores[:2]))):
            code = MANY.format(folder=str(Path(__file__).parent), cores=some)
            done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
            taken[name].append(float(done.stdout))
    found = {name: float(np.median(t)) for name, t in taken.items()}
    record("seconds, one core and two", found | {"ratio": found["one"] / found["two"]})


def test_cold_start():
    taken = {"empty cache": [], "filled cache": []}
    for _ in range(3):
        with tempfile.TemporaryDirectory() as cache:
            for name in taken:
                start = time.perf_counter()
                subprocess.run([sys.executable, "-c", SWEEP.format(cache=cache)], check=True, capture_output=True)
                taken[name].append(time.perf_counter() - start)
    record("seconds to the result of a small sweep", {name: float(np.median(t)) for name, t in taken.items()})


def test_observed_orders():
    whole = problem(64)
    reference = engine.prepare(whole, Choices(tableau("dopri8"), ledger=False))(1500)
    shown = {f"{n}, {how}": Choices(tableau(n), how, False) for n in TABLEAUS for how in ("cubic", "bisection")}
    shown |= {"rk4, not located": Choices(locate="none", ledger=False)}
    shown |= {"tsit5, cubic, float32": Choices(tableau("tsit5"), "cubic", False, "float32")}
    figure, axes = plt.subplots(figsize=(6, 4.5), layout="constrained")
    found = {}
    for name, method in shown.items():
        steps = np.array([50, 75, 100, 150, 200, 300, 400, 600, 800])
        run = engine.prepare(whole, method)
        error = np.array([np.median(errors(run(int(n)), reference)) for n in steps])
        falling = error > (1e-12 if method.precision == "float64" else 5e-6)  # above rounding
        found[name] = float(-np.polyfit(np.log(steps[falling][-4:]), np.log(error[falling][-4:]), 1)[0])
        color = f"C{list(TABLEAUS).index(method.tableau.name)}"
        style = {"cubic": "-", "bisection": "none", "none": ":"}[method.locate]
        marker = "o" if method.locate == "bisection" else "x" if method.precision == "float32" else None
        axes.loglog(steps, error, color=color, ls=style, marker=marker, mfc="none", label=f"{name}: {found[name]:.1f}")
    axes.set_xticks([50, 100, 200, 400, 800], ["50", "100", "200", "400", "800"])
    axes.minorticks_off()
    axes.set(xlabel="steps per period", ylabel="median error after 3 periods")
    axes.legend(title="method: observed order", fontsize=7, title_fontsize=7, frameon=False)
    figure.savefig(RESULTS / "order.png", dpi=150)
    plt.close(figure)
    record("observed order", found)
