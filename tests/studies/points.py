"""Do marches of faces with several points agree with independent ones? python tests/studies/points.py

Random pairs and rows, half of them light, are marched here and by `points_reference`, plain NumPy with a geometry of
its own. What is told of each: the largest difference of states at the ends of periods, over the largest size of each
quantity; where that is above 1e-8, how far a nudge of 1e-12 of the gap moves the reference; and whether all counts of
events are equal. It writes `points.json`; `--pairs` and `--rows` say how many of each, and `--series` marches them by
power series.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import jaxshroud as js

PERIODS, STEPS, STEPS_OF_REFERENCE = 2, 800, 400
RUNGE_KUTTA = js.RungeKutta("dopri8", STEPS, locate="bisection")
SERIES = js.Taylor(order=14, tolerance=1e-12, steps=STEPS)
AGREES = 1e-8
FILE = Path(__file__).with_suffix(".json")


def random_scene(seed: int, is_row: bool) -> js.Scene:
    """A random scene with points; every other one is light."""
    draw = np.random.default_rng(seed)
    light = seed % 2 == 0
    changes = [
        f"contact.points={draw.integers(2, 6)}",
        f"blades.I={2.46e-5 if light else 2.46e-3}",
        f"drive.M_0={draw.uniform(0.05, 1.0) if light else draw.uniform(1.0, 40.0)}",
        f"contact.gamma={draw.uniform(0.5, 6.0)}",
        f"friction.mu={draw.uniform(0.1, 0.7)}",
        f"friction.k_d={10 ** draw.uniform(5, 6.3)}",
        f"drive.F_0={draw.uniform(20, 80)}",
        f"shroud.gap={draw.uniform(-20e-6, 60e-6)}",
        f"shroud.alpha={draw.uniform(0.6, 1.3)}",
    ]
    if is_row:
        blades, closed = int(draw.integers(3, 6)), bool(draw.integers(2))
        changes += [f"row.blades={blades}", f"row.closed={str(closed).lower()}", "drive.engine_order=1"]
    return js.load("row_ring12" if is_row else "table1", changes).scene


def compared(scene: js.Scene, method: js.RungeKutta | js.Taylor) -> dict[str, Any]:
    """What is told of one scene."""
    from test_points import by_reference

    follow = lambda scene: by_reference(scene, PERIODS, STEPS_OF_REFERENCE)
    states, counts = follow(scene)
    run = js.simulate(scene, n_periods=PERIODS, method=method)
    size = np.abs(states).max(axis=(0, 2), keepdims=True)
    ends = np.stack(run.motion, axis=1)[STEPS::STEPS]
    error, moved = float(np.abs((ends - states) / size).max()), states
    if error > AGREES:
        moved = follow(js.vary(scene, "shroud.gap", scene.shroud.gap * (1 + 1e-12)))[0]
    same = [np.array_equal(np.ravel(run.counters[name]), of.sum(axis=-1)) for name, of in counts.items()]
    return {
        "points": scene.points,
        "error": error,
        "nudged": float(np.abs((moved - states) / size).max()),
        "counts equal": all(same),
        "events": int(sum(of.sum() for of in counts.values())),
        "energy residual": float(run.energy_residual),
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--rows", type=int, default=20)
    parser.add_argument("--series", action="store_true", help="march by power series")
    parser.add_argument("--resume", action="store_true", help="go on from the stored ones")
    asked = parser.parse_args()
    stored = json.loads(FILE.read_text(encoding="utf-8")) if asked.resume else {}
    found: dict[str, list[Any]] = dict(stored)
    method, suffix = (SERIES, " by series") if asked.series else (RUNGE_KUTTA, "")
    for kind, count in (("pairs", asked.pairs), ("rows", asked.rows)):
        own = found.setdefault(kind + suffix, [])
        for seed in range(len(own), count):
            own.append(compared(random_scene(seed, kind == "rows"), method))
            print(kind, seed, own[-1], flush=True)
            FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    import sys

    import jax

    jax.config.update("jax_enable_x64", True)
    folder = Path(__file__).parent.parent
    sys.path += [str(folder), str(folder / "march")]
    main()
