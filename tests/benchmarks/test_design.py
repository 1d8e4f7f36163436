"""What gradients cost against simulations, and tuning against looking everywhere."""

import json
import time

import engine
import numpy as np
import pytest
from problem import Problem
from test_peers import RESULTS

from jaxshroud import load, orbit, simulate, tune
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.tangents import direction, run_flow, without_direction
from jaxshroud.march.method import FAST, Choices, RungeKutta
from jaxshroud.march.tableau import tableau
from jaxshroud.verbs.design_problem import judge_designs
from jaxshroud.verbs.gradient import on_orbit

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("default")]
TWO = {"shroud.gap": (5e-6, 2e-4), "contact.gamma": (0.1, 10.0)}
FOUR = {**TWO, "friction.mu": (0.05, 1.0), "friction.k_d": (1e5, 1e7)}
FORCES = [20.0, 40.0, 60.0, 80.0]
TWENTY = [
    *TWO,
    *("friction.k_d", "friction.mu", "drive.omega", "drive.F_0", "drive.M_0", "drive.phase[0]", "drive.phase[1]"),
    *("shroud.alpha", "shroud.l_oa", "shroud.l_ab"),
    *(f"blades.{name}[{i}]" for name in ("m", "k_x", "k_y", "k_T") for i in (0, 1)),
]
LONG = Plan(256, 256, 400, 0.0, FAST)


def record(name: str, found: dict) -> None:
    """Print a finding and keep it."""
    path = RESULTS / "design.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(known | {name: found}, indent=1) + "\n")
    print(name, json.dumps(found, indent=1))


def median(f, repeats: int = 25, clock=time.perf_counter) -> float:
    """Median seconds of a call, after one that compiles."""
    f()
    times = []
    for _ in range(repeats):
        begin = clock()
        f()
        times.append(clock() - begin)
    return float(np.median(times))


def test_cost_of_gradients():
    """Gradients on a converged orbit over one simulation of the same orbit, everything a call does included."""
    found = {}
    for gamma in (2.5, 4.2):
        at = orbit(load("table1", [f"contact.gamma={gamma}", "drive.F_0=60"]).scene)
        once = median(lambda at=at: simulate(at.scene, at.start, n_periods=at.q, method=RungeKutta(steps=400)))
        two, twenty = (median(lambda at=at, keys=keys: on_orbit(at, keys)) for keys in (TWENTY[:2], TWENTY))
        found[f"gamma {gamma}, period {at.q}"] = {"two parameters": two / once, "twenty": twenty / once}
    record("simulations that a gradient costs", found)


def sought(over, conditions, designs: np.ndarray, name: str) -> None:
    """Tuning against the best of many designs, both simulated again for long."""
    scene = load("table1", ["drive.M_0=10"]).scene
    begin = time.perf_counter()
    tuned = tune(scene, over, conditions=conditions)
    mid = time.perf_counter()
    problem = tuned.problem
    everywhere = judge_designs(problem, problem.values(designs), lambda _: None)
    end = time.perf_counter()
    best = problem.values(designs)[np.argmax(everywhere.score)]
    again = judge_designs(problem._replace(plan=LONG), np.array([list(tuned.design.values()), best]), lambda _: None)
    periods = len(designs) * len(problem.rows) * (problem.plan.transient + problem.plan.kept)
    found = {
        "tuned": dict(zip(over, tuned.design.values(), strict=True)),
        "best of all": dict(zip(over, best.tolist(), strict=True)),
        "objective of the tuned, long run": float(again.objective[0]),
        "objective of the best of all, long run": float(again.objective[1]),
        "share of the periods": tuned.periods / periods,
        "share of the time": (mid - begin) / (end - mid),
        "confirmed": tuned.confirmed,
    }
    record(name, found)
    assert found["objective of the tuned, long run"] >= found["objective of the best of all, long run"] - 1e-3


def test_tuning_against_a_grid():
    """Gap and stiffness over four force amplitudes, against 64 x 64 designs."""
    side = np.linspace(0, 1, 64)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    sought(TWO, {"drive.F_0": FORCES}, grid, "two parameters against a grid of 64 x 64")


def test_tuning_against_random_designs():
    """Four parameters at one force amplitude against 20,000 random designs."""
    designs = np.random.default_rng(1).random((20_000, 4))
    sought(FOUR, {"drive.F_0": [60.0]}, designs, "four parameters against 20,000 random designs")


def test_cost_of_tangents():
    """One tangent along the gap, of 64 lanes over three periods: of like error; CPU time over that of series."""
    scenes = engine.scenes_of(Problem(np.linspace(0.1, 8.0, 64)))
    duals = Dual(scenes, direction(scenes, "shroud.gap")), without_direction(initial_states(scenes))
    ways = {"taylor": engine.series(12, 1e-8), "dopri8": Choices(tableau("dopri8"), "cubic", False)}
    found = {}
    for name, method in ways.items():
        run = lambda method=method: run_flow(*duals, 3, 100, as_differentiable(method))
        found[name] = median(run, 7, time.process_time)
    record("tangents, over series", {name: taken / found["taylor"] for name, taken in found.items()})
