"""The same lanes on the accelerator that JAX has, beside the CPU: `python tests/benchmarks/gpu.py --help`.

Each platform runs in a process of its own, as JAX chooses its programs by the platform. Lanes are marched as sweeps do
it, in chunks, and all in one call, which is what an accelerator needs. Where JAX has none, the CPU is measured alone.
No accelerator was at hand when this was written.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from problem import errors

RESULTS = Path(__file__).parent / "results" / "gpu.json"
METHODS = ("rk4 400", "dopri8 100", "taylor 12")
TOLERANCE, SERIES_STEPS = 1e-7, 100  # of the power series; their steps only count time


def measured(lanes: list[int], periods: int, rounds: int, methods: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the device of this process takes, medians [us per lane and period], and the final motions (lanes, 12)."""
    import jax

    jax.config.update("jax_enable_x64", True)
    taken, ends = {}, {}
    for count in lanes:
        for case, scenes in _cases(count).items():
            for method in methods:
                for way, run in _ways(scenes, method, periods).items():
                    name = f"{case}, {method}, {count} lanes, {way}"
                    ends[name] = run()  # compiles
                    taken[name] = float(np.median([_seconds(run) for _ in range(rounds)])) / count / periods * 1e6
    device = jax.devices()[0]
    return {"platform": device.platform, "device": device.device_kind, "us": taken}, ends


def _seconds(run: Callable[[], Any]) -> float:
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def _cases(count: int) -> dict[str, Any]:
    """The scenes, with a leading axis of so many stiffness ratios."""
    from engine import scenes_of
    from problem import problem

    import jaxshroud as js
    from jaxshroud.scene.grids import grid_of_scenes

    gamma = np.linspace(0.1, 8.0, count)
    best = grid_of_scenes(js.load("fig09_best").scene, {"contact.gamma": gamma})
    return {"table1": scenes_of(problem(count)), "fig09_best": best}


def _ways(scenes: Any, words: str, periods: int) -> dict[str, Callable[[], np.ndarray]]:
    """Functions that march the scenes from rest and give their final motions: in chunks, and all in one call."""
    from engine import motions, prepare_scenes

    from jaxshroud.batch.lanes import initial_states
    from jaxshroud.batch.plan import Plan
    from jaxshroud.batch.runs import run_lanes
    from jaxshroud.march.method import Choices
    from jaxshroud.march.tableau import TaylorOptions, tableau

    name, number = words.split()
    if name == "taylor":
        steps, method = SERIES_STEPS, Choices(TaylorOptions(int(number), TOLERANCE), "series", False)
    else:
        steps, method = int(number), Choices(tableau(name), "cubic", False)
    plan = Plan(0, periods, steps, 0.0, method)
    at_once = prepare_scenes(scenes, method, len(scenes.drive.omega), periods)
    in_chunks = lambda: motions(run_lanes(scenes, initial_states(scenes), plan, lambda _: None).last)
    return {"in chunks": in_chunks, "in one call": lambda: at_once(steps)}


def in_process(words: list[str], platform: str | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """What `measured` gives in a process on a platform; None: the one that JAX prefers."""
    environment = os.environ if platform is None else {**os.environ, "JAX_PLATFORMS": platform}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, *words, "--ends", f"{folder}/ends.npz"]
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        return json.loads(done.stdout.splitlines()[-1]), dict(np.load(f"{folder}/ends.npz"))


def compared(words: list[str]) -> dict[str, Any]:
    """The figures of the CPU and of the accelerator, if there is one, and how far their motions are apart."""
    other, other_ends = in_process(words, None)
    if other["platform"] == "cpu":
        return {"cpu": other}
    cpu, cpu_ends = in_process(words, "cpu")
    apart = {name: float(np.nanmedian(errors(other_ends[name], cpu_ends[name]))) for name in cpu_ends}
    return {"cpu": cpu, other["platform"]: other, "median difference of motions": apart}


def print_table(found: dict[str, Any]) -> None:
    """A line for each way to march."""
    devices = [part for part in found.values() if "us" in part]
    apart = found.get("median difference of motions", {})
    print("us per lane and period on", ", ".join(f"{part['platform']} ({part['device']})" for part in devices))
    for name in devices[0]["us"]:
        times = "".join(f"{part['us'][name]:12.3g}" for part in devices)
        print(f"{name:<48}{times}" + (f"{apart[name]:12.1e} apart" if apart else ""))


def main(words: list[str] | None = None, results: Path = RESULTS) -> None:
    """Print a table and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, nargs="+", default=[256, 16384])
    parser.add_argument("--periods", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--ends", type=Path, help=argparse.SUPPRESS)  # of `in_process`
    options = parser.parse_args(words)
    if options.ends is None:
        found = compared(sys.argv[1:] if words is None else words)
        print_table(found)
        results.write_text(json.dumps(found, indent=1) + "\n")
    else:
        figures, ends = measured(options.lanes, options.periods, options.rounds, options.methods)
        np.savez(options.ends, **ends)
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
