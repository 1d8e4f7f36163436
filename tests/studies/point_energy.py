"""Does the energy of scenes with points balance? python tests/studies/point_energy.py

Random pairs with two and three points, and chains and rings of three blades with two, half of them light, are marched
over four periods from rest. What is told is the largest residual of the energy balance of a period over the mean work
of the drive, which is no larger than its gross work, and the events. It writes `point_energy.json`; `--scenes` says how
many pairs and how many rows.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxshroud as js

FILE = Path(__file__).with_suffix(".json")
STEPS = 1000
PERIODS, BALANCES = 4, 1e-9
ROW = ("row.blades=3", "drive.engine_order=1")
STRUCTURES = {  # name -> the shipped scene, changes
    "pairs": [("table1", ("contact.points=2",)), ("table1", ("contact.points=3",))],
    "rows": [
        ("row_ring12", (*ROW, "row.closed=true", "contact.points=2")),
        ("row_ring12", (*ROW, "row.closed=false", "contact.points=2")),
    ],
}


def random_scenes(shipped: str, changes: tuple[str, ...], count: int, seed: int) -> js.Scene:
    """Scenes of one structure with random numbers (leading axis), every other one light."""
    scenes = []
    for i in range(count):
        draw = np.random.default_rng([seed, i])
        light = i % 2 == 0
        numbers = {
            "blades.I": 2.46e-5 if light else 2.46e-3,
            "drive.M_0": draw.uniform(0.05, 1.0) if light else draw.uniform(1.0, 40.0),
            "contact.gamma": draw.uniform(0.5, 6.0),
            "friction.mu": draw.uniform(0.1, 0.7),
            "friction.k_d": 10 ** draw.uniform(5, 6.3),
            "drive.F_0": draw.uniform(20, 80),
            "shroud.gap": draw.uniform(-20e-6, 60e-6),
            "shroud.alpha": draw.uniform(0.6, 1.3),
        }
        scenes.append(js.load(shipped, [*changes, *(f"{key}={value}" for key, value in numbers.items())]).scene)
    return jax.tree.map(lambda *a: np.stack(a), *scenes)


def residuals(scenes: js.Scene, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray]:
    """The largest energy residual of a period of scenes over the mean work of the drive, and their events."""
    method = js.RungeKutta("dopri8", steps=steps)
    ran = js.sweep(scenes, n_periods=PERIODS, transient=0, method=method, ledger=True)
    assert not np.any(ran.status)
    counts = [np.reshape(count, (len(ran.status), -1)).sum(axis=-1) for count in ran.counters.values()]
    return np.abs(np.asarray(ran.energy_residual)), np.sum(counts, axis=0)


def figures(kind: str, count: int) -> dict[str, Any]:
    """The residuals of so many scenes of one kind."""
    of = STRUCTURES[kind]
    found = [residuals(random_scenes(*one, count // len(of), seed)) for seed, one in enumerate(of)]
    every, events = (np.concatenate(a) for a in zip(*found, strict=True))
    return {
        "scenes": len(every),
        "balanced": int(np.sum(every < BALANCES)),
        "median": float(np.median(every)),
        "largest": float(every.max()),
        "fewest events": int(events.min()),
        "residuals": every.tolist(),
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=100)
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = {}
    for kind in STRUCTURES:
        found[kind] = figures(kind, asked.scenes)
        print(kind, {name: value for name, value in found[kind].items() if name != "residuals"}, flush=True)
        FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
