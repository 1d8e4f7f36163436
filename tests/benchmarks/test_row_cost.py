"""What a row of blades costs: compilation and CPU per lane and period against the number of blades, and by each method.

Methods are compared on one core (`taskset -c 0 pytest --benchmark ...`): where a second one is idle, XLA's threads wait
there for the small kernels of power series, and count as processor time.
"""

import json
import time
from pathlib import Path

import beam_model
import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.accumulator import Counters
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.scene.grids import scenes_at

RESULTS = Path(__file__).parent / "results"
BLADES, LANES, PERIODS, ROUNDS = (2, 4, 8, 16, 32, 64), 64, 2, 3
STEPS = 100
KINDS = {"gap": "22 um", "interference": "-0.4 mm"}
Methods = dict[str, tuple[Choices, int]]
METHODS: Methods = {
    "dopri8 100": (Choices(tableau("dopri8"), "cubic", False), 100),
    "taylor 12 1e-8": (Choices(TaylorOptions(12, 1e-8), "series", False), 100),
}
JUDGE = Choices(TaylorOptions(14, 1e-12), "series", False), 100
SIZES = [(8, 16), (12, 16), (12, 64), (16, 16), (32, 16), (64, 16), (128, 16)]
MODES = {4: 20, 6: 40, 16: 400}  # how many, and steps a period
LARGE = 64  # blades, from here on one run by turns
HOW = {"transient": 0, "method": js.RungeKutta("dopri8", steps=STEPS)}


def scene_of(blades: int, gap: str, base: str = "table1") -> js.Scene:
    """A scene of a pair as a ring under engine order N / 4, or 1 of less than four blades."""
    order = max(blades // 4, 1)
    row = [f"row.blades={blades}", "row.closed=true", f"drive.engine_order={order}", f"shroud.gap={gap}"]
    return js.load(base, row).scene


def cost_of(blades: int, kind: str) -> dict[str, float]:
    """The first call, and the median of the others."""
    scene, taken = scene_of(blades, KINDS[kind]), []
    along = {"drive.F_0": np.linspace(50.0, 70.0, LANES)}
    for n in (1, *[PERIODS] * ROUNDS):
        start = time.process_time()
        swept = js.sweep(scene, along, n_periods=n, **HOW)
        taken.append(time.process_time() - start)
    names = set(Counters.__annotations__) - {"grazing"}
    events = sum(float(np.sum(swept.counters[name])) for name in names) / LANES / PERIODS / blades
    cost = float(np.median(taken[1:])) / LANES / PERIODS
    return {
        "blades": blades,
        "first": taken[0],
        "cost": cost,
        "events": events,
        "work": blades * (STEPS + blades * events),
    }


def mistuned(scene: js.Scene) -> js.Scene:
    """The scene with stiffnesses that scatter by 3 %."""
    pattern = 0.03 * np.random.default_rng(1).standard_normal(scene.layout.blades)
    return js.vary(scene, "row.mistuning", pattern)


def end_of(scenes: js.Scene, method: Choices, steps: int) -> tuple[np.ndarray, float]:
    """The motion (6, blades, lanes) after some periods from rest, and the processor time that they take."""
    start = time.process_time()
    runs = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, steps, 0.0, method), lambda _: None)
    assert np.all(runs.last.status == js.Status.OK)
    return np.stack([np.moveaxis(a[:, -1], 0, -1) for a in runs.samples.motion]), time.process_time() - start


def costs_by_turns(scene: js.Scene, lanes: int, methods: Methods = METHODS) -> dict[str, dict[str, float]]:
    """Microseconds a blade and period by each method, the median of runs by turns, and the median of their errors."""
    scenes = scenes_at(scene, ["drive.F_0"], np.linspace(50.0, 70.0, lanes)[:, None])
    exact, _ = end_of(scenes, *JUDGE)
    size, errors, taken = np.abs(exact).max(axis=1), {}, {name: [] for name in methods}
    for _ in range(1 + (ROUNDS if scene.layout.blades < LARGE else 1)):
        for name, method in methods.items():
            end, seconds = end_of(scenes, *method)
            taken[name].append(1e6 * seconds / lanes / PERIODS / scene.layout.blades)
            errors[name] = float(np.median(np.max(np.abs(end - exact).max(axis=1) / size, axis=0)))
    return {name: {"cost": float(np.median(taken[name][1:])), "error": errors[name]} for name in methods}


@pytest.mark.benchmark
def test_cost_of_power_series():
    found, console = {}, Console(width=110)
    for kind, gap in (KINDS | {"mistuned": KINDS["gap"], "light, two points": KINDS["gap"]}).items():
        table = Table(
            "blades", "lanes", *(f"{name}: us, error" for name in METHODS), title=f"us a blade and period, {kind}"
        )
        for blades, lanes in SIZES:
            scene = scene_of(blades, gap, "table1_points" if kind.startswith("light") else "table1")
            costs = costs_by_turns(mistuned(scene) if kind == "mistuned" else scene, lanes)
            table.add_row(str(blades), str(lanes), *(f"{a['cost']:.0f}, {a['error']:.0e}" for a in costs.values()))
            found[f"{kind} {blades} {lanes}"] = costs
            (RESULTS / "row_series.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
        console.print(table)


@pytest.mark.benchmark
def test_cost_of_modes(tmp_path):
    """Rings of 12 blades with two points, pressed together, by modes of one blade with three residual vectors."""
    found, columns = {}, ("a coarse setting", "a fine one")
    table = Table(
        "modes", "highest over drive", *(f"{name}, {one}" for name in ("series", "dopri8") for one in columns)
    )
    blade = beam_model.Model()
    for modes, steps in MODES.items():
        given = {"dofs": blade.labels, "nodes": blade.nodes, "shroud": beam_model.TIPS, "fixed": ["0"], "zeta": 0.002}
        reduced = js.reduce(blade.K, blade.M, n_modes=modes - 3, **given)
        reduced.save(tmp_path / f"{modes}.csv")
        scene = js.load("fem_blade", [f"blades.modes={tmp_path / f'{modes}.csv'}"]).scene
        series = {f"taylor 12 {t:g}": (Choices(TaylorOptions(12, t), "series", False), 100) for t in (1e-6, 1e-8)}
        stepped = {f"dopri8 {n}": (Choices(tableau("dopri8"), "cubic", False), n) for n in (steps, 2 * steps)}
        costs = costs_by_turns(scene, 16, series | stepped)
        highest = f"{2 * np.pi * reduced.f.max() / scene.drive.omega:.1f}"
        table.add_row(str(modes), highest, *(f"{a['cost']:.0f} us: {a['error']:.0e}" for a in costs.values()))
        found[f"{modes} modes"] = costs
        (RESULTS / "row_modes.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    Console(width=110).print(table)


@pytest.mark.benchmark
def test_cost_against_the_number_of_blades(monkeypatch):
    monkeypatch.setenv("JAXSHROUD_CACHE", "off")
    found, console = {}, Console(width=110)
    for kind in KINDS:
        rows = [cost_of(blades, kind) for blades in BLADES]
        table = Table("blades", "first call [s]", "ms / lane / period", "events / blade", "us / N (steps + N events)")
        for row in rows:
            each = row["cost"] / row["work"]
            cells = f"{row['first']:.1f}", f"{1e3 * row['cost']:.2f}", f"{row['events']:.1f}", f"{1e6 * each:.2f}"
            table.add_row(str(row["blades"]), *cells)
        console.print(f"Table 1 as a ring, {kind}: {KINDS[kind]}", table)
        found[kind] = rows
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "rows.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
