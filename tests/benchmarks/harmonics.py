"""Harmonic balance beside the march: `uv run --group benchmark python tests/benchmarks/harmonics.py`.

The four peaks of the scene `dry_friction_2dof`: by `orbit`, which marches from rest and closes the orbit by shooting;
by the tests' plain harmonic balance; and by pyHarm (`peers/pyharm_balance.py` has what it can express). Prints a table,
and writes `results/harmonics.json`. An error is that of the largest y against Dormand-Prince 8, 64 periods from rest; a
cost is the CPU time of one peak, the median over rounds that go through all ways in turn. Compiling does not count.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from scipy.signal import resample

sys.path.append(str(Path(__file__).parents[1]))
from harmonic_balance import balanced, oscillator
from peers import pyharm_balance

import jaxshroud as js
from jaxshroud.scene.grids import stack_scenes
from jaxshroud.scene.scene import Scene

RESULTS = Path(__file__).parent / "results" / "harmonics.json"
PEAKS = {25.0: (3.64, 9.552), 50.0: (3.50, 27.486), 80.0: (3.46, 51.820), 100.0: (3.46, 68.384)}  # F: omega, published
PERIODS, STEPS, FINE = 64, 400, 8000
Way = Callable[[], np.ndarray]  # the largest y of every peak


def scenes() -> list[Scene]:
    """The oscillator at its published peaks."""
    at = lambda scene, F, omega: js.vary(js.vary(scene, "drive.F_0", F * np.sqrt(1.01)), "drive.omega", omega)
    return [at(js.load("dry_friction_2dof").scene, force, omega) for force, (omega, _) in PEAKS.items()]


def largest(y: np.ndarray) -> np.ndarray:
    """The largest value between the samples of a period."""
    return np.max(np.abs(resample(y, FINE, axis=-1)), axis=-1)


def marched_from_rest() -> np.ndarray:
    """The peaks after so many periods, by another method than the others'."""
    run = js.simulate(stack_scenes(scenes()), n_periods=PERIODS, method=js.RungeKutta("dopri8", steps=STEPS))
    return largest(run.motion.y[:, -STEPS - 1 : -1, 0])


def by_orbits() -> np.ndarray:
    """The peaks of the orbits that the scenes settle on."""
    batch, method = stack_scenes(scenes()), js.Taylor(tolerance=1e-9, steps=STEPS)
    run = js.simulate(batch, js.orbit(batch, method=method).start, n_periods=1, method=method)
    return largest(run.motion.y[:, :-1, 0])


def ways(harmonics: list[int]) -> tuple[dict[str, Way], dict[str, str]]:
    """What can run here, and why the others cannot."""
    systems = [oscillator(scene) for scene in scenes()]
    found: dict[str, Way] = {"orbit": by_orbits}
    absent = pyharm_balance.missing()
    for number in harmonics:
        plain = lambda number=number: np.array([largest(balanced(s, number).q[1]) for s in systems])
        other = lambda number=number: np.array([largest(pyharm_balance.period_of_y(s, number)) for s in systems])
        found |= {f"plain, {number}": plain} | ({} if absent else {f"{pyharm_balance.NAME}, {number}": other})
    return found, {pyharm_balance.NAME: absent} if absent else {}


def measured(harmonics: list[int], rounds: int) -> dict:
    """Peaks, largest relative errors and costs of every way."""
    exact = marched_from_rest()
    entries, absent = ways(harmonics)
    peaks = {name: run() for name, run in entries.items()}  # compiles
    costs: dict[str, list[float]] = {name: [] for name in entries}
    for _ in range(rounds):
        for name, run in entries.items():
            began = time.process_time()
            run()
            costs[name].append((time.process_time() - began) / len(PEAKS))
    rows = {
        name: {
            "peaks": peak.tolist(),
            "error": float(np.max(np.abs(peak / exact - 1))),
            "ms": 1e3 * float(np.median(costs[name])),
        }
        for name, peak in peaks.items()
    }
    published = [peak for _, peak in PEAKS.values()]
    return {"force": list(PEAKS), "published, 8": published, "marched": exact.tolist(), "ways": rows, "absent": absent}


def print_table(found: dict) -> None:
    """A line for each way."""
    print("largest y at F =", ", ".join(f"{force:.0f}" for force in found["force"]), "N; harmonics after the comma")
    lines = {"published, 8": (found["published, 8"], ""), "marched": (found["marched"], "")}
    lines |= {name: (row["peaks"], f"{row['error']:9.1e}{row['ms']:10.3g} ms") for name, row in found["ways"].items()}
    for name, (peaks, rest) in lines.items():
        print(f"{name:<14}" + "".join(f"{peak:10.4f}" for peak in peaks) + rest)
    for name, reason in found["absent"].items():
        print(f"{name}: {reason}")


def main(words: list[str] | None = None, results: Path = RESULTS) -> None:
    """Print a table and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--harmonics", type=int, nargs="+", default=[1, 3, 8, 15, 31])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args(words)
    jax.config.update("jax_enable_x64", True)
    found = measured(options.harmonics, options.rounds)
    print_table(found)
    results.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
