"""What a row of blades costs: compilation and CPU per lane and period against the number of blades."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

import jaxshroud as js
from jaxshroud.march.accumulator import Counters

RESULTS = Path(__file__).parent / "results"
BLADES, LANES, PERIODS, ROUNDS = (2, 4, 8, 16, 32, 64), 64, 2, 3
STEPS = 100
KINDS = {"gap": "22 um", "interference": "-0.4 mm"}
HOW = {"transient": 0, "method": js.RungeKutta("dopri8", steps=STEPS)}


def scene_of(blades: int, gap: str) -> js.Scene:
    """Table 1 as a ring under engine order N / 4, or 1 of less than four blades."""
    order = max(blades // 4, 1)
    row = [f"row.blades={blades}", "row.closed=true", f"drive.engine_order={order}", f"shroud.gap={gap}"]
    return js.load("table1", row).scene


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
