"""Which reading of the article its figures were computed from: python tests/studies/reading.py.

Simulates every reading at every point and stores period numbers and P_d in reading.npz; writes what follows from them
to reading.json and reading.png. With `--judge` it starts from the stored ones; with `--friction` only what the article
says of friction is looked at anew.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from reading_friction import friction
from reading_picture import picture
from reading_report import PLAUSIBLE, labelled, report
from reading_scenes import POINTS, Point, Reading, readings, scenes
from reading_verdict import STOPPED, Found

from jaxshroud.batch.plan import Plan, Runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import initial_states
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau
from jaxshroud.model.linear import area
from jaxshroud.model.modes import Status
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.averages import averages
from jaxshroud.version import __version__

FAST = Plan(160, 48, 100, 0.0, Choices(tableau("tsit5"), "cubic", False, "float32"))
FINE = Plan(400, 64, 100, 0.0, Choices(tableau("dopri8"), "cubic", False, "float64"))
STIFF = 1.28  # times as many steps, for omega_max h < 1.5: 1.75 is Tsitouras 5's limit of stability
HERE = Path(__file__)


def simulated(
    rows: list[Reading], points: list[Point] = POINTS, plan: Plan = FAST, tell: Callable[[str], None] = lambda _: None
) -> Found:
    """Every reading at every point; those that keep the same misprints and are as stiff run together."""
    alike = lambda row: (row.kept, row.stiff)
    parts = [[i for i, row in enumerate(rows) if alike(row) == which] for which in dict.fromkeys(map(alike, rows))]
    found = []
    for part in parts:
        first = rows[part[0]]
        own = replace(plan, steps_per_period=round(plan.steps_per_period * (STIFF if first.stiff else 1)))
        found.append(_together([rows[i] for i in part], points, own))
        tell(f"{len(found)} of {len(parts)}: {first.formulas}, {first.angles}{', stiff' if first.stiff else ''}")
    back = np.argsort(np.concatenate(parts))
    return Found(*(np.concatenate(column)[back] for column in zip(*found, strict=True)))


def _together(rows: list[Reading], points: list[Point], plan: Plan) -> Found:
    lanes = in_precision(scenes(rows, points), plan.method.precision)
    runs = run_lanes(lanes, initial_states(lanes), plan, lambda _: None)
    orbit, power, P_0 = averages(lanes, runs.samples)
    ended = np.asarray(runs.last.status) == Status.OK
    of_lanes = np.where(ended, orbit.number, STOPPED), np.where(ended, power.P_d, np.nan), _wander(lanes, runs, P_0)
    return Found(*(column.reshape(len(points), len(rows)).T for column in of_lanes))


def _wander(lanes: Scene, runs: Runs, P_0: np.ndarray) -> np.ndarray:
    """How far P_d(n) is from its last value, at most, over the second half of n (lanes,)."""
    P = np.asarray(jax.vmap(area)(lanes.shroud), float)[:, None] * np.asarray(runs.samples.power[..., 0])
    n = P.shape[1]
    mean = 100 * (1 - np.cumsum(P, axis=1) / np.arange(1, n + 1) / P_0[:, :1])
    return np.abs(mean[:, n // 2 :] - mean[:, -1:]).max(axis=1)


def stored() -> Found:
    """What reading.npz holds."""
    with np.load(HERE.with_suffix(".npz")) as file:
        return Found(file["period"].astype(int), file["P_d"].astype(float), file["wander"].astype(float))


def store(found: Found) -> None:
    """Write reading.npz: percentages to three digits, as many as the study asks for, and none beyond +-60,000."""
    few = {name: np.clip(getattr(found, name), -6e4, 6e4).astype(np.float16) for name in ("P_d", "wander")}
    np.savez_compressed(HERE.with_suffix(".npz"), period=found.period.astype(np.int8), **few)


def measured() -> dict[str, float]:
    """Simulate all readings and store them; what that took."""
    wall, cpu = time.time(), time.process_time()
    store(simulated(readings(), tell=lambda text: print(text, flush=True)))
    spent = time.process_time() - cpu
    return {"wall_s": round(time.time() - wall), "cpu_s": round(spent), "two_cores_s": round(spent / 2)}


def main() -> None:
    """Simulate, judge, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--judge", action="store_true", help="start from reading.npz")
    parser.add_argument("--friction", action="store_true", help="only what the article says of friction")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    file = HERE.with_suffix(".json")
    before = json.loads(file.read_text("utf-8"))
    if options.friction:
        file.write_text(json.dumps({**before, "friction": friction(PLAUSIBLE)}, indent=1) + "\n", "utf-8")
        return
    took = before["took"] if options.judge else measured()
    told = {
        "command": "python tests/studies/reading.py",
        "version": __version__,
        "took": took,
        "run": {
            "transient": FAST.transient,
            "kept": FAST.kept,
            "steps": FAST.steps_per_period,
            "how": str(FAST.method),
        },
        **report(stored(), lambda rows: simulated(rows, labelled(), FINE)),
        "friction": before["friction"] if options.judge else friction(PLAUSIBLE),
    }
    file.write_text(json.dumps(told, indent=1) + "\n", "utf-8")
    picture(stored(), told).savefig(HERE.with_suffix(".png"), dpi=300)
    print(json.dumps({name: told[name] for name in ("verdict", "took")}))


if __name__ == "__main__":
    main()
