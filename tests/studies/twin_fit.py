"""A twin experiment of `fit`: python tests/studies/twin_fit.py [DRAWS].

Friction stiffness, friction coefficient, gap, contact stiffness and damping are to be found from x and y of both blades
over six periods from rest, measured 16 times a period with noise of 1 % of each signal's root mean square. Each draw
has noise of its own. What is measured is computed by dopri8 with bisection, at 800 steps a period; what is fitted is
marched by RK4. Nobody tells the fit how large the noise is, nor more of the numbers than bounds of 0.4 and 2.5 times
their values.

A draw counts as recovered where the joint 95 % region of all five numbers holds the truth: p F(p, n - p) of their
quadratic form. By chance it does so in 19 of 20 draws. Each number's own interval is counted too, 100 of them.
"""

import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

import jaxshroud as js

KEYS = ("friction.k_d", "friction.mu", "shroud.gap", "contact.k", "blades.c_x")
SCENE = ['parts.motion=["x","y"]', "contact.k=1e5", "drive.F_0=60"]
PERIODS, A_PERIOD, STEPS = 6, 16, 800
NOISE = 0.01  # of each signal's root mean square
BOUNDS = 0.4, 2.5  # over the true value
DRAWS, SEED = 20, 3
HOW = {"scan": 16, "starts": 2, "method": js.RungeKutta(steps=400)}


def twin_scene() -> js.Scene:
    """The scene with the true numbers, which touches, sticks and slips."""
    return js.load("table1", SCENE).scene


def exact_signals(scene: js.Scene) -> dict[str, np.ndarray]:
    """What sensors would see without noise, by the headers of columns."""
    fine = js.RungeKutta("dopri8", steps=STEPS, locate="bisection")
    run = js.simulate(scene, n_periods=PERIODS, every=STEPS // A_PERIOD, method=fine)
    signals = {f"{name}_{side} [m]": getattr(run.motion, name)[1:, i]
               for name in ("x", "y") for i, side in enumerate(("left", "right"))}  # fmt: skip
    return {"t [s]": run.t[1:], **signals}


def with_noise(exact: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The signals with independent normal noise."""
    size = {name: NOISE * np.sqrt(np.mean(q**2)) for name, q in exact.items() if name != "t [s]"}
    return {name: q + size.get(name, 0.0) * rng.standard_normal(q.shape) for name, q in exact.items()}


def distance(found: js.Fit, truth: dict[str, float]) -> float:
    """The quadratic form of the joint region over its 95 % limit: up to 1 within."""
    logs = {key: np.log([n.low, n.value, n.high]) for key, n in found.numbers.items()}
    deviation = np.array([(of[2] - of[0]) / 2 for of in logs.values()]) / student.ppf(0.975, found.freedom)
    away = np.array([np.log(truth[key]) - of[1] for key, of in logs.items()]) / deviation
    form = away @ np.linalg.solve(found.correlation, away)
    return float(form / (len(away) * fisher.ppf(0.95, len(away), found.freedom)))


def figures(draws: int, seed: int) -> dict[str, Any]:
    """How many draws are recovered, and how many of the intervals hold their number."""
    scene, rng = twin_scene(), np.random.default_rng(seed)
    truth, exact, each = {key: js.value_of(scene, key) for key in KEYS}, exact_signals(scene), []
    over = {key: (BOUNDS[0] * value, BOUNDS[1] * value) for key, value in truth.items()}
    for _ in range(draws):
        found = js.fit(scene, with_noise(exact, rng), over, **HOW)
        numbers = found.numbers
        each.append(
            {
                "distance": distance(found, truth),
                "held": {key: numbers[key].holds(truth[key]) for key in KEYS},
                "error": {key: numbers[key].value / truth[key] - 1 for key in KEYS},
                "half width": {key: float(np.log(numbers[key].high / numbers[key].low)) / 2 for key in KEYS},
                "noise": list(found.noise.values()),
                "notes": list(found.notes),
                "evaluations": found.evaluations,
            }
        )
        print(json.dumps(each[-1]), flush=True)
    return {
        "draws": draws,
        "recovered": sum(one["distance"] <= 1 for one in each),
        "held": {key: sum(one["held"][key] for one in each) for key in KEYS},
        "each": each,
    }


def main() -> None:
    """All draws."""
    jax.config.update("jax_enable_x64", True)
    js.cache_compilations()
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS
    told = {"command": "python tests/studies/twin_fit.py", "version": js.__version__, "seed": SEED}
    told |= figures(draws, SEED)
    print(json.dumps(told | {"each": ...}, default=str))
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
