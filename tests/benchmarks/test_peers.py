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
from peers import heyoka_batch
from problem import PERIODS, Problem, errors, problem
from rich.console import Console
from rich.table import Table

from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau

RESULTS = Path(__file__).parent / "results"
PEERS = ("scalar_c", "scalar_c_unlocated", "vector_c", "heyoka_batch")
ROCKING = ("scalar_c",)  # which ends where faces rock without end: heyoka's program knows no flat contact
TARGETS = (1e-3, 1e-6, 1e-9, 1e-11)
QUANTILES = {"error": 0.5, "p95": 0.95, "most": 1.0}
TAILS = ("jaxshroud taylor", heyoka_batch.NAME)  # whose tails are drawn
COLORS = dict(zip(TAILS, ("black", "magenta"), strict=True))
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


def contestants(whole: Problem, peers: tuple[str, ...]):
    """(name, setting, run) of everything that can run here, and why the others cannot."""
    entries, absent = [], {}
    for name, (method, steps) in engine.METHODS.items():
        run = engine.prepare(whole, method)
        entries += [(name, n, run) for n in steps]
    by_series = engine.prepare_series(whole)
    entries += [("jaxshroud taylor", tolerance, by_series) for tolerance in engine.SERIES]
    for module in peers:
        peer = importlib.import_module(f"peers.{module}")
        reason = peer.missing()
        if reason:
            absent[peer.NAME] = reason
            continue
        run = peer.prepare(whole)
        entries += [(peer.NAME, setting, run) for setting in peer.SETTINGS]
    return entries, absent


def timed(entries) -> list[dict]:
    """Median cost of each entry over rounds that go through all of them in turn."""
    rows = []
    for name, setting, run in entries:
        start = time.process_time()
        states = run(setting)  # compiles
        rows.append(dict(name=name, setting=setting, lanes=LANES, states=states, seconds=[]))
        rows[-1]["first"] = time.process_time() - start
    for _ in range(ROUNDS):
        for row, (_, setting, run) in zip(rows, entries, strict=True):
            if row["seconds"] and row["seconds"][0] > SLOW:
                continue
            start = time.process_time()
            run(setting)
            row["seconds"].append(time.process_time() - start)
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


def cheapest(rows: list[dict], name: str, error: float, of: str) -> float | None:
    """Cost of the cheapest of a method's settings that reach an error."""
    return min((r["us"] for r in rows if r["name"] == name and r[of] <= error), default=None)


def without_callbacks(rows: list[dict], whole: Problem) -> list[dict]:
    """Rows of a peer less what it spends in Python at events."""
    if not any(r["name"] == heyoka_batch.NAME for r in rows):
        return []
    spent = heyoka_batch.callbacks(whole) / LANES / PERIODS * 1e6
    name = f"{heyoka_batch.NAME}, less its callbacks"
    return [{**r, "name": name, "us": r["us"] - spent} for r in rows if r["name"] == heyoka_batch.NAME]


def series_trials(whole: Problem, reference: np.ndarray) -> list[dict]:
    """Trials, events and errors of power series by order and tolerance."""
    found = []
    for order, digits in engine.TRIED.items():
        for tolerance in (10.0**-n for n in digits):
            method = engine.series(order, tolerance)
            steps = engine.series_steps(tolerance)
            made, events = engine.trials(whole, method, steps)
            error = errors(engine.prepare(whole, method)(steps), reference)
            told = dict(order=order, tolerance=tolerance, trials=made, events=events)
            found.append(told | {name: float(np.quantile(error, at)) for name, at in QUANTILES.items()})
    return found


def machine() -> dict:
    """What the figures were measured on."""
    info = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = next((line.split(":")[1].strip() for line in info.splitlines() if "model name" in line), platform.machine())
    packages = {p: importlib.import_module(p).__version__ for p in ("jax", "numpy", "scipy")}
    return {"cpu": model, "avx2": " avx2" in info, "avx512": "avx512f" in info, **packages}


