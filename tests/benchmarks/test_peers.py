"""Cost against error of every way to compute the same runs, side by side on one core."""

import importlib
import json
import os
import platform
import time
from pathlib import Path

import engine
import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from problem import PERIODS, Problem, errors, problem
from rich.console import Console
from rich.table import Table

from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau

RESULTS = Path(__file__).parent / "results"
PEERS = (
    "scalar_c",
    "scalar_c_unlocated",
    "vector_c",
    "numba_scalar",
    "scipy_compiled",
    "heyoka_batch",
    "diffrax_smooth",
    "jax_nested",
)
TARGETS = (1e-3, 1e-6, 1e-9, 1e-11)
LANES, ROUNDS = 256, 5
SLOW = 5.0  # seconds beyond which one round has to do


@pytest.fixture
def one_core():
    """The process on a single core, and back."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    with jax.numpy_dtype_promotion("standard"):  # peers need not be as strict as the package
        yield
    os.sched_setaffinity(0, cores)


def contestants(whole: Problem):
    """(name, setting, problem, run) of everything that can run here, and why the others cannot."""
    entries, absent = [], {}
    for name, (method, steps) in engine.METHODS.items():
        run = engine.prepare(whole, method)
        entries += [(name, n, whole, run) for n in steps]
    by_series = engine.prepare_series(whole)
    entries += [("jaxshroud taylor", tolerance, whole, by_series) for tolerance in engine.ORDERS]
    for module in PEERS:
        peer = importlib.import_module(f"peers.{module}")
        reason = peer.missing()
        if reason:
            absent[peer.NAME] = reason
            continue
        every = max(1, LANES // getattr(peer, "LANES", LANES))
        part = Problem(whole.gamma[::every])
        run = peer.prepare(part)
        entries += [(peer.NAME, setting, part, run) for setting in peer.SETTINGS]
    return entries, absent


def timed(entries) -> list[dict]:
    """Median cost of each entry over rounds that go through all of them in turn."""
    rows = []
    for name, setting, part, run in entries:
        start = time.perf_counter()
        states = run(setting)  # compiles
        rows.append(dict(name=name, setting=setting, lanes=len(part.gamma), states=states, seconds=[]))
        rows[-1]["first"] = time.perf_counter() - start
    for _ in range(ROUNDS):
        for row, (_, setting, _, run) in zip(rows, entries, strict=True):
            if row["seconds"] and row["seconds"][0] > SLOW:
                continue
            start = time.perf_counter()
            run(setting)
            row["seconds"].append(time.perf_counter() - start)
    for row in rows:
        row["us"] = float(np.median(row["seconds"]) / row["lanes"] / PERIODS * 1e6)
    return rows


def cost_at(rows: list[dict], name: str, error: float) -> float | None:
    """Cost at which a method reaches an error, between its settings on logarithmic scales."""
    points = sorted((r["error"], r["us"]) for r in rows if r["name"] == name)
    reached = [us for e, us in points if e <= error]
    if not reached:
        return None
    e, us = np.log([p[0] for p in points]), np.log([p[1] for p in points])
    return float(min(*reached, np.exp(np.interp(np.log(error), e, us)))) if error < points[-1][0] else min(reached)


def machine() -> dict:
    """What the figures were measured on."""
    info = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = next((line.split(":")[1].strip() for line in info.splitlines() if "model name" in line), platform.machine())
    packages = {p: importlib.import_module(p).__version__ for p in ("jax", "numpy", "scipy")}
    return {"cpu": model, "avx2": " avx2" in info, "avx512": "avx512f" in info, **packages}


def draw(rows: list[dict], path: Path) -> None:
    """The work-precision diagram."""
    figure, axes = plt.subplots(figsize=(7.5, 5), layout="constrained")
    for i, name in enumerate(dict.fromkeys(r["name"] for r in rows)):
        points = [(r["error"], r["us"]) for r in rows if r["name"] == name]
        ours = name.startswith("jaxshroud")
        style = dict(lw=2.2, marker="o", ms=5) if ours else dict(lw=1, marker="s", ms=3.5, ls="--")
        axes.loglog(*zip(*points, strict=True), label=name, color=plt.get_cmap("tab20")(i % 20), **style)
    axes.set(xlabel="median error after 3 periods", ylabel="cost [µs per lane and period]")
    axes.invert_xaxis()
    axes.grid(alpha=0.3, which="major")
    axes.legend(fontsize=7, ncols=2, frameon=False, loc="upper left", bbox_to_anchor=(0, -0.13))
    figure.savefig(path, dpi=150)
    plt.close(figure)


def show(rows: list[dict], ratios: dict, absent: dict) -> None:
    console = Console(width=110)
    table = Table("method", "setting", "median error", "us / lane / period", title="Cost against error, one core")
    for r in rows:
        table.add_row(r["name"], f"{r['setting']:g}", f"{r['error']:.1e}", f"{r['us']:.1f}")
    console.print(table)
    table = Table("method", *(f"at {t:g}" for t in TARGETS), title="Cost over that of jaxshroud's cheapest method")
    for name, row in ratios.items():
        table.add_row(name, *("-" if r is None else f"{r:.2f}" for r in row))
    console.print(table)
    for name, reason in absent.items():
        console.print(f"absent: {name}: {reason}")


@pytest.mark.benchmark
@pytest.mark.filterwarnings("default")
@pytest.mark.usefixtures("one_core")
def test_cost_against_error():
    whole = problem(LANES)
    entries, absent = contestants(whole)
    reference = engine.prepare(whole, Choices(tableau("dopri8"), ledger=False))(1000)
    rows = timed(entries)
    for row in rows:
        row["error"] = float(np.median(errors(row.pop("states"), reference[:: LANES // row["lanes"]])))
    names = list(dict.fromkeys(r["name"] for r in rows))
    costs = {name: [cost_at(rows, name, t) for t in TARGETS] for name in names}
    ours = [min(c for n in names if n.startswith("jaxshroud") and (c := costs[n][i])) for i in range(len(TARGETS))]
    ratios = {n: [c and c / o for c, o in zip(cost, ours, strict=True)] for n, cost in costs.items()}
    show(rows, ratios, absent)
    RESULTS.mkdir(exist_ok=True)
    draw(rows, RESULTS / "peers.png")
    found = {"machine": machine(), "rows": rows, "targets": TARGETS, "ratios": ratios, "absent": absent}
    (RESULTS / "peers.json").write_text(json.dumps(found, indent=1))
    assert all(np.isfinite(r["error"]) for r in rows if r["name"].startswith("jaxshroud"))
