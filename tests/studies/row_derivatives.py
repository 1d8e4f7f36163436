"""Derivatives of rows of blades against differences: python tests/studies/row_derivatives.py.

Random rows of 3 to 5 blades, chains and rings, mistuned, in x and y or with torsion and the article's inertia, are run
until they settle on an orbit; the first five of each structure that do are taken, and the derivatives of P_d and of the
worst blade's by five numbers are compared with fourth-order central differences on orbits followed from scene to scene,
at two step sizes, of which the better counts. Rows without a sound orbit are counted with their flags, those
whose blades never touch as "apart".
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.verbs.gradient import differences

WRT = ("shroud.gap", "row.mistuning[1]", "friction.mu", "drive.omega", "contact.gamma[0]")
STEPS = (1e-4, 1e-5)
METHOD = js.RungeKutta("dopri8", steps=120)
IN_PLANE = ('parts.motion=["x","y"]',)
TURNING = ("blades.I=2.46e-3", "drive.M_0=30")
STRUCTURES = {
    "ring of 3, x and y": ("row.closed=true", "row.blades=3", *IN_PLANE),
    "chain of 5, x and y": ("row.closed=false", "row.blades=5", *IN_PLANE),
    "chain of 3": ("row.closed=false", "row.blades=3", *TURNING),
    "ring of 4": ("row.closed=true", "row.blades=4", *TURNING),
}
ROWS, TRIED, MOST_PERIODS = 5, 40, 128  # of each structure


def random_rows(structure: tuple[str, ...], rng: np.random.Generator) -> Iterator[Any]:
    """Scenes of a structure with random numbers."""
    blades = next(int(option.split("=")[1]) for option in structure if "blades=" in option)
    while True:
        numbers = {
            "shroud.gap": rng.uniform(-5e-6, 40e-6),
            "contact.gamma": rng.uniform(0.5, 4.0),
            "friction.mu": rng.uniform(0.1, 0.7),
            "drive.omega": rng.uniform(350.0, 750.0),
            "drive.engine_order": float(rng.integers(0, blades)),
            "row.mistuning": rng.normal(0.0, 0.03, blades).round(4).tolist(),
        }
        yield js.load("row_ring12", [*structure, *(f"{key}={value}" for key, value in numbers.items())]).scene


def errors_of(found: Any, of: str) -> dict[str, float]:
    """The least relative errors of the derivatives of `of` on an orbit, by numbers."""
    exact = js.gradient(found.scene, WRT, of=of, orbit=found).value
    quotients = [differences(found, WRT, step, of) for step in STEPS]
    return {key: float(np.fmin.reduce([_relative_error(exact[key], one[key]) for one in quotients])) for key in WRT}


def _relative_error(exact: float, quotient: float) -> float:
    return abs(quotient / exact - 1) if exact else 0.0 if quotient == 0 else np.inf


def _is_apart(found: Any) -> bool:
    """Whether the blades of an orbit never touch."""
    return js.gradient(found.scene, "shroud.gap", orbit=found).value["shroud.gap"] == 0


def figures(structure: tuple[str, ...], rows: int, seed: int) -> dict[str, Any]:
    """The errors of the first rows of a structure that settle on a sound orbit."""
    scenes, kept, flags = random_rows(structure, np.random.default_rng(seed)), [], Counter()
    for tried in range(1, TRIED + 1):
        found = js.orbit(next(scenes), method=METHOD, most_periods=MOST_PERIODS)
        if found.flags or _is_apart(found):
            flags.update(found.flags or ("apart",))
            continue
        errors = {of: errors_of(found, of) for of in ("P_d", "P_d_worst")}
        kept.append({"q": found.q, "largest multiplier": float(abs(found.multipliers[0])), "errors": errors})
        print(f"{len(kept)} of {tried}: {errors}", file=sys.stderr, flush=True)
        if len(kept) == rows:
            break
    every = np.array([list(by_key.values()) for row in kept for by_key in row["errors"].values()])
    return {
        "tried": tried,
        "flags of the others": dict(flags),
        "derivatives": int(every.size),
        "within 1e-6": int(np.sum(every < 1e-6)),
        "median error": float(np.nanmedian(every)),
        "largest error": float(np.nanmax(every)),
        "differences that do not close": int(np.isnan(every).sum()),
        "rows": kept,
    }


def main() -> None:
    """Write the figures of all structures."""
    jax.config.update("jax_enable_x64", True)
    found = {}
    for seed, (name, structure) in enumerate(STRUCTURES.items()):
        found[name] = figures(structure, ROWS, seed)
        Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
