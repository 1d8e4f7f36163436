"""Does a long sweep take what is said before it starts? python tests/studies/projection.py

The sweep is a map of P_d of 1,000 x 1,000 lanes in float32: transient 32, kept 17, in a store without samples.

Time: maps of 128 x 128 over the same ranges, five times, each with other random chunks of lanes to project from.
Compared is processor time, which others who use the machine do not lengthen much, after compilation.

Memory: the whole map is begun in a process of its own, which ends itself when `--part` lanes are done; its largest
resident size is compared with 4 GiB and with what the command says. `projection.json` has it all.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxshroud as js  # noqa: E402
from jaxshroud.batch.limits import sweep_memory  # noqa: E402
from jaxshroud.batch.plan import Plan  # noqa: E402
from jaxshroud.cli.projection import projected_seconds  # noqa: E402
from jaxshroud.march.method import choices  # noqa: E402
from jaxshroud.scene.grids import grid_of_scenes  # noqa: E402
from jaxshroud.scene.valid import in_precision  # noqa: E402
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE  # noqa: E402

SIDE, SMALL, PART, RUNS, LIMIT = 1000, 128, 16_384, 5, 4 * 2**30
TRANSIENT, KEPT, STEPS = 32, 17, 200
METHOD = js.RungeKutta(precision="float32")


def axes(side: int) -> dict[str, np.ndarray]:
    """Both keys of a map with their values."""
    return {"contact.gamma": np.linspace(0.5, 8.0, side), "drive.F_0": np.linspace(10.0, 80.0, side)}


def mapped(side: int, out: str, **more) -> None:
    """A map of P_d, in a store."""
    keeps = dict(transient=TRANSIENT, n_periods=KEPT, method=METHOD.replace(steps=STEPS), keep_samples=False)
    js.sweep(js.load("table1").scene, axes(side), store=f"{out}/map.zarr", **keeps, **more)


def times(side: int, runs: int) -> dict:
    """Processor time that maps take, and what was projected [s]."""
    plan = Plan(TRANSIENT, KEPT, STEPS, 0.0, choices(METHOD))
    grid = grid_of_scenes(js.load("table1").scene, axes(side))
    lanes = in_precision(jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), grid), "float32")
    found = []
    for seed in range(runs):
        projected = projected_seconds(lanes, plan, seed)
        with tempfile.TemporaryDirectory() as out:
            began = time.process_time()
            mapped(side, out)
            found.append({"projected": round(projected, 2), "taken": round(time.process_time() - began, 2)})
    ratios = [round(run["projected"] / run["taken"], 3) for run in found]
    return {"lanes": side**2, "runs": found, "ratios": ratios, "median": statistics.median(ratios)}


def begun(side: int, part: int) -> None:
    """Begin a map, end when so many lanes are done, and print how many they were and the largest size so far."""
    periods, counts = TRANSIENT + KEPT, []

    def stop(done: int, total: int) -> None:
        if done >= part * periods:
            counts.append({"lanes done": done // periods, "of": total // periods})
            raise KeyboardInterrupt

    with tempfile.TemporaryDirectory() as out:
        try:
            mapped(side, out, progress=stop)
        except KeyboardInterrupt:
            size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            print(json.dumps(counts[0] | {"largest resident size": size}))


def measured(side: int, part: int, small: int, runs: int) -> dict:
    """Memory of part of a map, and times of small ones."""
    words = [sys.executable, __file__, "--begin", "--side", str(side), "--part", str(part)]
    told = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    told |= {"limit": LIMIT, "said": sweep_memory(side**2, KEPT, MAX_LANES_AT_ONCE)}
    return {"memory": told, "time": times(small, runs)}


def main() -> None:
    """Run the study and write its JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=SIDE)
    parser.add_argument("--part", type=int, default=PART)
    parser.add_argument("--begin", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    js.cache_compilations()
    if options.begin:
        return begun(options.side, options.part)
    found = measured(options.side, options.part, SMALL, RUNS)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