def draw(rows: list[dict], series: list[dict], path: Path) -> None:
    """The work-precision diagram with its tails, and the trials of power series."""
    figure, (axes, right) = plt.subplots(1, 2, figsize=(10, 5.6), layout="constrained", width_ratios=(2, 1))
    for i, name in enumerate(dict.fromkeys(r["name"] for r in rows)):
        mine = [r for r in rows if r["name"] == name]
        ours, color = name.startswith("jaxshroud"), COLORS.get(name, plt.get_cmap("tab20")(i % 20))
        style = dict(lw=2.2, marker="o", ms=5) if ours else dict(lw=1, marker="s", ms=3.5, ls="--")
        axes.loglog([r["error"] for r in mine], [r["us"] for r in mine], label=name, color=color, **style)
        if name in TAILS:
            for r in mine:
                axes.plot([r["error"], r["p95"]], [r["us"]] * 2, color=color, lw=1)
                axes.plot(r["most"], r["us"], color=color, marker="|", ms=6)
    axes.set(xlabel="error after 3 periods: median, line to p95, tick at the largest", xlim=(3e-1, 1e-15))
    axes.set(ylabel="CPU time [µs per lane and period]")
    axes.grid(alpha=0.3, which="major")
    axes.legend(fontsize=7, ncols=2, frameon=False, loc="upper left", bbox_to_anchor=(0, -0.13))
    for k, order in enumerate(dict.fromkeys(r["order"] for r in series)):
        mine = [r for r in series if r["order"] == order]
        color = plt.get_cmap("viridis")(k / len(engine.TRIED))
        right.semilogx([r["tolerance"] for r in mine], [r["trials"] for r in mine], "o-", color=color, label=f"{order}")
    right.axhline(series[0]["events"], color="k", ls=":", lw=1)
    least = min(r["tolerance"] for r in series)
    below = {"xytext": (0, -10), "textcoords": "offset points", "ha": "right", "fontsize": 8}
    right.annotate("events at the loosest", (least, series[0]["events"]), **below)
    right.set(xlabel="tolerance of the series", ylabel="trials of a lane in a period", ylim=(0, None))
    right.invert_xaxis()
    right.grid(alpha=0.3)
    right.legend(title="order", fontsize=7, title_fontsize=8, frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def show(rows: list[dict], ratios: dict, sound: dict, absent: dict) -> None:
    console = Console(width=110)
    columns = "method", "setting", "median error", "p95", "largest", "us / lane / period"
    table = Table(*columns, title="CPU time against error, one core")
    for r in rows:
        told = (f"{r[name]:.1e}" for name in QUANTILES)
        table.add_row(r["name"], f"{r['setting']:g}", *told, f"{r['us']:.1f}")
    console.print(table)
    for of, costs in sound.items():
        title = (
            f"Cost of the cheapest setting whose {'median' if of == 'error' else of} reaches it, over ours by series"
        )
        table = Table("method", *(f"at {t:g}" for t in TARGETS), title=title)
        for name, row in costs.items():
            over = zip(row, costs["jaxshroud taylor"], strict=True)
            table.add_row(name, *("-" if a is None or b is None else f"{a / b:.2f}" for a, b in over))
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
@pytest.mark.parametrize("light", [False, True], ids=["table1", "light"])
def test_cost_against_error(light):
    whole, name = problem(LANES, light=light), "peers_light" if light else "peers"
    entries, absent = contestants(whole, ROCKING if light else PEERS)
    reference = engine.prepare(whole, Choices(tableau("dopri8"), ledger=False))(4000 if light else 1000)
    rows = timed(entries)
    for row in rows:
        error = errors(row.pop("states"), reference)
        row |= {name: float(np.quantile(error, at)) for name, at in QUANTILES.items()}
    rows += without_callbacks(rows, whole)
    names = list(dict.fromkeys(r["name"] for r in rows))
    costs = {name: [cost_at(rows, name, t) for t in TARGETS] for name in names}
    ours = [min(c for n in names if n.startswith("jaxshroud") and (c := costs[n][i])) for i in range(len(TARGETS))]
    ratios = {n: [c and c / o for c, o in zip(cost, ours, strict=True)] for n, cost in costs.items()}
    sound = {of: {n: [cheapest(rows, n, t, of) for t in TARGETS] for n in names} for of in ("error", "p95")}
    series = series_trials(whole, reference)
    show(rows, ratios, sound, absent)
    RESULTS.mkdir(exist_ok=True)
    draw(rows, series, RESULTS / f"{name}.png")
    found = {"machine": machine(), "rows": rows, "targets": TARGETS, "ratios": ratios, "cheapest": sound}
    found |= {"series": series, "absent": absent}
    (RESULTS / f"{name}.json").write_text(json.dumps(found, indent=1))
    assert all(np.isfinite(r["error"]) for r in rows if r["name"].startswith("jaxshroud"))
