"""Derivatives of scenes with contact points against differences: python tests/studies/point_derivatives.py.

Random pairs, light and with the article's inertia, and light rings of three, whose faces touch at two or three places,
are run until they settle on an orbit; the first of each structure that do are taken, and the derivatives of P_d by k,
k_d, mu, the gap and a place are compared with fourth-order central differences on orbits followed from scene to scene,
at two step sizes, of which the better counts. Scenes without a sound orbit, or whose blades never touch, are counted.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.verbs.gradient import differences

WRT = ("contact.k", "friction.k_d", "friction.mu", "shroud.gap", "contact.point[0].place")
STEPS = (1e-4, 1e-5)
METHOD = js.RungeKutta("dopri8", steps=150)
LIGHT, HEAVY = ("blades.I=2.46e-5",), ("blades.I=2.46e-3",)
RING = ("row.blades=3", "row.closed=true", "drive.engine_order=1")
STRUCTURES = {  # name -> the shipped scene, changes, number of points, number of scenes
    "light pair, two points": ("table1", LIGHT, 2, 4),
    "heavy pair, three points": ("table1", HEAVY, 3, 3),
    "light ring of three, two points": ("row_ring12", (*RING, *LIGHT), 2, 3),
}
TRIED, MOST_PERIODS = 30, 160


def random_scene(name: str, rng: np.random.Generator) -> js.Scene:
    """A scene of a structure with random numbers."""
    shipped, changes, points, _ = STRUCTURES[name]
    light = "blades.I=2.46e-5" in changes
    ends = rng.uniform(0.01, 0.0175, 2)
    places = [-ends[0], *([0.0] if points == 3 else []), ends[1]]
    shares = [0.5, 0.5] if points == 2 else [0.25, 0.5, 0.25]
    numbers = {
        "contact.points": [round(float(place), 6) for place in places],
        "contact.shares": shares,
        "contact.gamma": rng.uniform(0.8, 4.0),
        "shroud.gap": rng.uniform(5e-6, 40e-6),
        "friction.mu": rng.uniform(0.2, 0.7),
        "friction.k_d": 10 ** rng.uniform(5.3, 6.2),
        "drive.M_0": rng.uniform(0.1, 1.0) if light else rng.uniform(1.0, 20.0),
    }
    return js.load(shipped, [*changes, *(f"{key}={value}" for key, value in numbers.items())]).scene


def errors_of(found: js.Orbit) -> dict[str, float]:
    """The least relative errors of the derivatives of P_d on an orbit, by numbers."""
    exact = js.gradient(found.scene, WRT, orbit=found).value
    quotients = [differences(found, WRT, step) for step in STEPS]
    return {key: float(np.fmin.reduce([_relative_error(exact[key], one[key]) for one in quotients])) for key in WRT}


def _relative_error(exact: float, quotient: float) -> float:
    return abs(quotient / exact - 1) if exact else 0.0 if quotient == 0 else np.inf


def figures(name: str, count: int, seed: int) -> dict[str, Any]:
    """The errors of the first scenes of a structure that settle on a sound orbit with contact."""
    rng, kept, flags = np.random.default_rng(seed), [], Counter()
    for tried in range(1, TRIED + 1):
        found = js.orbit(random_scene(name, rng), method=METHOD, most_periods=MOST_PERIODS)
        if found.flags or js.gradient(found.scene, "shroud.gap", orbit=found).value["shroud.gap"] == 0:
            flags.update(found.flags or ("apart",))
            continue
        kept.append({"q": found.q, "largest multiplier": float(abs(found.multipliers[0])), "errors": errors_of(found)})
        print(f"{name}, {len(kept)} of {tried}: {kept[-1]}", file=sys.stderr, flush=True)
        if len(kept) == count:
            break
    every = np.array([list(row["errors"].values()) for row in kept])
    return {
        "tried": tried,
        "flags of the others": dict(flags),
        "derivatives": int(every.size),
        "within 1e-6": int(np.sum(every < 1e-6)),
        "median error": float(np.nanmedian(every)),
        "largest error": float(np.nanmax(every)),
        "scenes": kept,
    }


def main() -> None:
    """Write the figures of all structures."""
    jax.config.update("jax_enable_x64", True)
    found = {}
    for seed, name in enumerate(STRUCTURES):
        found[name] = figures(name, STRUCTURES[name][-1], seed)
        Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
