"""How many periods a wheel takes: python tests/studies/wheel_periods.py SCENE.toml [--set KEY=VALUE ...] [--num N]

The speeds of `--start` to `--stop` rpm are run from the scene's own start without a transient. Windows of the run tell
after how many discarded periods the RMS of x and P_d are within their intervals of those at its end, and how many kept
ones the package's own verdict takes. `wheel_periods.json` has the table of every scene that was asked for, and of runs
of more than 1,000 periods what they say of each speed.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.batch.plan import Plan, Runs, Ticker
from jaxshroud.batch.runs import independent_runs
from jaxshroud.march.method import FOR_P_D
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.arguments import plan_march, resolve_options
from jaxshroud.verbs.lanes import flatten_lanes
from jaxshroud.verbs.sweep_run import SweepSettings, _lane_numbers

RPM = 2 * np.pi / 60
DISCARDED, BRIEF = (0, 20, 40, 60, 80, 100, 160, 200), 64  # periods before a window, and its length
BEGIN, KEPT = 40, (64, 128, 192, 260)  # of windows of several lengths
LONG = 500  # periods discarded of long runs, whose values are stored


def run(scene: js.SceneFile, speeds: np.ndarray, periods: int) -> tuple[Scene, Runs, SweepSettings]:
    """All periods of all speeds, from the scene's own start."""
    resolved = resolve_options(scene, n_periods=periods, transient=0, of_sweep=True, verb="sweep")
    lanes = without_given(flatten_lanes(grid_of_scenes(resolved.scene, {"drive.speed": speeds * RPM}), 1))
    march = plan_march(resolved, lanes, FOR_P_D)
    march = march._replace(method=march.method._replace(amplitudes=True))
    lanes = in_precision(lanes, march.method.precision)
    plan = Plan(0, periods, march.steps, 0.0, march.method)
    ticker = Ticker(len(speeds) * periods, lambda done, of: print(f"{done:.0f} of {of}", end="\r", flush=True))
    return lanes, independent_runs(lanes, (len(speeds),), plan, ticker), SweepSettings(plan, march, 1e-3, ticker)


def numbers(lanes: Scene, runs: Runs, settings: SweepSettings, begin: int, kept: int) -> dict:
    """The numbers of a sweep that discards and keeps so many periods."""
    window = replace(runs, samples=jax.tree.map(lambda a: a[:, begin : begin + kept], runs.samples))
    return _lane_numbers(lanes, window, settings)


def row(found: dict, last: dict, begin: int, kept: int) -> dict:
    """How many lanes of a window have settled, and agree with the last window within both intervals."""
    x, of_last = (one["x_rms"].max(axis=-1) for one in (found, last))
    ci, ci_of_last = (one["x_rms_ci"].max(axis=-1) for one in (found, last))
    return {
        "discarded": begin,
        "kept": kept,
        "aperiodic": int((found["period_number"] == 0).sum()),
        "motion settled": int(found["settled"].sum()),
        "P_d settled": int(found["P_d_settled"].sum()),
        "RMS as at the end": int((np.abs(x - of_last) <= np.hypot(ci, ci_of_last)).sum()),
        "P_d as at the end": int(
            (np.abs(found["P_d"] - last["P_d"]) <= np.hypot(found["P_d_ci"], last["P_d_ci"])).sum()
        ),
        "largest change of RMS": round(float(np.max(np.abs(x / of_last - 1))), 4),
        "median interval of RMS": round(float(np.median(ci / x)), 4),
    }


def values(speeds: np.ndarray, found: dict) -> dict:
    """What a long run says of each speed."""
    return {
        "speed [rpm]": speeds.tolist(),
        "RMS of x [m]": found["x_rms"].max(axis=-1).tolist(),
        "half width": found["x_rms_ci"].max(axis=-1).tolist(),
        "P_d [%]": found["P_d"].tolist(),
        "half width of P_d": found["P_d_ci"].tolist(),
        "settled": (found["settled"] & found["P_d_settled"]).tolist(),
    }


def main() -> None:
    """The table of one scene, added to those of others."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], dest="sets")
    parser.add_argument("--start", type=float, default=900.0)
    parser.add_argument("--stop", type=float, default=1800.0)
    parser.add_argument("--num", type=int, default=46)
    parser.add_argument("--speeds", type=float, nargs="+", help="in their place")
    parser.add_argument("--periods", type=int, default=300)
    parser.add_argument("--sigma", type=float, default=0.0, help="of one random pattern of mistuning")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    js.cache_compilations()
    scene = js.load(asked.scene, asked.sets)
    if asked.sigma:
        blades = scene.layout.blades
        pattern = asked.sigma * np.random.default_rng(0).standard_normal(blades)
        scene = js.load(asked.scene, [*asked.sets, f"row.mistuning={pattern.tolist()}"])
    began = time.process_time()
    speeds = np.linspace(asked.start, asked.stop, asked.num) if asked.speeds is None else np.array(asked.speeds)
    held = run(scene, speeds, asked.periods)
    seconds = time.process_time() - began
    last = numbers(*held, asked.periods - BRIEF, BRIEF)
    windows = [(begin, BRIEF) for begin in DISCARDED if begin + BRIEF <= asked.periods]
    windows += [(BEGIN, kept) for kept in KEPT if BEGIN + kept <= asked.periods]
    rows = [row(numbers(*held, *window), last, *window) for window in windows]
    name = " ".join([Path(asked.scene).stem, *asked.sets, *([f"sigma {asked.sigma:g}"] if asked.sigma else [])])
    path = Path(__file__).with_suffix(".json")
    tables = json.loads(path.read_text("utf-8")) if path.exists() else {}
    per_period = round(seconds / (len(speeds) * asked.periods), 3)
    tables[f"{name}, {asked.periods} periods"] = table = {
        "lanes": len(speeds),
        "periods": asked.periods,
        "seconds a lane and period": per_period,
        "rows": rows,
        **({"values": values(speeds, numbers(*held, LONG, asked.periods - LONG))} if asked.periods > 2 * LONG else {}),
    }
    path.write_text(json.dumps(tables, indent=1) + "\n", "utf-8")
    print(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
